import numpy as np
import pytest

from stages.flat import flatten, response
from stages.merge import InMemory, merge
from tests.test_merge import expose

SIZE = (200, 240)
PRNU = 0.008


def photographed(world, unequal, rng, times, electrons=30000.0):
    return merge(
        InMemory([expose(world, t, t, rng, prnu=unequal, electrons=electrons) for t in times])
    )


def unevenly_lit():
    """A wall (H, W), a third darker towards its corners."""
    y, x = np.mgrid[-1 : 1 : SIZE[0] * 1j, -1 : 1 : SIZE[1] * 1j]
    return 0.6 * (1 - 0.16 * (x**2 + y**2))


def test_pixels_unequal_response_is_divided_out():
    rng = np.random.default_rng(1)
    unequal = PRNU * rng.normal(size=SIZE)
    found = response(photographed(unevenly_lit(), unequal, rng, [1.0] * 16))
    world = np.full(SIZE, 0.5)
    merged = photographed(world, unequal, rng, [1.0, 1.125, 1.25, 1.375])
    flat = flatten(merged, found)
    before, after = (np.std(one.mosaic / world) for one in (merged, flat))
    assert before > PRNU
    assert after < 0.6 * before
    assert np.mean((flat.mosaic - flat.mosaic.mean()) ** 2 / flat.variance) == pytest.approx(
        1, abs=0.1
    )


def test_vignetting_is_not_corrected():
    rng = np.random.default_rng(2)
    found = response(photographed(unevenly_lit(), np.zeros(SIZE), rng, [1.0] * 8))
    wide = found.values.reshape(20, 10, 24, 10).mean(axis=(1, 3))
    np.testing.assert_allclose(wide, 1, atol=1.5e-3)


def test_light_that_is_uneven_as_no_polynomial_is_does_not_matter():
    rng = np.random.default_rng(5)
    waves = 0.02 * np.sin(np.arange(SIZE[1]) * 2 * np.pi / 110)
    lit = unevenly_lit() * (1 + waves)
    found = response(photographed(lit, PRNU * rng.normal(size=SIZE), rng, [1.0] * 8))
    assert np.std(found.values.mean(axis=0)) < 0.4 * np.std(waves)


def test_a_noisy_flat_does_no_harm():
    rng = np.random.default_rng(3)
    unequal = 0.002 * rng.normal(size=SIZE)
    found = response(photographed(unevenly_lit(), unequal, rng, [1.0, 1.0], electrons=1500.0))
    # Two frames of 3 % noise say next to nothing of .2 %.
    assert np.nanstd(found.values - 1) < 0.004
    merged = photographed(np.full(SIZE, 0.5), unequal, rng, [1.0, 1.25])
    assert np.nanstd(flatten(merged, found).mosaic) < 1.2 * np.nanstd(merged.mosaic)


def test_a_dead_pixel_becomes_defective():
    rng = np.random.default_rng(4)
    unequal = np.zeros(SIZE)
    unequal[80, 90] = -0.8
    found = response(photographed(unevenly_lit(), unequal, rng, [1.0] * 4))
    merged = photographed(np.full(SIZE, 0.5), np.zeros(SIZE), rng, [1.0, 1.25])
    flat = flatten(merged, found)
    assert np.argwhere(flat.defective & ~merged.defective).tolist() == [[80, 90]]
    assert not flat.valid[80, 90]
