// One job: its picture as it sharpens, what it does, and what can be done with it.

import { acting, ask } from "./farm.js";
import { pictureOf } from "./jobs.js";
import { element, ended, nameOf, progressOf, reasonOf, since, span, stateOf } from "./words.js";

const ZOOMS = [["Fit", 0], ["1:1", 1], ["2:1", 2], ["4:1", 4], ["8:1", 8]];

/** The picture, which is replaced when the next one is there: nothing flickers. */
function pictureView() {
  const image = element("img", { class: "fit", alt: "The picture as it stands" });
  const frame = element("div", { class: "picture", tabindex: 0, role: "region", "aria-label": "Picture" }, image);
  let [zoom, wanted] = [0, ""];
  const size = () => {
    image.className = zoom === 0 ? "fit" : "";
    if (zoom > 0) image.width = image.naturalWidth * zoom;
    else image.removeAttribute("width");
  };
  image.addEventListener("load", size);
  const buttons = ZOOMS.map(([text, factor]) =>
    element("button", {
      type: "button",
      "aria-pressed": String(factor === zoom),
      click: () => {
        zoom = factor;
        buttons.forEach((button, index) => button.setAttribute("aria-pressed", String(ZOOMS[index][1] === zoom)));
        size();
      },
    }, text));
  const update = (job) => {
    const source = job.iterations_done > 0 ? pictureOf(job) : "";
    if (!source || source === wanted) return;
    wanted = source;
    const next = new Image();
    next.onload = () => {
      if (wanted === source) image.src = source;
    };
    next.src = source;
  };
  return { nodes: [element("div", { class: "actions", role: "group", "aria-label": "Zoom" }, buttons), frame], update };
}

function facts(job) {
  const seconds = Object.values(job.totals.seconds).reduce((sum, value) => sum + value, 0);
  const bandwidth = job.totals.bandwidth;
  return [
    ["State", stateOf(job)],
    ["Progress", progressOf(job)],
    ["Reason", reasonOf(job)],
    ["Owner", job.owner],
    ["Submitted", `${new Date(job.created).toLocaleString()} (${since(job.created)} ago)`],
    ["Ended", job.ended && new Date(job.ended).toLocaleString()],
    ["Workers", ended(job) ? "" : String(job.workers)],
    ["Pace", job.iterations_per_second ? `${(60 * job.iterations_per_second).toPrecision(3)} iterations a minute` : ""],
    ["Rendering took", seconds > 0 ? `${span(seconds)} of all workers` : ""],
    ["Noise", job.checkpoint ? `${job.checkpoint.noise?.toPrecision(3)} after ${job.checkpoint.iterations} iterations` : ""],
    ["Sigma", bandwidth ? `${bandwidth.sigma[0].toPrecision(3)} to ${bandwidth.sigma[1].toPrecision(3)}` : ""],
    ["Theta", bandwidth?.theta ? bandwidth.theta.map((it) => `${((it * 180) / Math.PI).toPrecision(3)}°`).join(" to ") : ""],
    ["In doubt", job.iterations_in_doubt > 0 ? `${job.iterations_in_doubt} iterations are repeated` : ""],
    ["Size", job.resolution ? job.resolution.join(" × ") : ""],
    ["Scene", job.spec.main],
    ["Seed", String(job.spec.seed ?? 0)],
    ["Renderer", job.renderer],
  ].filter(([, value]) => value);
}

/** Buttons for what may be done with the job as it stands. */
function actionsView(id, act) {
  const more = element("input", { type: "number", min: 1, step: 1, required: true });
  const priority = element("input", { type: "number", min: 1, max: 100, step: 1, required: true });
  const button = (text, run, attributes = {}) => element("button", { type: "button", click: () => act(run), ...attributes }, text);
  const pause = button("Pause", () => ask("POST", `jobs/${id}/pause`, {}));
  const resume = button("Resume", () => ask("POST", `jobs/${id}/resume`, {}));
  const cancel = button("Cancel", () => confirm(`Cancel job ${id}? What has arrived stays.`) && ask("POST", `jobs/${id}/cancel`, {}), { class: "bad" });
  const remove = button("Delete", () => confirm(`Delete job ${id} with its picture?`) && ask("DELETE", `jobs/${id}`), { class: "bad" });
  const form = (label, field, text, run) =>
    element("form", {
      class: "actions",
      submit: (event) => {
        event.preventDefault();
        act(run);
      },
    }, element("label", {}, label, field), element("button", {}, text));
  const extend = form("Iterations", more, "Extend", () => ask("POST", `jobs/${id}/extend`, { iterations: Number(more.value) }));
  const weight = form("Priority", priority, "Set", () => ask("PUT", `jobs/${id}/priority`, { priority: Number(priority.value) }));
  const update = (job) => {
    const state = stateOf(job);
    pause.hidden = ended(job) || state === "paused";
    resume.hidden = state !== "paused";
    cancel.hidden = ended(job);
    remove.hidden = !ended(job);
    weight.hidden = ended(job);
    extend.hidden = ["failed", "cancelled"].includes(job.state);
    if (!more.value) more.value = 2 * job.spec.iterations;
    if (!priority.value) priority.value = job.spec.schedule?.priority ?? 10;
  };
  return { nodes: [element("div", { class: "actions" }, pause, resume, cancel, remove), element("div", { class: "actions" }, extend, weight)], update };
}

export function jobView(farm, id, tell) {
  const title = element("h1");
  const picture = pictureView();
  const links = element("p", {}, element("a", { href: `v1/jobs/${id}/image.exr`, download: `job-${id}.exr` }, "OpenEXR"), " ", element("a", { href: `v1/jobs/${id}/image.png`, download: `job-${id}.png` }, "PNG"));
  const [list, settings] = [element("dl"), element("pre", { tabindex: 0 })];
  const [warnings, failures] = [element("section"), element("section")];
  const act = acting(tell);
  const actions = actionsView(id, act);
  const bar = element("progress", { "aria-label": "iterations" });
  const body = element("div", {}, bar, picture.nodes, links, actions.nodes, element("h2", {}, "Now"), list, warnings, failures, element("h2", {}, "Settings"), settings);
  const gone = element("p", { hidden: true }, "There is no such job among the newest of the farm.");
  const node = element("section", {}, title, gone, body);
  const section = (node, text, items) =>
    node.replaceChildren(...(items.length === 0 ? [] : [element("h2", {}, text), element("ul", {}, items.map((item) => element("li", {}, item)))]));
  let shown = "";
  const update = () => {
    const job = farm.jobs.get(id);
    gone.hidden = Boolean(job);
    body.hidden = !job;
    title.textContent = job ? `${id}  ${nameOf(job)}` : `Job ${id}`;
    if (!job) return;
    bar.max = job.spec.iterations;
    bar.value = job.iterations_rendered;
    picture.update(job);
    links.hidden = job.iterations_done === 0;
    actions.update(job);
    list.replaceChildren(...facts(job).flatMap(([name, value]) => [element("dt", {}, name), element("dd", {}, value)]));
    const now = JSON.stringify([job.warnings, job.poisoned, job.integrator]);
    if (now === shown) return;
    shown = now;
    section(warnings, "Warnings of the scene", job.warnings);
    section(failures, "Iterations that were given up", job.poisoned.map((it) => `${it.iteration}: ${it.attempts.map((attempt) => `worker ${attempt.worker}: ${attempt.message}`).join("; ")}`));
    settings.textContent = JSON.stringify(job.integrator ?? job.spec.integrator, null, 2);
  };
  return { title: `Job ${id}`, node, update };
}
