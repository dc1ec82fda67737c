"""`import pipeline` in a notebook: the same results as the commands', as arrays."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pipeline
from pipeline import io

ROOT = Path(__file__).parent.parent
NOTEBOOK = ROOT / "docs" / "first_map.ipynb"


def test_a_loaded_map_is_what_the_file_holds(finished_once):
    room = pipeline.load(finished_once)
    measured, names = io.read_measured(finished_once / "cubemap.exr", cube=True)
    np.testing.assert_array_equal(room.values, measured.values)
    assert room.primaries.channels == names
    assert room.result == json.loads((finished_once / "result.json").read_text())
    known = room.valid == 1
    assert (room.sigma[known] > 0).all()
    matrix = room.primaries.xyz_from_primaries
    texel = np.argwhere(known)[0]
    np.testing.assert_allclose(room.xyz[tuple(texel)], matrix @ room.values[tuple(texel)])


@pytest.mark.slow
def test_envmap_gives_the_map_it_made(small, finished):
    room = pipeline.envmap(small, finished)  # current but for the picture's size
    assert room.file == finished / "cubemap.exr"


def test_a_rendering_is_a_picture_and_its_light(finished_once):
    picture = pipeline.render(finished_once, "probe", width=96, channels="six")
    assert picture.signal.shape[1:] == (96, 3)
    assert 0 <= picture.signal.min() < picture.signal.max() <= 1
    assert np.isfinite(picture.xyz).all()


def test_bad_input_is_one_sentence(tmp_path):
    with pytest.raises(ValueError, match="no such folder"):
        pipeline.envmap(tmp_path / "nowhere", tmp_path / "out")


def test_what_is_not_there_is_not_there():
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        pipeline.nothing  # noqa: B018


def test_importing_costs_nothing():
    program = "import pipeline, sys; print('numpy' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "False"


@pytest.mark.slow
def test_the_notebook_runs():
    """Every code cell, in order, in the checkout's folder, as a reader would run it."""
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    code = "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "code")
    done = subprocess.run(
        [sys.executable, "-c", "import matplotlib; matplotlib.use('agg')\n" + code],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
