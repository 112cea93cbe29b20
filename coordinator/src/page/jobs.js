// The list of jobs.

import { dropView } from "./drop.js";
import { overview } from "./overview.js";
import { element, nameOf, progressOf, reasonOf, since, stateOf } from "./words.js";

/** The picture of a job as it stands; another address for every number of iterations. */
export function pictureOf(job) {
  return `v1/jobs/${job.id}/image.png?iterations=${job.iterations_done}`;
}

function card(id) {
  const picture = element("img", { class: "thumbnail", alt: "" });
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
    if (job.iterations_done > 0 && picture.getAttribute("src") !== pictureOf(job)) picture.src = pictureOf(job);
  };
  return { node, update };
}

export function jobsView(farm, tell) {
  const list = element("ul", { class: "jobs" });
  const none = element("p", { hidden: true }, "There are no jobs. ", element("code", {}, "photonfarm submit scene.xml"), " sends one, and so does a scene that is dropped here.");
  const [glance, drop] = [overview(farm), dropView(tell)];
  drop.node.hidden = farm.role === "read";
  const node = element("section", {}, element("h1", {}, "Jobs"), glance.node, drop.node, none, list);
  const cards = new Map();
  const update = () => {
    glance.update();
    const jobs = [...farm.jobs.values()].sort((a, b) => b.id - a.id);
    none.hidden = jobs.length > 0;
    for (const [id, { node }] of cards) {
      if (!farm.jobs.has(id)) {
        node.remove();
        cards.delete(id);
      }
    }
    jobs.forEach((job, place) => {
      if (!cards.has(job.id)) cards.set(job.id, card(job.id));
      const { node, update } = cards.get(job.id);
      update(job);
      if (list.children[place] !== node) list.insertBefore(node, list.children[place] ?? null);
    });
  };
  return { title: "Jobs", node, update, stop: drop.stop };
}
