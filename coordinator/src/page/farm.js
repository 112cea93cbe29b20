// What the page knows of the farm: it asks by `fetch`, and hears what changes as server-sent events.
// All addresses are relative, so that the farm may lie behind a prefix.

/** An answer that is no success, with its status and what the farm says of it. */
export class Refused extends Error {
  constructor(status, message) {
    super(message);
    this.status = status;
  }
}

/** Sends a request and reads the answer's JSON. */
export async function ask(method, path, body, headers = {}) {
  const json = body === undefined ? {} : { "content-type": "application/json" };
  const answer = await fetch(`v1/${path}`, {
    method,
    headers: { ...json, ...headers },
    body: body === undefined ? undefined : JSON.stringify(body),
    cache: "no-store",
  });
  if (answer.ok) return answer.status === 204 ? null : answer.json();
  const problem = await answer.json().catch(() => ({}));
  throw new Refused(answer.status, problem.detail ?? problem.title ?? `the farm answers ${answer.status}`);
}

/** What runs a request and tells what went wrong, or takes away what was told. */
export function acting(tell) {
  return async (run) => {
    try {
      await run();
      tell("");
    } catch (error) {
      tell(error.message);
    }
  };
}

/** Follows the farm. `changed` is called after every change, `connected` with true or false. Returns what is known, and `stop`. */
export function follow(changed, connected) {
  const farm = { jobs: new Map(), workers: [], figures: null, obstacles: [], heard: false, stop: () => source.close() };
  const source = new EventSource("v1/events");
  source.addEventListener("farm", (event) => {
    const news = JSON.parse(event.data);
    if (news.whole) farm.jobs.clear();
    for (const job of news.jobs) farm.jobs.set(job.id, job);
    for (const id of news.gone) farm.jobs.delete(id);
    if (news.workers) farm.workers = news.workers;
    farm.figures = news.figures;
    farm.obstacles = news.obstacles ?? [];
    farm.heard = true;
    connected(true);
    changed();
  });
  source.addEventListener("error", () => connected(false, source.readyState === EventSource.CLOSED));
  return farm;
}

/** Follows one job that the farm does not tell of, from `start` on. `changed` is called after every change. */
export function followOne(id, changed) {
  const one = { job: null, missing: false, start, stop: () => source?.close() };
  let [source, begun] = [null, false];
  const hear = (event) => {
    one.job = JSON.parse(event.data);
    changed();
  };
  async function start() {
    if (begun) return;
    begun = true;
    try {
      one.job = await ask("GET", `jobs/${id}`);
      source = new EventSource(`v1/jobs/${id}/events`);
      source.addEventListener("status", hear);
      source.addEventListener("end", (event) => {
        source.close();
        hear(event);
      });
    } catch (error) {
      one.missing = error.status === 404;
      // The farm may be away for a moment.
      if (!one.missing) setTimeout(() => (begun = false), 2000);
    }
    if (one.job || one.missing) changed();
  }
  return one;
}
