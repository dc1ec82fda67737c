import re

import numpy as np
import pytest

from calibration.errors import InputError
from calibration.spectra import (
    WAVELENGTHS,
    Spectra,
    join,
    read_spectra,
    resample,
    write_spectra,
)


def csv(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "lamp.csv"
    path.write_bytes(text.encode(encoding))
    return path


def refused(path, kind="any"):
    """The problems of a file, each as its one line, which must name the file."""
    with pytest.raises(InputError) as caught:
        read_spectra(path, kind)
    lines = str(caught.value).splitlines()
    assert all(line.startswith(f"{path}: ") for line in lines)
    return lines


def test_a_written_file_comes_back_to_the_last_bit(tmp_path):
    values = np.random.default_rng(1).normal(size=(5, 2)) * [1e-9, 1e3]
    spectra = Spectra(np.array([400.0, 410.5, 500.0, 633.25, 700.0]), ("a, b", "ü"), values)
    write_spectra(tmp_path / "s.csv", spectra)
    back = read_spectra(tmp_path / "s.csv")
    assert back.names == spectra.names
    np.testing.assert_array_equal(back.wavelengths, spectra.wavelengths)
    np.testing.assert_array_equal(back.values, values)


def test_a_spreadsheets_byte_order_mark_and_blank_lines_are_read_over(tmp_path):
    path = csv(tmp_path, "wavelength_nm,a\r\n400, 1\r\n\r\n500,2\r\n\r\n", "utf-8-sig")
    np.testing.assert_array_equal(read_spectra(path)["a"], [1.0, 2.0])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "the file is empty"),
        ("nm,a\n400,1\n500,2\n", "the first column is 'nm'"),
        ("wavelength_nm;a\n400;1\n500;2\n", "columns separated by commas"),
        ("wavelength_nm\n400\n500\n", "no spectrum beside wavelength_nm"),
        ("wavelength_nm,a,\n400,1,2\n500,2,3\n", "line 1, column 3: no name"),
        ("wavelength_nm,a,a\n400,1,2\n500,2,3\n", "line 1, column 3: 'a' again"),
        ("wavelength_nm,a\n400,1\n", "1 rows of values"),
        ("wavelength_nm,a\n400,1\n500,\n600,1\n", "line 3, column 'a': empty"),
        ("wavelength_nm,a\n400,1\n500\n600,1\n", "line 3: 1 cells"),
        ("wavelength_nm,a\n400,1\n500,nan\n", "line 3, column 'a': 'nan'"),
        ("wavelength_nm,a\n400,1\n500,inf\n", "line 3, column 'a': 'inf'"),
        ("wavelength_nm,a\n400,1\n500,n/a\n", "line 3, column 'a': 'n/a'"),
        ("wavelength_nm,a\n0.4,1\n0.5,1\n0.7,1\n", "look like micrometres"),
        ("wavelength_nm,a\n400,1\n500,1\n500,2\n", "line 4, column 'wavelength_nm': 500 nm again"),
        ("wavelength_nm,a\n400,1\n600,1\n500,2\n", "500 nm after 600 nm"),
        ("wavelength_nm,a\n-400,1\n600,1\n", "a wavelength of -400"),
    ],
)
def test_a_faulty_file_is_refused_with_file_and_cell_named(tmp_path, text, says):
    lines = refused(csv(tmp_path, text))
    assert len(lines) == 1
    assert says in lines[0]


@pytest.mark.parametrize(
    ("kind", "text", "says"),
    [
        ("fraction", "wavelength_nm,a,b\n400,1,9\n700,1,92.5\n", "line 3, column 'b': 92.5 looks"),
        ("fraction", "wavelength_nm,a\n400,0.5\n700,-0.2\n", "line 3, column 'a': -0.2"),
        ("fraction", "wavelength_nm,a\n400,0.5\n700,5000\n", "is above 1"),
        ("power", "wavelength_nm,a\n400,1\n700,-1\n", "no negative values"),
        ("power", "wavelength_nm,a,b\n400,1,0\n700,1,0\n", "column 'b': nothing but 0"),
    ],
)
def test_values_of_a_kind_that_cannot_be_are_refused(tmp_path, kind, text, says):
    lines = refused(csv(tmp_path, text), kind)
    assert len(lines) == 1
    assert says in lines[0]
    read_spectra(tmp_path / "lamp.csv", "any")  # as numbers they are in order


def test_a_fluorescing_patch_and_a_noisy_dark_reading_are_let_in(tmp_path):
    read_spectra(csv(tmp_path, "wavelength_nm,a\n400,1.1\n700,-0.005\n"), "fraction")
    read_spectra(csv(tmp_path, "wavelength_nm,a\n400,5e-3\n700,-1e-5\n"), "power")


def test_a_missing_file_is_refused(tmp_path):
    assert "no such file" in refused(tmp_path / "lamp.csv")[0]


def test_a_file_that_is_not_utf8_is_refused(tmp_path):
    assert "not UTF-8" in refused(csv(tmp_path, "wavelength_nm,grün\n400,1\n", "latin-1"))[0]


def test_all_bad_cells_are_named_at_once_but_not_without_end(tmp_path):
    rows = "".join(f"{400 + i},x\n" for i in range(30))
    lines = refused(csv(tmp_path, "wavelength_nm,a\n" + rows))
    assert len(lines) == 11
    assert "20 more such cells" in lines[-1]
    assert [re.search(r"line (\d+)", line)[1] for line in lines[:3]] == ["2", "3", "4"]


def test_data_on_the_grid_come_out_as_they_are():
    values = np.random.default_rng(2).random((36, 3))
    np.testing.assert_allclose(resample(WAVELENGTHS, values), values, rtol=1e-12)


@pytest.mark.parametrize("step", [1.0, 2.0, 4.0, 5.0, 10.0])
def test_a_straight_spectrum_stays_straight(step):
    wavelengths = np.arange(360.0, 761.0, step)
    values = 3.0 + 0.01 * wavelengths[:, None]
    np.testing.assert_allclose(resample(wavelengths, values)[:, 0], 3.0 + 0.01 * WAVELENGTHS)


@pytest.mark.parametrize("step", [20.0, 25.0, 50.0])
def test_wide_steps_are_interpolated(step):
    """A roof, which is known from its corners, comes out where it has no bend within a band."""
    wavelengths = np.arange(350.0, 801.0, step)
    values = np.abs(wavelengths - 550.0)
    got = resample(wavelengths, values[:, None])[:, 0]
    away = np.abs(WAVELENGTHS - 550.0) >= 10.0
    np.testing.assert_allclose(got[away], np.abs(WAVELENGTHS - 550.0)[away], atol=1e-9)


@pytest.mark.parametrize("line_nm", [436, 546, 550, 577, 611])
def test_a_lamps_line_keeps_its_power_and_its_place(line_nm):
    wavelengths = np.arange(380.0, 781.0)
    values = np.where(wavelengths == line_nm, 7.0, 0.0)
    band = resample(wavelengths, values[:, None])[:, 0]
    assert band.sum() * 10.0 == pytest.approx(7.0)
    assert band @ WAVELENGTHS / band.sum() == pytest.approx(line_nm)


def test_missing_ends_keep_the_nearest_value():
    wavelengths = np.arange(400.0, 701.0, 5.0)
    values = np.linspace(2.0, 5.0, len(wavelengths))[:, None]
    got = resample(wavelengths, values)[:, 0]
    np.testing.assert_allclose(got[:2], 2.0)
    np.testing.assert_allclose(got[-3:], 5.0)


@pytest.mark.parametrize(("low", "high"), [(410.0, 730.0), (380.0, 690.0)])
def test_too_little_of_the_spectrum_is_refused(low, high):
    with pytest.raises(InputError, match="at least 400 to 700 nm"):
        resample(np.array([low, high]), np.ones((2, 1)))


def test_spectra_are_found_by_name():
    both = join([Spectra(WAVELENGTHS, (n,), np.full((36, 1), v)) for n, v in (("a", 1), ("b", 2))])
    assert both["b"][0] == 2
    assert both.only(["b", "a"]).values[0].tolist() == [2, 1]
