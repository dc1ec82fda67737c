"""Many captures: what two at once gain over one, memory as reckoned and as taken, a second run."""

from __future__ import annotations

import json
import math
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.figure import Figure
from pipeline import batch, finished
from pipeline.batch import child
from pipeline.batch.shoot import Job, needs_on_disk, plan
from pipeline.settings import Settings
from stages.compiled import compile_all

ROOM = Path("sample_captures/room")
_FINISHED = 40
_AT_ONCE = 4  # captures that efficiency is measured over
_SETTINGS = Settings(preview_width=192)


def measure() -> Iterator[Figure]:
    compile_all()  # or the first run alone would wait for it
    with tempfile.TemporaryDirectory() as place:
        yield from _measured(Path(place))


def _measured(place: Path) -> Iterator[Figure]:
    small = _small(place / "small")
    shoot = place / "shoot"
    for i in range(_AT_ONCE):
        shutil.copytree(small, shoot / f"c{i:02}")
    # Twice the processors' worth of threads would only stand in each other's way: as documented,
    # one capture uses what there is, so the gain of two at once is what one leaves unused.
    one_s, outcomes = _run(shoot, place / "one", 1)
    two_s, _ = _run(shoot, place / "two", 2)
    yield Figure("one small capture, after another", one_s / _AT_ONCE, "s")
    yield Figure("one small capture, two at once", two_s / _AT_ONCE, "s")
    yield Figure("efficiency of two at once, of twice as fast", one_s / two_s / 2, "", low=0.85)

    taken = {"small": max(o.peak_bytes for o in outcomes)}
    reckoned = {"small": needs_on_disk(shoot / "c00", _SETTINGS).memory_bytes}
    faces = Settings(face_size=512, preview_width=192)
    for name, capture, settings in (("512", small, faces), ("room", ROOM, _SETTINGS)):
        run = child.Run(capture, place / name, settings, False, 3600)
        while (outcome := run.poll()) is None:
            time.sleep(0.05)
        assert outcome.state == child.DONE, outcome.error
        taken[name] = outcome.peak_bytes
        reckoned[name] = needs_on_disk(capture, settings).memory_bytes
    about = {"small": "a small capture", "512": "the same, faces of 512", "room": "the bundled one"}
    for name, words in about.items():
        yield Figure(f"memory of {words}", taken[name] / 1e6, "MB")
        yield Figure(
            f"  of what was reckoned, {reckoned[name] / 1e6:.0f} MB",
            taken[name] / reckoned[name],
            "times",
            high=1.0,
        )

    many = place / "many"
    for i in range(_FINISHED):  # finished once, and copied: what stands is all that is looked at
        _copied(
            shoot / "c00", place / "one" / "c00", many / "shoot" / f"c{i:02}", many / f"c{i:02}"
        )
    began = time.monotonic()
    jobs = plan([many / "shoot"], many, _SETTINGS)
    states = [o.state for o in _outcomes(jobs, 1)]
    assert states == [child.CURRENT] * _FINISHED, states
    yield Figure(
        f"a second run over {_FINISHED} finished captures", time.monotonic() - began, "s", high=5.0
    )


def _small(folder: Path) -> Path:
    sys.path.insert(0, "tests")
    import small_capture

    folder.mkdir()
    return small_capture.make(folder)


def _run(shoot: Path, out: Path, at_once: int) -> tuple[float, list[child.Outcome]]:
    began = time.monotonic()
    outcomes = _outcomes(plan([shoot], out, _SETTINGS), at_once)
    assert {o.state for o in outcomes} == {child.DONE}, outcomes
    return time.monotonic() - began, outcomes


def _outcomes(jobs: Sequence[Job], at_once: int) -> list[child.Outcome]:
    limits = batch.Limits(at_once, batch.available_memory(), 3600, math.inf)
    return list(batch.run(jobs, batch.Orders(_SETTINGS, limits), quiet=True).values())


def _copied(capture: Path, out: Path, to_capture: Path, to_out: Path) -> None:
    """A finished capture somewhere else, with the stamp a run there would have left."""
    shutil.copytree(capture, to_capture)
    shutil.copytree(out, to_out)
    made = json.loads((to_out / finished.STAMP).read_text(encoding="utf-8"))["made"]
    curves = [to_capture / "C.csv", to_capture / "F.csv"]
    stamp = finished.stamp(to_capture, curves, finished.see([to_capture]), made, to_out, _SETTINGS)
    (to_out / finished.STAMP).write_text(json.dumps(stamp), encoding="utf-8")
