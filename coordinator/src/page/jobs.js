// The list of jobs: the newest as they change, and older ones on demand.

import { dropView } from "./drop.js";
import { acting } from "./farm.js";
import { overview } from "./overview.js";
import { afterTheNewest, look } from "./pages.js";
import { element, ended, nameOf, progressOf, reasonOf, since, stateOf } from "./words.js";

const STATES = ["queued", "running", "paused", "done", "failed", "cancelled"];
/** Time after which older jobs that go on are looked at again [ms]. */
const OLD = 10_000;

/** A small picture of a job as it stands; another address for every number of iterations. */
function thumbnailOf(job) {
  return `v1/jobs/${job.id}/image.jpg?iterations=${job.iterations_done}`;
}

function card(id) {
  const picture = element("img", { class: "thumbnail", alt: "", loading: "lazy" });
  const link = element("a", { href: `#/jobs/${id}` });
  const bar = element("progress", { "aria-label": "iterations" });
  const [state, done, reason] = [element("p"), element("p"), element("p", { class: "quiet" })];
  const node = element("li", { class: "job" }, picture, element("div", {}, element("h2", {}, link), state, bar, done, reason));
  const update = (job) => {
    link.textContent = `${id}  ${nameOf(job)}`;
    state.textContent = [stateOf(job), job.owner, `${since(job.created)} ago`].filter(Boolean).join(", ");
    state.className = job.state;
    bar.max = job.spec.iterations;
    bar.value = job.iterations_rendered;
    done.textContent = progressOf(job);
    reason.textContent = reasonOf(job);
    if (job.iterations_done > 0 && picture.getAttribute("src") !== thumbnailOf(job)) picture.src = thumbnailOf(job);
  };
  return { node, update };
}

/** What people look for: a text in a job's number, name, owner or labels, and a state. */
function filterView(changed) {
  const text = element("input", { type: "search", name: "find", placeholder: "number, name, owner, label", input: () => changed() });
  const state = element("select", { name: "state", change: () => changed() }, element("option", { value: "" }, "any"), STATES.map((value) => element("option", { value }, value)));
  const node = element("form", { class: "actions", role: "search", "aria-label": "Jobs", submit: (event) => event.preventDefault() },
    element("label", {}, "Find", text), element("label", {}, "State", state));
  const words = (job) => [job.id, nameOf(job), job.spec.main, job.owner, ...Object.entries(job.spec.labels ?? {}).map(([name, value]) => `${name}=${value}`)].join("\n").toLowerCase();
  const matches = (job) => (!state.value || stateOf(job) === state.value) && words(job).includes(text.value.trim().toLowerCase());
  return { node, matches, isSet: () => Boolean(state.value || text.value.trim()) };
}

/** The cards of some jobs, in their order. */
function cardsView() {
  const node = element("ul", { class: "jobs" });
  const cards = new Map();
  const update = (jobs) => {
    const here = new Set(jobs.map((job) => job.id));
    for (const [id, one] of cards) {
      if (here.has(id)) continue;
      one.node.remove();
      cards.delete(id);
    }
    jobs.forEach((job, place) => {
      if (!cards.has(job.id)) cards.set(job.id, card(job.id));
      const one = cards.get(job.id);
      one.update(job);
      if (node.children[place] !== one.node) node.insertBefore(one.node, node.children[place] ?? null);
    });
  };
  return { node, update };
}

export function jobsView(farm, tell) {
  const act = acting(tell);
  const cards = cardsView();
  const none = element("p", { hidden: true }, "There are no jobs. ", element("code", {}, "photonfarm submit scene.xml"), " sends one, and so does a scene that is dropped here.");
  const [glance, drop, filter] = [overview(farm), dropView(tell), filterView(() => newest())];
  drop.node.hidden = farm.role === "read";
  const told = element("p", { class: "quiet", role: "status" });
  const button = (text, run) => element("button", { type: "button", hidden: true, click: () => act(run) }, text);
  const [first, older] = [button("Newest jobs", () => newest()), button("Older jobs", () => goOlder())];
  const node = element("section", {}, element("h1", {}, "Jobs"), glance.node, drop.node, filter.node, none, cards.node, element("div", { class: "actions" }, first, older, told));
  // Older jobs as they were found: from which cursor on, which, and where those after them begin; nothing while the newest are shown.
  let [past, looking, at, end] = [null, 0, 0, false];

  async function find(cursor) {
    const mine = (looking += 1);
    const going = (looked) => {
      if (mine === looking) told.textContent = `${looked} older jobs looked at`;
      return mine === looking;
    };
    const found = await look(cursor, filter.matches, going);
    if (!found) return;
    [past, at] = [{ ...found, from: cursor }, Date.now()];
    update();
  }
  async function goOlder() {
    const cursor = past ? past.next : await afterTheNewest();
    end = !cursor;
    if (cursor) await find(cursor);
    else update();
  }
  function newest() {
    looking += 1;
    past = null;
    update();
  }
  const update = () => {
    glance.update();
    const live = [...farm.jobs.values()].sort((a, b) => b.id - a.id).filter(filter.matches);
    const jobs = past ? past.jobs.map((job) => farm.jobs.get(job.id) ?? job) : live;
    none.hidden = farm.jobs.size > 0;
    first.hidden = !past;
    older.hidden = past ? !past.next : end || farm.jobs.size < 100;
    told.textContent = past ? `${jobs.length} of ${past.looked} older jobs` : filter.isSet() ? `${jobs.length} of the newest ${farm.jobs.size} jobs` : "";
    cards.update(jobs);
    if (past && Date.now() - at > OLD && jobs.some((job) => !ended(job))) {
      at = Date.now();
      act(() => find(past.from));
    }
  };
  const stop = () => {
    looking += 1;
    drop.stop();
  };
  return { title: "Jobs", node, update, stop };
}
