"""Holes are closed smoothly and nothing known is touched."""

from __future__ import annotations

import numpy as np

from stages import cube
from stages.fill import fill
from stages.types import Measured


def with_hole(world, half_angle_deg=20.0, towards=(0, 0, -1)):
    d = cube.directions(world.shape[1])
    hidden = d @ np.array(towards, float) > np.cos(np.deg2rad(half_angle_deg))
    values = np.where(hidden[..., None], np.nan, world).astype(np.float32)
    valid = (~hidden).astype(np.float32)
    return Measured(values, values * 0, valid), hidden


def test_a_constant_world_stays_constant():
    measured, _ = with_hole(np.full((6, 16, 16, 3), 0.7))
    np.testing.assert_allclose(fill(measured), 0.7, rtol=1e-6)


def test_what_was_measured_stays_as_it_is():
    rng = np.random.default_rng(3)
    measured, hidden = with_hole(rng.normal(1, 1, (6, 16, 16, 2)))
    filled = fill(measured)
    assert np.isfinite(filled).all()
    np.testing.assert_array_equal(filled[~hidden], measured.values[~hidden])


def test_a_hole_over_an_edge_continues_its_surroundings():
    """A slope across the hole comes out between the values on its two sides, without a step."""
    d = cube.directions(32)
    world = 2.0 + d[..., :1]
    measured, hidden = with_hole(world, 15, towards=(0, 1, 1) / np.sqrt(2))
    filled = fill(measured)
    assert np.abs(filled - world)[hidden].max() < np.sin(np.deg2rad(15))
    assert np.corrcoef(filled[hidden][:, 0], world[hidden][:, 0])[0, 1] > 0.8


def test_partly_known_texels_lean_on_what_is_known():
    measured, _ = with_hole(np.ones((6, 8, 8, 1)))
    measured.valid[4, 3, 3] = 0.25
    measured.values[4, 3, 3] = 5.0
    value = fill(measured)[4, 3, 3, 0]
    assert 1.0 < value < 3.0
