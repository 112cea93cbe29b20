// The lamps of a job mixed anew: each with a colour, a power and a switch. Light is additive, so that the picture with other lamps is a sum of layers.

import { Picture } from "./raw.js";
import { element } from "./words.js";

/** What stands for the lamps that no other layer names. */
const OTHERS = "*";
const WHITE = "#ffffff";
/** Less than this share of the picture is not the light of a lamp, but roundings. */
const ROUNDINGS = 1e-4;

/** Mixes by job, in this tab alone. */
const mixes = new Map();

/** The lamps that can be mixed: layers that have no lamp in common with one before them, since their light would count twice. */
export function lampsOf(layers) {
  const [lamps, shared, taken] = [[], [], new Set()];
  layers.forEach((layer, place) => {
    if (!layer.startsWith("lamp:")) return;
    const name = layer.slice("lamp:".length);
    const names = name.split("+").map((one) => one.trim());
    if (names.some((one) => taken.has(one))) return shared.push(name);
    names.forEach((one) => taken.add(one));
    lamps.push({ name, number: place + 1 });
  });
  return { lamps, shared, covered: shared.length === 0 && taken.has(OTHERS) };
}

/** A colour of sRGB as factors of linear light (IEC 61966-2-1); the primaries are those of radiance, Rec. 709. */
function linear(colour) {
  const value = parseInt(colour.slice(1), 16);
  return [16, 8, 0].map((shift) => ((value >> shift) & 255) / 255).map((x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4));
}

function gainOf({ on, colour, stops }) {
  return on ? linear(colour).map((factor) => factor * 2 ** stops) : [0, 0, 0];
}

function isPlain({ on, colour, stops }) {
  return on && colour === WHITE && stops === 0;
}

/** The sum of lights times their gains, and of what they leave of the picture times `rest`, where that is not null. */
function mix(picture, lights, gains, rest, values) {
  for (let at = 0; at < values.length; at += 4) {
    for (let channel = 0; channel < 3; channel += 1) {
      let [sum, left] = [0, picture.values[at + channel]];
      for (let lamp = 0; lamp < lights.length; lamp += 1) {
        const light = lights[lamp].values[at + channel];
        sum += gains[lamp][channel] * light;
        left -= light;
      }
      values[at + channel] = rest ? sum + rest[channel] * Math.max(left, 0) : sum;
    }
    values[at + 3] = NaN;
  }
}

/** How much of the picture its lamps leave. */
function restOf(picture, lights) {
  let [all, left] = [0, 0];
  const step = 4 * Math.max(1, Math.floor(picture.values.length / 4 / 100_000));
  for (let at = 0; at < picture.values.length; at += step) {
    const value = picture.values[at] + picture.values[at + 1] + picture.values[at + 2];
    all += value;
    left += Math.abs(lights.reduce((sum, { values }) => sum - values[at] - values[at + 1] - values[at + 2], value));
  }
  return all > 0 ? left / all : 0;
}

/** A name and a gain as `photonfarm mix` reads them. */
function optionOf(name, { on, colour, stops }) {
  const gain = [colour === WHITE ? "" : colour, stops === 0 ? "" : `${stops}EV`].filter(Boolean).join("*");
  return `--lamp '${`${name}=${on ? gain : "0"}`.replaceAll("'", "'\\''")}'`;
}

/** The commands that write the mix of a job as files. */
function commandOf(id, rows) {
  const farm = location.href.replace(/#.*/, "").replace(/\/$/, "");
  const options = rows.filter(({ state }) => !isPlain(state)).map(({ name, state }) => optionOf(name, state));
  return `photonfarm fetch ${id} -o job-${id}.exr --coordinator ${farm} && photonfarm mix job-${id}.exr ${[...options, ""].join(" ")}-o job-${id}-mix.exr`;
}

function rowOf(name, state, changed) {
  const label = name === OTHERS ? "other lamps" : name;
  const on = element("input", { type: "checkbox", checked: state.on, change: () => changed((state.on = on.checked)) });
  const colour = element("input", { type: "color", value: state.colour, "aria-label": `Colour of ${label}`, input: () => changed((state.colour = colour.value)) });
  const reading = element("output", { class: "reading" });
  const stops = element("input", { type: "range", min: -6, max: 6, step: 0.25, value: state.stops, "aria-label": `Power of ${label} in stops`, input: () => changed((state.stops = Number(stops.value))) });
  const node = element("div", { class: "lamp", role: "group", "aria-label": label }, element("label", { class: "row" }, on, label), colour, stops, reading);
  const show = () => {
    [on.checked, colour.value, stops.value] = [state.on, state.colour, state.stops];
    reading.textContent = `${state.stops > 0 ? "+" : ""}${state.stops} EV`;
  };
  show();
  return { name, state, node, show };
}

/** The mixer of a job. `show` is called with the mixed picture. */
export function mixerView(id, show) {
  const list = element("div", { class: "lamps" });
  const note = element("p", { class: "quiet" });
  const command = element("code");
  const copy = element("button", { type: "button", click: () => navigator.clipboard.writeText(command.textContent) }, "Copy");
  copy.hidden = !navigator.clipboard;
  const reset = element("button", { type: "button", click: () => {
    rows.forEach((row) => Object.assign(row.state, { on: true, colour: WHITE, stops: 0 }));
    changed();
  } }, "As rendered");
  const node = element("section", { class: "mixer", hidden: true, "aria-label": "Lamps" }, element("h2", {}, "Lamps"), list, element("div", { class: "actions" }, reset, note),
    element("p", { class: "quiet" }, "The command that writes this mix as OpenEXR and PNG:"), element("div", { class: "command" }, command, copy));
  let [known, rows, found, live, mixed, due] = ["", [], lampsOf([]), null, null, 0];

  const draw = () => {
    due = 0;
    if (!live || rows.length === 0) return;
    const lights = live.layers;
    const others = rows.find(({ name }) => name === OTHERS && !found.covered);
    if (others) others.node.hidden = restOf(live, lights) < ROUNDINGS;
    if (rows.every(({ state }) => isPlain(state))) return show(live);
    if (mixed?.length !== live.values.length) mixed = new Float32Array(live.values.length);
    mix(live, lights, rows.slice(0, lights.length).map(({ state }) => gainOf(state)), others ? gainOf(others.state) : null, mixed);
    const picture = new Picture(live.width, live.height, live.iterations, NaN, mixed);
    // Lamps that become darker are to look darker.
    picture.fitted = live.fit;
    picture.measured = false;
    show(picture);
  };
  function changed() {
    rows.forEach((row) => row.show());
    command.textContent = commandOf(id, rows);
    if (!due) due = requestAnimationFrame(draw);
  }
  /** The job's layers. Returns the numbers of those that are mixed. */
  const update = (layers) => {
    if (known !== String(layers)) {
      known = String(layers);
      found = lampsOf(layers);
      if (!mixes.has(id)) mixes.set(id, new Map());
      const states = mixes.get(id);
      const names = [...found.lamps.map(({ name }) => name), ...(found.covered ? [] : [OTHERS])];
      rows = names.map((name) => {
        if (!states.has(name)) states.set(name, { on: true, colour: WHITE, stops: 0 });
        return rowOf(name, states.get(name), changed);
      });
      list.replaceChildren(...rows.map((row) => row.node));
      note.textContent = found.shared.length > 0 ? `Not here, since they share lamps with others: ${found.shared.join(", ")}` : "";
      command.textContent = commandOf(id, rows);
    }
    return found.lamps.map(({ number }) => number);
  };
  const shown = (picture) => {
    live = picture;
    draw();
  };
  return { node, update, shown };
}
