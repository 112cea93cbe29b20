// The picture on a canvas: developed by a tone curve, or as colours for its noise or for what differs from another one. A probe reads its pixels.

import { CURVES, developer, difference, HEAT, heat, mapped, SIGNED } from "./tone.js";
import { element, percent } from "./words.js";

const ZOOMS = [["Fit", 0], ["1:1", 1], ["2:1", 2], ["4:1", 4], ["8:1", 8]];
const VIEWS = [["Picture", "picture"], ["Noise", "noise"]];
const STEPS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

/** Buttons of which one is pressed. `chosen` is called with the value of that one. */
export function choice(label, options, first, chosen) {
  const press = (value) => buttons.forEach((button, index) => button.setAttribute("aria-pressed", String(options[index][1] === value)));
  const buttons = options.map(([text, value]) =>
    element("button", {
      type: "button",
      click: () => {
        press(value);
        chosen(value);
      },
    }, text));
  press(first);
  return { node: element("div", { class: "choice", role: "group", "aria-label": label }, buttons), press };
}

/** Numbers as people read them. */
function figure(value) {
  return value === 0 || (Math.abs(value) >= 1e-3 && Math.abs(value) < 1e5) ? value.toPrecision(4) : value.toExponential(3);
}

/** What the probe says of a pixel. */
function words(picture, x, y) {
  const { rgb, luminance, error } = picture.at(x, y);
  if (picture.kind !== "light") return `x ${x}, y ${y}: ${picture.label} ${rgb.slice(0, picture.count).map(figure).join(" ")}`;
  if (!picture.measured) return `x ${x}, y ${y}: radiance ${rgb.map(figure).join(" ")}, luminance ${figure(luminance)}`;
  const noise = error === error ? `, standard error ${figure(error)}${luminance > 0 ? ` (${percent(error / luminance)})` : ""}` : ", standard error not known yet";
  return `x ${x}, y ${y}: radiance ${rgb.map(figure).join(" ")}, luminance ${figure(luminance)}${noise}`;
}

/** A strip of colours with its ends in words. */
function legend() {
  const strip = element("canvas", { width: 256, height: 1, "aria-hidden": "true" });
  const [title, low, high] = [element("span"), element("span"), element("span")];
  const node = element("p", { class: "legend", hidden: true }, title, low, strip, high);
  const show = (colours, ...texts) => {
    const drawing = strip.getContext("2d");
    const fill = drawing.createLinearGradient(0, 0, 256, 0);
    colours.forEach(([r, g, b], index) => fill.addColorStop(index / (colours.length - 1), `rgb(${r} ${g} ${b})`));
    drawing.fillStyle = fill;
    drawing.fillRect(0, 0, 256, 1);
    [title.textContent, low.textContent, high.textContent] = texts;
    node.hidden = false;
  };
  return { node, show };
}

export class Viewer {
  constructor() {
    Object.assign(this, { picture: null, other: null, view: "picture", curve: "reinhard", stops: 0, automatic: true, zoom: 0, divide: 0.5, spot: [0, 0] });
    this.canvas = element("canvas", { class: "fit", hidden: true });
    // What of a job is shown is chosen here, where there is a choice.
    this.extra = element("div", { class: "actions" });
    this.caption = element("p", { class: "quiet caption" });
    this.plain = element("img", { class: "fit", alt: "The picture as it stands", hidden: true });
    this.cross = element("div", { class: "cross", hidden: true });
    this.line = element("div", { class: "divide", hidden: true });
    this.stage = element("div", { class: "stage" }, this.canvas, this.plain, this.cross, this.line);
    this.probe = element("output", { class: "probe", id: "probe", "aria-live": "polite" });
    this.legend = legend();
    const help = "Picture; arrow keys move the probe, with Shift by ten pixels";
    this.frame = element("div", { class: "picture", tabindex: 0, role: "application", "aria-label": help, "aria-describedby": "probe" }, this.stage);
    this.listen();
    this.node = element("div", { class: "viewer" }, this.controls(), this.frame, this.legend.node, this.probe);
  }

  controls() {
    const reading = element("output", { class: "reading" }, "0 stops");
    const stops = element("input", { type: "range", min: -8, max: 8, step: 0.25, value: 0, input: () => this.set({ stops: Number(stops.value) }, (reading.textContent = `${stops.value} stops`)) });
    const automatic = element("input", { type: "checkbox", checked: true, change: () => this.set({ automatic: automatic.checked }) });
    const curve = element("select", { change: () => this.set({ curve: curve.value }) }, Object.entries(CURVES).map(([value, text]) => element("option", { value }, text)));
    this.viewChoice = choice("View", VIEWS, "picture", (view) => {
      this.viewChanged?.();
      this.set({ view });
    });
    const zoom = choice("Zoom", ZOOMS, 0, (factor) => {
      this.zoom = factor;
      this.size();
    });
    return element("div", {},
      element("div", { class: "actions" }, this.viewChoice.node, zoom.node, this.caption),
      element("div", { class: "actions" },
        element("label", { class: "row" }, "Exposure", stops, reading),
        element("label", { class: "row" }, automatic, "from a middle grey"),
        element("label", { class: "row" }, "Tone curve", curve),
        this.extra));
  }

  /** What is shown, as a PNG. */
  save(name) {
    this.canvas.toBlob((blob) => {
      const address = URL.createObjectURL(blob);
      element("a", { href: address, download: name }).click();
      setTimeout(() => URL.revokeObjectURL(address), 60_000);
    }, "image/png");
  }

  listen() {
    const place = (event) => {
      const box = this.canvas.getBoundingClientRect();
      this.move(Math.floor(((event.clientX - box.left) / box.width) * this.canvas.width), Math.floor(((event.clientY - box.top) / box.height) * this.canvas.height));
    };
    this.canvas.addEventListener("pointermove", place);
    this.canvas.addEventListener("pointerdown", place);
    this.frame.addEventListener("keydown", (event) => {
      const step = STEPS[event.key];
      if (!step || !this.picture || event.ctrlKey || event.altKey || event.metaKey) return;
      event.preventDefault();
      const by = event.shiftKey ? 10 : 1;
      this.move(this.spot[0] + by * step[0], this.spot[1] + by * step[1]);
    });
    this.frame.addEventListener("focus", () => this.picture && this.move(...this.spot));
    this.plain.addEventListener("load", () => this.size());
  }

  /** Changes how the picture is shown. */
  set(change) {
    Object.assign(this, change);
    this.draw();
  }

  /** Shows another picture, beside `other` where there is one. */
  show(picture, other = this.other) {
    const fresh = !this.picture || this.picture.width !== picture.width;
    const fits = other && other.width === picture.width && other.height === picture.height;
    Object.assign(this, { picture, other: fits ? other : null });
    if (fresh) this.spot = [picture.width >> 1, picture.height >> 1];
    [this.canvas.width, this.canvas.height] = [picture.width, picture.height];
    [this.canvas.hidden, this.plain.hidden] = [false, true];
    this.node.dataset.iterations = picture.iterations;
    const noise = picture.noise > 0 ? `, noise ${percent(picture.noise)}` : "";
    this.caption.textContent = `${picture.iterations} iterations${noise}`;
    this.size();
    this.draw();
  }

  /** Shows a picture of which there are no numbers. */
  showPlain(source) {
    if (this.picture || this.wanted === source) return;
    this.wanted = source;
    const next = new Image();
    next.onload = () => {
      if (this.wanted !== source || this.picture) return;
      this.plain.src = source;
      this.plain.hidden = false;
    };
    next.src = source;
  }

  size() {
    const { canvas, plain, stage, zoom } = this;
    const [width, height] = canvas.hidden ? [plain.naturalWidth, plain.naturalHeight] : [canvas.width, canvas.height];
    stage.style.width = zoom > 0 ? `${width * zoom}px` : `min(100%, ${(72 * width) / Math.max(height, 1)}vh)`;
    [canvas.className, plain.className] = zoom === 0 ? ["fit", "fit"] : ["", ""];
  }

  draw() {
    const { picture, other, view } = this;
    if (!picture) return;
    const image = new ImageData(picture.width, picture.height);
    const paint = this.painter();
    const border = other && view !== "difference" ? Math.round(this.divide * picture.width) : picture.width;
    const [bytes, count] = [image.data, picture.width * picture.height];
    if (view === "difference" && other) {
      for (let at = 0; at < 4 * count; at += 4) paint(picture.values, other.values, at, bytes, at);
    } else {
      for (let y = 0, at = 0; y < picture.height; y += 1) {
        for (let x = 0; x < picture.width; x += 1, at += 4) paint((x < border ? picture : other).values, at, bytes, at);
      }
    }
    this.canvas.getContext("2d").putImageData(image, 0, 0);
    this.line.hidden = border === picture.width;
    this.line.style.left = `${100 * this.divide}%`;
    this.explain();
    if (!this.cross.hidden) this.tell();
  }

  painter() {
    const { exposure, white, mean } = this.picture.fit;
    const { kind } = this.picture;
    if (kind === "direction" || kind === "range") return mapped(kind, kind === "range" ? this.picture.range : []);
    if (kind === "share") return developer({ curve: "linear", factor: 2 ** this.stops, white: 1 });
    if (this.view === "noise") return heat;
    if (this.view === "difference" && this.other) return difference(mean);
    return developer({ curve: this.curve, factor: (this.automatic ? exposure : 1) * 2 ** this.stops, white });
  }

  explain() {
    if (this.picture.kind !== "light") this.legend.node.hidden = true;
    else if (this.view === "noise") this.legend.show(HEAT, "Standard error of the luminance, relative:", "0.1 %", "100 %; grey: none, or not known");
    else if (this.view === "difference" && this.other) this.legend.show(SIGNED, "Right minus left, of the mean luminance:", "-100 %", "+100 %; each colour a tenth of the next");
    else this.legend.node.hidden = true;
  }

  move(x, y) {
    if (!this.picture) return;
    this.spot = [Math.min(Math.max(x, 0), this.picture.width - 1), Math.min(Math.max(y, 0), this.picture.height - 1)];
    this.cross.hidden = false;
    this.tell();
  }

  tell() {
    const { picture, other, spot: [x, y] } = this;
    this.cross.style.left = `${(100 * (x + 0.5)) / picture.width}%`;
    this.cross.style.top = `${(100 * (y + 0.5)) / picture.height}%`;
    this.probe.textContent = words(picture, x, y) + (other ? `; right: ${words(other, x, y)}` : "");
  }
}
