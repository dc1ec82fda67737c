"""What a display is sent: sRGB's own numbers, hue kept in highlights, nothing out of range."""

import warnings

import numpy as np
import pytest

from calibration.adaptation import D65
from calibration.display import SHOULDER, auto_exposure, encode, shoulder, srgb


def linear(encoded):
    """The other way, as IEC 61966-2-1 writes it."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def test_greys_below_the_shoulder_are_srgb():
    # 18 % grey is 118 of 255
    np.testing.assert_allclose(srgb(0.18 * D65) * 255, 118.0, atol=0.5)
    assert srgb(np.zeros(3)).tolist() == [0, 0, 0]


def test_agrees_with_colour_science_within_the_gamut():
    rng = np.random.default_rng(1)
    rgb = 0.02 + 0.67 * rng.random((50, 3))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        colour = pytest.importorskip("colour")
        # its matrix is the standard's, rounded to four places: a tenth of an 8-bit step
        xyz = colour.RGB_to_XYZ(rgb, "sRGB")
        expected = colour.cctf_encoding(rgb, function="sRGB")
    np.testing.assert_allclose(srgb(xyz), expected, atol=5e-4)


def test_the_shoulder_is_smooth_rising_and_ends_at_one():
    x = np.linspace(0, 50, 100001)
    y = shoulder(x)
    np.testing.assert_array_equal(y[x <= SHOULDER], x[x <= SHOULDER])
    slope = np.diff(y) / np.diff(x)
    assert (slope >= 0).all()
    assert np.abs(np.diff(slope)).max() < 3e-3  # no kink: slope goes on as exp(-over / .3)
    assert y.max() <= 1


def test_highlights_keep_the_ratios_of_their_components():
    dim = np.array([0.5, 0.3, 0.2]) @ np.array(
        [[0.41239, 0.21264, 0.01933], [0.35758, 0.71517, 0.11919], [0.18048, 0.07219, 0.95053]]
    )
    bright = linear(srgb(dim, exposure=40.0).astype(float))
    np.testing.assert_allclose(bright / bright.max(), [1, 0.6, 0.4], atol=2e-3)
    assert bright.max() > 0.99


def test_colours_out_of_gamut_keep_luminance_and_come_inside():
    cyan = np.array([0.25, 0.4, 0.5])  # a negative red
    shown = linear(srgb(cyan).astype(float))
    assert shown.min() == pytest.approx(0, abs=1e-6)
    assert shown @ [0.2126, 0.7152, 0.0722] == pytest.approx(0.4, abs=1e-3)


def test_noise_about_black_and_lamps_stay_in_range():
    rng = np.random.default_rng(2)
    xyz = np.concatenate([rng.normal(0, 1e-3, (500, 3)), 10 ** rng.uniform(-3, 5, (500, 3))])
    shown = srgb(xyz)
    assert np.isfinite(shown).all()
    assert shown.min() >= 0
    assert shown.max() <= 1


def test_encoding_has_no_step():
    assert encode(0.0031308 - 1e-9) == pytest.approx(float(encode(0.0031308 + 1e-9)), abs=1e-6)


def test_exposure_brings_the_percentile_to_the_shoulder():
    y = np.linspace(0, 20, 201)[:, None] * D65
    assert auto_exposure(y) == pytest.approx(SHOULDER / 18)
    assert auto_exposure(np.zeros((4, 3))) == 1
