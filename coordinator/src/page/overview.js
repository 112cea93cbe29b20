// The farm at a glance.

import { element, size, span } from "./words.js";

/** What there is of disks: parts that lie on one, and those of which nothing is known. */
function disksOf(stores) {
  const disks = new Map();
  for (const { part, free_bytes: free, total_bytes: total, low } of stores) {
    const key = total == null ? "" : `${free} ${total}`;
    if (!disks.has(key)) disks.set(key, { parts: [], free, total, low });
    disks.get(key).parts.push(part);
  }
  return [...disks.values()];
}

function diskText({ parts, free, total }, all) {
  const of = parts.length === all ? "" : `${parts.join(", ")}: `;
  return total == null ? `${of}not known` : `${of}${size(free)} of ${size(total)} free`;
}

/** Figures of the farm, above the jobs. */
export function overview(farm) {
  const list = element("dl", { class: "figures", "aria-label": "The farm at a glance" });
  const warnings = element("ul", { class: "obstacles", hidden: true });
  const node = element("div", {}, warnings, list);
  let shown = "";
  const update = () => {
    const at = farm.figures;
    if (!at) return;
    const apart = farm.workers.filter((worker) => worker.quarantine || worker.drained || worker.rest).length;
    const [pace, pending] = [at.iterations_per_second, at.pending_iterations];
    const left = pace > 0 && pending > 0 ? `, about ${span(pending / pace)}` : "";
    const disks = disksOf(at.stores);
    const held = at.job_bytes == null ? "" : `; jobs hold ${size(at.job_bytes)}`;
    const figures = [
      ["Workers", `${at.workers_at_work} of ${at.workers} at work${apart ? `, ${apart} apart` : ""}`],
      ["Jobs", `${at.jobs_running} begun, ${at.jobs_queued} queued`],
      ["Pace", pace > 0 ? `${(60 * pace).toPrecision(3)} iterations a minute` : "none"],
      ["Backlog", `${pending} iterations${left}`],
      ["Disk", `${disks.map((disk) => diskText(disk, at.stores.length)).join("; ")}${held}`],
    ];
    const told = [
      ...farm.obstacles.map(({ part, detail }) => `${part}: ${detail}`),
      ...disks.filter(({ low }) => low).map(({ parts, free }) => `${parts.join(", ")}: only ${size(free)} are left on the disk. Delete jobs, or have the coordinator do so (serve --keep-days, --keep-gigabytes).`),
    ];
    const now = JSON.stringify([figures, told]);
    if (now === shown) return;
    shown = now;
    warnings.hidden = told.length === 0;
    warnings.replaceChildren(...told.map((text) => element("li", {}, text)));
    list.replaceChildren(...figures.map(([name, value]) => element("div", {}, element("dt", {}, name), element("dd", {}, value))));
  };
  return { node, update };
}
