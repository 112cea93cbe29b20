// The workers, and what is thought of them.

import { acting, ask } from "./farm.js";
import { overview } from "./overview.js";
import { element, memory, span } from "./words.js";

function stateOfWorker(worker) {
  if (worker.quarantine) return `in quarantine: ${worker.quarantine}`;
  const state = worker.leases > 0 ? "working" : "idle";
  if (worker.rest && !worker.drained) {
    const why = worker.rest.reason === "hours" ? "outside its hours" : "somebody else uses its machine";
    const until = worker.rest.until ? ` until ${new Date(worker.rest.until).toLocaleString()}` : "";
    return `${worker.leases > 0 ? "finishes what it holds, then rests" : "resting"}${until}: ${why}`;
  }
  if (!worker.drained) return state;
  return worker.leases > 0 ? "finishes what it holds" : "drained";
}

export function workersView(farm, tell) {
  const glance = overview(farm);
  const rows = element("tbody");
  const head = ["Worker", "State", "", "Jobs", "Speed", "Threads", "Memory", "Heard of", "From", "Confirmed", "Faults", "Tags", "Renderer"];
  const table = element("table", {}, element("thead", {}, element("tr", {}, head.map((text) => element("th", { scope: "col" }, text || element("span", { class: "skip" }, "Actions"))))), rows);
  const none = element("p", { hidden: true }, "No worker is there. ", element("code", {}, `photonfarm-worker --coordinator ${location.origin}`), " starts one.");
  const node = element("section", {}, element("h1", {}, "Workers"), glance.node, none, element("div", { class: "wide", tabindex: 0, role: "region", "aria-label": "Workers" }, table));
  const known = new Map();
  const act = acting(tell);
  const row = (id) => {
    const cells = head.slice(3).map(() => element("td"));
    const state = element("td");
    const name = element("th", { scope: "row" });
    const isolate = element("button", { type: "button", class: "bad", click: () => act(() => ask("POST", `workers/${id}/quarantine`, { reason: "from the page" })) }, "Quarantine");
    const release = element("button", { type: "button", click: () => act(() => ask("POST", `workers/${id}/release`, {})) }, "Release");
    const drain = element("button", { type: "button", title: "It finishes what it holds, and gets no more", click: () => act(() => ask("POST", `workers/${id}/drain`, {})) }, "Drain");
    const resume = element("button", { type: "button", click: () => act(() => ask("POST", `workers/${id}/resume`, {})) }, "Resume");
    const node = element("tr", {}, name, state, element("td", {}, drain, resume, " ", isolate, release), cells);
    const update = (worker) => {
      const speed = worker.iterations_per_second;
      name.textContent = `${id}  ${worker.name}`;
      [
        worker.jobs.join(", "),
        speed ? `${(60 * speed).toPrecision(3)} a minute` : "",
        worker.threads,
        memory(worker.memory_mb),
        `${span(worker.silent_ms / 1000)} ago`,
        [worker.token, worker.machine].filter(Boolean).join("@"),
        worker.verified,
        worker.faults,
        worker.tags.join(", "),
        worker.renderer,
      ].forEach((text, index) => (cells[index].textContent = text));
      state.textContent = stateOfWorker(worker);
      const rules = farm.role === "admin";
      drain.hidden = !rules || worker.drained;
      resume.hidden = !rules || !worker.drained;
      state.className = worker.quarantine ? "quarantine" : "";
      isolate.hidden = !rules || Boolean(worker.quarantine);
      release.hidden = !rules || !worker.quarantine;
    };
    return { node, update };
  };
  const update = () => {
    glance.update();
    none.hidden = farm.workers.length > 0;
    table.hidden = farm.workers.length === 0;
    const here = new Set(farm.workers.map((worker) => worker.id));
    for (const [id, { node }] of known) {
      if (!here.has(id)) {
        node.remove();
        known.delete(id);
      }
    }
    for (const worker of farm.workers) {
      if (!known.has(worker.id)) {
        known.set(worker.id, row(worker.id));
        rows.append(known.get(worker.id).node);
      }
      known.get(worker.id).update(worker);
    }
  };
  return { title: "Workers", node, update };
}
