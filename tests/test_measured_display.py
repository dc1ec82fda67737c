"""A measured display: a screen of known numbers comes back, and bad measurements are named."""

import measured_screen as screen
import numpy as np
import pytest

from calibration import measured_display
from calibration.display import auto_exposure, show
from calibration.errors import InputError


@pytest.fixture(scope="module")
def found():
    return measured_display.characterise(measured_display.check(screen.table()))


def test_a_screen_that_is_additive_comes_back(found):
    # what is left is PCHIP between 18 levels of a gamma of 2.4: Day et al. report .2 to .4
    assert found.fitted.max < 0.02
    assert found.left_out.mean < 0.05
    assert found.left_out.max < 0.2
    assert (found.fitted.count, found.left_out.count) == (69, 40)
    assert found.display.white_cd_m2 == pytest.approx(screen.WHITE_CD_M2)
    np.testing.assert_allclose(found.display.black * 120, screen.BLACK, rtol=1e-3)
    np.testing.assert_allclose(
        found.display.primaries, [[0.68, 0.32], [0.265, 0.69], [0.15, 0.06]], atol=1e-4
    )


def test_the_inverse_sends_what_shows_the_colour(found):
    drive = np.random.default_rng(5).uniform(0.15, 0.95, (200, 3))
    sent = found.display.signal(screen.xyz(drive) / screen.WHITE_CD_M2)
    assert np.abs(sent - drive).max() < 1 / 255  # one 8-bit step, between the levels measured
    assert found.inverse.mean < 0.05


def test_black_is_subtracted_or_darks_would_come_out_wrong(found):
    dark = np.array([0.1, 0.12, 0.15])
    without = np.clip((screen.xyz(dark) / screen.WHITE_CD_M2) @ found.display.rgb_from_xyz.T, 0, 1)
    wrong = found.display.encoded(without)
    assert np.abs(wrong - dark).max() > 4 / 255
    right = found.display.signal(screen.xyz(dark) / screen.WHITE_CD_M2)
    np.testing.assert_allclose(right, dark, atol=0.003)


def test_pictures_are_shown_on_it_as_on_any_display(found):
    display = found.display
    greys = np.linspace(0.05, 0.6, 12)[:, None] * display.white
    seen = display.xyz(show(greys, display))
    np.testing.assert_allclose(seen, greys, atol=5e-4)
    sent = show(np.random.default_rng(1).normal(0, 3, (200, 3)), display)
    assert sent.min() >= 0
    assert sent.max() <= 1
    assert auto_exposure(greys, display=display) > 0


def test_dark_colours_out_of_gamut_keep_luminance_black_included(found):
    violet = np.array([0.09, 0.05, 0.5])
    assert found.display.linear(violet).min() < 0
    seen = found.display.xyz(show(violet, found.display).astype(float))
    assert seen[1] == pytest.approx(0.05, abs=3e-4)  # black is .0023 of it


def test_noise_of_an_instrument_stays_noise():
    table = screen.table()
    rng = np.random.default_rng(7)
    table[:, 3:] *= 1 + 0.002 * rng.standard_normal((len(table), 3))
    found = measured_display.characterise(measured_display.check(table))
    assert found.fitted.mean < 0.35
    assert found.left_out.mean < 0.35


def test_channels_that_do_not_quite_add_up_are_fitted_for_the_eye():
    table = screen.table()
    lit = np.count_nonzero(table[:, :3], axis=1)
    table[lit > 1, 3:] *= 0.97  # the supply sags
    samples = measured_display.check(table)
    found = measured_display.characterise(samples)
    # .69 at most and .64 with the primaries as they were read
    assert 0.1 < found.fitted.max < 0.5
    assert found.left_out.mean < 0.5


def test_without_mixed_colours_there_is_nothing_left_out():
    found = measured_display.characterise(measured_display.check(screen.table(mixed=0)))
    assert found.left_out.count == 0
    assert np.isnan(found.left_out.mean)


def test_any_full_scale_and_unit_give_the_same_display(found):
    table = screen.table()
    table[:, :3] /= 255
    table[:, 3:] *= 100 / screen.WHITE_CD_M2
    other = measured_display.characterise(measured_display.check(table)).display
    np.testing.assert_allclose(other.xyz_from_rgb, found.display.xyz_from_rgb, rtol=1e-6)


def test_a_csv_is_read_in_any_order_of_columns_and_named(tmp_path):
    rows = screen.table(levels=9, mixed=5)
    path = screen.write(tmp_path / "panel.csv", rows[:, [3, 4, 5, 0, 1, 2]], "X,Y,Z,R,G,B")
    loaded = measured_display.load(path)
    assert loaded.display.name == "panel"
    assert loaded.left_out.count == 5


def spoilt(change):
    table = screen.table(levels=9, mixed=0)
    return change(table)


def _without(which):
    return lambda t: t[~which(t)]


def _dip(t):
    t[(t[:, 1] == 159) & (t[:, 0] == 0), 3:] *= 0.2
    return t


def _swap(t):
    return t[:, [0, 1, 2, 4, 3, 5]]


def _xyy(t):
    total = t[:, 3:].sum(axis=1, keepdims=True)
    return np.concatenate([t[:, :3], t[:, 3:5] / total, t[:, 4:5]], axis=1)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_without(lambda t: (t[:, :3] == 0).all(axis=1)), "black"),
        (_without(lambda t: (t[:, :3] == 255).all(axis=1)), "white"),
        (_without(lambda t: (t[:, 0] > 0) & (t[:, 1:3] == 0).all(axis=1)), "ramp of red"),
        (_without(lambda t: (t[:, 2] == 255) & (t[:, :2] == 0).all(axis=1)), "blue alone"),
        (_dip, "green at 159"),
        (lambda t: t * [1, 1, 1, 1, -1, 1], "negative"),
        (lambda t: t[:, [0, 1, 2, 5, 3, 4]] * [1, 1, 1, 3, 1, 1], "chromaticity"),
        (_xyy, "x,y,Y|chromaticity"),
        (lambda t: t * [0, 0, 0, 1, 1, 1], "no drive"),
        (lambda t: t * [1, 1, 1, np.nan, 1, 1], "finite"),
    ],
)
def test_bad_measurements_are_named(change, said):
    with pytest.raises(InputError, match=said):
        measured_display.check(spoilt(change))


def test_everything_wrong_is_said_at_once():
    table = screen.table(levels=9, mixed=0)
    few = table[(table[:, :3] != 0).any(axis=1) & (table[:, :3] != 255).any(axis=1)]
    with pytest.raises(InputError) as raised:
        measured_display.check(few)
    assert len(raised.value.problems) >= 2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "empty file"),
        ("R,G,B,x,y,Y\n0,0,0,1,1,1\n", "X, Z"),
        ("R,G,B,X,Y,Z\n0,0,0,1,dark,1\n", "line 2, column 'Y'"),
        ("R,G,B,X,Y,Z\n", "no measurements"),
        ("R,G,B,X,Y,Z\n0,0,0,1\n", "empty cell"),
    ],
)
def test_a_bad_file_is_named(tmp_path, text, said):
    path = tmp_path / "screen.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=said) as raised:
        measured_display.read(path)
    assert "screen.csv" in str(raised.value)
    with pytest.raises(InputError, match="no such file"):
        measured_display.read(tmp_path / "none.csv")
