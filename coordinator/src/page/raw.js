// The picture in plain numbers, as the farm gives them (`image.raw`): radiance and standard error of each pixel.

/** Values of a pixel: red, green, blue, standard error of the luminance. */
const VALUES = 4;
const HEADER = 32;
/** Larger pictures are shown as PNG: their numbers take more memory than a browser tab should. */
const MOST_PIXELS = 16e6;
/** Least time between two pictures [ms]. */
const STEP = 1000;

/** The weights of ITU-R BT.709. */
export function luminance(r, g, b) {
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}

/** Reads `image.raw`. */
export function readPicture(buffer) {
  const head = new DataView(buffer, 0, HEADER);
  const magic = String.fromCharCode(...new Uint8Array(buffer, 0, 8));
  const [width, height] = [head.getUint32(8, true), head.getUint32(12, true)];
  if (magic !== "photonf1" || buffer.byteLength !== HEADER + 4 * VALUES * width * height) throw new Error("the farm sent no picture");
  return new Picture(width, height, Number(head.getBigUint64(16, true)), head.getFloat64(24, true), new Float32Array(buffer, HEADER));
}

class Picture {
  constructor(width, height, iterations, noise, values) {
    Object.assign(this, { width, height, iterations, noise, values });
  }

  /** Radiance, luminance and standard error of a pixel. */
  at(x, y) {
    const [r, g, b, error] = this.values.subarray(VALUES * (y * this.width + x), VALUES * (y * this.width + x + 1));
    return { rgb: [r, g, b], luminance: luminance(r, g, b), error };
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
    Object.assign(this, { id, shown, tag: "", have: 0, want: 0, busy: false, pause: STEP });
  }

  /** The job as it stands. Returns whether its numbers can be shown at all. */
  update(job) {
    const [width, height] = job.resolution ?? [0, 0];
    if (width * height > MOST_PIXELS) return false;
    // The picture of a job whose iterations were lost has fewer.
    this.want = job.iterations_done;
    this.next();
    return true;
  }

  async next() {
    if (this.busy || this.stopped || this.want === 0 || this.want === this.have) return;
    this.busy = true;
    const [wanted, begun] = [this.want, performance.now()];
    try {
      const headers = this.tag ? { "if-none-match": this.tag } : {};
      const answer = await fetch(`v1/jobs/${this.id}/image.raw`, { cache: "no-store", headers });
      if (answer.status === 200) {
        const picture = readPicture(await answer.arrayBuffer());
        this.tag = answer.headers.get("etag") ?? "";
        if (!this.stopped) this.shown(picture);
      }
      if (answer.ok || answer.status === 304) this.have = wanted;
    } catch {
      // The stream tells when the farm is back.
    }
    // Whoever has a slow line is not kept busy by one picture after the other.
    setTimeout(() => {
      this.busy = false;
      this.next();
    }, Math.max(STEP, 2 * (performance.now() - begun)));
  }

  stop() {
    this.stopped = true;
  }
}
