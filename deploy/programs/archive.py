"""Packs a folder, `archive.py FOLDER OUT`: as a zip where its programs are for Windows, else as a tar.gz.

The same files give the same bytes: entries are sorted, belong to nobody, and have the time SOURCE_DATE_EPOCH.
"""

import gzip
import os
import pathlib
import sys
import tarfile
import time
import zipfile

PROGRAMS = ("photonfarm", "photonfarm-worker", "photonfarm.exe", "photonfarm-worker.exe")


def mode(path):
    return 0o755 if path.name in PROGRAMS else 0o644


def tar(folder, files, out, moment):
    with open(out, "wb") as raw, gzip.GzipFile("", "wb", 9, raw, mtime=moment) as packed:
        with tarfile.open(fileobj=packed, mode="w", format=tarfile.USTAR_FORMAT) as archive:
            for path in files:
                entry = tarfile.TarInfo(path.relative_to(folder.parent).as_posix())
                entry.size, entry.mode, entry.mtime = path.stat().st_size, mode(path), moment
                with path.open("rb") as content:
                    archive.addfile(entry, content)


def zip_file(folder, files, out, moment):
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for path in files:
            entry = zipfile.ZipInfo(path.relative_to(folder.parent).as_posix(), time.gmtime(moment)[:6])
            entry.external_attr = (0o100000 | mode(path)) << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, path.read_bytes())


def main(folder, out):
    moment = int(os.environ["SOURCE_DATE_EPOCH"])
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    windows = (folder / "photonfarm.exe").exists()
    target = out / (folder.name + (".zip" if windows else ".tar.gz"))
    (zip_file if windows else tar)(folder, files, target, moment)
    print(f"{target}: {target.stat().st_size / 1e6:.1f} MB")


main(pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2]))
