"""A digest of the code is the same in every process, and changes with what the code can reach."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pipeline import digest
from pipeline.steps import STEPS, colour, maps

ROOT = Path(__file__).parent.parent
PROGRAM = (
    "from pipeline import digest; from pipeline.steps import STEPS;"
    "print([digest.of_code(step.run) for step in STEPS])"
)


@pytest.mark.slow
def test_every_process_finds_the_same_digest():
    """Python orders sets of names differently in each."""
    said = {
        subprocess.run(
            [sys.executable, "-c", PROGRAM],
            env=os.environ | {"PYTHONHASHSEED": seed},
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2", "3")
    }
    assert len(said) == 1


@pytest.fixture
def reached(monkeypatch):
    def of_step(name: str) -> set[str]:
        """Modules that count for a step."""
        (step,) = (s for s in STEPS if s.name == name)
        seen: set[str] = set()
        monkeypatch.setattr(digest, "_content", lambda module: seen.add(module) or module)
        digest.of_code(step.run)
        return seen

    return of_step


def test_a_step_depends_on_its_stage_and_what_that_uses(reached):
    assert {"stages.merge", "stages.noise", "stages.types"} <= reached("merge")
    assert "stages.preview" not in reached("merge")
    assert "stages.mirror" in reached("unwrap")


def test_a_step_depends_on_what_helpers_beside_it_use(reached):
    assert "stages.region" in reached("align")  # through read_region alone
    assert "stages.mirror" not in reached("scale")  # read_sphere lies beside what that uses


@pytest.mark.parametrize(
    ("module", "constant", "run"),
    [
        (maps, "LATLONG", maps.run_export),
        (colour, "BAYER_NOISE_CORRELATION", colour.run_transform),
    ],
)
def test_a_step_depends_on_constants(module, constant, run, monkeypatch):
    before = digest.of_code(run)
    monkeypatch.setattr(module, constant, "another")
    assert digest.of_code(run) != before


def test_shaders_and_data_are_part_of_the_code():
    assert "ward.frag" in digest._content("shaders")
    assert "stainless_steel.csv" in digest._content("calibration")


def test_values_count_whatever_they_are_made_of():
    a = {"x": np.arange(3), "path": Path("a"), "number": np.float64(1.5)}
    assert digest.of_values(a) == digest.of_values(dict(reversed(a.items())))
    assert digest.of_values(a) != digest.of_values(a | {"x": np.arange(4)})
