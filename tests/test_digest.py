"""A digest of the code is the same in every process, and changes with what the code can reach."""

from __future__ import annotations

import ast
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


def by_the_parser(path: Path) -> set[str]:
    """What a file imports, as Python itself reads it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("package", ["pipeline", "stages", "calibration", "shaders"])
def test_imports_are_those_that_python_reads(package):
    for path in (ROOT / package).rglob("*.py"):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        ours = {n for n in by_the_parser(path) if n.split(".")[0] in digest._OURS}
        found = digest._imports(module)
        assert set(found) <= ours, module
        missed = ours - set(found)  # names in a module, which are no modules themselves
        assert not [n for n in missed if (ROOT / n.replace(".", "/")).with_suffix(".py").exists()]
        assert not [n for n in missed if (ROOT / n.replace(".", "/")).is_dir()]


def test_shaders_and_data_are_part_of_the_code():
    assert "ward.frag" in digest._content("shaders")
    assert "stainless_steel.csv" in digest._content("calibration")


def test_values_count_whatever_they_are_made_of():
    a = {"x": np.arange(3), "path": Path("a"), "number": np.float64(1.5)}
    assert digest.of_values(a) == digest.of_values(dict(reversed(a.items())))
    assert digest.of_values(a) != digest.of_values(a | {"x": np.arange(4)})
