// What has happened to a job: plots, leases, failures.

import { ask } from "./farm.js";
import { plot, widths } from "./plots.js";
import { timeline } from "./timeline.js";
import { choice } from "./viewer.js";
import { element } from "./words.js";

/** Least time between two looks at the history [ms]. */
const STEP = 2000;

/** Iterations per minute between samples: forty steps, of a second at least. */
function rates(progress) {
  const list = [];
  let from = progress[0];
  const minutesTo = (sample) => (Date.parse(sample.at) - Date.parse(from.at)) / 60_000;
  const step = progress.length > 1 ? Math.max(1 / 60, minutesTo(progress.at(-1)) / 40) : 0;
  for (const sample of progress.slice(1)) {
    const minutes = minutesTo(sample);
    if (minutes < step) continue;
    list.push({ ...sample, rate: Math.max(0, sample.iterations - from.iterations) / minutes });
    from = sample;
  }
  return list;
}

/** A span as clocks show it: 1:40 is a minute and forty seconds, 2 h 05 more than two hours. */
function hours(seconds) {
  const [h, m, s] = [Math.floor(seconds / 3600), Math.floor((seconds % 3600) / 60), Math.floor(seconds % 60)];
  const two = (number) => String(number).padStart(2, "0");
  return h > 0 ? `${h} h ${two(m)}` : `${m}:${two(s)}`;
}

/** When so many iterations were there, between samples; nothing outside of them. */
function timeOf(progress, iterations) {
  const after = progress.findIndex((sample) => sample.iterations >= iterations);
  if (after < 1) return after === 0 ? Date.parse(progress[0].at) : NaN;
  const [a, b] = [progress[after - 1], progress[after]];
  const share = (iterations - a.iterations) / (b.iterations - a.iterations);
  return Date.parse(a.at) + share * (Date.parse(b.at) - Date.parse(a.at));
}

function plots() {
  let [against, last] = ["time", null];
  const noise = plot("Noise", { logarithmic: true });
  const pace = plot("Iterations a minute", { fromZero: true });
  const sigma = plot("Sigma", { logarithmic: true });
  const theta = plot("Theta", { logarithmic: true, unit: "°" });
  const axis = choice("Against", [["Time", "time"], ["Iterations", "iterations"]], against, (value) => {
    against = value;
    if (last) update(...last);
  });
  const node = element("section", { hidden: true }, element("div", { class: "head" }, element("h2", {}, "Curves"), axis.node),
    element("div", { class: "plots" }, [noise, pace, sigma, theta].map((one) => one.node)));
  const update = (job, history) => {
    last = [job, history];
    const begin = Date.parse(job.created);
    const byTime = against === "time";
    const below = byTime ? { below: "against time", across: hours } : { below: "against iterations", across: (value) => String(Math.round(value)) };
    const place = (sample) => (byTime ? (Date.parse(sample.at) - begin) / 1000 : sample.iterations);
    // The ends are known however short the coordinator's memory is.
    const ends = [{ at: job.created, iterations: 0 }, { at: job.ended ?? new Date().toISOString(), iterations: job.iterations_done }];
    const progress = [ends[0], ...history.progress, ends[1]];
    const placeOf = (iterations) => (byTime ? (timeOf(progress, iterations) - begin) / 1000 : iterations);
    noise.update(history.noise.map((sample) => [place(sample), sample.noise]), below);
    pace.update(rates(history.progress).map((sample) => [place(sample), sample.rate]), below);
    const list = widths(job);
    sigma.update(list.map(([i, value]) => [placeOf(i), value]), below);
    theta.update(list.map(([i, , value]) => [placeOf(i), value]), below);
    node.hidden = [noise, pace, sigma, theta].every((one) => one.node.hidden);
  };
  return { node, update };
}

function failures() {
  const list = element("ul");
  const node = element("section", { hidden: true }, element("h2", {}, "Attempts that failed"), list);
  const update = (job, history) => {
    const givenUp = new Set(job.poisoned.map((it) => it.iteration));
    node.hidden = history.failures.length === 0;
    list.replaceChildren(...history.failures.map(({ iteration, attempts }) =>
      element("li", {}, `iteration ${iteration}${givenUp.has(iteration) ? ", given up" : ""}: `,
        attempts.map((it) => `${new Date(it.at).toLocaleTimeString()} worker ${it.worker}, ${it.kind}: ${it.message}`).join("; "))));
  };
  return { node, update };
}

/** Fetches the history whenever the job has moved, and shows it. */
export function historyView(id) {
  const [curves, leases, failed] = [plots(), timeline(), failures()];
  let [busy, seen, stopped] = [false, "", false];
  const update = async (job) => {
    const now = JSON.stringify([job.iterations_done, job.iterations_rendered, job.state, job.workers, job.spec.iterations, job.integrator, job.poisoned.length]);
    if (busy || stopped || now === seen) return;
    busy = true;
    try {
      const history = await ask("GET", `jobs/${id}/history`);
      seen = now;
      curves.update(job, history);
      leases.update(history.leases);
      failed.update(job, history);
    } catch {
      // The stream tells when the farm is back.
    }
    setTimeout(() => (busy = false), STEP);
  };
  return { nodes: [failed.node, curves.node, leases.node], update, stop: () => (stopped = true) };
}
