"""The benchmarks' exact shading against what is known on paper, and against other integrals."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import integrate

from benchmarks import quadrature
from stages import cube as cubes

UP = np.array([0.3, -0.5, 0.81]) / np.linalg.norm([0.3, -0.5, 0.81])


def leaning(degrees):
    """A view so far from UP."""
    across = np.cross(UP, [0, 1.0, 0])
    across /= np.linalg.norm(across)
    angle = np.radians(degrees)
    return np.cos(angle) * UP + np.sin(angle) * across


def white(n):
    return np.ones((6, n, n, 1))


@pytest.mark.parametrize("alpha", [0.05, 0.2, 0.5])
def test_bounded_ward_seen_head_on_returns_what_paper_says(alpha):
    # samples' weight 2 nl / (nl + nv) is 1 - t with t = tan^2, exponential of mean alpha^2
    a = alpha**2
    expected = 1 - a + a * np.exp(-1 / a)
    found = quadrature.gloss(white(16), [UP], [UP], alpha)
    assert found[0, 0] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("brdf", ["ward", "ward1992", "ggx"])
@pytest.mark.parametrize(("alpha", "degrees"), [(0.05, 20), (0.05, 80), (0.3, 0), (0.3, 70)])
def test_a_white_world_agrees_with_an_integral_over_angles(brdf, alpha, degrees):
    # the same BRDFs over polar angles about the mirrored view, where the lobe is
    view = leaning(degrees)
    mirrored = 2 * (view @ UP) * UP - view
    x = np.cross(mirrored, UP if degrees else [1.0, 0, 0])
    x /= np.linalg.norm(x)
    y = np.cross(mirrored, x)
    node, weight = np.polynomial.legendre.leggauss(250)
    edges = np.radians([0, 15, 60, 180])
    total = 0.0
    for low, high in pairwise(edges):
        theta = (low + high) / 2 + (high - low) / 2 * node
        phi = np.pi * (np.arange(600) + 0.5) / 300
        sin, cos = np.sin(theta)[:, None], np.cos(theta)[:, None]
        light = (
            (sin * np.cos(phi))[..., None] * x
            + (sin * np.sin(phi))[..., None] * y
            + (cos + 0 * phi)[..., None] * mirrored
        )
        n_l = light @ UP
        up = n_l > 0
        value = np.zeros_like(n_l)
        value[up] = quadrature.BRDFS[brdf](light[up], view, UP, alpha) * n_l[up]
        ring = value.sum(axis=1) * np.pi / 300 * np.sin(theta)
        total += (ring * weight).sum() * (high - low) / 2
    found = quadrature.gloss(white(16), [UP], [view], alpha, brdf)
    assert found[0, 0] == pytest.approx(total, rel=2e-3)


def test_ggx_head_on_is_as_an_integral_over_one_angle():
    alpha = 0.4

    def slice_(theta):
        # facets by their own angle; light at twice it, its solid angle 4 cos as large
        cos = np.cos(theta)
        n_l = np.cos(2 * theta)
        density = alpha**2 / (np.pi * (cos**2 * (alpha**2 - 1) + 1) ** 2)
        hidden = (np.sqrt(1 + alpha**2 * np.tan(2 * theta) ** 2) - 1) / 2
        return density / (1 + hidden) / (4 * n_l) * n_l * 4 * cos * 2 * np.pi * np.sin(theta)

    expected, _ = integrate.quad(slice_, 0, np.pi / 4)
    found = quadrature.gloss(white(16), [UP], [UP], alpha, "ggx")
    assert found[0, 0] == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("brdf", ["ward", "ward1992", "ggx"])
def test_a_far_light_returns_the_brdf_itself(brdf):
    n, alpha, view = 256, 0.3, leaning(35)
    world = np.zeros((6, n, n, 2))
    at = (4, 100, 170)
    world[at] = np.array([1.0, 3.0]) / cubes.solid_angles(n)[at[1:]]
    light = cubes.directions(n)[at]
    assert light @ UP > 0.1
    expected = quadrature.BRDFS[brdf](light, view, UP, alpha) * (light @ UP)
    found = quadrature.gloss(world, [UP], [view], alpha, brdf)
    np.testing.assert_allclose(found[0], [expected, 3 * expected], rtol=1e-3)


def test_a_mirror_sharper_than_a_texel_still_returns_all_its_light():
    # alpha .005: a lobe of half a degree among texels of eleven
    found = quadrature.gloss(white(8), [UP], [leaning(40)], 0.005)
    assert found[0, 0] == pytest.approx(1, abs=2e-3)


def test_white_under_half_a_sky_is_known_on_paper():
    # white above, black below: (1 + cos of the angle from the zenith) / 2
    world = np.zeros((6, 32, 32, 1))
    world[cubes.directions(32)[..., 1] > 0] = 1
    normals = np.concatenate([cubes.directions(4).reshape(-1, 3), [UP]])
    expected = (1 + normals[:, 1]) / 2
    np.testing.assert_allclose(quadrature.diffuse(world, normals)[:, 0], expected, atol=1e-4)
