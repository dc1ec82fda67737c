"""What steps leave each other can go, and comes back only when something needs it."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest
from conftest import digests

from pipeline import clean


@pytest.fixture(scope="module")
def bands_once(small_capture_once, tmp_path_factory):
    """A finished capture without a calibration, which takes few seconds."""
    from pipeline import cli

    folder = tmp_path_factory.mktemp("bands")
    capture = Path(shutil.copytree(small_capture_once, folder / "capture"))
    toml = capture / "capture.toml"
    toml.write_text(toml.read_text().split("[calibration]")[0])
    assert cli.status(["envmap", str(capture), "-o", str(folder / "out"), "--quiet"]) == 0
    return folder


@pytest.fixture
def bands(bands_once, tmp_path):
    """Its capture and its output, to be spoilt."""
    shutil.copytree(bands_once, tmp_path / "bands")
    return tmp_path / "bands" / "capture", tmp_path / "bands" / "out"


def results(out: Path) -> dict[str, str]:
    """Results but for those that tell how many seconds steps took."""
    timed = ("result.json", "report.html")
    return {k: v for k, v in digests(out).items() if not k.startswith("work/") and k not in timed}


def done(sixlight, capture, out) -> list[str]:
    """Steps that another run does."""
    outcome = sixlight("envmap", capture, "-o", out)
    assert outcome.status == 0, outcome.err
    lines = [line for line in outcome.err.splitlines() if not line.startswith("note")]
    return [line.split("] ")[-1].split(":")[0] for line in lines if not line.endswith("current")]


def again(sixlight, capture, out) -> list[str]:
    """What another run makes again that had been removed."""
    outcome = sixlight("envmap", capture, "-o", out)
    assert outcome.status == 0, outcome.err
    lines = outcome.err.splitlines()
    return [line.removeprefix("again: ") for line in lines if line.startswith("again")]


def test_results_stay_and_stay_current(sixlight, bands):
    capture, out = bands
    before = results(out)
    assert sixlight("clean", out).status == 0
    assert results(out) == before
    left = {p.name for p in (out / "work").iterdir()}
    assert not {name for name in left if name.endswith((".npz", ".exr"))}
    assert sixlight("verify", out).status == 0
    assert done(sixlight, capture, out) == []
    assert results(out) == before
    assert {p.name for p in (out / "work").iterdir()} == left  # nothing was made for nothing


@pytest.mark.slow
def test_what_is_needed_again_is_made_again_first(sixlight, bands):
    capture, out = bands
    before = results(out)
    sixlight("clean", out)
    (out / "sphere.png").unlink()
    made = again(sixlight, capture, out)
    assert made == [
        "find",
        "merge cyan",
        "merge yellow",
        "scale",
        "demosaic cyan",
        "demosaic yellow",
        "drift",  # for the report
    ]
    assert results(out) == before
    assert done(sixlight, capture, out) == []


def test_a_report_is_made_again_though_what_it_shows_was_removed(sixlight, bands):
    capture, out = bands
    sixlight("clean", out)
    (out / "report.html").unlink()
    assert again(sixlight, capture, out)[-1] == "drift"
    assert done(sixlight, capture, out) == []


def test_all_removes_all_of_ours_and_nothing_else(sixlight, bands):
    _, out = bands
    (out / "notes.txt").write_text("mine")
    (out / "work" / "mine.txt").write_text("mine too")
    assert sixlight("clean", "--all", out).status == 0
    left = sorted(str(p.relative_to(out)) for p in out.rglob("*") if p.is_file())
    assert left == ["notes.txt", "work/mine.txt"]


def test_all_of_a_folder_that_is_only_ours_is_gone(sixlight, bands):
    _, out = bands
    sixlight("clean", "--all", out)
    assert not out.exists()


def test_the_least_recently_run_go_first(bands, tmp_path):
    _, out = bands
    places = [Path(shutil.copytree(out, tmp_path / "outs" / name)) for name in "abc"]
    for place, at in zip(places, (3, 1, 2), strict=True):
        os.utime(place / "work" / "lock", (at, at))
    size = sum(p.stat().st_size for p in clean._intermediate(out))
    cleaned = clean.keep([tmp_path / "outs"], 2.5 * size)
    assert [c.out.name for c in cleaned] == ["b"]
    assert cleaned[0].bytes == size
    assert clean.keep([tmp_path / "outs"], 2.5 * size) == []


def test_nothing_is_removed_under_a_run(sixlight, bands):
    import fcntl

    _, out = bands
    before = digests(out)
    with (out / "work" / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        outcome = sixlight("clean", out)
    assert outcome.status == 2
    assert "a run is writing" in outcome.err
    assert digests(out) == before


def test_stamps_cannot_name_files_elsewhere(sixlight, bands):
    _, out = bands
    other = out.parent / "thesis.txt"
    other.write_text("three years of work")
    for name in ("../thesis.txt", str(other)):
        (out / "work" / "x.made.json").write_text(json.dumps({"made": {name: ""}}))
        sixlight("clean", "--all", out)
        assert other.exists()
        (out / "work").mkdir(parents=True, exist_ok=True)
        (out / "work" / "capture.json").write_text("{}")


@pytest.mark.parametrize("make", [False, True])
def test_what_is_no_output_is_refused(sixlight, tmp_path, make):
    if make:
        (tmp_path / "mine").mkdir()
    outcome = sixlight("clean", tmp_path / "mine")
    assert outcome.status == 2
    assert len(outcome.err.splitlines()) == 1
