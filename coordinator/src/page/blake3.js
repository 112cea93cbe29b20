// BLAKE3 (O'Connor, Aumasson, Neves, Wilcox-O'Hearn 2020), the hash by which the farm names files. Browsers do not have it.

const IV = [0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a, 0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19];
const PERMUTATION = [2, 6, 3, 10, 7, 0, 4, 13, 1, 11, 12, 5, 9, 14, 15, 8];
const [CHUNK_START, CHUNK_END, PARENT, ROOT] = [1, 2, 4, 8];
const [BLOCK, CHUNK] = [64, 1024];
/** Bytes hashed before the page may do something else. */
const TURN = 2 << 20;

/** The columns and diagonals that a round mixes, four words each. */
const MIXES = Uint8Array.of(0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15, 0, 5, 10, 15, 1, 6, 11, 12, 2, 7, 8, 13, 3, 4, 9, 14);
/** Which words of a block the mixes of the seven rounds take, in turn. */
const ORDER = new Uint8Array(7 * 16);
for (let at = 0; at < ORDER.length; at += 1) ORDER[at] = at < 16 ? at : ORDER[at - (at % 16) - 16 + PERMUTATION[at % 16]];

const state = new Int32Array(16);
const block = new Uint8Array(BLOCK);
const view = new DataView(block.buffer);
const blockWords = new Int32Array(16);

/** Mixes the words of a block into the state. */
function stir(words) {
  for (let at = 0; at < ORDER.length; at += 2) {
    const mixed = (2 * at) % 32;
    const [ia, ib, ic, id] = [MIXES[mixed], MIXES[mixed + 1], MIXES[mixed + 2], MIXES[mixed + 3]];
    let a = (state[ia] + state[ib] + words[ORDER[at]]) | 0;
    let d = state[id] ^ a;
    d = (d >>> 16) | (d << 16);
    let c = (state[ic] + d) | 0;
    let b = state[ib] ^ c;
    b = (b >>> 12) | (b << 20);
    a = (a + b + words[ORDER[at + 1]]) | 0;
    d ^= a;
    d = (d >>> 8) | (d << 24);
    c = (c + d) | 0;
    b ^= c;
    state[ia] = a;
    state[ib] = (b >>> 7) | (b << 25);
    state[ic] = c;
    state[id] = d;
  }
}

/** The first eight words that come of a block. */
function compress(chaining, words, counter, length, flags) {
  for (let index = 0; index < 8; index += 1) state[index] = chaining[index];
  for (let index = 0; index < 4; index += 1) state[8 + index] = IV[index];
  state[12] = counter % 0x100000000;
  state[13] = Math.floor(counter / 0x100000000);
  state[14] = length;
  state[15] = flags;
  stir(words);
  const out = new Int32Array(8);
  for (let index = 0; index < 8; index += 1) out[index] = state[index] ^ state[index + 8];
  return out;
}

/** The words of a block, with zeros behind its end; they hold until the next ones are read. */
function wordsOf(bytes, from, to) {
  block.fill(0);
  block.set(bytes.subarray(from, to));
  for (let index = 0; index < 16; index += 1) blockWords[index] = view.getInt32(4 * index, true);
  return blockWords;
}

/** What is left to compress of a chunk: its last block. */
function chunk(bytes, from, to, counter) {
  let chaining = IV;
  let at = from;
  for (; to - at > BLOCK; at += BLOCK) {
    chaining = compress(chaining, wordsOf(bytes, at, at + BLOCK), counter, BLOCK, at === from ? CHUNK_START : 0);
  }
  const flags = CHUNK_END | (at === from ? CHUNK_START : 0);
  return { chaining, words: wordsOf(bytes, at, to).slice(), counter, length: to - at, flags };
}

function finish({ chaining, words, counter, length, flags }, root) {
  return compress(chaining, words, root ? 0 : counter, length, flags | (root ? ROOT : 0));
}

function parent(left, right) {
  const words = new Int32Array(16);
  words.set(left);
  words.set(right, 8);
  return { chaining: IV, words, counter: 0, length: BLOCK, flags: PARENT };
}

/** The hash of bytes, in hexadecimal digits. */
export async function blake3(bytes) {
  const stack = [];
  let [at, counter, turn] = [0, 0, TURN];
  while (bytes.length - at > CHUNK) {
    let value = finish(chunk(bytes, at, at + CHUNK, counter), false);
    at += CHUNK;
    counter += 1;
    for (let whole = counter; whole % 2 === 0; whole /= 2) value = finish(parent(stack.pop(), value), false);
    stack.push(value);
    if (at >= turn) {
      turn += TURN;
      await new Promise((resume) => setTimeout(resume));
    }
  }
  let last = chunk(bytes, at, bytes.length, counter);
  while (stack.length > 0) last = parent(stack.pop(), finish(last, false));
  const root = finish(last, true);
  const digits = new DataView(new ArrayBuffer(32));
  root.forEach((word, index) => digits.setInt32(4 * index, word, true));
  return Array.from(new Uint8Array(digits.buffer), (byte) => byte.toString(16).padStart(2, "0")).join("");
}
