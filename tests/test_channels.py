"""Rendering in channels against what must hold, and against the paper's printed comparators."""

import numpy as np
import pytest

from calibration import channels, sets
from calibration.channels import SHARP_FROM_XYZ
from calibration.primaries import load
from calibration.spectra import WAVELENGTHS


@pytest.fixture(scope="module")
def lights():
    return sets.lights("darling2011")


@pytest.fixture(scope="module")
def checker():
    return sets.surfaces("colorchecker24")


@pytest.fixture(scope="module")
def six():
    return channels.of_primaries(load("darling2011"))


def test_a_channel_a_wavelength_makes_no_error(lights, checker):
    every = channels.Channels(np.eye(36), np.eye(36), sets.observer().T)
    np.testing.assert_allclose(every.errors(lights, checker), 0.0, atol=1e-9)


@pytest.mark.parametrize("space", [np.eye(3), SHARP_FROM_XYZ])
def test_three_channels_are_right_under_daylight_and_for_white(lights, checker, space):
    three = channels.of_colour_space(space)
    np.testing.assert_allclose(three.errors(lights.only(["D65"]), checker), 0.0, atol=1e-6)
    np.testing.assert_allclose(three.errors(lights, sets.surfaces("white")), 0.0, atol=1e-6)


# The paper's table 1, ColorChecker under 19 lights. It prints one decimal.
@pytest.mark.parametrize(
    ("space", "mean", "sd", "largest", "p90"),
    [(SHARP_FROM_XYZ, 1.7, 2.0, 13.3, 4.4), (np.eye(3), 2.3, 2.2, 12.1, 5.4)],
)
def test_three_channels_have_the_papers_errors(lights, checker, space, mean, sd, largest, p90):
    errors = channels.of_colour_space(space).errors(lights, checker)
    assert errors.mean() == pytest.approx(mean, abs=0.1)
    assert errors.std() == pytest.approx(sd, abs=0.1)
    assert errors.max() == pytest.approx(largest, abs=2.0)
    assert np.percentile(errors, 90) == pytest.approx(p90, abs=0.1 + 0.05)


def test_a_camera_that_sees_the_primaries_changes_nothing_of_light(lights, checker, six):
    mixed = six.light @ np.random.default_rng(1).normal(size=(6, 6))
    seen = channels.photographed(
        six, mixed, light=True, surface=False, lights=lights, surfaces=checker
    )
    # The fit may beat the primaries' own numbers on what it is fitted to, never be worse.
    assert np.mean(seen.errors(lights, checker) ** 2) <= np.mean(
        six.errors(lights, checker) ** 2
    ) * (1 + 1e-6)
    linear = channels.best_linear(np.eye(36), mixed, six.light)
    np.testing.assert_allclose(mixed @ linear.T, six.light, atol=1e-10)


@pytest.mark.parametrize(("light", "surface"), [(True, False), (False, True), (True, True)])
def test_the_fit_of_a_camera_is_a_minimum_with_right_derivatives(
    lights, checker, six, light, surface
):
    few, some = lights.only(["A", "D65", "F4", "F11"]), checker.only(["1", "5", "9", "15", "22"])
    bands = _bands()
    start = channels.photographed(
        six, bands, light=light, surface=surface, lights=few, surfaces=some
    )
    cost = np.sum(start.errors(few, some) ** 2) + np.sum(
        start.errors(few, sets.surfaces("white")) ** 2
    )
    rng = np.random.default_rng(5)
    for _ in range(20):
        nudged = channels.Channels(
            start.light + light * 1e-3 * bands @ rng.normal(size=(6, 6)) * 0.01,
            start.surface + surface * 1e-3 * bands @ rng.normal(size=(6, 6)),
            start.xyz_from_channels,
        )
        other = np.sum(nudged.errors(few, some) ** 2) + np.sum(
            nudged.errors(few, sets.surfaces("white")) ** 2
        )
        assert other > cost * (1 - 1e-4)


def _bands():
    middles = np.array([430.0, 470.0, 520.0, 560.0, 600.0, 640.0])
    return np.exp(-0.5 * ((WAVELENGTHS[:, None] - middles) / 25.0) ** 2)
