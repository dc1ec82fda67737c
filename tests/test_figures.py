import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.figures import __main__ as command
from benchmarks.figures import errors, page
from benchmarks.figures.setting import WAYS, Setting, upright
from benchmarks.figures.sheet import WIDTH, Sheet, columns
from calibration import primaries, sets
from pipeline import io
from stages.prefilter import mean

DOCS = Path(__file__).parent.parent / "docs"
MOST_BYTES = 6_000_000


def setting(spectrum) -> Setting:
    """The same light from everywhere, captured without error."""
    light_in = primaries.load()
    world = np.broadcast_to(np.float32(spectrum), (6, 8, 8, 36))
    return Setting(Path("nowhere"), light_in.project(world).astype(np.float32), light_in, world)


def test_the_page_says_what_was_measured_when_its_pictures_were_drawn():
    measured = page.read(DOCS / "images" / page.MEASURED)
    assert set(measured) == set(page.TITLES)
    assert page.written(measured) == (DOCS / "figures.md").read_text()


def test_the_pages_pictures_are_there_and_not_too_large():
    shown = re.findall(r"\]\((images/[^)]+)\)", (DOCS / "figures.md").read_text())
    assert len(shown) == len(page.TITLES)
    for name in shown:
        assert io.read_exr(DOCS / name)[0].shape[1] <= WIDTH, name
    assert sum(path.stat().st_size for path in (DOCS / "images").iterdir()) < MOST_BYTES


def test_a_page_without_mitsuba_says_what_is_left_out():
    measured = page.read(DOCS / "images" / page.MEASURED)
    del measured["errors"]
    assert "Left out: Mitsuba" in page.written(measured)
    assert page.file_of("errors") not in page.written(measured)


def test_a_picture_keeps_its_pixels_on_a_sheet():
    picture = np.random.default_rng(1).random((5, 7, 3)).astype(np.float32)
    sheet = Sheet(40, 60)
    sheet.picture(picture, 11, 23)
    whole = sheet.signal()
    assert whole.shape == (40, 60, 3)
    np.testing.assert_array_equal(whole[23:28, 11:18], picture)
    whole[23:28, 11:18] = 1
    assert (whole == 1).all()


@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_columns_lie_beside_one_another_within_the_sheet(count):
    lefts, wide = columns(count)
    assert (np.diff(lefts) > wide).all()
    assert lefts[-1] + wide <= WIDTH


def test_errors_above_the_scale_look_as_its_end_and_no_thing_is_grey():
    off = np.array([[0.0, errors.HIGHEST, 2 * errors.HIGHEST, np.nan, 1.0]])
    colours = errors.coloured(off, np.array([[True, True, True, True, False]]))[0]
    np.testing.assert_array_equal(colours[1], colours[2])
    assert colours[0].max() < 0.1 < colours[1].min()  # black to nearly white
    for grey in colours[3:]:
        assert np.ptp(grey) < 0.01


def test_three_channels_are_right_in_daylight_and_six_everywhere():
    patches = sets.surfaces("colorchecker24").values.T
    for name, right in (("D65", {"six", "sharp", "xyz"}), ("A", {"six"})):
        here = setting(sets.lights("darling2011")[name])
        captured, true = here.falling(upright([0.0, 120.0]))
        for way in WAYS:
            off = [
                here.apart(here.matt(way, captured, patch), sets.xyz(true * patch)).mean()
                for patch in patches
            ]
            # Six channels are themselves off by some .3 in these lights.
            assert (np.mean(off) < 0.4) == (way in right), (name, way)


def test_what_falls_on_a_surface_in_even_light_is_that_light():
    spectrum = np.asarray(sets.lights("darling2011")["F11"])
    captured, true = setting(spectrum).falling(upright([-70.0, 10.0], 20.0))
    np.testing.assert_allclose(true, [spectrum, spectrum], rtol=1e-5)
    expected = mean(setting(spectrum).light)
    np.testing.assert_allclose(captured, [expected, expected], rtol=1e-5)


def test_a_figure_is_drawn_with_what_was_measured_for_it(tmp_path):
    command.draw(setting(np.ones(36)), tmp_path / "docs", ["primaries"])
    images = tmp_path / "docs" / "images"
    assert set(page.read(images / page.MEASURED)) == {"primaries"}
    assert page.file_of("primaries") in (tmp_path / "docs" / "figures.md").read_text()
    assert io.read_exr(images / page.file_of("primaries"))[0].shape[1] == WIDTH


def test_a_missing_map_is_named(tmp_path, monkeypatch, capsys):
    nowhere = tmp_path / "nowhere"
    monkeypatch.setattr("sys.argv", ["figures", str(nowhere), "-o", str(tmp_path / "docs")])
    assert command.main() == 2
    assert str(nowhere) in capsys.readouterr().err
    assert not (tmp_path / "docs").exists()
