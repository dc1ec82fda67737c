import numpy as np
import pytest

from calibration import chart
from calibration.errors import InputError
from calibration.spectra import WAVELENGTHS, Spectra, write_spectra
from pipeline.fitting import session

NAMES = tuple(str(i) for i in range(1, 25))
ROWS = [f"{i},{10 * i},0,{10 * i + 8},8" for i in range(1, 25)]  # of boxes


@pytest.fixture
def folder(tmp_path):
    """Two lights, two filters; the raw files are not opened, so they are empty."""
    for light in ("A", "D65"):
        for name in ("yellow", "cyan"):
            (tmp_path / light / name).mkdir(parents=True)
            for shot in ("2.dng", "1.dng", "notes.txt", ".hidden"):
                (tmp_path / light / name / shot).touch()
        radiance = Spectra(WAVELENGTHS, NAMES, np.full((36, 24), 0.02))
        write_spectra(tmp_path / light / "radiance.csv", radiance)
    (tmp_path / "notes").mkdir()
    return tmp_path


def refused(folder):
    with pytest.raises(InputError) as caught:
        session.read_session(folder)
    return str(caught.value)


def test_a_folder_needs_no_settings(folder):
    got = session.read_session(folder)
    assert [light.name for light in got.lights] == ["A", "D65"]
    assert got.filters == ("cyan", "yellow")
    assert got.channels == ("cyan.R", "cyan.G", "cyan.B", "yellow.R", "yellow.G", "yellow.B")
    assert [p.name for p in got.lights[0].files["cyan"]] == ["1.dng", "2.dng"]
    assert got.lights[0].radiance.names == NAMES
    assert (got.patches, got.primaries, got.method) == (None, "signed6", "delta-e")


def test_settings_are_read(folder):
    (folder / "patch_boxes.csv").write_text("\n".join(["patch,x0,y0,x1,y1", *ROWS]))
    (folder / "calibration.toml").write_text(
        'chart = "colorchecker24"\npatches = "patch_boxes.csv"\nmethod = "pinv"\n'
        'primaries = "mine"\n'
    )
    got = session.read_session(folder)
    assert got.method == "pinv"
    assert got.primaries == str(folder / "mine")
    assert got.patches.corners[2, 0].tolist() == [30.0, 0.0]


def test_no_such_folder_is_refused(tmp_path):
    assert "no such folder" in refused(tmp_path / "none")


def test_a_folder_without_lights_is_refused(tmp_path):
    (tmp_path / "cyan").mkdir()
    assert "no lights" in refused(tmp_path)


def test_everything_wrong_is_said_at_once(folder):
    (folder / "calibration.toml").write_text(
        'chart = "sg"\nmethod = "best"\npatches = "none.csv"\nlight = 1\n'
    )
    for shot in (folder / "A" / "cyan").iterdir():
        shot.unlink()
    (folder / "D65" / "radiance.csv").write_text("wavelength_nm,1\n400,1\n700,\n")
    said = refused(folder)
    for what in (
        "calibration.toml: chart is 'sg' (expected colorchecker24 or colorchecker-sg)",
        "method is 'best' (expected pinv or ridge or delta-e",
        "patches is 'none.csv', which is not there",
        "light is not known here",
        "line 3, column '1': empty",
    ):
        assert what in said
    assert len(said.splitlines()) == 5


def test_a_filter_missing_under_one_light_is_named(folder):
    for shot in (folder / "A" / "cyan").iterdir():
        shot.unlink()
    assert refused(folder).startswith(f"{folder / 'A'}: no photographs through cyan")


def test_patches_without_radiance_are_named(folder):
    few = Spectra(WAVELENGTHS, NAMES[:-1], np.ones((36, 23)))
    write_spectra(folder / "A" / "radiance.csv", few)
    assert "A/radiance.csv: no column for patch 24" in refused(folder)


def test_a_light_without_readings_or_photographs_is_named(folder):
    (folder / "A" / "radiance.csv").unlink()
    for name in ("cyan", "yellow"):
        for shot in (folder / "D65" / name).iterdir():
            shot.unlink()
    said = refused(folder)
    assert "A/radiance.csv: no such file" in said
    assert "D65: no photographs" in said


def test_settings_that_are_no_toml_are_refused(folder):
    (folder / "calibration.toml").write_text("chart =")
    assert "calibration.toml: not TOML" in refused(folder)


def test_a_white_is_apart_from_the_filters_and_whole_or_refused(folder):
    (folder / "A" / "white" / "cyan").mkdir(parents=True)
    (folder / "A" / "white" / "cyan" / "1.dng").touch()
    assert refused(folder).startswith(f"{folder / 'A' / 'white'}: no white through yellow")
    (folder / "A" / "white" / "yellow").mkdir()
    (folder / "A" / "white" / "yellow" / "1.dng").touch()
    got = session.read_session(folder)
    assert got.filters == ("cyan", "yellow")
    assert list(got.lights[0].white) == ["cyan", "yellow"]
    assert got.lights[1].white == {}


def test_an_sg_needs_no_places_but_readings_of_all_its_patches(folder):
    (folder / "calibration.toml").write_text('chart = "colorchecker-sg"\n')
    said = refused(folder)
    assert "no column for patch A1, B1, C1, D1, E1, F1 and 134 more, but 1, 2, 3" in said
    names = chart.CHARTS["colorchecker-sg"]
    for light in ("A", "D65"):
        radiance = Spectra(WAVELENGTHS, names, np.full((36, 140), 0.02))
        write_spectra(folder / light / "radiance.csv", radiance)
    got = session.read_session(folder)
    assert (got.chart, got.patches) == ("colorchecker-sg", None)


def test_a_chart_may_be_given_by_its_corners(folder):
    (folder / "calibration.toml").write_text(
        "corners = [[10, 10], [590.0, 10], [590, 390], [10, 390]]\n"
    )
    got = session.read_session(folder)
    assert got.patches.names == NAMES
    middles = got.patches.corners.mean(axis=1)
    # Six patches of .8 and five gaps of .2 in 580 px: a place is 100 px.
    np.testing.assert_allclose(middles[0], [50, 50], atol=1e-3)
    np.testing.assert_allclose(middles[23], [550, 350], atol=1e-3)


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ("corners = [[1, 2], [3, 4], [5, 6]]", "a list of 4 points [x, y] in px"),
        ("corners = [1, 2, 3, 4]", "a list of 4 points [x, y] in px"),
        ("corners = [[0, 0], [0, 9], [9, 9], [9, 0]]", "that do not go clockwise"),
        ('patches = "../boxes.csv"', "a path inside the capture's folder"),
    ],
)
def test_corners_and_patches_that_cannot_be_are_refused(folder, settings, says):
    (folder / "calibration.toml").write_text(settings)
    said = refused(folder)
    assert said.startswith(f"{folder / 'calibration.toml'}: ")
    assert says in said
    assert len(said.splitlines()) == 1


def test_corners_and_patches_are_not_both_given(folder):
    (folder / "boxes.csv").write_text("\n".join(["patch,x0,y0,x1,y1", *ROWS]))
    (folder / "calibration.toml").write_text(
        'patches = "boxes.csv"\ncorners = [[0, 0], [60, 0], [60, 40], [0, 40]]\n'
    )
    assert "corners is given beside patches" in refused(folder)
