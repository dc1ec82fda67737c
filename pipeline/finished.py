"""Whether a finished capture needs another look: by names, sizes and times, in milliseconds.

A run that ends well leaves work/finished.json: what stood on disk of all it read and wrote, the
code, the versions, the settings. While all that is as it was, running again would change nothing.
This only ever spares work: where anything is doubtful the steps' own digests decide. Nothing slow
is imported here, so that a batch of finished captures is looked through at once.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import platform
from collections.abc import Iterable
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pipeline import defaults
from pipeline.settings import Settings

STAMP = "work/finished.json"
_LIBRARIES = (
    "colour-science",
    "moderngl",
    "numpy",
    "opencv-contrib-python-headless",
    "OpenImageIO",
    "rawpy",
    "scipy",
)
_CODE = Path(__file__).parent.parent
_PACKAGES = ("pipeline", "stages", "shaders", "calibration")

Seen = dict[str, list[int] | None]  # path -> size and times; None: not there


def see(paths: Iterable[Path]) -> Seen:
    """What stands on disk; a folder by all files below it."""
    files = itertools.chain.from_iterable(_below(p) if p.is_dir() else [p] for p in paths)
    return {str(file.resolve()): _state(file) for file in files}


def _below(folder: Path) -> list[Path]:
    return [Path(place) / name for place, _, names in os.walk(folder) for name in names]


def _state(file: Path) -> list[int] | None:
    try:
        at = file.stat()
    except OSError:
        return None
    # ctime tells also of a file whose time of change was set back.
    return [at.st_size, at.st_mtime_ns, at.st_ctime_ns]


def stamp(
    folder: Path, curves: Iterable[Path], seen: Seen, made: Iterable[str], out: Path, settings: Any
) -> dict[str, Any]:
    """What work/finished.json holds of a run that ended well; all names relative to `out`.

    folder, curves  of the capture
    seen            both, and defaults.toml, as they stood before anything was read
    made            names of the results
    """
    place = out.resolve()

    def relative(paths: Iterable[str | Path]) -> list[str]:
        return [os.path.relpath(path, place) for path in paths]

    own = f"{place}{os.sep}"  # a capture may hold its own results
    inputs = {path: state for path, state in seen.items() if not path.startswith(own)}
    return {
        "capture": relative([folder.resolve()])[0],
        "defaults": relative(defaults.above(folder)),
        "curves": sorted(relative(path.resolve() for path in curves)),
        "inputs": dict(zip(relative(inputs), inputs.values(), strict=True)),
        "made": {name: _state(out / name) for name in made},
        "settings": vars(settings),
        "code": code(),
        "versions": versions(),
    }


def holds(folder: Path, out: Path, settings: Settings) -> bool:
    """Whether a capture's results in `out` are certain to be current."""
    try:
        kept = json.loads((out / STAMP).read_text(encoding="utf-8"))
        curves = [out / name for name in kept["curves"]]
        seen = see([folder, *defaults.above(folder), *curves])
        return bool(stamp(folder, curves, seen, kept["made"], out, settings) == kept)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return False


@cache
def versions() -> dict[str, str]:
    """Of Python and the libraries that results come through."""
    return {"python": platform.python_version(), **{n: version(n) for n in _LIBRARIES}}


@cache
def code() -> str:
    """SHA-256 of all that sixlight is made of, with its shaders and data."""
    digest = hashlib.sha256()
    for package in _PACKAGES:
        for file in sorted((_CODE / package).rglob("*")):
            if file.is_file() and file.suffix != ".pyc":
                content = file.read_bytes()
                digest.update(f"{file.relative_to(_CODE)}\0{len(content)}\0".encode())
                digest.update(content)
    return digest.hexdigest()
