"""Runs the steps in order: skips what is current, moves results into place, writes result.json.

A result is current when its inputs, the values given to its step and the code hash as they did
when it was made, and the file is still what was written then; that it exists proves nothing.
"""

from __future__ import annotations

import fcntl
import itertools
import json
import os
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pipeline import digest, finished, io
from pipeline.capture import Capture
from pipeline.errors import fault, reading, storing
from pipeline.progress import Progress
from pipeline.settings import Settings
from pipeline.steps import STEPS, Step, files_of
from pipeline.verdict import verdict

_RESULT = "result.json"


@dataclass(frozen=True)
class _Task:
    """A step for one filter, for one view, or for the whole capture.

    name   "merge cyan"; of several views "merge left cyan"
    reads  (name, path) of each input; the name has no machine's folders in it
    makes  names of files in the output folder
    """

    step: Step
    name: str
    reads: tuple[tuple[str, Path], ...]
    makes: tuple[str, ...]
    given: Mapping[str, Any]
    out: Path

    @property
    def writes(self) -> set[Path]:
        return {self.out / name for name in self.makes}

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
    claim(capture, out, force)
    with _alone(out):
        return _bring_up_to_date(capture, out, settings, quiet)


def _bring_up_to_date(
    capture: Capture, out: Path, settings: Settings, quiet: bool
) -> dict[str, Any]:
    tasks = _plan(capture, out, settings)
    digests: dict[Path, str] = {}
    progress = Progress(len(tasks), quiet=quiet)
    stamps: list[dict[str, Any]] = []
    result: dict[str, Any] = {}
    for task in tasks:
        if (_RESULT, out / _RESULT) in task.reads:  # it tells of all the tasks before
            result = _result(capture, settings, tasks, stamps, digests)
            _store_json(out / _RESULT, result, out)
        key = _key(task, digests)
        stamp = _current(task, key, out)
        if stamp is not None:
            progress.current(task.name)
        else:
            (out / finished.STAMP).unlink(missing_ok=True)
            for maker in _makers(task, tasks):
                before, again = _stamp(maker, out), _key(maker, digests)
                with progress.again(maker.name):
                    made = _make(maker, again, out, capture.seen)["made"]
                if before is None or before["made"] != made:  # other libraries: others read it too
                    return _bring_up_to_date(capture, out, settings, quiet)
                _store_json(out / maker.stamp, before, out)  # result.json tells its seconds
            with progress.step(task.name, ", ".join(Path(m).name for m in task.makes)):
                stamp = _make(task, key, out, capture.seen)
        stamps.append(stamp)
        digests |= {out / name: d for name, d in stamp["made"].items()}
    _note_finished(capture, out, settings, tasks)
    return result


def _makers(task: _Task, tasks: Sequence[_Task]) -> list[_Task]:
    """The tasks, in order, that must make again what `sixlight clean` removed and `task` reads."""
    missing = {path for _, path in task.reads if not path.is_file()}
    makers = []
    for other in reversed(tasks[: tasks.index(task)]):
        if missing & other.writes:
            makers.append(other)
            missing |= {path for _, path in other.reads if not path.is_file()}
    return makers[::-1]


def _note_finished(capture: Capture, out: Path, settings: Settings, tasks: Sequence[_Task]) -> None:
    """Leaves word that nothing needs to be looked at while all stands as it does now."""
    results = [name for t in tasks for name in t.makes if not name.startswith("work/")]
    made = [_RESULT, *(t.stamp for t in tasks), *results]
    stands = finished.stamp(capture.folder, capture.curves, capture.seen, made, out, settings)
    _store_json(out / finished.STAMP, stands, out)


def claim(capture: Capture, out: Path, force: bool) -> None:
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
        elif _holds_something(out) and not force:
            raise fault(
                "holds files that sixlight did not write",
                "an empty folder or earlier results of the same capture",
                "choose another with -o, or --force",
                out,
            )
        (out / "work").mkdir(parents=True, exist_ok=True)
    _store_json(owner, mine, out)


def _holds_something(out: Path) -> bool:
    """More than a run leaves that is killed before it says whose results these are to be."""
    work = out / "work"
    inside = work.iterdir() if work.is_dir() and not work.is_symlink() else ()
    unfinished = all(path.name.startswith("unfinished-") for path in inside)
    return out.is_dir() and any(path != work or not unfinished for path in out.iterdir())


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
    several = bool(capture.views)
    names = [view.name for view in capture.views] if several else [None]
    for step in STEPS:
        if (step.calibrated and capture.transform is None) or (step.several and not several):
            continue
        for view in names if step.each_view else [None]:
            part = capture if view is None else capture.of_view(view)
            for i, f in enumerate(part.filters[: None if step.for_each else 1]):
                files = partial(
                    files_of,
                    filters=[f.name] if step.for_each else [g.name for g in part.filters],
                    channels=channels,
                    views=names if view is None else [view],
                )
                photographs = {
                    "raw": f.shots if step.for_each else part.shots,
                    "dark": part.of_sensor.dark,
                    "flat": part.of_sensor.flat.get(f.name, ()),
                }
                reads: list[tuple[str, Path]] = []
                for name in step.reads:
                    if name in photographs:
                        reads += [(f"{name} {s.path.name}", s.path) for s in photographs[name]]
                    else:
                        reads += [(file, out / file) for file in files(name)]
                about = [step.name, view, f.name if step.for_each else None]
                tasks.append(
                    _Task(
                        step,
                        " ".join(word for word in about if word is not None),
                        tuple(reads),
                        tuple(itertools.chain.from_iterable(map(files, step.makes))),
                        step.given(part, settings, i),
                        out,
                    )
                )
    return tasks


def _key(task: _Task, digests: dict[Path, str]) -> str:
    """The digest of all a task's results depend on."""
    for _, path in task.reads:
        if path not in digests:
            with reading(path):
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
    """The stamp of a task whose results are current, else None.

    What steps leave each other in work/ may be missing: `sixlight clean` removes it. Its digest, as
    noted when it was made, stands for it until something that reads it must be done again.
    """
    stamp = _stamp(task, out)
    if stamp is None or stamp.get("key") != key:
        return None
    for name, expected in stamp["made"].items():
        path = out / name
        if name.startswith("work/") and not path.exists():
            continue
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


def _make(task: _Task, key: str, out: Path, seen: finished.Seen) -> dict[str, Any]:
    """Runs a task beside the results, then moves what it made into place.

    seen  the photographs as they were when the capture was checked: what is made of others is not
          kept
    """
    with storing(out):
        beside = Path(tempfile.mkdtemp(prefix="unfinished-", dir=out / "work"))
    try:
        began = time.monotonic()
        writes = [beside / Path(name).name for name in task.makes]
        learnt = task.step.run([path for _, path in task.reads], writes, **task.given)
        _check_unchanged((path for _, path in task.reads), seen)
        made = {name: digest.of_file(w) for name, w in zip(task.makes, writes, strict=True)}
        stamp = {
            "key": key,
            "seconds": round(time.monotonic() - began, 2),
            "made": made,
            "learnt": learnt,
        }
        stamp_file = beside / "stamp"
        io.write_json(stamp_file, stamp)
        stamp = json.loads(stamp_file.read_text(encoding="utf-8"))  # as the next run will have it
        with storing(out):
            for name, written in zip(task.makes, writes, strict=True):
                os.replace(written, out / name)
            _clear_away(_stamp(task, out), made, out)
            os.replace(stamp_file, out / task.stamp)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return stamp


def _check_unchanged(paths: Iterable[Path], seen: finished.Seen) -> None:
    """InputError where a photograph was written to, or removed, since the run began."""
    for path, now in finished.see(paths).items():
        before = seen.get(path)
        if before is not None and (now is None or now[:2] != before[:2]):
            raise fault(
                "is gone" if now is None else "has changed since the run began",
                "photographs that stay as they are while they are read",
                "run again once it is there, complete",
                path,
            )


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
        f"{task.name.partition(' ')[2] or task.name}: {note}"
        for task, stamp in zip(tasks, stamps, strict=False)
        for note in stamp["learnt"].get("notes", ())
    ]


def _result(
    capture: Capture,
    settings: Settings,
    tasks: Sequence[_Task],
    stamps: Sequence[Mapping[str, Any]],
    digests: Mapping[Path, str],
) -> dict[str, Any]:
    """result.json: what was read, how it went, what was made by the tasks done so far."""
    t = capture.transform
    told: dict[str, Any] = {
        "name": capture.name,
        "capture": _told(capture),
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
            "changed_since": _changed_since(capture),
            **t.figures,
        },
        "settings": asdict(settings),
        "steps": {
            task.name: {"seconds": s["seconds"], "learnt": s["learnt"], "made": s["made"]}
            for task, s in zip(tasks, stamps, strict=False)
        },
        "versions": finished.versions(),
    }
    return {**told, "verdict": verdict(told)}


def _changed_since(capture: Capture) -> list[str]:
    """What M_S was fitted from and has changed since, as far as it lies beside it."""
    file = capture.calibration.transform
    if file is None or capture.transform is None:
        return []
    beside = [file.parent, *(p for p in file.parent.iterdir() if p.is_dir())]
    return digest.changed(capture.transform.inputs, beside)


def _told(capture: Capture) -> dict[str, Any]:
    """What the capture itself says."""
    return {
        "camera": capture.shots[0].camera or "a camera not named in its files",
        "filters": [f.name for f in capture.filters],
        "brackets": [
            {
                "name": name,
                "exposures": [
                    {
                        "file": shot.path.name,
                        "time_s": shot.time_s,
                        "iso": shot.iso,
                        "f_number": shot.f_number,
                    }
                    for shot in f.shots
                ],
            }
            for name, f in capture.brackets
        ],
        "radius_mm": capture.sphere.radius_mm,
        "room": None if capture.room is None else asdict(capture.room),
        "distant": capture.distant,
    }
