// Two pictures beside each other: moments of one job that were kept, or another job of the same size.

import { fetchPicture, luminance } from "./raw.js";
import { element, nameOf, percent } from "./words.js";
import { choice } from "./viewer.js";

/** Moments kept by job, in this tab alone. */
const kept = new Map();
/** Most values that kept moments may hold together: 256 MB. */
const MOST_VALUES = 64e6;

function room() {
  return [...kept.values()].flat().reduce((left, moment) => left - moment.values.length, MOST_VALUES);
}

/** How far two pictures are from each other: the mean squared error of the luminance, and the same relative to the mean. */
function distance(left, right) {
  const { values } = left;
  let sum = 0;
  for (let at = 0; at < values.length; at += 4) {
    const [a, b] = [values, right.values].map((of) => luminance(of[at], of[at + 1], of[at + 2]));
    sum += (a - b) ** 2;
  }
  const mean = sum / (values.length / 4);
  return `root mean squared error ${Math.sqrt(mean).toPrecision(3)}, ${percent(Math.sqrt(mean) / left.fit.mean)} of the mean luminance`;
}

export function compareView(farm, id, viewer, act) {
  const select = element("select", { change: () => choose() });
  const divide = element("input", { type: "range", min: 0, max: 100, value: 50, step: 1, input: () => viewer.set({ divide: divide.value / 100 }) });
  const told = element("p", { class: "quiet", "aria-live": "polite" });
  const keep = element("button", { type: "button", click: () => act(keepMoment) }, "Keep this moment");
  const mode = choice("Comparison", [["Side by side", "picture"], ["Difference", "difference"]], "picture", (view) => {
    viewer.viewChoice.press(view);
    viewer.set({ view });
    slider.hidden = view === "difference";
  });
  const slider = element("label", {}, "Border", divide);
  const tools = element("div", { class: "actions", hidden: true }, mode.node, slider);
  const node = element("details", { class: "compare" }, element("summary", {}, "Compare"),
    element("div", { class: "actions" }, keep, element("label", {}, "On the right", select)), tools, told);
  let [live, right, options] = [null, null, ""];
  viewer.viewChanged = () => {
    mode.press("picture");
    slider.hidden = false;
  };

  const moments = () => kept.get(id) ?? [];
  async function keepMoment() {
    if (!live) throw new Error("there is no picture yet");
    if (live.values.length > room()) throw new Error("no more moments fit into the memory: reload the page to forget them");
    kept.set(id, [...moments().filter((moment) => moment.iterations !== live.iterations), live]);
    update();
  }
  /** What stands on the left is the picture that goes on; a moment that was kept is older, and stands on the right. */
  const show = () => {
    const fits = live && right && right.width === live.width && right.height === live.height;
    tools.hidden = !fits;
    if (!fits && viewer.view === "difference") {
      mode.press("picture");
      viewer.viewChoice.press("picture");
      viewer.view = "picture";
    }
    if (live) viewer.show(live, fits ? right : null);
    told.textContent = fits ? `Left: ${live.iterations} iterations. Right: ${right.iterations}. ${distance(live, right)}` : "";
  };
  function choose() {
    act(async () => {
      const [kind, number] = select.value.split(" ");
      right = null;
      if (kind === "moment") right = moments().find((moment) => moment.iterations === Number(number));
      if (kind === "job") right = await fetchPicture(Number(number));
      show();
    });
  }
  let shown = null;
  const update = (job = shown) => {
    shown = job;
    const size = String(job?.resolution);
    const others = [...farm.jobs.values()].filter((other) => other.id !== id && other.iterations_done > 0 && String(other.resolution) === size);
    const all = [["", "nothing"], ...moments().map((moment) => [`moment ${moment.iterations}`, `this job at ${moment.iterations} iterations`]),
      ...others.map((other) => [`job ${other.id}`, `job ${other.id}  ${nameOf(other)}`])];
    if (String(all) === options) return;
    options = String(all);
    const chosen = select.value;
    select.replaceChildren(...all.map(([value, text]) => element("option", { value }, text)));
    select.value = all.some(([value]) => value === chosen) ? chosen : "";
  };
  return {
    node,
    update,
    /** The job's picture, as it stands now. */
    shown: (picture) => {
      live = picture;
      show();
    },
  };
}
