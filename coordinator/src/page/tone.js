// From radiance to what a screen shows: tone curves, and colours for numbers.

import { luminance } from "./raw.js";

const STEPS = 4096;
/** Linear display values to bytes of sRGB (IEC 61966-2-1). */
const SRGB = Uint8ClampedArray.from({ length: STEPS + 1 }, (_, index) => {
  const value = index / STEPS;
  return 255 * (value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055) + 0.5;
});

function toByte(value) {
  return SRGB[value > 0 ? Math.min(STEPS, Math.round(value * STEPS)) : 0];
}

/** Tone curves by name: from a scaled radiance to display values. */
export const CURVES = {
  reinhard: "Reinhard (as PNG)",
  filmic: "Filmic",
  linear: "Linear",
};

/** Narkowicz 2015, a fit of the curve of the Academy Color Encoding System. */
function filmic(x) {
  return (x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14);
}

/** Writes one pixel of a picture as bytes. `look` has the curve, the factor of radiance, and Reinhard's white. */
export function developer(look) {
  const { curve, factor, white } = look;
  return (values, from, bytes, to) => {
    const [r, g, b] = [values[from] * factor, values[from + 1] * factor, values[from + 2] * factor];
    if (curve === "reinhard") {
      const bright = luminance(r, g, b);
      const scale = (1 + bright / (white * white)) / (1 + bright);
      bytes[to] = toByte(r * scale);
      bytes[to + 1] = toByte(g * scale);
      bytes[to + 2] = toByte(b * scale);
    } else if (curve === "filmic") {
      bytes[to] = toByte(filmic(r));
      bytes[to + 1] = toByte(filmic(g));
      bytes[to + 2] = toByte(filmic(b));
    } else {
      bytes[to] = toByte(r);
      bytes[to + 1] = toByte(g);
      bytes[to + 2] = toByte(b);
    }
    bytes[to + 3] = 255;
  };
}

/** Writes the values of a layer that is no light: directions from -1 to 1, or values within a range. */
export function mapped(kind, [low, high]) {
  const [from, over] = kind === "direction" ? [[-1, -1, -1], [2, 2, 2]] : [low, high.map((value, channel) => value - low[channel] || 1)];
  return (values, at, bytes, to) => {
    for (let channel = 0; channel < 3; channel += 1) bytes[to + channel] = (255 * (values[at + channel] - from[channel])) / over[channel];
    bytes[to + 3] = 255;
  };
}

/** Dark to bright, evenly in lightness (after matplotlib's `inferno`). */
export const HEAT = [[0, 0, 4], [40, 11, 84], [101, 21, 110], [159, 42, 99], [212, 72, 66], [245, 125, 21], [250, 193, 39], [252, 255, 164]];
/** Blue below, red above, dark where nothing differs. */
export const SIGNED = [[146, 197, 255], [67, 130, 220], [30, 66, 128], [18, 18, 20], [128, 34, 28], [224, 84, 56], [255, 178, 138]];

/** A colour map as a table of 256 colours. */
function table(colours) {
  return Array.from({ length: 256 }, (_, index) => {
    const at = (index / 255) * (colours.length - 1);
    const low = Math.min(Math.floor(at), colours.length - 2);
    return colours[low].map((value, channel) => value + (at - low) * (colours[low + 1][channel] - value));
  });
}

const HEAT_TABLE = table(HEAT);
const SIGNED_TABLE = table(SIGNED);
/** The least share that has a colour of its own: a thousandth; the greatest is all. */
const DECADES = 3;

function place(share) {
  return Math.min(Math.max(1 + Math.log10(share) / DECADES, 0), 1);
}

function put(colour, bytes, to) {
  [bytes[to], bytes[to + 1], bytes[to + 2]] = colour;
  bytes[to + 3] = 255;
}

/** Writes the relative standard error of a pixel as a colour. */
export function heat(values, from, bytes, to) {
  const bright = luminance(values[from], values[from + 1], values[from + 2]);
  const error = values[from + 3];
  const known = bright > 0 && error === error;
  put(known ? HEAT_TABLE[Math.round(255 * place(error / bright))] : [70, 70, 74], bytes, to);
}

/** Writes how much brighter the pixel of another picture is, as a share of the mean luminance. */
export function difference(mean) {
  return (values, others, from, bytes, to) => {
    const before = luminance(values[from], values[from + 1], values[from + 2]);
    const share = (luminance(others[from], others[from + 1], others[from + 2]) - before) / mean;
    put(SIGNED_TABLE[Math.round(127.5 + 127.5 * Math.sign(share) * place(Math.abs(share)))], bytes, to);
  };
}
