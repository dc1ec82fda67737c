"""A white divided out: shading and colour of the light cancel, and noise is accounted for."""

import numpy as np
import pytest

from stages.reflect import reflect
from stages.types import Measured

SIZE = (90, 120)


def image(values, sigma=0.0, rng=None):
    values = np.broadcast_to(values, (*SIZE, 3)).astype(np.float32)
    if rng is not None:
        values = values + rng.normal(0, sigma, values.shape).astype(np.float32)
    variance = np.full(values.shape, sigma**2, np.float32)
    return Measured(values, variance, np.ones(SIZE, np.float32))


def shading():
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    return (1 - 0.3 * x / SIZE[1] - 0.2 * y / SIZE[0])[..., None] * [0.8, 1.0, 0.3]


def test_shading_and_the_lights_colour_cancel():
    result = reflect(image(0.25 * shading()), image(shading()))
    np.testing.assert_allclose(result.values, 0.25, rtol=2.5e-3)
    # Away from blocks that the frame cuts, whose mean counts at their middle:
    np.testing.assert_allclose(result.values[:60], 0.25, rtol=2e-4)
    assert (result.valid == 1).all()


def test_a_surface_over_itself_without_texture_is_one():
    np.testing.assert_allclose(reflect(image(0.4), image(0.4)).values, 1, rtol=1e-5)


def test_the_whites_noise_stays_out_of_the_surface():
    rng = np.random.default_rng(1)
    clean, noisy = image(0.5), image(1.0, 0.02, rng)
    result = reflect(clean, noisy)
    # 2 % of one pixel, averaged over 4 pi 8^2 = 800
    assert result.values.std() / 0.5 < 0.0015
    assert np.abs(result.values.mean() - 0.5) < 1e-3


def test_the_variance_told_is_the_variance_there_is():
    rng = np.random.default_rng(2)
    result = reflect(image(0.5, 0.01, rng), image(0.8, 0.01, rng))
    z = (result.values - 0.625) / np.sqrt(result.variance)
    assert z.std() == pytest.approx(1, abs=0.03)


def test_beyond_the_card_nothing_is_known():
    card = shading()
    card[:, 80:] = 0.01  # a dark table
    result = reflect(image(0.5 * card), image(card))
    assert (result.valid[:, :80] == 1).all()
    assert (result.valid[:, 80:] == 0).all()
    assert np.isnan(result.values[:, 80:]).all()
    # the table takes no part in the card's level beside it
    np.testing.assert_allclose(result.values[:, :80], 0.5, rtol=2.5e-3)


def test_unknown_pixels_stay_unknown_and_alone():
    surface, white = image(0.5), image(1.0)
    surface.values[10, 10] = np.nan
    surface.valid[10, 10] = 0
    white.values[40, 50] = np.nan
    white.valid[40, 50] = 0
    result = reflect(surface, white)
    unknown = np.zeros(SIZE, bool)
    unknown[10, 10] = unknown[40, 50] = True
    np.testing.assert_array_equal(result.valid == 0, unknown)
    np.testing.assert_array_equal(np.isnan(result.values).all(axis=-1), unknown)
    np.testing.assert_allclose(result.values[~unknown], 0.5, rtol=1e-5)


def test_without_a_white_nothing_is_known():
    assert (reflect(image(0.5), image(0.0)).valid == 0).all()
    assert (reflect(image(0.5), image(np.nan)).valid == 0).all()


def test_noise_about_black_keeps_its_sign():
    rng = np.random.default_rng(3)
    result = reflect(image(0.0, 0.01, rng), image(1.0))
    assert result.values.min() < 0
    assert abs(result.values.mean()) < 3e-4
