"""What the page in a browser holds of a map."""

from __future__ import annotations

import lit_room
import numpy as np

from stages.fill import fill
from stages.prefilter import mean
from stages.types import Measured
from stages.view import view


def test_a_small_map_is_kept_as_it_is():
    measured, _ = lit_room.measured(16)
    seen = view(measured)
    whole = seen.light.whole.mips[0] * seen.scale
    assert np.allclose(whole, fill(measured), rtol=1e-6)
    assert np.allclose(seen.mean, mean(whole), rtol=1e-5)
    assert np.array_equal(seen.valid, measured.valid)
    assert seen.finer == 1


def test_half_floats_hold_it():
    measured, _ = lit_room.measured(16)
    stored = view(measured).light.whole.mips[0]
    assert np.abs(stored).max() < 65504
    assert np.median(np.abs(stored)) > 6.1e-5


def test_sigma_is_that_of_one_texel_and_unknown_in_holes():
    measured, _ = lit_room.measured(16)
    seen = view(measured)
    four = measured.variance.reshape(6, 8, 2, 8, 2, -1)
    known = np.isfinite(four).all(axis=(2, 4))
    assert np.allclose(seen.sigma[known] ** 2, four.mean(axis=(2, 4))[known], rtol=1e-5)
    nowhere = (measured.valid.reshape(6, 8, 2, 8, 2) == 0).all(axis=(2, 4))
    assert nowhere.any()
    assert np.isnan(seen.sigma[nowhere]).all()


def test_a_large_map_is_averaged_over_solid_angle():
    measured, _ = lit_room.measured(32)
    seen = view(measured, most=8)
    assert seen.light.whole.mips[0].shape[:3] == (6, 8, 8)
    assert seen.finer == 4
    assert seen.valid.shape == (6, 8, 8)
    assert seen.sigma.shape[:3] == (6, 4, 4)
    assert np.allclose(seen.mean, mean(fill(measured)), rtol=1e-4)


def test_a_texel_that_says_it_is_known_and_is_not_is_not():
    measured, _ = lit_room.measured(8)
    values = measured.values.copy()
    values[4, 3, 3] = np.nan
    seen = view(Measured(values, measured.variance, np.ones_like(measured.valid)))
    assert seen.valid[4, 3, 3] == 0
    assert np.isfinite(seen.light.whole.mips[0]).all()


def test_a_constant_map_stays_constant_in_every_form():
    ones = np.ones((6, 8, 8, 6), np.float32)
    seen = view(Measured(ones, ones * 1e-4, np.ones((6, 8, 8), np.float32)))
    for mip in (*seen.light.whole.mips, *seen.light.broad.mips, seen.light.matt.irradiance):
        assert np.allclose(mip * seen.scale, 1, atol=1e-4)
    assert np.allclose(seen.sigma, 0.01)
