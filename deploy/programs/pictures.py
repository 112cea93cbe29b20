"""Holds two OpenEXR files of ours against each other: `pictures.py A B` fails unless they differ by the name of the renderer alone."""

import json
import pathlib
import struct
import sys
import zlib

MAGIC = b"\x76\x2f\x31\x01"


def parts(path):
    """The attributes of a file with one part, and its blocks of lines, unpacked."""
    data = path.read_bytes()
    assert data[:4] == MAGIC, f"{path} is no OpenEXR file"
    at, attributes = 8, {}
    while data[at]:
        name, kind, _ = data[at:].split(b"\0", 2)
        at += len(name) + len(kind) + 2
        (size,) = struct.unpack_from("<I", data, at)
        attributes[name.decode()] = data[at + 4 : at + 4 + size]
        at += 4 + size
    said = json.loads(attributes.pop("photonfarm"))
    del said["renderer"], attributes["renderer"]
    # Between the attributes and the blocks lies a table of where the blocks are.
    (at,) = struct.unpack_from("<Q", data, at + 1)
    blocks = []
    while at < len(data):
        line, size = struct.unpack_from("<iI", data, at)
        block = data[at + 8 : at + 8 + size]
        try:
            block = zlib.decompress(block)
        except zlib.error:
            pass  # What does not become smaller is not packed.
        blocks.append((line, block))
        at += 8 + size
    return attributes | said, blocks


def main(ours, theirs):
    (ours_said, ours_blocks), (theirs_said, theirs_blocks) = parts(ours), parts(theirs)
    assert ours_blocks and ours_said, ours
    differing = sorted(name for name in ours_said.keys() | theirs_said.keys() if ours_said.get(name) != theirs_said.get(name))
    if ours_blocks != theirs_blocks:
        differing.append("pixels")
    if differing:
        sys.exit(f"error: {ours} and {theirs} differ: {', '.join(differing)}")


main(*map(pathlib.Path, sys.argv[1:]))
