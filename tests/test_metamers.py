"""Pairs of paints against full spectra: what matches, what parts, what six channels make of it."""

import numpy as np
import pytest

from calibration import metamers, primaries, sets
from calibration.adaptation import D65, cat02
from calibration.difference import delta_e_2000, lab
from calibration.errors import InputError

SET = primaries.load("darling2011")


def light(name):
    return sets.lights("darling2011")[name]


def apart(spectrum, paints):
    """CIEDE2000 of two paints under a light, from full spectra, written out once more."""
    white = sets.xyz(spectrum)
    to_d65 = cat02(white, D65)
    colours = [lab(to_d65 @ (sets.xyz(spectrum * curve) / white[1])) for curve in paints]
    return float(delta_e_2000(*colours))


@pytest.fixture(scope="module")
def pair():
    return metamers.pair(light("A"), light("D65"), SET)


def test_they_match_under_one_light_and_part_under_the_other(pair):
    first, second = pair.paints.values.T
    assert apart(light("A"), (first, second)) < 1e-6
    assert apart(light("D65"), (first, second)) == pytest.approx(metamers.PART, abs=1e-3)


def test_they_are_paints(pair):
    values = pair.paints.values
    assert values.min() >= 0.03
    assert values.max() <= 0.92
    assert np.abs(np.diff(values, 2, axis=0)).max() <= 0.035 + 1e-9


def test_six_channels_hold_what_three_do_not(pair):
    first, second = (SET.project(curve) for curve in pair.paints.values.T)

    def rendered(name):
        in_primaries = SET.project(light(name))
        white = sets.xyz(light(name))
        to_d65 = cat02(white, D65) / white[1]
        xyz = [SET.xyz_from_primaries @ (in_primaries * paint) for paint in (first, second)]
        return float(delta_e_2000(*(lab(to_d65 @ c) for c in xyz)))

    # What the renderer has to show, and with what margin.
    assert rendered("A") == pytest.approx(pair.figures["match_six"], abs=1e-6)
    assert rendered("A") < 1.2
    assert rendered("D65") > 10.0
    assert pair.figures["match_sharp"] > 5.0
    assert pair.figures["held"] < 1.0


def test_another_seed_gives_other_paints(pair):
    other = metamers.pair(light("A"), light("D65"), SET, seed=2)
    assert np.abs(other.paints.values - pair.paints.values).max() > 0.02
    again = metamers.pair(light("A"), light("D65"), SET)
    np.testing.assert_array_equal(again.paints.values, pair.paints.values)


def test_two_lights_that_are_one_part_nothing():
    with pytest.raises(InputError, match="no two paints") as caught:
        metamers.pair(light("A"), 2.0 * light("A"), SET)
    assert "\n" not in str(caught.value)
