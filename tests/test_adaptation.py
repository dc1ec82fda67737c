"""CAT02 and CAT16 against what must hold on paper, and against colour-science."""

import warnings

import numpy as np
import pytest

from calibration.adaptation import D65, METHODS, WHITES, adapt, cat02, white
from calibration.errors import InputError

ILLUMINANT_A = np.array([1.09850, 1.0, 0.35585])  # CIE 15, 2 degrees


@pytest.fixture(scope="module")
def colour():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return pytest.importorskip("colour")


@pytest.mark.parametrize("method", METHODS)
def test_white_goes_to_white_and_keeps_its_luminance(method):
    adapted = adapt(ILLUMINANT_A, D65, method) @ (7 * ILLUMINANT_A)
    np.testing.assert_allclose(adapted, 7 * D65, rtol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_the_level_of_a_white_does_not_count(method):
    np.testing.assert_allclose(
        adapt(40 * ILLUMINANT_A, D65, method), adapt(ILLUMINANT_A, 9 * D65, method)
    )


@pytest.mark.parametrize("method", METHODS)
def test_there_and_back_is_nothing(method):
    there, back = adapt(ILLUMINANT_A, D65, method), adapt(D65, ILLUMINANT_A, method)
    np.testing.assert_allclose(back @ there, np.eye(3), atol=1e-12)


def test_an_eye_that_does_not_adapt_sees_what_is_there():
    np.testing.assert_array_equal(adapt(ILLUMINANT_A, D65, None), np.eye(3))
    np.testing.assert_allclose(adapt(ILLUMINANT_A, D65, degree=0.0), np.eye(3), atol=1e-12)


def test_half_adapted_lies_half_way_and_keeps_luminance():
    half = adapt(ILLUMINANT_A, D65, degree=0.5) @ ILLUMINANT_A
    np.testing.assert_allclose(half, (ILLUMINANT_A + D65) / 2, rtol=1e-12)


def test_cat02_is_the_default():
    np.testing.assert_array_equal(adapt(ILLUMINANT_A, D65), cat02(ILLUMINANT_A, D65))


@pytest.mark.parametrize("method", METHODS)
def test_agrees_with_colour_science(colour, method):
    expected = colour.adaptation.matrix_chromatic_adaptation_VonKries(
        ILLUMINANT_A, D65, transform=method.upper()
    )
    # 1e-4: colour-science gives the matrices and their inverses to four and six places
    np.testing.assert_allclose(adapt(ILLUMINANT_A, D65, method), expected, atol=1e-4)


def test_incomplete_adaptation_agrees_with_colour_sciences_ciecam02(colour):
    equal_energy, degree = np.ones(3), 0.7
    cones_from_xyz = colour.adaptation.CHROMATIC_ADAPTATION_TRANSFORMS["CAT02"]
    xyz = np.array([0.4, 0.3, 0.1])
    adapted = colour.appearance.ciecam02.full_chromatic_adaptation_forward(
        cones_from_xyz @ xyz * 100, cones_from_xyz @ ILLUMINANT_A * 100, 100.0, degree
    )
    expected = np.linalg.solve(cones_from_xyz, adapted) / 100
    np.testing.assert_allclose(
        adapt(ILLUMINANT_A, equal_energy, degree=degree) @ xyz, expected, atol=1e-4
    )


@pytest.mark.parametrize("name", WHITES)
def test_named_whites_are_the_cies(colour, name):
    xy = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"][
        {"F2": "FL2", "F11": "FL11"}.get(name, name)
    ]
    np.testing.assert_allclose(white(name), colour.xy_to_XYZ(xy), atol=2e-4)


def test_a_white_may_be_a_chromaticity():
    np.testing.assert_array_equal(white("0.3127,0.3290"), D65)


@pytest.mark.parametrize("name", ["D66", "0.3", "0.3,x", "0.6,0.6", "0,0.3", "nan,0.3"])
def test_what_is_no_white_is_refused(name):
    with pytest.raises(InputError):
        white(name)


@pytest.mark.parametrize("xyz", [(0, 0, 0), (1, -1, 1), (np.nan, 1, 1), (0, 0.1, 5)])
def test_a_light_without_colour_is_no_adapting_white(xyz):
    with pytest.raises(InputError, match="adapting white"):
        adapt(xyz, D65)
