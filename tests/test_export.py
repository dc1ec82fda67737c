"""Maps for other programs hold the same light."""

from __future__ import annotations

import numpy as np
import pytest

from stages.export import export, half_float_scale
from stages.types import Measured


def world(factor):
    values = (factor * (1 + np.random.default_rng(9).random((6, 8, 8, 6)))).astype(np.float32)
    return Measured(values, values * 0, np.ones((6, 8, 8), np.float32))


@pytest.mark.parametrize("factor", [1e-6, 1.0, 1e7])
def test_half_floats_hold_the_light_whatever_its_unit(factor):
    light = world(factor)
    maps = export(light)
    stored = np.concatenate([t.astype(np.float16) for t in maps.triples], axis=-1)
    back = stored.astype(np.float64) * maps.scale
    np.testing.assert_allclose(back, light.values, rtol=2**-11)  # half a step of 11 bits


def test_light_that_fits_is_stored_as_it_is():
    assert export(world(1.0)).scale == 1.0


def test_scales_are_powers_of_two_so_that_nothing_is_rounded():
    for largest in (3e-4, 1e5, 7e9):
        scale = half_float_scale(np.array([largest]))
        assert np.log2(scale) == round(np.log2(scale))
        assert 16384 <= largest / scale < 32768


def test_the_latlong_image_has_twice_the_cubes_rows():
    assert export(world(1.0)).latlong.values.shape == (16, 32, 6)
