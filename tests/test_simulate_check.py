"""The comparison with the truth must notice what it is there to notice."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks import check_sample
from calibration import primaries
from calibration.spectra import WAVELENGTHS
from pipeline.io import write_exr
from stages import cube

N = 32


@pytest.fixture
def world(tmp_path, monkeypatch):
    """A truth of smooth coloured light, a bright window to the left, and a place for results."""
    monkeypatch.setattr(check_sample, "FACE", N)
    rng = np.random.default_rng(8)
    d = cube.directions(N)
    spectra = np.full((6, N, N, len(WAVELENGTHS)), 0.3)
    for _ in range(40):
        towards = rng.standard_normal(3)
        near = np.exp(12 * (d @ (towards / np.linalg.norm(towards)) - 1))
        colour = 1 + 0.8 * np.sin(WAVELENGTHS / 60 + rng.uniform(0, 6))
        spectra += rng.uniform(0.2, 1.0) * near[..., None] * colour
    spectra[d[..., 0] < -0.85] *= 20
    light = primaries.load()
    valid = (d[..., 2] > -0.98).astype(float)
    (tmp_path / "truth").mkdir()
    names = [f"{w:.0f}nm" for w in WAVELENGTHS]
    write_exr(tmp_path / "truth/spectral.exr", spectra.reshape(6 * N, N, -1), names, {})
    values = light.project(spectra)
    write(tmp_path / "truth/cubemap.exr", values, valid)
    return tmp_path, values, valid


def write(path, values, valid):
    pixels = np.concatenate([values, valid[..., None]], axis=-1).reshape(6 * N, N, -1)
    write_exr(path, pixels, [*primaries.load().channels, "valid"], {})


def failing(world, values):
    """Names of the figures that do not hold when `values` is the result."""
    folder, _, valid = world
    unknown = np.where(valid[..., None] > 0, values, np.nan)
    write(folder / "cubemap.exr", unknown, valid)
    return {f.name for f in check_sample.compare(folder, folder) if f.holds is False}


def test_the_truth_itself_passes(world):
    assert failing(world, world[1]) == set()


def test_a_tenth_too_much_light_is_noticed(world):
    assert {"scale, total light", "relative error, median"} <= failing(world, 1.1 * world[1])


def test_a_mirrored_result_is_noticed(world):
    mirrored = cube.sample(world[1], cube.directions(N) * [-1, 1, 1])
    assert "correlation as it is" in failing(world, mirrored)


def test_a_turned_result_is_noticed_and_how_far(world):
    turn = Rotation.from_rotvec([0, np.radians(2.0), 0])
    turned = cube.sample(
        world[1], turn.apply(cube.directions(N).reshape(-1, 3)).reshape(6, N, N, 3)
    )
    assert "rotation left" in failing(world, turned)
    figures = {f.name: f for f in check_sample.compare(world[0], world[0])}
    assert figures["rotation left"].value == pytest.approx(2.0, abs=0.2)


def test_a_channel_that_is_off_is_noticed(world):
    assert "white patch dE2000, median" in failing(world, world[1] * [1, 1, 1.08, 1, 1, 1])
