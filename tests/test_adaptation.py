"""CAT02 against what must hold on paper, and against colour-science."""

import warnings

import numpy as np
import pytest

from calibration.adaptation import D65, cat02

ILLUMINANT_A = np.array([1.09850, 1.0, 0.35585])  # CIE 15, 2 degrees


def test_white_goes_to_white_and_keeps_its_luminance():
    np.testing.assert_allclose(cat02(ILLUMINANT_A, D65) @ (7 * ILLUMINANT_A), 7 * D65, rtol=1e-12)


def test_the_level_of_a_white_does_not_count():
    np.testing.assert_allclose(cat02(40 * ILLUMINANT_A, D65), cat02(ILLUMINANT_A, 9 * D65))


def test_there_and_back_is_nothing():
    np.testing.assert_allclose(
        cat02(D65, ILLUMINANT_A) @ cat02(ILLUMINANT_A, D65), np.eye(3), atol=1e-12
    )


def test_agrees_with_colour_science():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        colour = pytest.importorskip("colour")
        expected = colour.adaptation.matrix_chromatic_adaptation_VonKries(
            ILLUMINANT_A, D65, transform="CAT02"
        )
    # 1e-4: colour-science gives the CAT02 matrix and its inverse to four and six places
    np.testing.assert_allclose(cat02(ILLUMINANT_A, D65), expected, atol=1e-4)
