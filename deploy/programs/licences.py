"""Prints the licences of everything that is compiled into the programs for a target: `licences.py TARGET`, in a checkout.

Each text stands there once, with the libraries that it is of.
"""

import json
import pathlib
import subprocess
import sys

NAMES = ("LICEN", "COPYING", "COPYRIGHT", "NOTICE", "UNLICENSE")
# Libraries that come without a text of their licence.
WITHOUT_TEXT = {"draco-core", "pulp-wasm-simd-flag", "zune-inflate"}
PROGRAMS = ("photonfarm", "photonfarm-worker")


def libraries(target):
    """The packages that the programs are made of, without those that only build or test them."""
    command = ["cargo", "metadata", "--locked", "--format-version", "1", "--filter-platform", target]
    metadata = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
    packages = {package["id"]: package for package in metadata["packages"]}
    depends = {
        node["id"]: [to["pkg"] for to in node["deps"] if any(kind["kind"] is None for kind in to["dep_kinds"])]
        for node in metadata["resolve"]["nodes"]
    }
    reached = {name for name, package in packages.items() if package["name"] in PROGRAMS and package["source"] is None}
    todo = list(reached)
    while todo:
        for name in depends[todo.pop()]:
            if name not in reached:
                reached.add(name)
                todo.append(name)
    found = [packages[name] for name in reached if packages[name]["source"] is not None]
    return sorted(found, key=lambda package: (package["name"], package["version"]))


def texts(package):
    """The texts of a package's licences."""
    folder = pathlib.Path(package["manifest_path"]).parent
    files = sorted(path for path in folder.iterdir() if path.is_file() and path.name.upper().startswith(NAMES))
    if not files and package["name"] not in WITHOUT_TEXT:
        sys.exit(f"error: {package['name']} {package['version']} ({package['license']}) has no text of its licence in {folder}")
    return [path.read_text(errors="replace").replace("\r\n", "\n").strip() for path in files]


def main(target):
    rust = subprocess.run(["rustc", "--version"], check=True, stdout=subprocess.PIPE, text=True).stdout.strip()
    print("Photonfarm is licensed as LICENSE-MIT or LICENSE-APACHE say, at your choice. It holds these libraries:\n")
    holders = {}
    for package in libraries(target):
        title = f"{package['name']} {package['version']}"
        print(f"  {title}: {package['license']}")
        for text in texts(package):
            holders.setdefault(text, []).append(title)
    print(f"  the standard library of {rust}: MIT OR Apache-2.0")
    print("  libunwind and compiler-rt of LLVM, by zig: Apache-2.0 WITH LLVM-exception")
    print("  SQLite, within libsqlite3-sys: in the public domain")
    for text, names in holders.items():
        print(f"\n{'=' * 80}\n{', '.join(names)}\n{'=' * 80}\n\n{text}")


main(sys.argv[1])
