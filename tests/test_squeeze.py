"""Where a picture is squeezed as by a mirror, and where it is only full of things."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from sphere_tracer import Camera, busy_world, chromium, photograph

from stages.squeeze import squeezed_circles

HEIGHT, WIDTH = 280, 320


def clutter(seed):
    """A wall on which everything changes from one pixel or two to the next."""
    noise = np.random.default_rng(seed).normal(size=(HEIGHT, WIDTH))
    return np.exp(2.0 * gaussian_filter(noise, 1.0))


def before_clutter(x, y, rim, seed):
    """The logarithm of a photograph of a sphere before it."""
    camera = Camera.seeing(x, y, rim, HEIGHT, WIDTH)
    image = photograph(camera, busy_world(seed), chromium, samples=1, rim_samples=2)[..., 0]
    row, column = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    return np.log(np.where(np.hypot(column - x, row - y) < rim, image, clutter(seed)))


@pytest.mark.parametrize(("x", "y", "rim"), [(150.3, 120.7, 90.0), (231.0, 66.0, 48.0)])
def test_a_sphere_is_where_the_picture_is_squeezed_whatever_is_behind(x, y, rim):
    best, next_best = squeezed_circles(before_clutter(x, y, rim, seed=4), 2)
    # To a few percent of the radius, and rather too large than too small.
    np.testing.assert_allclose(best.circle[:2], (x, y), atol=0.04 * rim)
    assert 0.97 < best.circle[2] / rim < 1.09
    assert best.score > 1.4 * next_best.score


def test_nothing_is_squeezed_in_clutter_or_in_a_chequered_wall():
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    boxes = np.random.default_rng(8).uniform(0.1, 3.0, (12, 12))[row // 30, column // 40]
    noise = np.random.default_rng(9).normal(0.0, 0.003, (HEIGHT, WIDTH))
    for light in (np.log(clutter(3)), np.log(boxes) + noise, noise):
        best, next_best = squeezed_circles(light, 2)
        assert best.score < 1.2 * next_best.score


def test_a_picture_too_small_for_a_sphere_has_none():
    assert squeezed_circles(np.zeros((9, 9))) == []
