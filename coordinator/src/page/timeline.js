// Leases on a time line, a row for each worker.

import { element, shape } from "./words.js";

const [WIDTH, ROW, LEFT, BOTTOM] = [960, 24, 150, 24];
/** More rows are not drawn: those of the workers whose leases are oldest. */
const ROWS = 40;

function clock(time) {
  return new Date(time).toLocaleTimeString();
}

function range({ first, last }) {
  return first === last ? `iteration ${first}` : `iterations ${first} to ${last}`;
}

function said(lease) {
  const ends = lease.to ? `${clock(lease.from)} to ${clock(lease.to)}` : `since ${clock(lease.from)}`;
  return `${lease.name || `worker ${lease.worker}`}: ${lease.verifies ? "repeats " : ""}${range(lease)}, ${lease.outcome}, ${ends}${lease.attempt > 1 ? `, attempt ${lease.attempt}` : ""}`;
}

/** The rows: workers by name, the latest leases below. */
function rowsOf(leases) {
  const rows = new Map();
  for (const lease of leases) {
    if (!rows.has(lease.worker)) rows.set(lease.worker, []);
    rows.get(lease.worker).push(lease);
  }
  return [...rows].slice(-ROWS).sort(([a], [b]) => a - b);
}

export function timeline() {
  const svg = shape("svg", { class: "plot", role: "img" });
  const list = element("ul", { class: "leases" });
  const node = element("section", { hidden: true }, element("h2", {}, "Leases"),
    element("div", { class: "wide", tabindex: 0, role: "region", "aria-label": "Leases on a time line" }, svg),
    element("p", { class: "keys" }, ["held", "delivered", "failed", "lost", "ended"].map((outcome) => element("span", { class: outcome }, outcome))),
    element("details", {}, element("summary", {}, "The latest leases in words"), list));
  const update = (leases) => {
    node.hidden = leases.length === 0;
    if (node.hidden) return;
    const now = leases.some((lease) => !lease.to) ? Date.now() : Math.max(...leases.map((lease) => Date.parse(lease.to)));
    const begin = Math.min(...leases.map((lease) => Date.parse(lease.from)));
    const x = (time) => LEFT + ((time - begin) / Math.max(now - begin, 1)) * (WIDTH - LEFT - 8);
    const rows = rowsOf(leases);
    const height = rows.length * ROW + BOTTOM;
    svg.setAttribute("viewBox", `0 0 ${WIDTH} ${height}`);
    svg.setAttribute("aria-label", `${leases.length} leases of ${rows.length} workers from ${clock(begin)} to ${clock(now)}; below in words`);
    const parts = rows.flatMap(([worker, own], row) => {
      const name = shape("text", { x: 4, y: row * ROW + 16 }, `${worker}  ${own.at(-1).name}`.slice(0, 20));
      return [name, ...own.map((lease) => {
        const [from, to] = [x(Date.parse(lease.from)), x(lease.to ? Date.parse(lease.to) : now)];
        return shape("rect", { x: from, y: row * ROW + 4, width: Math.max(to - from - 1, 2), height: ROW - 8, rx: 2, class: `lease ${lease.outcome}` }, shape("title", {}, said(lease)));
      })];
    });
    for (const share of [0, 0.5, 1]) {
      const at = begin + share * (now - begin);
      parts.push(shape("text", { x: x(at), y: height - 6, class: ["start", "middle", "end"][2 * share] }, clock(at)));
    }
    svg.replaceChildren(...parts);
    list.replaceChildren(...leases.slice(-50).reverse().map((lease) => element("li", {}, said(lease))));
  };
  return { node, update };
}
