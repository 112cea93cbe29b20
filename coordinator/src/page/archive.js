// What was dropped, as files by name: single files, folders, and archives (zip, tar, tar.gz).

/** Most bytes of all files together: they are held in memory. */
const MOST_BYTES = 1 << 30;

async function through(bytes, format) {
  return new Uint8Array(await new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream(format))).arrayBuffer());
}

/** The files of a zip archive, by its central directory (APPNOTE 6.3, section 4.3). */
async function unzip(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let end = bytes.length - 22;
  while (end >= 0 && view.getUint32(end, true) !== 0x06054b50) end -= 1;
  if (end < 0) throw new Error("the zip archive has no directory");
  const files = new Map();
  let [count, at, total] = [view.getUint16(end + 10, true), view.getUint32(end + 16, true), 0];
  for (; count > 0; count -= 1) {
    if (at + 46 > bytes.length || view.getUint32(at, true) !== 0x02014b50) throw new Error("the directory of the zip archive is broken");
    const [flags, method, packed, size] = [view.getUint16(at + 8, true), view.getUint16(at + 10, true), view.getUint32(at + 20, true), view.getUint32(at + 24, true)];
    const [nameLength, extra, comment, local] = [view.getUint16(at + 28, true), view.getUint16(at + 30, true), view.getUint16(at + 32, true), view.getUint32(at + 42, true)];
    const name = new TextDecoder().decode(bytes.subarray(at + 46, at + 46 + nameLength));
    at += 46 + nameLength + extra + comment;
    if (name.endsWith("/")) continue;
    if (flags & 1) throw new Error(`${name} is encrypted`);
    if (packed === 0xffffffff || size === 0xffffffff) throw new Error(`${name} is too long for a zip archive of this kind`);
    total += size;
    if (total > MOST_BYTES) throw new Error("the archive is too large for a browser: use photonfarm submit");
    const from = local + 30 + view.getUint16(local + 26, true) + view.getUint16(local + 28, true);
    const content = bytes.subarray(from, from + packed);
    if (method !== 0 && method !== 8) throw new Error(`${name} is packed in a way that is not known here (${method})`);
    files.set(name, method === 0 ? content : await through(content, "deflate-raw"));
  }
  return files;
}

/** The regular files of a tar archive (POSIX ustar, and long names of GNU and pax). */
function untar(bytes) {
  const text = (from, length) => new TextDecoder().decode(bytes.subarray(from, from + length)).replace(/\0.*/s, "");
  const files = new Map();
  let long = "";
  for (let at = 0; at + 512 <= bytes.length && bytes[at] !== 0; ) {
    const size = parseInt(text(at + 124, 12), 8);
    if (!Number.isFinite(size)) throw new Error("the tar archive is broken");
    const [kind, prefix, content] = [text(at + 156, 1), text(at + 257, 5) === "ustar" ? text(at + 345, 155) : "", at + 512];
    if (kind === "L") long = text(content, size);
    else if (kind === "x") long = /\d+ path=([^\n]*)\n/.exec(text(content, size))?.[1] ?? "";
    else {
      const name = long || (prefix && kind !== "5" ? `${prefix}/${text(at, 100)}` : text(at, 100));
      if (kind === "" || kind === "0") files.set(name, bytes.subarray(content, content + size));
      long = "";
    }
    at = content + 512 * Math.ceil(size / 512);
  }
  return files;
}

/** The files in a file that may be an archive. */
async function unpack(name, bytes) {
  if (/\.zip$/i.test(name)) return unzip(bytes);
  if (/\.(tar\.gz|tgz)$/i.test(name)) return untar(await through(bytes, "gzip"));
  if (/\.tar$/i.test(name)) return untar(bytes);
  return new Map([[name, bytes]]);
}

/** The files below an entry of what was dropped, with their paths. */
async function walk(entry, path, found) {
  if (entry.isFile) {
    found.push([path + entry.name, await new Promise((done, failed) => entry.file(done, failed))]);
    return;
  }
  const reader = entry.createReader();
  for (;;) {
    const some = await new Promise((done, failed) => reader.readEntries(done, failed));
    if (some.length === 0) return;
    for (const child of some) await walk(child, `${path}${entry.name}/`, found);
  }
}

/** Files with their names, of a drop. What the browser tells of a drop is gone once the event is over: it is taken at once. */
export async function dropped(transfer) {
  const items = [...transfer.items].filter((item) => item.kind === "file");
  const taken = items.map((item) => item.webkitGetAsEntry() ?? item.getAsFile());
  const found = [];
  for (const one of taken) {
    if (one instanceof File) found.push([one.name, one]);
    else await walk(one, "", found);
  }
  return found;
}

/** Files with their names, of an `<input type="file">`. */
export function picked(input) {
  return [...input.files].map((file) => [file.webkitRelativePath || file.name, file]);
}

/** Reads files, and those in archives among them. Names have no folder in front that all of them share, and nothing that hides. */
export async function readAll(found) {
  const files = new Map();
  const total = found.reduce((sum, [, file]) => sum + file.size, 0);
  if (total > MOST_BYTES) throw new Error("that is too much for a browser: use photonfarm submit");
  for (const [name, file] of found) {
    const parts = await unpack(name, new Uint8Array(await file.arrayBuffer()));
    for (const [inner, bytes] of parts) files.set(inner.replace(/^(\.?\/)+/, ""), bytes);
  }
  for (const name of files.keys()) {
    if (/(^|\/)(\.|__MACOSX)/.test(name)) files.delete(name);
  }
  while (files.size > 0) {
    const first = /^[^/]+\//.exec([...files.keys()][0])?.[0];
    if (!first || ![...files.keys()].every((name) => name.startsWith(first))) return files;
    const inner = [...files].map(([name, bytes]) => [name.slice(first.length), bytes]);
    files.clear();
    inner.forEach(([name, bytes]) => files.set(name, bytes));
  }
  throw new Error("there are no files in it");
}
