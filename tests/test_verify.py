"""`sixlight verify` tells each way in which results are no longer what they were."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest


@pytest.fixture
def copied(small_capture_once, finished_once, tmp_path) -> Path:
    """A finished capture beside its photographs, to be spoilt."""
    capture, out = tmp_path / "captures" / "small", tmp_path / "finished" / "small"
    shutil.copytree(small_capture_once, capture)
    shutil.copytree(finished_once, out)
    (out / "work" / "capture.json").write_text(json.dumps({"capture": "../../captures/small"}))
    return out


def test_what_was_just_made_holds(copied, sixlight):
    outcome = sixlight("verify", copied)
    assert (outcome.status, outcome.err) == (0, "")
    told = json.loads(sixlight("verify", copied, "--json").out)
    result = json.loads((copied / "result.json").read_text())
    made = sum(len(step["made"]) for step in result["steps"].values())
    assert told["problems"] == []
    assert told["checked"] >= made + len(result["inputs"]) + 1  # the report too


def removed(out):
    (out / "cubemap.exr").unlink()
    return "cubemap.exr: missing"


def changed(out):
    (out / "latlong.exr").write_bytes(b"")
    return "latlong.exr: not what it was"


def another_report(out):
    with (out / "report.html").open("a") as file:
        file.write("<p>all is well</p>")
    return "report.html: not what it was"


def another_photograph(out):
    path = out.parent.parent / "captures" / "small" / "cyan" / "cyan_1.dng"
    path.write_bytes(path.read_bytes() + b"\0")
    return "cyan_1.dng: not what it was"


def a_killed_run(out):
    (out / "work" / "unfinished-abc").mkdir()
    return "work/unfinished-abc: left by a run that was stopped"


@pytest.mark.parametrize(
    "spoil", [removed, changed, another_report, another_photograph, a_killed_run]
)
def test_what_is_wrong_is_said(copied, sixlight, spoil):
    said = spoil(copied)
    outcome = sixlight("verify", copied)
    assert outcome.status == 2
    assert outcome.err.count("\n") == 1
    assert said in outcome.err


@pytest.mark.parametrize("content", [None, "{"])
def test_a_folder_without_results_is_refused(tmp_path, sixlight, content):
    if content is not None:
        (tmp_path / "result.json").write_text(content)
    outcome = sixlight("verify", tmp_path)
    assert outcome.status == 2
    assert outcome.err.count("\n") == 1
    assert "run sixlight envmap" in outcome.err
