// Curves over time or over iterations, as SVG.

import { element, shape } from "./words.js";

const [WIDTH, HEIGHT, LEFT, BOTTOM, TOP, RIGHT] = [460, 190, 62, 26, 10, 12];

/** Ticks at round numbers, four or so. */
function ticks(low, high, logarithmic) {
  if (logarithmic) {
    const found = [];
    const factors = high / low > 30 ? [1] : high / low > 4 ? [1, 2, 5] : [1, 1.5, 2, 3, 4, 5, 6, 7, 8, 9];
    for (let decade = Math.floor(Math.log10(low)); decade <= Math.ceil(Math.log10(high)); decade += 1) {
      for (const factor of factors) found.push(factor * 10 ** decade);
    }
    return found.filter((value) => value >= low * 0.999 && value <= high * 1.001);
  }
  const rough = (high - low) / 4 || 1;
  const decade = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * decade).find((size) => size >= rough);
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.floor(high / step) - first + 1 }, (_, index) => (first + index) * step);
}

function short(value) {
  return value !== 0 && (Math.abs(value) < 1e-3 || Math.abs(value) >= 1e5) ? value.toExponential(0) : String(Number(value.toPrecision(3)));
}

/** A range that is no point, and for logarithms above zero. */
function rangeOf(values, logarithmic, fromZero) {
  let [low, high] = [Math.min(...values), Math.max(...values)];
  if (fromZero) low = Math.min(low, 0);
  if (low === high) [low, high] = logarithmic ? [low / 2, high * 2] : [low - 0.5, high + 0.5];
  return logarithmic ? [low / 1.1, high * 1.1] : [low, high];
}

function scale([low, high], from, to, logarithmic) {
  const of = logarithmic ? Math.log : (value) => value;
  return (value) => from + ((of(value) - of(low)) / (of(high) - of(low))) * (to - from);
}

/**
 * One plot. `points` are pairs of numbers in order; `across` writes those of the axis below. With `logarithmic` the axis at the left is.
 */
function draw(svg, title, points, { logarithmic, fromZero, across, below }) {
  const parts = [];
  const [xs, ys] = [points.map(([x]) => x), points.map(([, y]) => y)];
  const [rangeX, rangeY] = [rangeOf(xs), rangeOf(ys, logarithmic, fromZero)];
  const x = scale(rangeX, LEFT, WIDTH - RIGHT);
  const y = scale(rangeY, HEIGHT - BOTTOM, TOP, logarithmic);
  for (const value of ticks(...rangeY, logarithmic)) {
    parts.push(shape("line", { x1: LEFT, x2: WIDTH - RIGHT, y1: y(value), y2: y(value), class: "grid" }));
    parts.push(shape("text", { x: LEFT - 6, y: y(value) + 4, class: "end" }, short(value)));
  }
  for (const value of ticks(...rangeX).slice(0, 6)) {
    parts.push(shape("text", { x: Math.min(x(value), WIDTH - 24), y: HEIGHT - 8, class: "middle" }, across(value)));
  }
  parts.push(shape("polyline", { points: points.map(([a, b]) => `${x(a).toFixed(1)},${y(b).toFixed(1)}`).join(" "), class: "curve" }));
  if (points.length < 40) points.forEach(([a, b]) => parts.push(shape("circle", { cx: x(a), cy: y(b), r: 2.5, class: "dot" })));
  const said = `${title} ${below}: from ${short(ys[0])} to ${short(ys.at(-1))}`;
  svg.replaceChildren(shape("title", {}, said), ...parts);
  svg.setAttribute("aria-label", said);
}

/** A plot with its title, which is hidden while there are fewer than two points. */
export function plot(title, options = {}) {
  const svg = shape("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", class: "plot" });
  const latest = element("span", { class: "quiet" });
  const node = element("figure", { hidden: true }, element("figcaption", {}, title, " ", latest), svg);
  return {
    node,
    update: (points, axis) => {
      const good = points.filter(([a, b]) => Number.isFinite(a) && Number.isFinite(b) && (!options.logarithmic || b > 0));
      node.hidden = good.length < 2;
      if (node.hidden) return;
      latest.textContent = `${short(good.at(-1)[1])}${options.unit ?? ""}`;
      draw(svg, title, good, { ...options, ...axis });
    },
  };
}

/** Share of the first squared width that iteration `i` has left (Knaus and Zwicker 2011, equation 15), for i = 1, 2, ... in turn. */
function* shares(alpha) {
  for (let [i, share] = [1, 1]; ; share *= (i + alpha) / (i + 1), i += 1) yield [i, share];
}

/** The root s of s^2 (1 - cos(theta1 s^p)) = share (1 - cos theta1), as the renderer has it (`core/src/density/schedule.rs`). */
function focused(share, p, theta1) {
  const side = (s) => s * s * (1 - Math.cos(theta1 * s ** p));
  let [low, high] = [0, 1];
  for (let step = 0; step < 50; step += 1) {
    const middle = (low + high) / 2;
    if (side(middle) < share * (1 - Math.cos(theta1))) low = middle;
    else high = middle;
  }
  return high;
}

/** Widths of kernels by iteration, [iteration, sigma, theta in degrees or NaN]: closed functions of the first ones. Empty for integrators without such. */
export function widths(job) {
  const [settings, found] = [job.integrator, job.totals.bandwidth];
  if (!found || !["pppm", "pcf", "vcm"].includes(settings?.type)) return [];
  const [sigma1, theta1] = [found.sigma[0], found.theta?.[0]];
  const list = [];
  let next = 1;
  for (const [i, share] of shares(settings.alpha)) {
    if (i > job.spec.iterations) return list;
    if (i < next && i < job.spec.iterations) continue;
    next = Math.max(i + 1, Math.floor(i * 1.08));
    const ratio = settings.type === "pcf" ? focused(share, settings.p, theta1) : Math.sqrt(share);
    list.push([i, sigma1 * ratio, settings.type === "pcf" ? ((theta1 * ratio ** settings.p) * 180) / Math.PI : NaN]);
  }
}
