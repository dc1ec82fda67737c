"""Resolve and lock every dependency, for all platforms at once, and list the licences.

    python -m supply.lock [--upgrade]

Without --upgrade the locked versions stay as far as pyproject.toml allows. All extras are resolved
together, so that any of them can be installed beside any other; then each gets the part it needs.
"""

from __future__ import annotations

import argparse
import csv
import io
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import uv

from supply import LICENCES, LOCKS, PROGRAM, PYTHONS, ROOT, Locked, apart, asked, listed, lock, read
from supply.licences import licences_of

COLUMNS = ("name", "version", "licence", "locks", "needed_by")
PLATFORM = "x86_64-unknown-linux-gnu"
NO_WHEEL = {"hdrutils"}
"""Has a source distribution only: what pip builds it with is not locked. A benchmark's peer."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--upgrade", action="store_true", help="take the newest versions")
    upgrade = parser.parse_args().upgrade
    with tempfile.TemporaryDirectory() as folder:
        texts = _resolve(Path(folder), upgrade)
        _check(texts, Path(folder))
    LOCKS.mkdir(exist_ok=True)
    for name, text in texts.items():
        (LOCKS / name).write_text(text)
    return 0


def _resolve(folder: Path, upgrade: bool) -> dict[str, str]:
    """By file name, the text of each lock and of the list of licences."""
    whole = folder / "whole.txt"
    if not upgrade:  # uv prefers the versions in the file that it is to replace
        whole.write_text(
            "\n".join(lock(name).read_text() for name in asked() if lock(name).exists())
        )
    _compile(whole, "--annotation-style", "line", "--all-extras")

    part = folder / "part.txt"
    _compile(part, "--no-annotate", "--constraint", str(whole))
    parts = {PROGRAM: read(part)}
    texts = {f"{PROGRAM}.txt": _headed("what sixlight needs", part)}
    served = _served(parts[PROGRAM], read(whole))
    left_out = [word for name in served for word in ("--no-emit-package", name)]
    for extra in asked():
        if extra != PROGRAM:
            part.unlink()
            _compile(
                *(part, "--no-annotate", "--constraint", str(whole), "--extra", extra), *left_out
            )
            parts[extra] = read(part)
            about = f"what the extra {extra} needs beyond {PROGRAM}.txt"
            texts[f"{extra}.txt"] = _headed(about, part)
    texts[LICENCES.name] = _list(whole, parts, folder)
    return texts


def _served(program: list[Locked], whole: list[Locked]) -> list[str]:
    """The packages that the program's lock has wherever anything wants them.

    colorama, which the program wants on Windows alone, is none: mkdocs-material always wants it.
    """
    elsewhere = {package.name for package in set(whole) - set(program)}
    return sorted({package.name for package in program} - elsewhere)


def _compile(out: Path, *options: str) -> None:
    """Write a lock that holds for every platform and for all Pythons from the oldest on."""
    _uv(
        *("pip", "compile", "pyproject.toml", "--universal", "--generate-hashes", "--no-header"),
        *("--python-version", PYTHONS[0], "--output-file", str(out), *options),
    )


def _headed(about: str, part: Path) -> str:
    """A lock's text below a line that says what it is, without what uv says it left out."""
    text = part.read_text().split("\n# The following packages were excluded")[0]
    return f"# Made by `make lock`: {about}.\n{text.rstrip()}\n"


def _check(texts: dict[str, str], folder: Path) -> None:
    """End with uv's message unless each lock installs on Linux by its hashes, for each Python."""
    for name in asked():
        (folder / f"{name}.txt").write_text(texts[f"{name}.txt"])
        built = [word for package in sorted(NO_WHEEL) for word in ("--no-binary", package)]
        for python in PYTHONS:
            _uv(
                *("pip", "install", "--dry-run", "--require-hashes", "--only-binary", ":all:"),
                *(*built, "--python-version", python, "--python-platform", PLATFORM),
                *("--target", str(folder / "site"), "-r", str(folder / f"{PROGRAM}.txt")),
                *("-r", str(folder / f"{name}.txt")),
            )


def _list(whole: Path, parts: dict[str, list[Locked]], folder: Path) -> str:
    """The text of licences.csv; only packages that it does not have yet are fetched."""
    rows = listed() if LICENCES.exists() else []
    known = {(row.name, row.version): row.licence for row in rows}
    packages = read(whole)
    fresh = [package for package in packages if (package.name, package.version) not in known]
    for number, some in enumerate(apart(fresh)):
        known |= licences_of(_installed(some, folder / f"site{number}"))
    needed_by = re.findall(r"^    # via (.*)$", whole.read_text(), flags=re.M)
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    for package, who in zip(packages, needed_by, strict=True):
        key = (package.name, package.version)
        locks = [name for name, part in parts.items() if key in {(p.name, p.version) for p in part}]
        needs = who.replace(" (pyproject.toml)", "").replace(",", "")
        table.writerow([*key, known[key], " ".join(locks), needs])
    return text.getvalue()


def _installed(packages: list[Locked], site: Path) -> Path:
    """A folder with the packages installed for the newest Python, whatever their markers say."""
    lines = [
        " ".join([f"{p.name}=={p.version}", *(f"--hash=sha256:{h}" for h in p.hashes)])
        for p in packages
    ]
    site.with_suffix(".txt").write_text("\n".join(lines) + "\n")
    _uv(
        *("pip", "install", "--require-hashes", "--no-deps", "--target", str(site)),
        *("--python-version", PYTHONS[-1]),
        *("--requirements", str(site.with_suffix(".txt"))),
    )
    return site


def _uv(*words: str) -> None:
    done = subprocess.run([uv.find_uv_bin(), "--quiet", *words], cwd=ROOT)
    if done.returncode:
        sys.exit(done.returncode)


if __name__ == "__main__":
    sys.exit(main())
