"""Runs the steps in order: skips what is current, moves results into place, writes result.json.

A result is current when its inputs, the values given to its step and the code hash as they did
when it was made, and the file is still what was written then; that it exists proves nothing.
"""

from __future__ import annotations

import fcntl
import itertools
import json
import os
import platform
import shutil
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pipeline import digest, io
from pipeline.capture import Capture
from pipeline.errors import fault, storing
from pipeline.progress import Progress
from pipeline.settings import Settings
from pipeline.steps import STEPS, Step, files_of

_LIBRARIES = [
    "colour-science",
    "moderngl",
    "numpy",
    "opencv-contrib-python-headless",
    "OpenImageIO",
    "rawpy",
    "scipy",
]


@dataclass(frozen=True)
class _Task:
    """A step for one filter, or for the whole capture.

    name   "merge cyan"
    reads  (name, path) of each input; the name has no machine's folders in it
    makes  names of files in the output folder
    """

    step: Step
    name: str
    reads: tuple[tuple[str, Path], ...]
    makes: tuple[str, ...]
    given: Mapping[str, Any]

    @property
    def stamp(self) -> str:
        return f"work/{self.name.replace(' ', '_')}.made.json"


def run(
    capture: Capture, out: Path, settings: Settings, *, force: bool = False, quiet: bool = False
) -> dict[str, Any]:
    """Brings all results of a capture in `out` up to date, and returns result.json's content.

    force  write into a folder that holds something else; results are still only made when
           they are not current

    InputError where the input or the place is at fault; results that were there stay as they are
    until the step that makes them has ended well.
    """
    _claim(capture, out, force)
    with _alone(out):
        tasks = _plan(capture, out, settings)
        digests: dict[Path, str] = {}
        progress = Progress(len(tasks), quiet=quiet)
        stamps = []
        for task in tasks:
            key = _key(task, digests)
            stamp = _current(task, key, out)
            if stamp is not None:
                progress.current(task.name)
            else:
                with progress.step(task.name, ", ".join(Path(m).name for m in task.makes)):
                    stamp = _make(task, key, out)
            stamps.append(stamp)
            digests |= {out / name: d for name, d in stamp["made"].items()}
        result = _result(capture, settings, tasks, stamps, digests)
        _store_json(out / "result.json", result, out)
        return result


def _claim(capture: Capture, out: Path, force: bool) -> None:
    """Makes sure that what is in `out` is this capture's, or nothing, or meant to be replaced."""
    owner = out / "work" / "capture.json"
    mine = {"capture": os.path.relpath(capture.folder.resolve(), out.resolve())}
    with storing(out):
        if owner.is_file():
            theirs = json.loads(owner.read_text(encoding="utf-8"))
            if theirs != mine and not force:
                raise fault(
                    f"holds results of another capture ({theirs.get('capture')})",
                    "an empty folder or earlier results of the same capture",
                    "choose another with -o, or --force",
                    out,
                )
        elif out.is_dir() and any(out.iterdir()) and not force:
            raise fault(
                "holds files that sixlight did not write",
                "an empty folder or earlier results of the same capture",
                "choose another with -o, or --force",
                out,
            )
        (out / "work").mkdir(parents=True, exist_ok=True)
    _store_json(owner, mine, out)


@contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Holds the output folder's lock, and clears away what a killed run left unfinished."""
    with storing(out), (out / "work" / "lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise fault(
                "another run is writing here",
                "one run at a time",
                "wait for it or choose another folder with -o",
                out,
            ) from error
        for leftover in (out / "work").glob("unfinished-*"):
            shutil.rmtree(leftover) if leftover.is_dir() else leftover.unlink()
        yield


def _plan(capture: Capture, out: Path, settings: Settings) -> list[_Task]:
    """The steps this capture needs, with the names of their files filled in."""
    tasks = []
    channels = 0 if capture.transform is None else len(capture.transform.matrix)
    for step in STEPS:
        if step.calibrated and capture.transform is None:
            continue
        for i, f in enumerate(capture.filters[: None if step.for_each else 1]):
            only = [f.name] if step.for_each else [g.name for g in capture.filters]
            reads: list[tuple[str, Path]] = []
            photographs = {
                "raw": f.shots,
                "dark": capture.of_sensor.dark,
                "flat": capture.of_sensor.flat.get(f.name, ()),
            }
            for name in step.reads:
                if name in photographs:
                    reads += [(f"{name} {s.path.name}", s.path) for s in photographs[name]]
                else:
                    files = files_of(name, filters=only, channels=channels)
                    reads += [(file, out / file) for file in files]
            makes = [files_of(name, filters=only, channels=channels) for name in step.makes]
            tasks.append(
                _Task(
                    step,
                    f"{step.name} {f.name}" if step.for_each else step.name,
                    tuple(reads),
                    tuple(itertools.chain.from_iterable(makes)),
                    step.given(capture, settings, i),
                )
            )
    return tasks


def _key(task: _Task, digests: dict[Path, str]) -> str:
    """The digest of all a task's results depend on."""
    for _, path in task.reads:
        if path not in digests:
            with storing(path):
                digests[path] = digest.of_file(path)
    return digest.of_values(
        {
            "step": task.step.name,
            "reads": [(name, digests[path]) for name, path in task.reads],
            "makes": task.makes,
            "given": task.given,
            "code": digest.of_code(task.step.run),
        }
    )


def _current(task: _Task, key: str, out: Path) -> dict[str, Any] | None:
    """The stamp of a task whose results are current, else None."""
    stamp = _stamp(task, out)
    if stamp is None or stamp.get("key") != key:
        return None
    for name, expected in stamp["made"].items():
        path = out / name
        if not path.is_file() or digest.of_file(path) != expected:
            return None
    return stamp


def _stamp(task: _Task, out: Path) -> dict[str, Any] | None:
    """What is known of the task's last results; None where there are none."""
    try:
        stamp: dict[str, Any] = json.loads((out / task.stamp).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return stamp


def _make(task: _Task, key: str, out: Path) -> dict[str, Any]:
    """Runs a task beside the results, then moves what it made into place."""
    with storing(out):
        beside = Path(tempfile.mkdtemp(prefix="unfinished-", dir=out / "work"))
    try:
        began = time.monotonic()
        writes = [beside / Path(name).name for name in task.makes]
        learnt = task.step.run([path for _, path in task.reads], writes, **task.given)
        made = {name: digest.of_file(w) for name, w in zip(task.makes, writes, strict=True)}
        stamp = {
            "key": key,
            "seconds": round(time.monotonic() - began, 2),
            "made": made,
            "learnt": learnt,
        }
        stamp_file = beside / "stamp"
        io.write_json(stamp_file, stamp)
        with storing(out):
            for name, written in zip(task.makes, writes, strict=True):
                os.replace(written, out / name)
            _clear_away(_stamp(task, out), made, out)
            os.replace(stamp_file, out / task.stamp)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return stamp


def _clear_away(before: Mapping[str, Any] | None, made: Mapping[str, str], out: Path) -> None:
    """Removes what a step made before and no longer makes: maps of channels there are no more."""
    for name, expected in (before or {}).get("made", {}).items():
        path = out / name
        if name not in made and path.is_file() and digest.of_file(path) == expected:
            path.unlink()


def _store_json(path: Path, content: Any, out: Path) -> None:
    """Writes a small file beside its place, then moves it there; not at all if it is the same."""
    beside = out / "work" / f"unfinished-{path.name}"
    try:
        io.write_json(beside, content)
        if path.is_file() and path.read_bytes() == beside.read_bytes():
            beside.unlink()
            return
        with storing(path):
            os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)


def _found(tasks: Sequence[_Task], stamps: Sequence[Mapping[str, Any]]) -> list[str]:
    """What the steps found that the user should know."""
    return [
        f"{task.name.split(' ')[-1]}: {note}"
        for task, stamp in zip(tasks, stamps, strict=True)
        for note in stamp["learnt"].get("notes", ())
    ]


def _result(
    capture: Capture,
    settings: Settings,
    tasks: Sequence[_Task],
    stamps: Sequence[Mapping[str, Any]],
    digests: Mapping[Path, str],
) -> dict[str, Any]:
    """result.json: what was read, how it went, what was made."""
    t = capture.transform
    return {
        "name": capture.name,
        "sixlight": version("sixlight"),
        "notes": list(capture.notes) + _found(tasks, stamps),
        "inputs": {
            str(shot.path.relative_to(capture.folder)): digests[shot.path] for shot in capture.shots
        },
        "calibration": None
        if t is None
        else {
            "primaries": t.primaries,
            "units": t.units,
            "method": t.method,
            "matrix": t.matrix.tolist(),
            **t.figures,
        },
        "settings": asdict(settings),
        "steps": {
            task.name: {"seconds": s["seconds"], "learnt": s["learnt"], "made": s["made"]}
            for task, s in zip(tasks, stamps, strict=True)
        },
        "versions": {"python": platform.python_version(), **{n: version(n) for n in _LIBRARIES}},
    }
