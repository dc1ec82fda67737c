"""What a light's XYZ says of it; more of it with the lights of tests/test_illuminants.py."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from calibration.chromaticity import planckian_locus, temperature


def of(x, y):
    """XYZ of a chromaticity, Y = 1."""
    return np.array([x / y, 1.0, (1.0 - x - y) / y])


@pytest.mark.parametrize("xy", [(0.22, 0.21), (0.55, 0.22)], ids=["hot", "cold"])
def test_beyond_the_ends_of_the_locus_there_is_no_temperature_nor_a_warning(xy):
    assert temperature(of(0.3457, 0.3585)) is not None  # the library is imported, with its filters
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert temperature(of(*xy)) is None


def test_the_locus_is_that_of_black_bodies():
    # Robertson (1968), as in Wyszecki and Stiles, "Color Science" (1982), table 1(3.11).
    kelvin, u, v = planckian_locus().T
    for mired, *uv in ((100, 0.19032, 0.29326), (200, 0.21142, 0.32312), (400, 0.27218, 0.35407)):
        at = [np.interp(np.log(1e6 / mired), np.log(kelvin), c) for c in (u, v)]
        np.testing.assert_allclose(at, uv, atol=1e-4)
