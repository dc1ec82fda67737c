"""defaults.toml: what all captures of a shoot share, written once in a folder above them.

Every defaults.toml above a capture counts, the nearest first, and the capture's own capture.toml
before all: key by key, so that a capture may give its own outline on the shoot's sphere.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from calibration.errors import InputError, Problem
from pipeline.files.tables import read_toml

NAME = "defaults.toml"
ROOT = ".sixlight-root"  # in a folder that nothing above counts in: what was brought from elsewhere
_TABLES = ("sphere", "camera", "room", "calibration", "orientation")
# What is said in one of two ways; a capture that says it one way is not given the other besides.
_EITHER = (
    ("calibration", {"transform"}, {"camera", "filters"}),
    ("room", {"distant"}, {"size_m", "sphere_m", "camera_m"}),
)


def above(folder: Path) -> list[Path]:
    """The defaults.toml that hold for a capture's folder, the nearest first.

    Folders above are looked through as long as they belong to the owner of the capture's, and no
    further up than the home folder: what others left in a common place says nothing here.
    """
    folder = folder.resolve()
    owner = folder.stat().st_uid
    home = _home()
    found = []
    for place in folder.parents:
        if place.stat().st_uid != owner:
            break
        file = place / NAME
        if file.is_file() and file.stat().st_uid == owner:
            found.append(file)
        if place == home or (place / ROOT).is_file():
            break
    return found


def _home() -> Path | None:
    try:
        return Path.home().resolve()
    except (RuntimeError, OSError):  # there is none
        return None


def under(
    own: Mapping[str, Any], file: Path, files: Iterable[Path], problems: list[Problem]
) -> tuple[dict[str, Any], dict[str, Path]]:
    """A capture.toml's content with defaults under it, and where each value is from.

    own       the content of `file`
    files     as `above` finds them
    problems  gains what is wrong with them
    returns   content, and by name, "sphere.radius_mm", the file it was read from where that is not
              `file`
    """
    content = {key: dict(v) if isinstance(v, dict) else v for key, v in own.items()}
    origins: dict[str, Path] = {}
    for shared in files:
        try:
            given = read_toml(shared)
        except InputError as error:
            problems += error.problems
            continue
        for name, table in given.items():
            if name not in _TABLES or not isinstance(table, dict):
                expected = f"tables that captures share: [{'], ['.join(_TABLES)}]"
                problems.append(
                    Problem(f"{name} is given"[:200], expected, "move it to a capture.toml", shared)
                )
                continue
            mine = content.setdefault(name, {})
            if not isinstance(mine, dict):
                continue  # which reading it will say
            for key in sorted(set(table) - set(mine) - _excluded(name, set(mine))):
                mine[key] = table[key]
                origins[f"{name}.{key}"] = shared
    return content, origins


def told(origins: Mapping[str, Path], folder: Path) -> list[str]:
    """A sentence for each file that something was taken from."""
    return [
        f"from {os.path.relpath(file, folder.resolve())}: "
        + ", ".join(sorted(name for name, other in origins.items() if other == file))
        for file in dict.fromkeys(origins.values())
    ]


def _excluded(table: str, given: set[str]) -> set[str]:
    """Keys that what is given already stands in place of."""
    out: set[str] = set()
    for name, one, other in _EITHER:
        if name == table:
            out |= other if given & one else set()
            out |= one if given & other else set()
    return out
