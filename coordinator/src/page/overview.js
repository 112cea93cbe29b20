// The farm at a glance.

import { element, ended, span, stateOf } from "./words.js";

/** Figures of the farm, above the jobs. */
export function overview(farm) {
  const list = element("dl", { class: "figures", "aria-label": "The farm at a glance" });
  const obstacles = element("ul", { class: "obstacles", hidden: true });
  const node = element("div", {}, obstacles, list);
  let shown = "";
  const update = () => {
    const jobs = [...farm.jobs.values()].filter((job) => !ended(job));
    const running = jobs.filter((job) => job.workers > 0);
    const pace = running.reduce((sum, job) => sum + (job.iterations_per_second ?? 0), 0);
    const workers = farm.workers.filter((worker) => worker.silent_ms < 60_000);
    const apart = workers.filter((worker) => worker.quarantine || worker.drained || worker.rest).length;
    const waiting = jobs.filter((job) => job.waiting && stateOf(job) !== "paused").length;
    const left = pace > 0 && farm.pending > 0 ? `, about ${span(farm.pending / pace)}` : "";
    const figures = [
      ["Workers", `${workers.filter((worker) => worker.leases > 0).length} of ${workers.length} at work${apart ? `, ${apart} apart` : ""}`],
      ["Jobs", `${running.length} at work${waiting ? `, ${waiting} waiting` : ""}`],
      ["Pace", pace > 0 ? `${(60 * pace).toPrecision(3)} iterations a minute` : "none"],
      ["Backlog", `${farm.pending} iterations${left}`],
    ];
    const now = JSON.stringify([figures, farm.obstacles]);
    if (now === shown) return;
    shown = now;
    obstacles.hidden = farm.obstacles.length === 0;
    obstacles.replaceChildren(...farm.obstacles.map((obstacle) => element("li", {}, `${obstacle.part}: ${obstacle.detail}`)));
    list.replaceChildren(...figures.map(([name, value]) => element("div", {}, element("dt", {}, name), element("dd", {}, value))));
  };
  return { node, update };
}
