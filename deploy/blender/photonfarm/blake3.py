"""BLAKE3, by which a farm names files. Python has none, so it is done here for all chunks of a file at once, by numpy.

The names are those of the paper: O'Connor, Aumasson, Neves and Wilcox-O'Hearn, "BLAKE3: one function, fast everywhere".
"""

import numpy

IV = numpy.array(
    [0x6A09E667, 0xBB67AE85, 0x3C6EF372, 0xA54FF53A, 0x510E527F, 0x9B05688C, 0x1F83D9AB, 0x5BE0CD19], dtype=numpy.uint32
)
PERMUTATION = [2, 6, 3, 10, 7, 0, 4, 13, 1, 11, 12, 5, 9, 14, 15, 8]
CHUNK_START, CHUNK_END, PARENT, ROOT = 1, 2, 4, 8
CHUNK, BLOCK = 1024, 64
# Chunks that are hashed at once: their state stays in the cache.
BATCH = 4096


def _mix(v, a, b, c, d, x, y):
    def turn(value, bits):
        return (value >> numpy.uint32(bits)) | (value << numpy.uint32(32 - bits))

    v[a] = v[a] + v[b] + x
    v[d] = turn(v[d] ^ v[a], 16)
    v[c] = v[c] + v[d]
    v[b] = turn(v[b] ^ v[c], 12)
    v[a] = v[a] + v[b] + y
    v[d] = turn(v[d] ^ v[a], 8)
    v[c] = v[c] + v[d]
    v[b] = turn(v[b] ^ v[c], 7)


def _compress(chaining, words, counters, size, flags):
    """The chaining values (8 x N) after one block (16 x N words) of each of N chunks or parents."""
    count = words.shape[1]
    same = numpy.ones(count, dtype=numpy.uint32)
    v = [*chaining, *(IV[i] * same for i in range(4))]
    v += [counters.astype(numpy.uint32), (counters >> numpy.uint64(32)).astype(numpy.uint32)]
    v += [numpy.uint32(size) * same, numpy.uint32(flags) * same]
    m = list(words)
    for _ in range(7):
        _mix(v, 0, 4, 8, 12, m[0], m[1])
        _mix(v, 1, 5, 9, 13, m[2], m[3])
        _mix(v, 2, 6, 10, 14, m[4], m[5])
        _mix(v, 3, 7, 11, 15, m[6], m[7])
        _mix(v, 0, 5, 10, 15, m[8], m[9])
        _mix(v, 1, 6, 11, 12, m[10], m[11])
        _mix(v, 2, 7, 8, 13, m[12], m[13])
        _mix(v, 3, 4, 9, 14, m[14], m[15])
        m = [m[i] for i in PERMUTATION]
    return numpy.array([v[i] ^ v[i + 8] for i in range(8)])


def _chunks(data, first, root):
    """Chaining values of chunks of the same size, one or more, the bytes of which are the rows of `data`."""
    count, size = data.shape
    counters = numpy.arange(first, first + count, dtype=numpy.uint64)
    chaining = numpy.repeat(IV[:, None], count, axis=1)
    blocks = max(1, -(-size // BLOCK))
    padded = numpy.zeros((count, blocks * BLOCK), dtype=numpy.uint8)
    padded[:, :size] = data
    words = padded.view("<u4").reshape(count, blocks, 16).astype(numpy.uint32)
    for block in range(blocks):
        last = block == blocks - 1
        flags = (CHUNK_START if block == 0 else 0) | (CHUNK_END if last else 0) | (ROOT if last and root else 0)
        length = size - block * BLOCK if last else BLOCK
        chaining = _compress(chaining, words[:, block].T, counters, length, flags)
    return chaining


def hexdigest(content):
    """The hash of some bytes, as a farm writes it."""
    data = numpy.frombuffer(content, dtype=numpy.uint8)
    # The last chunk, whole or not, stands by itself; an empty file is one empty chunk.
    whole = max(0, -(-len(data) // CHUNK) - 1)
    parts = []
    for first in range(0, whole, BATCH):
        end = min(first + BATCH, whole)
        parts.append(_chunks(data[first * CHUNK : end * CHUNK].reshape(-1, CHUNK), first, False))
    parts.append(_chunks(data[whole * CHUNK :].reshape(1, -1), whole, whole == 0))
    nodes = numpy.concatenate(parts, axis=1)
    while nodes.shape[1] > 1:
        pairs = nodes.shape[1] // 2
        words = numpy.concatenate([nodes[:, 0 : 2 * pairs : 2], nodes[:, 1 : 2 * pairs : 2]])
        root = ROOT if nodes.shape[1] == 2 else 0
        chaining = numpy.repeat(IV[:, None], pairs, axis=1)
        joined = _compress(chaining, words, numpy.zeros(pairs, dtype=numpy.uint64), BLOCK, PARENT | root)
        nodes = numpy.concatenate([joined, nodes[:, 2 * pairs :]], axis=1)
    return nodes[:, 0].astype("<u4").tobytes().hex()
