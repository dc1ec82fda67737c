"""Many captures: what is found, what runs at once, and that none takes another with it.

Most of these run a stand-in for `envmap`, which does in milliseconds what a capture's name says.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import small_capture

from pipeline import batch, finished
from pipeline.batch import child
from pipeline.batch.child import CURRENT, DONE, FAILED, LEFT, OURS
from pipeline.batch.shoot import needs_on_disk, plan
from pipeline.settings import Settings

ROOT = Path(__file__).parent.parent

STAND_IN = """
import json, os, pathlib, sys, time
out, folder = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
word = folder.name.split("_")[0]
out.mkdir(parents=True, exist_ok=True)
log = out.parent / f"{folder.name}.log"
log.write_text(f"{time.monotonic()} ")
if word == "hang":
    time.sleep(60)
elif word == "crash":
    os.abort()
elif word == "killed":
    os.kill(os.getpid(), 9)
elif word == "bad":
    sys.exit(print("cyan_1.dng: damaged; copy it again", file=sys.stderr) or 2)
elif word == "bug":
    raise TypeError("ours")
time.sleep(0.3 if word == "slow" else 0.0)
(out / "result.json").write_text(json.dumps({"verdict": {"grade": "good"}}))
with log.open("a") as file:
    file.write(f"{time.monotonic()}")
"""


@pytest.fixture
def stand_in(monkeypatch):
    monkeypatch.setattr(
        child,
        "_command",
        lambda folder, out, settings, force: [sys.executable, "-c", STAND_IN, out, folder],
    )


def captures(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).mkdir(parents=True)
        (folder / name / "capture.toml").touch()
    return folder


def done(folder: Path, out: Path, *, memory_bytes=1e12, at_once=8, seconds=20.0, **how):
    jobs = plan([folder], out, Settings())
    limits = batch.Limits(at_once, memory_bytes, seconds, math.inf)
    outcomes = batch.run(jobs, batch.Orders(Settings(), limits, **how), quiet=True)
    return {job.name: outcome for job, outcome in outcomes.items()}


# ---------------------------------------------------------------------------------- what is found


def test_captures_are_found_below_a_folder(tmp_path):
    shoot = captures(tmp_path / "shoot", "office", "week2/hall")
    (shoot / "plain" / "cyan").mkdir(parents=True)
    (shoot / "plain" / "cyan" / "1.CR2").touch()
    jobs = plan([shoot], tmp_path / "out", Settings())
    assert [job.name for job in jobs] == ["office", "plain", "week2/hall"]
    assert jobs[2].out == tmp_path / "out" / "week2" / "hall"


def test_what_is_no_capture_is_passed_over(tmp_path):
    shoot = captures(tmp_path / "shoot", "office", ".hidden/x", "results/not")
    for light in ("A", "D65"):  # a session for `fit`, with and without a calibration.toml
        (shoot / "session" / light / "cyan").mkdir(parents=True)
        (shoot / "session" / light / "cyan" / "1.dng").touch()
        (shoot / "session" / light / "radiance.csv").touch()
    captures(shoot / "office", "within")
    (shoot / "results" / "work").mkdir()
    (shoot / "results" / "work" / "capture.json").touch()
    (shoot / "sensor" / "dark").mkdir(parents=True)
    (shoot / "sensor" / "dark" / "1.dng").touch()
    (shoot / "circle").symlink_to(shoot)
    assert [job.name for job in plan([shoot], None, Settings())] == ["office"]


def test_a_capture_itself_may_be_named(tmp_path):
    captures(tmp_path, "office")
    (job,) = plan([tmp_path / "office"], tmp_path / "out", Settings())
    assert (job.name, job.out) == ("office", tmp_path / "out" / "office")


@pytest.mark.parametrize(
    ("made", "folders", "out", "said"),
    [
        (("a/x", "b/x"), ("a", "b"), "out", "results of"),
        (("a/x", "b/x/y"), ("a", "b"), "out", "results of"),
        (("a/x",), ("a",), "a/x/out", "own folder"),
        ((), ("",), "out", "no captures found"),
        ((), ("nowhere",), "out", "no such folder"),
    ],
    ids=["same place", "one in another", "among photographs", "none", "no folder"],
)
def test_what_cannot_be_done_is_refused_before_anything_runs(
    sixlight, tmp_path, made, folders, out, said
):
    captures(tmp_path, *made)
    before = sorted(tmp_path.rglob("*"))
    outcome = sixlight("batch", *(tmp_path / f for f in folders), "-o", tmp_path / out)
    assert outcome.status == 2
    assert said in outcome.err
    assert len(outcome.err.splitlines()) == 1
    assert sorted(tmp_path.rglob("*")) == before


def test_a_dry_run_does_nothing(sixlight, tmp_path):
    captures(tmp_path / "shoot", "office", "hall")
    before = sorted(tmp_path.rglob("*"))
    outcome = sixlight("batch", tmp_path / "shoot", "-o", tmp_path / "out", "--dry-run")
    assert outcome.status == 0
    assert f"{tmp_path}/shoot/hall -> {tmp_path}/out/hall" in outcome.out
    assert sorted(tmp_path.rglob("*")) == before


def test_memory_is_reckoned_by_pixels_and_face_size(tmp_path):
    for name, size in (("small", (120, 160)), ("large", (1200, 1600))):
        (tmp_path / name / "cyan").mkdir(parents=True)
        small_capture.write_shot(tmp_path / name / "cyan" / "1.dng", np.zeros(size, np.uint16))
    small, large = (
        needs_on_disk(tmp_path / n, Settings()).memory_bytes for n in ("small", "large")
    )
    assert large - small > 1200 * 1600 * 100
    large_faces = needs_on_disk(tmp_path / "small", Settings(face_size=1024))
    assert large_faces.memory_bytes > small + 1e9


# ------------------------------------------------------------------------------------- how it goes


def test_no_capture_takes_another_with_it(stand_in, tmp_path):
    shoot = captures(tmp_path / "shoot", "bad", "bug", "crash", "good", "hang", "killed")
    began = time.monotonic()
    outcomes = done(shoot, tmp_path / "out", seconds=1.5)
    assert time.monotonic() - began < 15
    states = {name: outcome.state for name, outcome in outcomes.items()}
    assert states == {
        "bad": FAILED,
        "bug": OURS,
        "crash": FAILED,
        "good": DONE,
        "hang": FAILED,
        "killed": FAILED,
    }
    assert outcomes["good"].grade == "good"
    assert outcomes["bad"].error == ["cyan_1.dng: damaged; copy it again"]
    assert "SIGABRT" in outcomes["crash"].error[0]
    assert "still running" in outcomes["hang"].error[0]
    assert "memory" in outcomes["killed"].error[0]
    assert outcomes["bug"].error[-1] == "TypeError: ours"
    assert outcomes["good"].peak_bytes > 1e6


def test_the_summary_tells_of_each(stand_in, sixlight, tmp_path):
    shoot = captures(tmp_path / "shoot", "good", "bad")
    outcome = sixlight("batch", shoot, "-o", tmp_path / "out")
    assert outcome.status == 2
    assert "[2/2]" in outcome.err
    lines = outcome.out.splitlines()
    assert lines[1].split()[:2] == ["bad", "failed"]
    assert "copy it again" in lines[1]
    assert lines[2].split()[:2] == ["good", "good"]
    assert lines[-1] == "2 captures: 1 done, 1 failed"
    told = json.loads((tmp_path / "out" / "batch.json").read_text())
    assert [(c["name"], c["state"]) for c in told["captures"]] == [("bad", FAILED), ("good", DONE)]
    assert told["captures"][1]["capture"] == "../shoot/good"
    captures(shoot, "bug")
    assert sixlight("batch", shoot, "-o", tmp_path / "out", "--quiet", "--json").status == 1


def test_stop_begins_no_others(stand_in, tmp_path):
    shoot = captures(tmp_path / "shoot", "bad", "good_1", "good_2")
    outcomes = done(shoot, tmp_path / "out", at_once=1, keep_going=False)
    assert [o.state for o in outcomes.values()] == [FAILED, LEFT, LEFT]


def spans(out: Path) -> list[tuple[float, float]]:
    return [tuple(map(float, log.read_text().split())) for log in sorted(out.glob("*.log"))]


def most_at_once(times) -> int:
    return max(sum(a <= begin < b for a, b in times) for begin, _ in times)


@pytest.mark.slow
def test_no_more_run_at_once_than_jobs_and_memory_allow(stand_in, tmp_path):
    shoot = captures(tmp_path / "shoot", *(f"slow_{i}" for i in range(4)))
    (one,) = {job.needs.memory_bytes for job in plan([shoot], None, Settings())}
    done(shoot, tmp_path / "jobs", at_once=2, memory_bytes=4.5 * one)
    assert most_at_once(spans(tmp_path / "jobs")) <= 2
    done(shoot, tmp_path / "memory", at_once=4, memory_bytes=1.5 * one)
    first, second, *_ = sorted(spans(tmp_path / "memory"))
    assert second[0] >= first[1]  # later ones are reckoned by what the first really took
    assert len(done(shoot, tmp_path / "tight", memory_bytes=1.0)) == 4  # one alone always may


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_batch_ends_its_children_and_itself(tmp_path, number):
    """The children are real ones, waiting on a photograph that never comes."""
    shoot = tmp_path / "shoot"
    for i in (1, 2):
        (shoot / f"c{i}" / "cyan").mkdir(parents=True)
        (shoot / f"c{i}" / "capture.toml").touch()
        os.mkfifo(shoot / f"c{i}" / "capture.fifo")
    program = (
        "import signal, sys; from pipeline import cli; from pipeline.batch import child;"
        "child._command = lambda folder, *_:"
        " [sys.executable, '-c', 'open(__import__(\"sys\").argv[1])', f'{folder}/capture.fifo'];"
        "cli.main()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program, "batch", shoot, "-o", tmp_path / "out", "--jobs", "2"],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
    )
    until = time.monotonic() + 30
    while len(children(process.pid)) < 2 and time.monotonic() < until:
        time.sleep(0.02)
    mine = children(process.pid)
    assert len(mine) == 2
    process.send_signal(number)
    _, said = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "Traceback" not in said
    assert not any(Path(f"/proc/{pid}").exists() for pid in mine)


def children(pid: int) -> list[int]:
    try:
        return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


# --------------------------------------------------------------------------- finished captures


@pytest.fixture
def copied(small_capture_once, finished_once, tmp_path):
    """A finished capture with its photographs, whose stamp is of where it lies now."""
    capture, out = tmp_path / "shoot" / "small", tmp_path / "out" / "small"
    shutil.copytree(small_capture_once, capture)
    shutil.copytree(finished_once, out)
    kept = json.loads((out / finished.STAMP).read_text())
    curves = [capture / "C.csv", capture / "F.csv"]
    quick = Settings(preview_width=192)
    stamp = finished.stamp(capture, curves, finished.see([capture]), kept["made"], out, quick)
    assert set(stamp["made"]) == set(kept["made"])
    (out / finished.STAMP).write_text(json.dumps(stamp))
    return capture, out


def test_a_run_leaves_word_of_what_it_saw(small_capture_once, finished_once):
    assert finished.holds(small_capture_once, finished_once, Settings(preview_width=192))
    assert not finished.holds(small_capture_once, finished_once, Settings(preview_width=256))


def test_finished_captures_start_no_process(copied, tmp_path, monkeypatch):
    monkeypatch.setattr(batch, "Run", None)
    jobs = plan([tmp_path / "shoot"], tmp_path / "out", Settings())
    orders = batch.Orders(Settings(preview_width=192), batch.Limits(1, 1e12, 60, math.inf))
    (outcome,) = batch.run(jobs, orders, quiet=True).values()
    assert (outcome.state, outcome.grade) == (CURRENT, child.grade(*copied))
    assert outcome.grade is not None


def spoilt_photograph(capture, out):
    path = capture / "cyan" / "cyan_1.dng"
    path.write_bytes(path.read_bytes())


def another_photograph(capture, out):
    shutil.copy(capture / "cyan" / "cyan_1.dng", capture / "cyan" / "cyan_9.dng")


def a_photograph_less(capture, out):
    (capture / "cyan" / "cyan_1.dng").unlink()


def back_dated(capture, out):
    at = (capture / "F.csv").stat()
    (capture / "F.csv").write_text((capture / "F.csv").read_text()[::-1])
    os.utime(capture / "F.csv", ns=(at.st_atime_ns, at.st_mtime_ns))


def new_defaults(capture, out):
    (capture.parent / "defaults.toml").write_text("[sphere]\n")


def result_removed(capture, out):
    (out / "cubemap.exr").unlink()


def result_changed(capture, out):
    (out / "latlong.exr").write_bytes(b"")


def no_stamp(capture, out):
    (out / finished.STAMP).unlink()


def broken_stamp(capture, out):
    (out / finished.STAMP).write_text("[1")


def other_stamp(capture, out):
    (out / finished.STAMP).write_text('{"curves": 3}')


@pytest.mark.parametrize(
    "change",
    [
        spoilt_photograph,
        another_photograph,
        a_photograph_less,
        back_dated,
        new_defaults,
        result_removed,
        result_changed,
        no_stamp,
        broken_stamp,
        other_stamp,
    ],
)
def test_whatever_is_doubtful_is_run(copied, change):
    quick = Settings(preview_width=192)
    assert finished.holds(*copied, quick)
    change(*copied)
    assert not finished.holds(*copied, quick)


def test_looking_imports_nothing_slow(copied):
    program = (
        "import sys; from pathlib import Path; from pipeline import batch; "
        "from pipeline.batch import child, shoot; "
        "shoot.plan([Path(sys.argv[1])], None, batch.Settings()); "
        "child.standing(Path(sys.argv[1]), Path(sys.argv[2]), batch.Settings()); "
        "print({'numpy', 'rich', 'rawpy', 'OpenImageIO', 'fsspec'} & set(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, *copied], cwd=ROOT, capture_output=True, text=True
    )
    assert done.stdout == "set()\n", done.stderr


# ------------------------------------------------------------------------------------ the real job


@pytest.mark.slow
def test_real_captures_side_by_side(small, tmp_path, sixlight):
    """One good, one damaged, one without calibration; and the second time nothing is done."""
    toml = small / "capture.toml"
    toml.write_text(toml.read_text().split("[calibration]")[0])
    for name in ("good", "bad"):
        shutil.copytree(small, tmp_path / "shoot" / name)
    (tmp_path / "shoot" / "bad" / "cyan" / "cyan_2.dng").write_bytes(b"no photograph")
    options = ("-o", tmp_path / "out", "--jobs", "2", "--json", "--quiet")
    outcome = sixlight("batch", tmp_path / "shoot", *options)
    assert outcome.status == 2
    bad, good = json.loads(outcome.out)["captures"]
    assert (good["state"], bad["state"]) == (DONE, FAILED)
    assert good["peak_mb"] <= good["expected_mb"]
    assert "cyan_2.dng" in bad["error"][0]
    assert not (tmp_path / "out" / "bad" / "result.json").exists()
    shutil.rmtree(tmp_path / "shoot" / "bad")
    began = time.monotonic()
    again = sixlight("batch", tmp_path / "shoot", *options)
    assert time.monotonic() - began < 1.0
    assert json.loads(again.out)["captures"][0]["state"] == CURRENT
