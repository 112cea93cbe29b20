// The picture in plain numbers, as the farm gives them (`image.raw`): radiance and standard error of each pixel.

/** Values of a pixel: red, green, blue, standard error of the luminance. */
const VALUES = 4;
const HEADER = 32;
/** Larger pictures are shown as PNG, and layers not at all: their numbers take more memory than a browser tab should. */
const MOST_PIXELS = 16e6;
/** Least time between two pictures [ms]. */
const STEP = 1000;

/** The weights of ITU-R BT.709. */
export function luminance(r, g, b) {
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}

/** Reads `image.raw`: a picture, and the layers that follow it. */
export function readPicture(buffer) {
  const head = new DataView(buffer, 0, HEADER);
  const magic = String.fromCharCode(...new Uint8Array(buffer, 0, 8));
  const [width, height] = [head.getUint32(8, true), head.getUint32(12, true)];
  const [count, iterations] = [VALUES * width * height, Number(head.getBigUint64(16, true))];
  const images = (buffer.byteLength - HEADER) / (4 * count);
  if (magic !== "photonf1" || !Number.isInteger(images) || images < 1) throw new Error("the farm sent no picture");
  const image = (index, noise) => new Picture(width, height, iterations, noise, new Float32Array(buffer, HEADER + 4 * count * index, count));
  const picture = image(0, head.getFloat64(24, true));
  picture.layers = Array.from({ length: images - 1 }, (_, index) => image(1 + index, NaN));
  return picture;
}

/** An image: the light of a picture, or a layer. */
export class Picture {
  constructor(width, height, iterations, noise, values) {
    // `kind` says how it is shown, `label` what its values are, of which it has `count`; `measured` whether an error can be known.
    Object.assign(this, { width, height, iterations, noise, values, layers: [], kind: "light", label: "radiance", count: 3, measured: true });
  }

  /** Radiance, luminance and standard error of a pixel. */
  at(x, y) {
    const [r, g, b, error] = this.values.subarray(VALUES * (y * this.width + x), VALUES * (y * this.width + x + 1));
    return { rgb: [r, g, b], luminance: luminance(r, g, b), error };
  }

  /** The least and the greatest value of each channel. */
  get range() {
    if (!this.found) {
      this.found = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
      const [low, high] = this.found;
      this.values.forEach((value, at) => {
        const channel = at % VALUES;
        if (channel === 3 || !Number.isFinite(value)) return;
        low[channel] = Math.min(low[channel], value);
        high[channel] = Math.max(high[channel], value);
      });
    }
    return this.found;
  }

  /** The exposure and the white of the farm's PNG: Reinhard's middle grey, and a thousandth of the pixels that burn out. */
  get fit() {
    this.fitted ??= fitTo(this);
    return this.fitted;
  }
}

function fitTo({ width, height, values }) {
  const step = Math.max(1, Math.floor((width * height) / 250_000));
  const found = [];
  let [logs, sum, count] = [0, 0, 0];
  for (let at = 0; at < values.length; at += VALUES * step) {
    const bright = luminance(values[at], values[at + 1], values[at + 2]);
    sum += bright;
    count += 1;
    if (bright > 0) {
      logs += Math.log(bright);
      found.push(bright);
    }
  }
  if (found.length === 0) return { exposure: 1, white: 1, mean: 1 };
  const exposure = 0.18 / Math.exp(logs / found.length);
  const order = Float32Array.from(found).sort();
  const white = order[Math.max(0, order.length - 1 - Math.floor(count * 0.001))];
  return { exposure, white: Math.min(Math.max(white * exposure, 1), 1e9), mean: sum / count };
}

/** Fetches a job's picture once. */
export async function fetchPicture(id) {
  const answer = await fetch(`v1/jobs/${id}/image.raw`, { cache: "no-store" });
  if (!answer.ok) throw new Error(`the farm gives no picture of job ${id} (${answer.status})`);
  return readPicture(await answer.arrayBuffer());
}

/** Fetches a job's picture whenever more of it is there, one at a time, and no more often than it can be shown. */
export class Feed {
  constructor(id, shown) {
    Object.assign(this, { id, shown, tag: "", have: 0, want: 0, busy: false, layers: "", pixels: 0 });
  }

  /** Chooses the layers that come with the picture, by their numbers. */
  choose(numbers) {
    if ((1 + numbers.length) * this.pixels > MOST_PIXELS) throw new Error("the layers of this picture are too large for a browser: `photonfarm fetch` has them in the OpenEXR file");
    Object.assign(this, { layers: numbers.join(","), tag: "", have: 0 });
    clearTimeout(this.timer);
    this.busy = Boolean(this.fetching);
    this.next();
  }

  /** The job as it stands. Returns whether its numbers can be shown at all. */
  update(job) {
    const [width, height] = job.resolution ?? [0, 0];
    this.pixels = width * height;
    if (this.pixels > MOST_PIXELS) return false;
    // The picture of a job whose iterations were lost has fewer.
    this.want = job.iterations_done;
    this.next();
    return true;
  }

  async next() {
    if (this.busy || this.stopped || this.want === 0 || this.want === this.have) return;
    this.busy = true;
    const [wanted, layers, begun] = [this.want, this.layers, performance.now()];
    this.fetching = true;
    try {
      const headers = this.tag ? { "if-none-match": this.tag } : {};
      const answer = await fetch(`v1/jobs/${this.id}/image.raw${layers && `?layers=${layers}`}`, { cache: "no-store", headers });
      const bytes = answer.status === 200 ? await answer.arrayBuffer() : null;
      const current = layers === this.layers && !this.stopped;
      if (current && (answer.ok || answer.status === 304)) this.have = wanted;
      if (current && bytes) {
        this.tag = answer.headers.get("etag") ?? "";
        this.shown(readPicture(bytes));
      }
    } catch {
      // The stream tells when the farm is back.
    }
    this.fetching = false;
    // Whoever has a slow line is not kept busy by one picture after the other.
    const pause = layers === this.layers ? Math.max(STEP, 2 * (performance.now() - begun)) : 0;
    this.timer = setTimeout(() => {
      this.busy = false;
      this.next();
    }, pause);
  }

  stop() {
    this.stopped = true;
  }
}
