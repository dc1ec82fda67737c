"""`sixlight clean`: removes what steps leave each other, which is most of what a run takes on disk.

The results stay, and stay current: the runner knows by its stamps what was in the files that are
gone, and makes them again only when something that reads them must be done again.
"""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline import finished
from pipeline.errors import fault, storing

_OURS = ("work/capture.json", "work/lock", finished.STAMP)  # beside what stamps list


@dataclass(frozen=True)
class Cleaned:
    """What was done in one output folder.

    files, bytes  removed
    """

    out: Path
    files: int
    bytes: int


def clean(outs: Sequence[Path], *, everything: bool = False) -> list[Cleaned]:
    """Removes intermediate files of finished and unfinished runs.

    everything  all that sixlight wrote there, results too; what others put beside them stays
    raises      InputError, before anything is removed, where one is no output folder or is in use
    """
    for out in outs:
        _check(out)
    return [_clean(out, everything) for out in outs]


def keep(outs: Sequence[Path], most_bytes: float) -> list[Cleaned]:
    """Removes intermediate files of the least recently run captures until the rest fit.

    outs        output folders, or folders that have some below them
    most_bytes  that intermediate files may take in all
    """
    found = [out for folder in outs for out in _below(folder)]
    if not found:
        raise fault("no results found", "folders `envmap` wrote to", "check the path", outs[0])
    by_use = sorted(found, key=_last_run_ns, reverse=True)
    cleaned = []
    left = most_bytes
    for out in by_use:
        left -= sum(_size(path) for path in _intermediate(out))
        if left < 0:
            cleaned.append(_clean(out, everything=False))
    return cleaned


def _below(folder: Path) -> Iterator[Path]:
    if not folder.is_dir():
        _check(folder)
    for place, names, _ in os.walk(folder):
        if (Path(place) / "work" / "capture.json").is_file():
            names.clear()
            yield Path(place)
        names.sort()


def _last_run_ns(out: Path) -> int:
    """When the capture was last run: each run opens the lock for writing."""
    lock = out / "work" / "lock"
    return lock.stat().st_mtime_ns if lock.is_file() else 0


def _check(out: Path) -> None:
    if not (out / "work" / "capture.json").is_file():
        found = "holds no results of sixlight" if out.is_dir() else "no such folder"
        raise fault(found, "a folder `envmap` wrote to", "check the path", out)


def _clean(out: Path, everything: bool) -> Cleaned:
    with _alone(out):
        paths = _written(out) if everything else _intermediate(out)
        size = sum(_size(path) for path in paths)
        with storing(out):
            # Stamps that tell of whole runs go first: what is removed half is not finished.
            for path in sorted(paths, key=lambda path: path != out / finished.STAMP):
                path.unlink()
            if everything:
                _remove_empty(out / "work")
                _remove_empty(out)
        return Cleaned(out, len(paths), size)


@contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Holds the folder's lock, as a run does; refuses where one has it."""
    with storing(out), (out / "work" / "lock").open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise fault("a run is writing here", "finished results", "wait for it", out) from error
        yield


def _intermediate(out: Path) -> list[Path]:
    """Files in work/ that a step made, as its stamp says."""
    return [path for path in _made(out) if path.parent == out / "work" and path.is_file()]


def _written(out: Path) -> list[Path]:
    """All files that sixlight wrote: what stamps list, they themselves, and what goes with them."""
    stamps = (out / "work").glob("*.made.json")
    ours = [out / name for name in ("result.json", *_OURS)]
    return [path for path in dict.fromkeys([*_made(out), *stamps, *ours]) if path.is_file()]


def _made(out: Path) -> list[Path]:
    made: list[Path] = []
    for stamp in sorted((out / "work").glob("*.made.json")):
        try:
            content: dict[str, Any] = json.loads(stamp.read_text(encoding="utf-8"))
            names = [name for name in content["made"] if ".." not in Path(name).parts]
        except (OSError, ValueError, KeyError, TypeError):
            continue  # no stamp of ours
        made += [out / name for name in names if not Path(name).is_absolute()]
    return made


def _size(path: Path) -> int:
    return path.stat().st_size


def _remove_empty(folder: Path) -> None:
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()
