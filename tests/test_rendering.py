import numpy as np
import pytest

from calibration import rendering, sets
from calibration.merit import noise_amplification
from calibration.primaries import load
from calibration.rendering import Rendered, Side

BANDS = 6


def colours(noise=0.005, joint=True):
    """Five lights on twelve surfaces through a made-up camera of broad bands."""
    primaries = load("darling2011")
    lights = sets.lights("darling2011").values.T[[0, 3, 7, 12, 18]]
    surfaces = np.vstack([sets.surfaces("colorchecker24").values.T[::2], np.ones(36)])
    bands = np.exp(-0.5 * ((np.arange(36)[:, None] - np.linspace(6, 29, BANDS)) / 3.0) ** 2)
    sides = []
    for spectra in (lights, surfaces):
        seen = spectra @ bands / bands.sum(axis=0)
        true = primaries.project(spectra)
        metric = seen.T @ seen / len(seen) + np.diag(np.mean((noise * seen) ** 2, axis=0))
        ridge = np.linalg.solve(metric, seen.T @ true / len(seen)).T
        sides.append(Side(true, seen, (noise * seen) ** 2, ridge, metric))
    if not joint:
        sides[1] = Side(sides[1].true)
    xyz = sets.xyz(lights[:, None] * surfaces)
    weights = np.ones(xyz.shape[:2])
    whites = sets.xyz(lights)
    return Rendered.of(*sides, xyz, whites, primaries.xyz_from_primaries, weights)


@pytest.mark.parametrize("joint", [False, True])
def test_the_slopes_are_those_of_small_steps(joint):
    got = colours(joint=joint)
    matrices = [side.ridge for side in (got.light, got.surface) if side.sought]
    shapes = [m.shape for m in matrices]

    def cost(x):
        pair = rendering._matrices(got, rendering._split(x, shapes))
        return rendering._equations(got, *pair)

    x, step = rendering._flat(matrices), 1e-6
    here = cost(x)
    along = [
        (cost(x + step * e).cost - cost(x - step * e).cost) / (2 * step) for e in np.eye(len(x))
    ]
    np.testing.assert_allclose(2 * here.right, along, rtol=1e-4, atol=1e-5 * np.abs(along).max())


def test_the_fit_lowers_the_error_and_a_great_strength_keeps_ridge():
    got = colours()
    start = got.mean_error(got.light.ridge, got.surface.ridge)
    free = rendering.fitted(got, 1.0)
    tied = rendering.fitted(got, 1e5)
    assert got.mean_error(*free) < 0.9 * start
    np.testing.assert_allclose(tied[0], got.light.ridge, atol=1e-4)
    np.testing.assert_allclose(tied[1], got.surface.ridge, atol=1e-4)


def test_the_expected_error_is_that_of_noise_really_drawn():
    got = colours(joint=False)
    rng = np.random.default_rng(3)
    matrix = got.light.ridge
    expected = got.errors(matrix, noise=True)
    square = np.zeros_like(expected)
    for _ in range(400):
        noise = 0.005 * rng.normal(size=got.light.signals.shape)
        seen = Side(got.light.true, got.light.signals * (1 + noise), got.light.variances)
        drawn = Rendered(seen, got.surface, got.true_lab, got.xyz_of, got.weights)
        square += drawn.errors(matrix) ** 2 / 400
    assert np.sqrt(square).mean() == pytest.approx(expected.mean(), rel=0.05)


def test_more_noise_expected_is_less_noise_amplified():
    def amplified(noise):
        got = colours(noise, joint=False)
        m_s, _ = rendering.fitted(got, 1.0)
        return noise_amplification(m_s, got.light.signals).max()

    assert amplified(0.02) < amplified(0.001)
