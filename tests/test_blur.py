"""Steps blurred by a known amount, and pictures that have none."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from stages.blur import edge_blur


def panels(seed, size=160, sub=6):
    """Slanted panels of all brightnesses at so many samples a pixel."""
    rng = np.random.default_rng(seed)
    y, x = (np.mgrid[: size * sub, : size * sub] + 0.5) / sub
    picture = np.ones(x.shape)
    for _ in range(25):
        cx, cy, half, other = rng.uniform([0, 0, 12, 12], [size, size, 30, 30])
        c, s = np.cos(t := rng.uniform(0, np.pi)), np.sin(t)
        u, v = c * (x - cx) + s * (y - cy), c * (y - cy) - s * (x - cx)
        picture[(np.abs(u) < half) & (np.abs(v) < other)] = rng.uniform(0.2, 3.0)
    return picture


@pytest.mark.parametrize("lens", [0.5, 0.8, 1.1])
def test_the_blur_of_lens_and_pixel_is_found_from_edges(lens):
    sub = 6
    fine = gaussian_filter(panels(3), lens * sub)
    light = fine.reshape(160, sub, 160, sub).mean(axis=(1, 3))
    light += np.random.default_rng(4).normal(0, 0.003, light.shape)
    found = edge_blur(light, np.full(light.shape, 0.003**2))
    # On top of the lens comes the pixel's square, whose variance is a twelfth.
    assert found == pytest.approx(np.hypot(lens, np.sqrt(1 / 12)), abs=0.05)


def test_soft_edges_beside_sharp_ones_do_not_count():
    fine = panels(3)
    fine = np.concatenate(
        [gaussian_filter(f, b * 6) for f, b in ((fine[:640], 0.6), (fine[640:], 3))]
    )
    light = fine.reshape(160, 6, 160, 6).mean(axis=(1, 3))
    found = edge_blur(light, np.full(light.shape, 1e-6))
    assert found == pytest.approx(np.hypot(0.6, np.sqrt(1 / 12)), abs=0.05)


def test_without_edges_nothing_is_said():
    rng = np.random.default_rng(5)
    flat = 1.0 + rng.normal(0, 0.01, (80, 80))
    assert np.isnan(edge_blur(flat, np.full(flat.shape, 1e-4)))
    assert np.isnan(edge_blur(np.full((80, 80), np.nan), np.ones((80, 80))))
