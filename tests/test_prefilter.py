"""Filtered maps against what is known on paper, and against plain sums."""

import numpy as np
import pytest

from stages import cube as cubes
from stages.prefilter import SIGMA, area_average, irradiance, mean, prefilter


@pytest.mark.parametrize("size", [16, 12])  # 12 has odd levels
def test_a_constant_map_stays_constant(size):
    constant = np.broadcast_to(np.float32([3.0, -0.5]), (6, size, size, 2))
    for level in prefilter(constant):
        np.testing.assert_allclose(level, constant[:, :1, :1] + 0 * level, rtol=2e-6)
    np.testing.assert_allclose(irradiance(constant, size=4), constant[:, :4, :4], rtol=2e-6)
    np.testing.assert_allclose(area_average(constant, 5), constant[:, :5, :5], rtol=2e-6)


def test_levels_have_the_sizes_opengl_wants():
    levels = prefilter(np.zeros((6, 12, 12, 7), np.float32))
    assert [level.shape for level in levels] == [(6, n, n, 7) for n in (12, 6, 3, 1)]


def test_a_linear_world_loses_no_light_and_keeps_its_direction():
    # L = 2 + d . a: symmetric kernels leave the mean, and shorten a, which is the blur
    a = np.array([0.6, -0.3, 0.5])
    world = (2 + cubes.directions(64) @ a)[..., None].astype(np.float32)
    for level in prefilter(world)[:5]:
        n = level.shape[1]
        weight = cubes.solid_angles(n)[..., None] / (4 * np.pi)
        assert (level * weight).sum() == pytest.approx(2, abs=1e-3)
        seen = 3 * np.einsum("fyxc,fyxk->k", level * weight, cubes.directions(n))
        assert np.dot(seen, a) / np.linalg.norm(seen) / np.linalg.norm(a) > 0.99999
        assert np.linalg.norm(seen) / np.linalg.norm(a) > 1 - (SIGMA * 2 / n) ** 2 * 2


def test_blur_is_six_tenths_of_a_texel_and_crosses_edges():
    # a bright texel at the middle of a face and one at an edge: same shape, same light
    n, level = 64, 3
    for v in (0.0, 1.0):
        world = np.zeros((6, n, n, 1), np.float32)
        row = n // 2 if v == 0 else n - 1
        world[4, row, n // 2] = 1 / cubes.solid_angles(n)[row, n // 2]
        mip = prefilter(world)[level]
        m = mip.shape[1]
        power = mip[..., 0] * cubes.solid_angles(m)
        assert power.sum() == pytest.approx(1, abs=0.02)
        d = cubes.directions(m)
        centre = np.einsum("fyx,fyxk->k", power, d)
        target = cubes.directions(n)[4, row, n // 2]
        assert np.degrees(np.arccos(centre @ target / np.linalg.norm(centre))) < 2.5
        # its width along x, in texels of the level
        x = np.arctan2(d[..., 0], d[..., 2] if v == 0 else (d[..., 2] - d[..., 1]) / np.sqrt(2))
        texel = 2 / m if v == 0 else 2 / m / np.sqrt(2)
        offset = x - np.arctan2(target[0], target[2] if v == 0 else np.sqrt(2) * target[2])
        near = power > 0.01 * power.max()
        width = np.sqrt((power * offset**2)[near].sum() / power[near].sum()) / texel
        assert width == pytest.approx(SIGMA, rel=0.15)


@pytest.mark.parametrize("place", [(2, 32, 32), (2, 32, 63), (2, 63, 63), (5, 1, 2)])
def test_a_lamp_keeps_its_light_wherever_it_is(place):
    world = np.zeros((6, 64, 64, 1), np.float32)
    world[place] = 1 / cubes.solid_angles(64)[place[1:]]
    for level in prefilter(world):
        light = (level[..., 0] * cubes.solid_angles(level.shape[1])).sum()
        assert light == pytest.approx(1, abs=0.05)


def test_irradiance_is_the_cosine_weighted_mean_of_the_sky():
    rng = np.random.default_rng(3)
    world = rng.random((6, 16, 16, 6)).astype(np.float32)
    result = irradiance(world, size=4)
    d = cubes.directions(16)
    weight = cubes.solid_angles(16)[None]
    facing = cubes.directions(4)
    for place in [(0, 0, 0), (3, 2, 1), (5, 3, 3)]:
        cosine = np.maximum(d @ facing[place], 0) * weight
        expected = (world * cosine[..., None]).sum(axis=(0, 1, 2)) / np.pi
        np.testing.assert_allclose(result[place], expected, rtol=2e-3)  # 16 texels: a coarse sum


def test_irradiance_of_half_a_sky_is_known_on_paper():
    # white above, black below: (1 + cos of the angle from the zenith) / 2
    world = np.zeros((6, 64, 64, 1), np.float32)
    world[cubes.directions(64)[..., 1] > 0] = 1
    facing = cubes.directions(8)
    expected = (1 + facing[..., 1]) / 2
    np.testing.assert_allclose(irradiance(world, size=8)[..., 0], expected, atol=2e-4)


def test_a_large_map_is_brought_down_without_loss_of_light():
    rng = np.random.default_rng(4)
    world = rng.random((6, 24, 24, 2)).astype(np.float32)
    np.testing.assert_allclose(mean(area_average(world, 7)), mean(world), rtol=0.02)
    # exactly, where the coarse texels are unions of fine ones
    np.testing.assert_allclose(mean(area_average(world, 8)), mean(world), rtol=1e-6)
