import json

import numpy as np
import pytest

from pipeline import io
from stages.normalise import normalise, reflectance_at
from stages.transform import transform
from stages.types import Measured
from stages.unwrap import BAYER_NOISE_CORRELATION


@pytest.fixture
def bands():
    rng = np.random.default_rng(4)
    values = rng.random((6, 4, 4, 6), np.float32)
    return Measured(values, values * 0.01, np.ones((6, 4, 4), np.float32))


def test_the_identity_leaves_six_channels_alone(bands):
    same = transform(bands, np.eye(6))
    np.testing.assert_array_equal(same.values, bands.values)
    np.testing.assert_array_equal(same.variance, bands.variance)


def test_variance_is_that_of_independent_bands():
    """Against the spread of 20,000 noisy signals; its own sampling error is 1 %."""
    rng = np.random.default_rng(5)
    matrix = rng.normal(size=(6, 6))
    sigma = rng.random(6) + 0.1
    noisy = (rng.normal(size=(20000, 6)) * sigma).astype(np.float32)
    variance = np.broadcast_to(sigma**2, (1, 6)).astype(np.float32)
    one = Measured(np.zeros((1, 6), np.float32), variance, np.ones(1, np.float32))
    spread = (noisy @ matrix.T.astype(np.float32)).var(axis=0)
    np.testing.assert_allclose(transform(one, matrix).variance[0], spread, rtol=0.04)


def test_nine_bands_become_six_primaries():
    nine = np.ones((2, 9), np.float32)
    light = transform(Measured(nine, nine, nine[:, 0]), np.full((6, 9), 1 / 9))
    np.testing.assert_allclose(light.values, 1.0, rtol=1e-6)


def test_a_white_sphere_changes_nothing(bands):
    same = normalise(bands, np.ones((6, 4, 4, 6), np.float32))
    np.testing.assert_array_equal(same.values, bands.values)
    np.testing.assert_array_equal(same.variance, bands.variance)


def test_what_a_sphere_reflected_comes_back(bands):
    reflectance = np.full(bands.values.shape, 0.5, np.float32)
    reflected = Measured(bands.values * 0.5, bands.variance * 0.25, bands.valid)
    light = normalise(reflected, reflectance)
    np.testing.assert_allclose(light.values, bands.values, rtol=1e-6)
    np.testing.assert_allclose(light.variance, bands.variance, rtol=1e-6)


def test_reflectance_is_read_between_the_angles_of_the_table():
    table = np.array([[0.6, 0.5], [0.8, 0.9]])
    read = reflectance_at(np.array([[0.0, 0.25], [0.5, np.nan]]), np.array([0.0, 0.5]), table)
    np.testing.assert_allclose(read[0, 1], [0.7, 0.7], rtol=1e-6)
    np.testing.assert_allclose(read[1, 0], [0.8, 0.9], rtol=1e-6)
    assert np.isnan(read[1, 1]).all()


def test_the_maps_sigma_is_the_spread_that_noise_in_the_bands_leaves(finished_once):
    """80 draws of noise by the bands' own sigma, each transformed: spread known to 8 % a texel."""
    bands, _ = io.read_measured(finished_once / "cubemap_bands.exr", cube=True)
    light, _ = io.read_measured(finished_once / "cubemap.exr", cube=True)
    result = json.loads((finished_once / "result.json").read_text())
    matrix = np.array(result["calibration"]["matrix"])
    reflected, _ = io.read_measured(finished_once / "work" / "reflected.exr", cube=True)
    reflectance = reflected.values / light.values
    rng = np.random.default_rng(6)
    correlation = np.kron(np.eye(2), BAYER_NOISE_CORRELATION)
    noise = rng.standard_normal((80, *bands.values.shape), np.float32)
    noise @= np.linalg.cholesky(correlation).T.astype(np.float32)
    noisy = bands.values + np.sqrt(bands.variance) * noise
    spread = np.array(
        [
            normalise(
                transform(Measured(b, bands.variance, bands.valid), matrix), reflectance
            ).values
            for b in noisy
        ]
    ).std(axis=0, ddof=1)
    known = light.valid > 0
    ratio = np.sqrt(light.variance[known]) / spread[known]
    np.testing.assert_allclose(np.median(ratio, axis=0), 1.0, atol=0.02)


def test_the_report_says_how_sure_a_white_is(finished_once):
    learnt = json.loads((finished_once / "result.json").read_text())["steps"]["normalise"]["learnt"]
    noise = learnt["white_delta_e_noise"]
    assert 0.0 < noise["median"] < noise["p95"]
    assert set(noise["facing"]) == {"+X", "-X", "+Y", "-Y", "+Z", "-Z"}
    # Half a map averages: far surer than one texel.
    assert max(noise["facing"].values()) < noise["median"] / 3


def test_noise_that_bands_share_counts_with_the_signs_of_the_matrix():
    """20,000 draws of correlated noise: a spread is known to half a percent."""
    rng = np.random.default_rng(3)
    correlation = np.array([[1.0, 0.5, 0.0], [0.5, 1.0, -0.3], [0.0, -0.3, 1.0]])
    matrix = np.array([[1.0, -0.8, 0.2], [0.3, 0.4, 1.0]])
    sigma = np.array([0.1, 0.2, 0.15])
    noise = rng.multivariate_normal(np.zeros(3), correlation * np.outer(sigma, sigma), 20000)
    one = Measured(np.ones((1, 3), np.float32), sigma[None].astype(np.float32) ** 2, np.ones(1))
    told = np.sqrt(transform(one, matrix, correlation).variance[0])
    np.testing.assert_allclose(told, (noise @ matrix.T).std(axis=0), rtol=0.02)
    assert np.sqrt(transform(one, matrix).variance[0, 0]) > 1.2 * told[0]
