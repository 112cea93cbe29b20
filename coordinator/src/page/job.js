// One job: its picture as it sharpens, what it does, and what can be done with it.

import { commandsView } from "./commands.js";
import { compareView } from "./compare.js";
import { acting, ask, followOne } from "./farm.js";
import { historyView } from "./history.js";
import { layersView } from "./layers.js";
import { Feed } from "./raw.js";
import { Viewer } from "./viewer.js";
import { element, ended, memory, nameOf, progressOf, reasonOf, since, span, stateOf } from "./words.js";

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
    ["Memory", memory(job.memory_mb)],
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
  const retry = button("Retry what failed", () => ask("POST", `jobs/${id}/retry`, {}));
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
    retry.hidden = job.state !== "failed" && (ended(job) || job.poisoned.length === 0);
    cancel.hidden = ended(job);
    remove.hidden = !ended(job);
    weight.hidden = ended(job);
    extend.hidden = ["failed", "cancelled"].includes(job.state);
    if (!more.value) more.value = 2 * job.spec.iterations;
    if (!priority.value) priority.value = job.spec.schedule?.priority ?? 10;
  };
  return { nodes: [element("div", { class: "actions" }, pause, resume, retry, cancel, remove), element("div", { class: "actions" }, extend, weight)], update };
}

/** The picture as a PNG; another address for every number of iterations. */
function pictureOf(job) {
  return `v1/jobs/${job.id}/image.png?iterations=${job.iterations_done}`;
}

/** The picture: in numbers as it sharpens, or as a PNG where there are too many; its layers; and what it is compared with. */
function pictureView(farm, id, act) {
  const viewer = new Viewer();
  const compare = compareView(farm, id, viewer, act);
  const choose = (numbers) => act(() => {
    compare.node.hidden = !layers.isPlain();
    feed.choose(numbers);
  });
  const layers = layersView(id, viewer, { plain: compare.shown, choose });
  const feed = new Feed(id, layers.shown);
  viewer.extra.append(layers.label);
  const save = element("button", { type: "button", click: () => viewer.save(`job-${id}-shown.png`) }, "Save what is shown");
  const links = ["exr", "png"].map((format) => element("a", { href: `v1/jobs/${id}/image.${format}`, download: `job-${id}.${format}` }, format === "exr" ? "OpenEXR" : "PNG"));
  const node = element("div", { hidden: true }, viewer.node, layers.node, compare.node, element("p", {}, "Download: ", links[0], " ", links[1], " ", save));
  const update = (job) => {
    node.hidden = job.iterations_done === 0;
    if (node.hidden) return;
    layers.update(job);
    save.hidden = !feed.update(job);
    viewer.showPlain(pictureOf(job));
    compare.update(job);
  };
  return { node, update, stop: () => feed.stop() };
}

/** Warnings, and all settings. */
function detailsView() {
  const [settings, warnings] = [element("pre", { tabindex: 0, "aria-label": "Settings" }), element("ul")];
  const warned = element("section", {}, element("h2", {}, "Warnings of the scene"), warnings);
  let shown = "";
  const update = (job) => {
    const { schedule, ...asked } = job.spec;
    const now = JSON.stringify([job.warnings, { ...asked, integrator: job.integrator ?? asked.integrator, schedule }]);
    if (now === shown) return;
    shown = now;
    warned.hidden = job.warnings.length === 0;
    warnings.replaceChildren(...job.warnings.map((warning) => element("li", {}, warning)));
    settings.textContent = JSON.stringify(JSON.parse(now)[1], null, 2);
  };
  return { nodes: [warned, element("details", {}, element("summary", {}, "All settings"), settings)], update };
}

export function jobView(farm, id, tell) {
  const act = acting(tell);
  const [title, list, bar] = [element("h1"), element("dl"), element("progress", { "aria-label": "iterations" })];
  const [picture, actions, history, commands, details] = [pictureView(farm, id, act), actionsView(id, act), historyView(id), commandsView(), detailsView()];
  const now = element("section", {}, element("h2", {}, "Now"), list);
  const body = element("div", {}, bar, element("div", { class: "two" }, element("div", {}, picture.node), element("div", {}, actions.nodes, now)),
    history.nodes, details.nodes, commands.node);
  const gone = element("p", { hidden: true }, "There is no such job.");
  const node = element("section", {}, title, gone, body);
  const alone = followOne(id, () => update());
  const update = () => {
    // The farm tells of the newest jobs only.
    if (farm.heard && !farm.jobs.has(id)) alone.start();
    const job = farm.jobs.get(id) ?? alone.job;
    gone.hidden = Boolean(job) || !alone.missing;
    body.hidden = !job;
    title.textContent = job ? `${id}  ${nameOf(job)}` : `Job ${id}`;
    if (!job) return;
    bar.max = job.spec.iterations;
    bar.value = job.iterations_rendered;
    [picture, actions, history, commands, details].forEach((part) => part.update(job));
    list.replaceChildren(...facts(job).flatMap(([name, value]) => [element("dt", {}, name), element("dd", {}, value)]));
  };
  actions.nodes.forEach((part) => (part.hidden = farm.role === "read"));
  const stop = () => [picture, history, alone].forEach((part) => part.stop());
  return { title: `Job ${id}`, node, update, stop };
}
