"""`sixlight primaries fit` from files: what is made of them, and what is refused."""

import numpy as np
import pytest

from calibration import primaries, sets
from calibration.spectra import WAVELENGTHS, Spectra, write_spectra


@pytest.fixture
def files(tmp_path):
    """Six lights and eight surfaces, as CSV files."""
    lights = sets.lights("darling2011").only(["A", "D50", "D65", "F2", "F8", "F11"])
    write_spectra(tmp_path / "lights.csv", lights)
    write_spectra(tmp_path / "surfaces.csv", sets.surfaces("colorchecker24").only("12345678"))
    return tmp_path


def fit(sixlight, files, *options):
    return sixlight(
        "primaries", "fit", "--lights", files / "lights.csv",
        "--surfaces", files / "surfaces.csv", "-o", files / "mine", *options,
    )  # fmt: skip


def test_a_set_is_made_for_the_users_lights_and_surfaces(sixlight, files):
    outcome = fit(sixlight, files, "--channels", "4", "--starts", "2")
    assert outcome.status == 0, outcome.err
    mine = primaries.load(files / "mine")
    assert mine.channels == ("P1", "P2", "P3", "P4")
    assert "mine/curves.csv" in outcome.out


def spoil(path, name, change):
    """A column of a file made anew by `change` from all of them."""
    from calibration.spectra import read_spectra

    spectra = read_spectra(path)
    values = spectra.values.copy()
    values[:, spectra.names.index(name)] = change(values)
    write_spectra(path, Spectra(spectra.wavelengths, spectra.names, values))


@pytest.mark.parametrize(
    ("file", "name", "change", "says"),
    [
        ("lights.csv", "D65", lambda v: 7.0 * v[:, 1], "light 'D65' is 'D50' again"),
        ("surfaces.csv", "3", lambda v: v[:, 0], "surface '3' is '1' again"),
        ("lights.csv", "F2", lambda v: 1.0 + 0.0 * v[:, 0], "'F2' is 1 at every wavelength"),
        ("surfaces.csv", "3", lambda v: 0.5 + 0.0 * v[:, 0], "'3' is 0.5 at every wavelength"),
        ("lights.csv", "F2", lambda v: -v[:, 3], "column 'F2': -"),
        ("surfaces.csv", "3", lambda v: 100.0 * v[:, 2], "looks like percent"),
        ("lights.csv", "F2", lambda v: 1.0 * (WAVELENGTHS == 590), "'F2' has nothing from 430"),
    ],
    ids=["same light", "same surface", "flat light", "flat surface", "negative", "percent", "line"],
)
def test_spectra_that_tell_nothing_are_refused_by_name(sixlight, files, file, name, change, says):
    spoil(files / file, name, change)
    outcome = fit(sixlight, files)
    assert outcome.status == 2
    (line,) = outcome.err.splitlines()
    assert line.startswith(f"{files / file}: ")
    assert says in line
    assert not (files / "mine").exists()


def test_too_few_colours_are_refused(sixlight, files):
    write_spectra(files / "surfaces.csv", sets.surfaces("colorchecker24").only("12"))
    outcome = fit(sixlight, files)
    assert outcome.status == 2
    assert "6 lights x 2 surfaces are 12 colours (expected 30 or more" in outcome.err


def test_what_is_made_does_not_depend_on_the_lights_scale(sixlight, files):
    made = []
    for scale in (1.0, 1e4):
        lights = sets.lights("darling2011").only(["A", "D50", "D65", "F2", "F8", "F11"])
        scaled = Spectra(lights.wavelengths, lights.names, scale * lights.values)
        write_spectra(files / "lights.csv", scaled)
        options = ("--channels", "3", "--kind", "gaussian", "--starts", "1", "--force")
        assert fit(sixlight, files, *options).status == 0
        made.append(primaries.load(files / "mine").peaks_nm)
    np.testing.assert_allclose(*made, atol=0.01)
