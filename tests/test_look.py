"""What a picture is shown with: white stays white, exposure is shared, words are understood."""

import measured_screen as screen
import numpy as np
import pytest

from calibration import look as looks
from calibration import measured_display
from calibration.adaptation import white
from calibration.display import DISPLAY_P3, DISPLAYS, REC2020_PQ, SRGB, srgb
from calibration.errors import InputError
from calibration.look import Look, parse, shown

LAMP = np.array([1.09850, 1.0, 0.35585])  # illuminant A, CIE 15


@pytest.fixture(scope="module")
def panel():
    return measured_display.characterise(measured_display.check(screen.table()), "panel").display


@pytest.fixture(scope="module")
def picture():
    return np.random.default_rng(1).uniform(0.02, 0.5, (6, 8, 3)) * LAMP


@pytest.mark.parametrize("display", [*DISPLAYS.values(), None], ids=lambda d: d and d.name)
@pytest.mark.parametrize("method", ["cat02", "cat16"])
@pytest.mark.parametrize("tone", looks.TONES)
def test_what_is_white_in_the_scene_is_white_on_the_display(display, method, tone, panel):
    display = display or panel
    greys = np.linspace(0.05, 0.6, 5)[:, None] * 37 * LAMP
    look = Look(display, method, tone=tone, exposure_ev=float(-np.log2(37)))
    seen = display.xyz(shown(greys, look, 9 * LAMP).signal)
    expected = np.linspace(0.05, 0.6, 5)[:, None] * display.white
    np.testing.assert_allclose(seen, expected, atol=5e-4)  # of the panel's curves, read at 4097


def test_no_adaptation_shows_the_light_as_it_is(panel):
    look = Look(panel, None, exposure_ev=0.0)
    seen = panel.xyz(shown(0.4 * LAMP, look).signal)
    np.testing.assert_allclose(seen, 0.4 * LAMP, atol=5e-4)


def test_half_adapted_lies_between():
    """The part of blue in a lamp's white, which grows as the eye adapts."""
    seen = [
        SRGB.xyz(shown(0.2 * LAMP, Look(degree=d, exposure_ev=0.0), LAMP).signal)[2]
        for d in (0.0, 0.5, 1.0)
    ]
    assert seen[0] == pytest.approx(0.2 * LAMP[2], abs=1e-4)
    assert seen[0] < seen[1] < seen[2]
    assert seen[1] == pytest.approx((seen[0] + seen[2]) / 2, abs=1e-4)  # D is linear in gains


def test_a_white_by_name_is_that_white(picture):
    named = shown(picture, Look(white="A", exposure_ev=0.0))
    given = shown(picture, Look(exposure_ev=0.0), white("A"))
    np.testing.assert_array_equal(named.signal, given.signal)
    # a name outdoes the scene's own
    np.testing.assert_array_equal(
        shown(picture, Look(white="A", exposure_ev=0.0), white("D75")).signal, named.signal
    )


def test_ev_are_stops():
    one = SRGB.decoded(shown(0.1 * LAMP, Look(exposure_ev=0.0), LAMP).signal)
    two = SRGB.decoded(shown(0.1 * LAMP, Look(exposure_ev=1.0), LAMP).signal)
    np.testing.assert_allclose(two, 2 * one, rtol=1e-5)
    assert shown(0.1 * LAMP, Look(exposure_ev=-2.5), LAMP).exposure_ev == pytest.approx(-2.5)


def test_pictures_to_be_compared_share_an_exposure(picture):
    first = shown(picture, Look(), LAMP)
    dimmer = shown(picture / 4, Look(), LAMP, exposure_of=picture)
    assert dimmer.exposure == first.exposure
    assert shown(picture / 4, Look(), LAMP).exposure == pytest.approx(4 * first.exposure)
    again = shown(picture, Look(exposure_ev=first.exposure_ev), LAMP)
    np.testing.assert_allclose(again.signal, first.signal, atol=1e-6)


def test_what_is_unknown_is_black_counted_and_does_not_set_the_exposure(picture):
    holed = picture.copy()
    holed[:, :6] = np.nan
    holed[0, 7, 1] = np.inf
    found = shown(holed, Look(), LAMP)
    assert found.unknown == 6 * 6 + 1
    assert (found.signal[:, :6] == 0).all()
    assert np.isfinite(found.signal).all()
    rest = np.concatenate([picture[0:1, 6], *picture[1:, 6:]])
    assert found.exposure == pytest.approx(shown(rest, Look(), LAMP).exposure)
    nothing = shown(np.full((2, 2, 3), np.nan), Look(), LAMP)
    assert nothing.unknown == 4
    assert (nothing.signal == 0).all()


def test_the_shoulder_keeps_hue_where_clipping_turns_it():
    bright = SRGB.xyz_from_rgb @ [3.0, 1.5, 0.3]
    kept = SRGB.decoded(shown(bright, Look(adaptation=None, exposure_ev=0.0)).signal)
    np.testing.assert_allclose(kept / kept[0], [1.0, 0.5, 0.1], atol=1e-4)
    clipped = Look(adaptation=None, exposure_ev=0.0, tone="clip")
    cut = SRGB.decoded(shown(bright, clipped).signal)
    np.testing.assert_allclose(cut, [1.0, 1.0, 0.3], atol=1e-4)


def test_the_default_is_the_srgb_picture_of_the_display_module(picture):
    adapted = picture @ looks.xyz_to_display(Look(), LAMP).T
    found = shown(picture, Look(), LAMP)
    np.testing.assert_array_equal(found.signal, srgb(adapted, exposure=found.exposure))
    assert found.signal.dtype == np.float32


def test_a_look_is_told_in_words():
    assert looks.in_words(Look(white="D50")) == "sRGB, cat02 from D50, shoulder"
    assert "not adapted" in looks.in_words(Look(adaptation=None))


# ----------------------------------------------------------------------------------------- words


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ({}, Look()),
        ({"display": "display-p3", "adapt": "cat16"}, Look(DISPLAY_P3, "cat16")),
        ({"display": "rec2020-pq", "exposure": "-1.5"}, Look(REC2020_PQ, exposure_ev=-1.5)),
        ({"adapt": "none", "tone": "clip"}, Look(adaptation=None, tone="clip")),
        ({"white": "D50", "exposure": "+2", "degree": 0.9}, Look(SRGB, "cat02", 0.9, "D50", 2.0)),
        ({"white": ".3127,.3290"}, Look(white=".3127,.3290")),
    ],
)
def test_words_make_a_look(words, expected):
    assert parse(**words) == expected


def test_a_csv_of_measurements_is_a_display(tmp_path):
    path = screen.write(tmp_path / "panel.csv", screen.table(levels=9, mixed=0))
    look = parse(display=str(path))
    assert look.display.name == "panel"
    assert look.display.white_cd_m2 == pytest.approx(screen.WHITE_CD_M2)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"display": "adobe"}, "'adobe'.*srgb, display-p3, rec2020-pq"),
        ({"display": "none.csv"}, "none.csv: no such file"),
        ({"adapt": "bradford"}, "'bradford'.*cat02, cat16, none"),
        ({"tone": "aces"}, "'aces'.*shoulder, clip"),
        ({"white": "D93"}, "'D93'.*map, A"),
        ({"white": "0.9,0.9"}, "chromaticity 0.9,0.9"),
        ({"white": "D65", "adapt": "none"}, "D65 with no adaptation"),
        ({"exposure": "bright"}, "'bright'.*auto, or EV"),
        ({"exposure": "nan"}, "auto, or EV"),
        ({"exposure": "1e9"}, "auto, or EV"),
        ({"degree": 1.5}, "1.5.*0 to 1"),
        ({"degree": float("nan")}, "0 to 1"),
    ],
)
def test_other_words_are_named(words, said):
    with pytest.raises(InputError, match=said) as raised:
        parse(**words)
    assert len(raised.value.problems) == 1


def test_all_wrong_words_are_said_at_once():
    with pytest.raises(InputError) as raised:
        parse("adobe", "bradford", "D93", "bright", "aces", 2.0)
    assert len(raised.value.problems) == 6


def test_a_scene_without_a_white_is_not_guessed(picture):
    with pytest.raises(InputError, match="white of the scene"):
        shown(picture, Look())
    with pytest.raises(InputError, match="adapting white"):
        shown(picture, Look(), np.zeros(3))
