"""Profiles as Little CMS reads them: the colours are those the display shows."""

import io
import struct
import warnings

import measured_screen as screen
import numpy as np
import pytest

from calibration import icc, measured_display
from calibration.display import DISPLAY_P3, REC2020_PQ, SRGB

D50 = np.array([0.9642, 1.0, 0.8249])  # ICC.1:2022, 7.2.16


@pytest.fixture(scope="module")
def measured():
    return measured_display.characterise(measured_display.check(screen.table()), "panel").display


@pytest.fixture(scope="module")
def to_d50():
    """colour-science's Bradford adaptation from a white to D50."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        colour = pytest.importorskip("colour")

        def matrix(white):
            return colour.adaptation.matrix_chromatic_adaptation_VonKries(
                white, D50, transform="Bradford"
            )

        return matrix


def lcms_xyz(profile, rgb):
    """XYZ (n, 3) relative to D50 that Little CMS makes of a signal, media-relative."""
    codecs = pytest.importorskip("imagecodecs")
    settings = {"colorspace": "rgb", "outcolorspace": "xyz", "outdtype": "f8", "intent": 1}
    return codecs.cms_transform(rgb[None], profile, codecs.cms_profile("xyz"), **settings)[0]


def opened(profile):
    cms = pytest.importorskip("PIL.ImageCms")
    return cms.ImageCmsProfile(io.BytesIO(profile)).profile


@pytest.mark.parametrize("display", [SRGB, DISPLAY_P3], ids=lambda d: d.name)
def test_a_signal_means_what_the_display_shows(display, to_d50):
    rgb = np.random.default_rng(1).random((200, 3))
    rgb[0], rgb[1] = 0, 1
    found = lcms_xyz(icc.profile(display), rgb)
    # colorants and curve numbers are rounded to 1/65536
    np.testing.assert_allclose(found, display.xyz(rgb) @ to_d50(display.white).T, atol=5e-5)


def test_a_measured_display_keeps_its_curves_and_its_black(measured, to_d50):
    rgb = np.random.default_rng(2).random((200, 3))
    rgb[0], rgb[1] = 0, 1
    found = lcms_xyz(icc.profile(measured), rgb)
    expected = measured.xyz(rgb) @ to_d50(measured.white).T
    np.testing.assert_allclose(found, expected, atol=5e-5)
    assert found[0, 1] == pytest.approx(screen.BLACK[1] / screen.WHITE_CD_M2, abs=2e-5)


def test_primaries_are_those_of_the_published_profiles():
    cms = pytest.importorskip("PIL.ImageCms")
    ours = opened(icc.profile(SRGB))
    theirs = cms.ImageCmsProfile(cms.createProfile("sRGB")).profile
    for name in ("red_colorant", "green_colorant", "blue_colorant"):
        np.testing.assert_allclose(getattr(ours, name)[0], getattr(theirs, name)[0], atol=2e-4)
    # Apple's Display P3 profile, as its tags are rounded
    p3 = opened(icc.profile(DISPLAY_P3))
    np.testing.assert_allclose(p3.red_colorant[0], [0.51512, 0.24120, -0.00105], atol=2e-5)
    np.testing.assert_allclose(p3.green_colorant[0], [0.29198, 0.69225, 0.04189], atol=2e-5)
    np.testing.assert_allclose(p3.blue_colorant[0], [0.15710, 0.06657, 0.78407], atol=2e-5)


def test_a_profile_says_what_it_is(measured):
    profile = icc.profile(measured)
    assert struct.unpack(">I", profile[:4])[0] == len(profile)
    read = opened(profile)
    assert read.profile_description == "panel"
    assert read.version == pytest.approx(4.4)
    assert read.device_class == "mntr"
    assert read.is_matrix_shaper
    np.testing.assert_allclose(read.media_white_point[0], D50, atol=1e-5)


def test_equal_displays_give_equal_bytes(measured):
    again = measured_display.characterise(measured_display.check(screen.table()), "panel").display
    assert icc.profile(again) == icc.profile(measured)
    assert icc.profile(SRGB) != icc.profile(DISPLAY_P3)


def test_absolute_luminance_has_no_profile_of_this_kind():
    with pytest.raises(AssertionError):
        icc.profile(REC2020_PQ)
