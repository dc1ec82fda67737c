import numpy as np
import pytest

from calibration import uncertainty
from calibration.adaptation import D65, cat02
from calibration.difference import delta_e_2000, lab
from calibration.primaries import load


@pytest.fixture(scope="module")
def drawn():
    """A light's bands, 40,000 noisy draws of them, a matrix and a reflectance."""
    rng = np.random.default_rng(7)
    bands = rng.uniform(0.3, 1.0, 6)
    sigma = 0.001 * bands  # small: to first order is what is promised
    noisy = bands + sigma * rng.normal(size=(40_000, 6))
    matrix = np.eye(6) + 0.12 * rng.normal(size=(6, 6))
    return bands, sigma**2, noisy, matrix, rng.uniform(0.5, 0.7, 6)


def test_the_primaries_covariance_is_that_of_noise_really_drawn(drawn):
    _, variances, noisy, matrix, reflectance = drawn
    got = uncertainty.of_primaries(variances, matrix, reflectance)
    measured = np.cov((noisy @ matrix.T / reflectance).T)
    scale = np.sqrt(np.outer(np.diag(got), np.diag(got)))
    np.testing.assert_allclose(got / scale, measured / scale, atol=0.02)  # 4 / sqrt(draws)


def test_a_colours_uncertainty_is_the_rms_difference_of_noise_really_drawn(drawn):
    bands, variances, noisy, matrix, reflectance = drawn
    xyz_from = load("darling2011").xyz_from_primaries
    to_xyz = xyz_from @ (matrix / reflectance[:, None])
    xyz, seen = to_xyz @ bands, noisy @ to_xyz.T
    covariance = uncertainty.of_primaries(variances, matrix, reflectance)
    got = uncertainty.delta_e(xyz, uncertainty.of_xyz(covariance, xyz_from), xyz)
    adapted = cat02(xyz, D65) / xyz[1]
    off = delta_e_2000(lab(adapted @ xyz), lab(seen @ adapted.T))
    assert got == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.03)
    # The variances alone, without what the primaries' noise has in common, say something else.
    alone = uncertainty.of_xyz(np.diag(np.diag(covariance)), xyz_from)
    assert uncertainty.delta_e(xyz, alone, xyz) != pytest.approx(got, rel=0.1)


def test_a_hundred_equal_lights_are_ten_times_surer():
    one = np.diag([4.0, 9.0])
    got = uncertainty.of_sum(np.tile(one, (100, 1, 1)), np.full(100, 0.01))
    np.testing.assert_allclose(got, one / 100)
