"""What `sixlight display` tells of a screen, and that it warns where it should."""

import json
import re

import measured_screen as screen
import numpy as np
import pytest

from pipeline import display_report


def report(tmp_path, table):
    return display_report.report(screen.write(tmp_path / "panel.csv", table))


def test_a_good_screen_is_told_as_it_is(tmp_path):
    told = report(tmp_path, screen.table())
    assert told["white_luminance"] == pytest.approx(screen.WHITE_CD_M2)
    assert told["contrast"] == pytest.approx(screen.WHITE_CD_M2 / screen.BLACK[1])
    assert told["full_drive"] == 255
    np.testing.assert_allclose(told["channels"]["red"]["xy"], [0.68, 0.32], atol=1e-4)
    assert [c["levels"] for c in told["channels"].values()] == [18, 18, 18]
    light = screen.curve(np.full(3, 0.5)) / screen.curve(np.ones(3))
    gammas = [c["gamma"] for c in told["channels"].values()]
    np.testing.assert_allclose(gammas, np.log(light) / np.log(0.5), atol=0.01)
    assert told["additivity"] == pytest.approx(1.0)
    assert told["delta_e_2000"]["left_out"]["count"] == 40
    assert told["distrust"] == []


def test_the_worst_colour_is_told_in_the_files_own_drives(tmp_path):
    table = screen.table(mixed=0)
    odd = [100, 150, 200]
    table = np.vstack([table, [*odd, *1.3 * screen.xyz(np.array(odd) / 255)]])
    told = report(tmp_path, table)
    np.testing.assert_allclose(told["delta_e_2000"]["left_out"]["worst"], odd)
    assert any("mixed colours are missed" in doubt for doubt in told["distrust"])


def _sagging(table):
    lit = np.count_nonzero(table[:, :3], axis=1)
    table[lit > 1, 3:] *= 0.85
    return table


def _milky(table):
    table[:, 3:] += 0.02 * screen.WHITE_CD_M2 * np.array([0.95, 1.0, 1.09])
    return table


def _drifting(table):
    table[:, 3:] *= np.linspace(0.75, 1.25, len(table))[:, None] ** [1, -0.2, -1]
    return table


def _coarse(table):
    """Of each channel's ramp and the greys every third level: 0, 45 .. 255."""
    return table[np.isin(table[:, :3], [0, 45, 90, 135, 180, 255]).all(axis=1)]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_coarse, "a ramp has 6 levels"),
        (lambda t: t[: len(t) - 40], "no mixed colour"),
        (_sagging, "the white has .* times the light"),
        (_milky, "darken the room"),
        (_drifting, "misses what it was made from"),
    ],
)
def test_what_is_to_be_distrusted_is_said(tmp_path, change, said):
    told = report(tmp_path, change(screen.table()))
    assert any(re.search(said, doubt) for doubt in told["distrust"]), told["distrust"]


def test_the_command_prints_it_for_people_and_for_machines(sixlight, tmp_path):
    path = screen.write(tmp_path / "panel.csv", screen.table(levels=9, mixed=0))
    text = sixlight("display", path)
    assert text.status == 0
    for words in ("white   120", "contrast 429 : 1", "none measured", "- no mixed colour"):
        assert words in text.out
    told = json.loads(sixlight("display", path, "--json").out)
    assert told["name"] == "panel"
    assert told["delta_e_2000"]["left_out"] == {"mean": None, "max": None, "count": 0, "worst": []}


def test_a_perfect_black_has_no_contrast_to_tell(tmp_path):
    table = screen.table(levels=9, mixed=5)
    table[:, 3:] -= screen.BLACK
    table[:, 3:] = np.maximum(table[:, 3:], 0.0)
    told = report(tmp_path, table)
    assert told["contrast"] is None
    assert "not measurable" in display_report.as_text(told)


def test_bad_measurements_are_named(sixlight, tmp_path):
    path = tmp_path / "panel.csv"
    path.write_text("R,G,B,x,y,Y\n0,0,0,1,1,1\n")
    done = sixlight("display", path)
    assert done.status == 2
    assert "panel.csv: the columns" in done.err
    assert sixlight("display", tmp_path / "none.csv").status == 2
