import numpy as np
import pytest

from calibration import uncertainty
from calibration.adaptation import D65, cat02
from calibration.difference import delta_e_2000, lab
from calibration.primaries import load

XYZ_FROM = load("darling2011").xyz_from_primaries


@pytest.fixture(scope="module")
def drawn():
    """A light's bands, 40,000 noisy draws of them, a matrix and a reflectance."""
    rng = np.random.default_rng(7)
    bands = rng.uniform(0.3, 1.0, 6)
    sigma = 0.001 * bands  # small: to first order is what is promised
    noisy = bands + sigma * rng.normal(size=(40_000, 6))
    matrix = np.eye(6) + 0.12 * rng.normal(size=(6, 6))
    return bands, sigma**2, noisy, matrix, rng.uniform(0.5, 0.7, 6)


def difference(white, xyz, seen):
    """CIEDE2000 between a colour and others (n, 3), under a white that is adapted to."""
    adapted = cat02(white, D65) / white[1]
    return delta_e_2000(lab(adapted @ xyz), lab(seen @ adapted.T))


def rms(values):
    return np.sqrt(np.mean(values**2))


def test_the_primaries_covariance_is_that_of_noise_really_drawn(drawn):
    _, variances, noisy, matrix, reflectance = drawn
    got = uncertainty.of_primaries(variances, matrix, reflectance)
    measured = np.cov((noisy @ matrix.T / reflectance).T)
    scale = np.sqrt(np.outer(np.diag(got), np.diag(got)))
    np.testing.assert_allclose(got / scale, measured / scale, atol=0.02)  # 4 / sqrt(draws)


def test_many_texels_have_each_its_own_covariance(drawn):
    _, variances, _, matrix, reflectance = drawn
    rng = np.random.default_rng(8)
    many = variances * rng.uniform(0.5, 2.0, (3, 4, 6))
    divisors = reflectance * rng.uniform(0.5, 2.0, (3, 4, 6))
    got = uncertainty.of_primaries(many, matrix, divisors)
    assert got.shape == (3, 4, 6, 6)
    for place in np.ndindex(3, 4):
        one = np.diag(1 / divisors[place]) @ matrix
        np.testing.assert_allclose(got[place], one @ np.diag(many[place]) @ one.T, rtol=1e-12)
    np.testing.assert_allclose(
        uncertainty.of_primaries(many, matrix), uncertainty.of_primaries(many, matrix, np.ones(6))
    )


def test_a_colours_uncertainty_is_the_rms_difference_of_noise_really_drawn(drawn):
    bands, variances, noisy, matrix, reflectance = drawn
    to_xyz = XYZ_FROM @ (matrix / reflectance[:, None])
    xyz, seen = to_xyz @ bands, noisy @ to_xyz.T
    covariance = uncertainty.of_primaries(variances, matrix, reflectance)
    got = uncertainty.delta_e(xyz, uncertainty.of_xyz(covariance, XYZ_FROM), xyz)
    assert got == pytest.approx(rms(difference(xyz, xyz, seen)), rel=0.03)
    # The variances alone, without what the primaries' noise has in common, say something else.
    alone = uncertainty.of_xyz(np.diag(np.diag(covariance)), XYZ_FROM)
    assert uncertainty.delta_e(xyz, alone, xyz) != pytest.approx(got, rel=0.1)


def test_a_white_under_its_own_light_is_the_general_case_at_a_white(drawn):
    _, variances, _, matrix, reflectance = drawn
    lights = np.array([[0.9, 1.0, 1.1], [1.1, 1.0, 0.35], [20.0, 22.0, 18.0]])
    covariance = uncertainty.of_xyz(
        uncertainty.of_primaries(variances, matrix, reflectance), XYZ_FROM
    )
    np.testing.assert_allclose(
        uncertainty.white_delta_e(lights, covariance),
        uncertainty.delta_e(lights, covariance, lights),
        rtol=1e-6,
    )


def test_a_surfaces_colour_under_the_light_is_as_unsure_as_drawn(drawn):
    """A coloured surface, seen under a white whose colour the eye knows."""
    bands, variances, noisy, matrix, reflectance = drawn
    surface = np.array([0.08, 0.1, 0.2, 0.35, 0.6, 0.7])
    to_xyz = XYZ_FROM @ (matrix / reflectance[:, None])
    white = to_xyz @ bands
    to_seen = (XYZ_FROM * surface) @ (matrix / reflectance[:, None])
    covariance = uncertainty.of_primaries(variances, matrix, reflectance)
    got = uncertainty.delta_e(
        to_seen @ bands, uncertainty.of_xyz(covariance, XYZ_FROM, surface), white
    )
    off = difference(white, to_seen @ bands, noisy @ to_seen.T)
    assert got == pytest.approx(rms(off), rel=0.03)


def test_a_diffuse_white_gathers_the_noise_of_many_texels_as_drawn(drawn):
    """50 texels of different light, noise and weight, 2,000 times."""
    bands, variances, _, matrix, _ = drawn
    rng = np.random.default_rng(9)
    amount = rng.uniform(0.2, 5.0, (50, 1))
    texels, variances = bands * amount, 25 * variances * amount
    weights = rng.uniform(0.0, 0.1, (2, 50))
    noisy = texels + np.sqrt(variances) * rng.normal(size=(2000, 50, 6))
    to_xyz = XYZ_FROM @ matrix
    covariance = uncertainty.of_sum(uncertainty.of_primaries(variances, matrix), weights)
    got = uncertainty.white_delta_e(
        weights @ texels @ to_xyz.T, uncertainty.of_xyz(covariance, XYZ_FROM)
    )
    for k in range(2):
        white = to_xyz @ (weights[k] @ texels)
        seen = np.einsum("n,knb->kb", weights[k], noisy) @ to_xyz.T
        assert got[k] == pytest.approx(rms(difference(white, white, seen)), rel=0.07)  # 3 / sqrt


def test_a_hundred_equal_lights_are_ten_times_surer():
    one = np.diag([4.0, 9.0])
    got = uncertainty.of_sum(np.tile(one, (100, 1, 1)), np.full(100, 0.01))
    np.testing.assert_allclose(got, one / 100)


def test_what_is_no_light_has_no_difference():
    got = uncertainty.white_delta_e([[0.95, 1.0, 1.09], [0.1, -0.2, 0.1]], np.eye(3))
    np.testing.assert_array_equal(np.isnan(got), [False, True])
