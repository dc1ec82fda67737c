import numpy as np
import pytest

from calibration import primaries, sets
from calibration.errors import InputError
from calibration.primaries import Primaries, gaussians, load, write
from calibration.spectra import WAVELENGTHS


@pytest.fixture
def darling():
    return load("darling2011")


@pytest.fixture
def folder(tmp_path, darling):
    write(darling, tmp_path / "mine")
    return tmp_path / "mine"


def test_the_default_is_the_signed_set_of_six():
    assert load().name == "signed6"
    assert load().digest == load("signed6").digest


def test_the_papers_primaries_are_its_gaussians(darling):
    assert darling.channels == ("P1", "P2", "P3", "P4", "P5", "P6")
    peaks, widths = [447.0, 481.5, 519.6, 543.1, 572.9, 622.4], [16.9, 4.3, 7.8, 9.4, 15.5, 18.0]
    for curve, peak, width in zip(darling.curves.T, peaks, widths, strict=True):
        shape = np.exp(-((WAVELENGTHS - peak) ** 2) / (2 * width**2))
        np.testing.assert_allclose(curve, shape / shape.sum(), atol=1e-8)
    np.testing.assert_allclose(darling.peaks_nm, peaks, atol=0.01)
    np.testing.assert_allclose(darling.widths_nm, widths, atol=0.01)


@pytest.mark.parametrize("name", primaries.NAMES)
def test_a_perfect_reflector_is_one_in_every_channel(name):
    np.testing.assert_allclose(load(name).project(np.ones(36)), 1.0, atol=1e-7)


@pytest.mark.parametrize("name", primaries.NAMES)
def test_equal_energy_light_of_unit_radiance_has_unit_luminance(name):
    xyz = load(name).xyz_from_primaries @ np.ones(load(name).curves.shape[1])
    assert xyz[1] == pytest.approx(1.0, abs=1e-5)
    np.testing.assert_allclose(xyz, sets.xyz(np.ones(36)), atol=6e-3)


def test_projection_averages_along_the_last_axis(darling):
    spectra = np.random.default_rng(1).random((2, 5, 36))
    expected = sum(spectra[..., i, None] * darling.curves[i] for i in range(36))
    np.testing.assert_allclose(darling.project(spectra), expected)


def test_a_written_set_comes_back_the_same(folder, darling):
    back = load(folder)
    assert back.name == "mine"
    assert back.digest == darling.digest
    assert back.trained_on == darling.trained_on
    np.testing.assert_array_equal(back.curves, darling.curves)
    np.testing.assert_array_equal(back.xyz_from_primaries, darling.xyz_from_primaries)


def test_the_digest_tells_sets_apart(darling):
    other = Primaries("x", darling.curves, darling.xyz_from_primaries * (1 + 1e-6))
    assert other.digest != darling.digest


def test_any_number_of_primaries_is_a_set(tmp_path):
    curves = gaussians(np.linspace(430, 650, 8), 15.0)
    write(Primaries("eight", curves, np.full((3, 8), 1 / 8)), tmp_path / "eight")
    assert load(tmp_path / "eight").channels[-1] == "P8"


def change(folder, name, old, new):
    path = folder / name
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path


@pytest.mark.parametrize(
    ("name", "old", "new", "says"),
    [
        ("curves.csv", "P2", "blue", "columns P1, blue"),
        ("curves.csv", "380,", "381,", "other wavelengths"),
        ("curves.csv", "0.000799531", "0.1", "P1 sums to 1.0992"),
        ("xyz_from_primaries.csv", "Y,", "L,", "rows X, L, Z"),
        ("xyz_from_primaries.csv", "P6", "P7", "P5, P7"),
        ("xyz_from_primaries.csv", "0.385941", "?", "could not convert"),
        ("xyz_from_primaries.csv", "0.385941", "nan", "gaps or NaN"),
        ("xyz_from_primaries.csv", "0.385941", "38.5941", "gets Y = 39.2"),
    ],
)
def test_a_faulty_set_is_refused(folder, name, old, new, says):
    path = change(folder, name, old, new)
    with pytest.raises(InputError, match="; ") as caught:
        load(folder)
    assert str(caught.value).startswith(f"{path}: ")
    assert says in str(caught.value)


def test_peaks_out_of_order_are_refused(tmp_path, darling):
    turned = Primaries("x", darling.curves[:, ::-1], darling.xyz_from_primaries[:, ::-1])
    write(turned, tmp_path / "x")
    with pytest.raises(InputError, match="ascending peaks"):
        load(tmp_path / "x")


def test_an_unknown_set_lists_the_known_ones(tmp_path):
    with pytest.raises(InputError, match="darling2011"):
        load(tmp_path / "none")


@pytest.mark.parametrize("name", ["curves.csv", "xyz_from_primaries.csv"])
def test_a_missing_file_of_a_set_is_named(folder, name):
    (folder / name).unlink()
    with pytest.raises(InputError, match=f"{name}: no such file"):
        load(folder)
