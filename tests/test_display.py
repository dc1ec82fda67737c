"""What a display is sent: sRGB's own numbers, hue kept in highlights, nothing out of range."""

import warnings

import numpy as np
import pytest

from calibration.adaptation import D65
from calibration.display import (
    DISPLAY_P3,
    DISPLAYS,
    REC2020_PQ,
    SHOULDER,
    SRGB,
    auto_exposure,
    decode_pq,
    encode,
    encode_pq,
    named,
    rec2020_pq,
    shoulder,
    show,
    srgb,
)
from calibration.errors import InputError


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


# ------------------------------------------------------------------------------ other displays


@pytest.mark.parametrize("display", DISPLAYS.values(), ids=lambda d: d.name)
def test_white_is_white_on_every_display(display):
    np.testing.assert_allclose(display.linear(D65), 1, atol=1e-12)
    np.testing.assert_allclose(display.white, D65, rtol=1e-12)


@pytest.mark.parametrize(
    ("display", "space"),
    [(SRGB, "sRGB"), (DISPLAY_P3, "Display P3"), (REC2020_PQ, "ITU-R BT.2020")],
)
def test_primaries_are_colour_sciences(display, space):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        colour = pytest.importorskip("colour")
        expected = colour.RGB_COLOURSPACES[space].primaries
    np.testing.assert_allclose(display.primaries, expected, atol=1e-12)


def test_pq_is_known_on_paper():
    # ST 2084: 0 and 10000 cd/m2 are the ends, 100 is .508; BT.2408: reference white is 58 %
    assert encode_pq(10000.0) == pytest.approx(1.0)
    assert encode_pq(0.0) == pytest.approx(0.0, abs=1e-6)
    assert encode_pq(100.0) == pytest.approx(0.5081, abs=1e-4)
    assert encode_pq(203.0) == pytest.approx(0.58, abs=2e-3)


def test_pq_agrees_with_colour_science_and_turns_round():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        colour = pytest.importorskip("colour")
        luminance = np.geomspace(1e-3, 1e4, 50)
        expected = colour.models.eotf_inverse_ST2084(luminance)
    np.testing.assert_allclose(encode_pq(luminance), expected, atol=1e-9)
    np.testing.assert_allclose(decode_pq(encode_pq(luminance)), luminance, rtol=1e-7)


def test_hdr_shows_white_at_203_and_lamps_below_the_peak():
    assert decode_pq(show(D65, REC2020_PQ).astype(float)) == pytest.approx([203.0] * 3, rel=1e-4)
    lamp = decode_pq(show(1e5 * D65, REC2020_PQ).astype(float))
    assert lamp == pytest.approx([1000.0] * 3, rel=1e-4)
    twice = decode_pq(show(2 * D65, REC2020_PQ).astype(float))
    assert twice == pytest.approx([406.0] * 3, rel=1e-4)  # no compression where there is room
    dim = rec2020_pq(100.0, 600.0)
    assert decode_pq(show(D65, dim).astype(float)) == pytest.approx([100.0] * 3, rel=1e-4)


def test_a_wider_gamut_keeps_what_srgb_cannot_show():
    green = DISPLAY_P3.xyz([0.1, 0.8, 0.1])
    assert SRGB.linear(green).min() < 0
    np.testing.assert_allclose(show(green, DISPLAY_P3), [0.1, 0.8, 0.1], atol=1e-6)
    narrowed = SRGB.xyz(show(green, SRGB))
    assert narrowed[1] == pytest.approx(green[1], abs=1e-4)


@pytest.mark.parametrize("display", DISPLAYS.values(), ids=lambda d: d.name)
def test_signal_and_xyz_are_inverse(display):
    signal = np.random.default_rng(4).uniform(0.01, 0.55, (40, 3))
    np.testing.assert_allclose(display.signal(display.xyz(signal)), signal, atol=1e-6)


def test_a_display_is_found_by_name_or_named_missing():
    assert named("srgb") is SRGB
    with pytest.raises(InputError, match="display-p3"):
        named("adobe")
