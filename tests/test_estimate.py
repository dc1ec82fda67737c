"""Spectra estimated from primaries keep the primaries' values, and are the best of their kind."""

import numpy as np
import pytest

from calibration import estimate, primaries, sets

PRIMARIES = primaries.load("darling2011")


@pytest.mark.parametrize("kind", estimate.KINDS)
def test_the_estimates_own_values_are_what_it_was_made_from(kind):
    matrix = estimate.spectra_from_primaries(PRIMARIES, kind)
    np.testing.assert_allclose(PRIMARIES.curves.T @ matrix, np.eye(6), atol=1e-10)


@pytest.mark.parametrize("kind", estimate.KINDS)
def test_no_other_estimate_that_keeps_the_values_is_better(kind):
    """On random draws of what is expected: moved any way that leaves the values, it is worse."""
    rng = np.random.default_rng(8)
    moment = estimate.second_moment(kind)
    matrix = estimate.spectra_from_primaries(PRIMARIES, kind)
    unseen = np.eye(36) - PRIMARIES.curves @ np.linalg.pinv(PRIMARIES.curves)

    def error(m):
        lost = np.eye(36) - m @ PRIMARIES.curves.T
        return np.trace(lost @ moment @ lost.T)

    best = error(matrix)
    for _ in range(20):
        other = matrix + 0.01 * unseen @ rng.standard_normal(matrix.shape)
        assert error(other) > best


def test_a_white_is_estimated_nearly_white():
    white = estimate.spectra_from_primaries(PRIMARIES, "reflectance") @ np.ones(6)
    seen = sets.observer()[:, 1] > 1e-4  # 99.9 % of what the eye sees
    assert np.abs(white[seen] - 1).max() < 0.1


def test_surfaces_never_seen_are_estimated_as_well_as_told():
    matrix = estimate.spectra_from_primaries(PRIMARIES, "reflectance")
    chart = sets.surfaces("colorchecker24").values
    error = matrix @ (PRIMARIES.curves.T @ chart) - chart
    relative = np.sqrt(np.mean(error**2) / np.mean(chart**2))
    assert relative < 1.3 * estimate.rms_error(PRIMARIES, "reflectance")
    assert relative < 0.25


def test_daylight_is_estimated_as_daylight():
    day = sets.lights("darling2011")["D65"]
    found = estimate.spectra_from_primaries(PRIMARIES) @ PRIMARIES.project(day)
    assert np.sqrt(np.mean((found - day) ** 2) / np.mean(day**2)) < 0.25
