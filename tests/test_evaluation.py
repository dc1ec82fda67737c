"""`sixlight evaluate` and `sixlight filters` from files."""

import json
import re

import numpy as np
import pytest

from calibration import evaluate as tables
from calibration import sets
from calibration.errors import InputError
from calibration.spectra import WAVELENGTHS, Spectra, write_spectra
from pipeline import evaluation


@pytest.fixture
def files(tmp_path):
    """Two surfaces, two lights, a camera and two filters, as CSV files."""
    camera, filters = tables.default_camera()
    write_spectra(tmp_path / "camera.csv", camera)
    write_spectra(tmp_path / "filters.csv", filters)
    write_spectra(tmp_path / "paints.csv", sets.surfaces("colorchecker24").only(["1", "14"]))
    write_spectra(tmp_path / "lamps.csv", sets.lights("darling2011").only(["A", "F11"]))
    return tmp_path


@pytest.mark.slow
def test_the_users_spectra_take_the_place_of_the_sets(files):
    rows = tables_of(files, "lamps.csv")
    assert {row["table"] for row in rows} == {1, 2, 3, 4}
    assert {row["surfaces"] for row in rows} == {"paints"}
    assert {row["lights"] for row in rows} == {"lamps"}
    assert {row["n"] for row in rows} == {4}
    assert all(row["paper"] is None for row in rows)  # it has nothing on these
    assert json.loads(json.dumps(rows)) == rows
    assert "| paints | FS-Both | Sharp RGB |" in evaluation.as_markdown(rows)


@pytest.mark.slow
def test_lights_count_alike_whatever_their_scale(files):
    lamps = sets.lights("darling2011").only(["A", "F11"])
    louder = Spectra(lamps.wavelengths, lamps.names, lamps.values * [1.0, 500.0])
    write_spectra(files / "louder.csv", louder)
    figures = [
        [row["mean"] for row in tables_of(files, name) if row["table"] == 1]
        for name in ("lamps.csv", "louder.csv")
    ]
    np.testing.assert_allclose(*figures, atol=2e-4)


def tables_of(files, lights):
    return evaluation.evaluate(given(files, lights))


def given(files, lights):
    return evaluation.read(
        surfaces=files / "paints.csv", lights=files / lights, primaries=["darling2011"]
    )


@pytest.mark.parametrize(
    ("option", "values", "message"),
    [
        ("surfaces", [20.0, 60.0], r"column 'x': 60 looks like percent"),
        ("surfaces", [0.5, 0.5], r"surface 'x' is 0.5 at every wavelength"),
        ("surfaces", [0.2, -0.4], r"column 'x': -0.4"),
        ("lights", [1.0, -1.0], r"column 'x': -1"),
        ("lights", [1.0, 1.0], r"light 'x' is 1 at every wavelength"),
    ],
)
def test_bad_spectra_are_named(tmp_path, option, values, message):
    path = tmp_path / "bad.csv"
    ramp = np.linspace(*values, 36)[:, None]
    write_spectra(path, Spectra(WAVELENGTHS, ("x",), ramp))
    with pytest.raises(InputError, match=r"bad\.csv: .*" + message):
        evaluation.read(**{option: path})


def test_micrometres_and_duplicates_are_named(tmp_path):
    ramp = np.linspace(0.2, 0.5, 36)
    write_spectra(tmp_path / "um.csv", Spectra(WAVELENGTHS / 1000.0, ("x",), ramp[:, None]))
    with pytest.raises(InputError, match="micrometres"):
        evaluation.read(surfaces=tmp_path / "um.csv")
    twice = Spectra(WAVELENGTHS, ("x", "y"), np.stack([ramp, 3.0 * ramp], axis=1))
    write_spectra(tmp_path / "twice.csv", twice)
    with pytest.raises(InputError, match=r"twice\.csv: light 'y' is 'x' again"):
        evaluation.read(lights=tmp_path / "twice.csv")


@pytest.mark.slow
def test_a_single_light_is_enough_to_evaluate_but_not_to_leave_out(files):
    write_spectra(files / "lamp.csv", sets.lights("darling2011").only(["F11"]))
    assert {row["n"] for row in tables_of(files, "lamp.csv")} == {2}
    with pytest.raises(InputError, match=r"a single light .*two or more"):
        evaluation.rank_filters(
            files / "camera.csv", [files / "filters.csv"], count=1, lights=files / "lamp.csv"
        )


def test_a_camera_needs_its_filters(files):
    with pytest.raises(InputError, match="only --camera"):
        evaluation.read(camera=files / "camera.csv")
    with pytest.raises(InputError, match=r"filters\.csv: the curves cyan, yellow"):
        evaluation.read(camera=files / "filters.csv", filters=files / "filters.csv")


def test_filters_are_ranked_from_files(files):
    rows = evaluation.rank_filters(
        files / "camera.csv",
        [files / "filters.csv"],
        count=2,
        lights=None,
        beside=[("cyan", "yellow")],
    )
    assert [row["rank"] for row in rows[:3]] == [1, 2, 3]
    assert rows[-1]["filters"] == ("cyan", "yellow")
    text = evaluation.ranking_as_markdown(rows)
    assert re.search(r"^\| 1 \| \w.* \+ .* \| \d\.\d\d \|", text, re.M)


def test_names_that_two_files_share_get_the_files_before_them(files):
    rows = evaluation.rank_filters(
        files / "camera.csv",
        [files / "filters.csv", _copy(files / "filters.csv", "other.csv")],
        count=1,
        best=9,
    )
    assert {row["filters"][0] for row in rows} == {
        "filters cyan", "filters yellow", "other cyan", "other yellow", "no filter",
    }  # fmt: skip


def _copy(path, name):
    copy = path.with_name(name)
    copy.write_text(path.read_text())
    return copy


@pytest.mark.slow
def test_heat_maps_are_drawn(files):
    pytest.importorskip("matplotlib", reason="the extra `report` is not installed")
    made = evaluation.heat_maps(files / "pictures", given(files, "lamps.csv"))
    assert [path.name for path in made] == list(evaluation.PICTURES)
    for path in made:
        assert path.read_bytes().startswith(b"\x89PNG")
    assert not list((files / "pictures").glob(".*"))
