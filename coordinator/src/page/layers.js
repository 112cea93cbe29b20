// What of a job is shown: its picture, one of its layers, or its lamps mixed anew.

import { mixerView } from "./lamps.js";
import { element } from "./words.js";

/** Layers that are no light, by name: what they are, and how they are shown. */
const KINDS = {
  alpha: { label: "share covered", kind: "share", count: 1 },
  albedo: { label: "albedo", kind: "share", count: 3 },
  normal: { label: "normal", kind: "direction", count: 3 },
  depth: { label: "distance", kind: "range", count: 1 },
  position: { label: "position", kind: "range", count: 3 },
};

/** What can be shown of the layers: [value, text, number, place among the images of that number]. */
function choicesOf(layers) {
  return layers.flatMap((layer, index) => {
    const number = index + 1;
    const name = layer.startsWith("lamp:") || KINDS[layer] ? layer : layer.split("=")[0].trim();
    const text = layer === "lamp:*" ? "lamp:* (others)" : name;
    if (layer !== "halves") return [{ value: `${number}`, text, number, image: 0, layer }];
    return ["odd", "even"].map((half, image) => ({ value: `${number} ${half}`, text: `${half} iterations`, number, image, layer }));
  });
}

/** The choice of a job. `plain` is called with its picture; `choose` with the numbers of the layers that are to come with it. */
export function layersView(id, viewer, { plain, choose }) {
  const mixer = mixerView(id, (picture) => viewer.show(picture, null));
  const select = element("select", { change: () => pick() });
  const label = element("label", { class: "row", hidden: true }, "Shown", select);
  let [known, choices, lamps, chosen] = ["", [], [], "picture"];

  function pick() {
    chosen = select.value;
    mixer.node.hidden = chosen !== "mix";
    const choice = choices.find(({ value }) => value === chosen);
    choose(chosen === "mix" ? lamps : choice ? [choice.number] : []);
  }
  const update = (job) => {
    const layers = job.spec.layers ?? [];
    if (String(layers) === known) return;
    known = String(layers);
    choices = choicesOf(layers);
    lamps = mixer.update(layers);
    const options = [["picture", "the picture"], ...(lamps.length > 0 ? [["mix", "its lamps, mixed"]] : []), ...choices.map(({ value, text }) => [value, text])];
    select.replaceChildren(...options.map(([value, text]) => element("option", { value }, text)));
    label.hidden = layers.length === 0;
  };
  const shown = (picture) => {
    if (chosen === "picture") return plain(picture);
    if (chosen === "mix") return mixer.shown(picture);
    const { image, layer } = choices.find(({ value }) => value === chosen);
    const one = picture.layers[image];
    Object.assign(one, KINDS[layer] ?? {});
    // Light is as bright as it is in the picture.
    one.fitted = picture.fit;
    viewer.show(one, null);
  };
  return { label, node: mixer.node, update, shown, isPlain: () => chosen === "picture" };
}
