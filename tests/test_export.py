"""Maps for other programs hold the same light."""

from __future__ import annotations

import numpy as np
import pytest

from stages.export import export, half_float_scale, triples
from stages.types import Measured


def world(factor, channels=6):
    random = np.random.default_rng(9).random((6, 8, 8, channels))
    values = (factor * (1 + random)).astype(np.float32)
    return Measured(values, values * 0, np.ones((6, 8, 8), np.float32))


@pytest.mark.parametrize("factor", [1e-6, 1.0, 1e7])
def test_half_floats_hold_the_light_whatever_its_unit(factor):
    light = world(factor)
    maps = export(light)
    stored = np.concatenate([t.astype(np.float16) for t in maps.triples], axis=-1)
    back = stored.astype(np.float64) * maps.scale
    np.testing.assert_allclose(back, light.values, rtol=2**-11)  # half a step of 11 bits


@pytest.mark.parametrize(
    ("channels", "dealt"),
    [
        (5, [[0, 1, 2], [3, 4]]),
        (6, [[0, 1, 2], [3, 4, 5]]),
        (7, [[0, 1, 2], [3, 4, 5], [6]]),
        (8, [[0, 1, 2], [3, 4, 5], [6, 7]]),
    ],
)
def test_every_channel_is_in_one_map_and_what_is_left_over_is_black(channels, dealt):
    assert [list(triple) for triple in triples(channels)] == dealt
    light = world(1.0, channels)
    maps = export(light)
    assert [m.shape[-1] for m in maps.triples] == [3] * len(dealt)
    together = np.concatenate(maps.triples, axis=-1)
    np.testing.assert_array_equal(together[..., :channels], light.values)
    assert (together[..., channels:] == 0).all()
    assert maps.latlong.values.shape[-1] == channels


def test_light_that_fits_is_stored_as_it_is():
    assert export(world(1.0)).scale == 1.0


def test_scales_are_powers_of_two_so_that_nothing_is_rounded():
    for largest in (3e-4, 1e5, 7e9):
        scale = half_float_scale(np.array([largest]))
        assert np.log2(scale) == round(np.log2(scale))
        assert 16384 <= largest / scale < 32768


def test_the_latlong_image_has_twice_the_cubes_rows():
    assert export(world(1.0)).latlong.values.shape == (16, 32, 6)
