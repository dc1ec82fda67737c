"""Fixtures shared by the tests of the whole: one small capture, made and processed once."""

from __future__ import annotations

import hashlib
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest

from pipeline import cli

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # as the command has it, lest last digits differ

QUICK = ("--quiet", "--preview-width", "192")  # a small picture keeps the tests quick


@dataclass(frozen=True)
class Outcome:
    """How a command line ended."""

    status: int
    out: str
    err: str


@pytest.fixture
def sixlight(capfd):
    """Runs the command line in this process: sixlight("envmap", folder, ...) -> Outcome."""

    def run(*arguments) -> Outcome:
        capfd.readouterr()
        status = cli.status([str(a) for a in arguments])
        said = capfd.readouterr()
        return Outcome(status, said.out, said.err)

    return run


@pytest.fixture(scope="session")
def small_capture_once(tmp_path_factory) -> Path:
    import small_capture

    return small_capture.make(tmp_path_factory.mktemp("captures") / "small")


@pytest.fixture(scope="session")
def finished_once(small_capture_once, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("finished") / "small"
    assert cli.status(["envmap", str(small_capture_once), "-o", str(out), *QUICK]) == 0
    return out


@pytest.fixture
def small(small_capture_once, tmp_path) -> Path:
    """A copy of the small capture that a test may spoil."""
    return Path(shutil.copytree(small_capture_once, tmp_path / "small"))


@pytest.fixture
def finished(finished_once, small, tmp_path) -> Path:
    """The results of `small`, a copy that a test may change."""
    out = Path(shutil.copytree(finished_once, tmp_path / "out"))
    (out / "work" / "capture.json").write_text('{\n  "capture": "../small"\n}\n')
    return out


def digests(folder: Path) -> dict[str, str]:
    """Every file below a folder, by content."""
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }
