"""Spectral images in and out, against colour-science and against values known on paper."""

import warnings

import numpy as np
import pytest

from calibration import primaries, sets
from calibration.errors import InputError
from calibration.spectra import WAVELENGTHS
from pipeline import io, spectral
from pipeline.files import header, spectral_exr
from pipeline.files.spectral_exr import SpectralImage
from stages.fill import fill
from stages.prefilter import mean
from stages.types import Measured

PRIMARIES = primaries.load("darling2011")
SIZE = (4, 5)


@pytest.fixture(scope="module")
def colour():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return pytest.importorskip("colour")


def lights():
    """An image (4, 5, 36) of D65 and A in all mixtures."""
    paper = sets.lights("darling2011")
    amount = np.linspace(0, 1, 20).reshape(*SIZE, 1)
    return (amount * paper["D65"] + (1 - amount) * paper["A"]).astype(np.float32)


def write_plain(path, values, names):
    io.write_exr(path, values, names, {})
    return path


def write_light(path, values, name="cubemap", **more):
    """An image in primaries as sixlight writes one."""
    about = header.of_primaries(PRIMARIES, unit="W/(sr m2 nm)", quantity="light") | more
    valid = np.asarray(np.isfinite(values).all(axis=-1), np.float32)
    io.write_measured(
        path, Measured(values, np.full_like(values, 1e-4), valid), PRIMARIES.channels, about
    )
    return path


# ------------------------------------------------------------------------------------------- in


def test_spectra_on_the_common_grid_become_eq_1(tmp_path):
    names = [f"{w:g}nm" for w in WAVELENGTHS]
    source = write_plain(tmp_path / "in.exr", lights(), names)
    notes = spectral.to_primaries(source, tmp_path / "out.exr", PRIMARIES)
    measured, channels = io.read_measured(tmp_path / "out.exr")
    assert notes == ()
    assert channels == PRIMARIES.channels
    np.testing.assert_allclose(measured.values, PRIMARIES.project(lights()), rtol=1e-5)
    assert (measured.valid == 1).all()
    assert np.isnan(measured.variance).all()  # not known, and so
    _, written, about = io.read_exr(tmp_path / "out.exr")
    assert written == [*channels, "valid"]
    assert header.primaries_of(source, channels, about).name == "darling2011"
    assert about["quantity"] == "light"


def test_files_of_colour_science_are_read(colour, tmp_path):
    msds = colour.MultiSpectralDistributions(
        np.moveaxis(lights().reshape(-1, 36), 0, 1).astype(float), WAVELENGTHS
    )
    specification = colour.Specification_Fichet2021(is_emissive=True, attributes=None)
    path = tmp_path / "theirs.exr"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        colour.write_spectral_image_Fichet2021(
            msds, str(path), "float32", specification, shape=(*SIZE, 36)
        )
    image = spectral_exr.read(path)
    np.testing.assert_array_equal(image.wavelengths, WAVELENGTHS)
    np.testing.assert_allclose(image.values, lights(), rtol=1e-6)
    assert image.notes == ()
    spectral.to_primaries(path, tmp_path / "out.exr", PRIMARIES)
    measured, _ = io.read_measured(tmp_path / "out.exr")
    np.testing.assert_allclose(measured.values, PRIMARIES.project(lights()), rtol=1e-5)


@pytest.mark.parametrize("kind", spectral_exr.KINDS)
def test_colour_science_reads_our_files(colour, tmp_path, kind):
    wavelengths = np.array([400.0, 450.25, 512.5, 555.5, 600.0, 700.0])
    values = np.random.default_rng(1).random((*SIZE, 6)).astype(np.float32)
    image = SpectralImage(wavelengths, values, kind, "W.m^-2.sr^-1.nm^-1", {}, ())
    path = tmp_path / "ours.exr"
    spectral_exr.write(path, image, description="test", preview=values[..., :3])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        components, specification = colour.read_spectral_image_Fichet2021(
            str(path), additional_data=True
        )
    assert specification.is_emissive == (kind == "light")
    assert not specification.is_polarised
    found = components["S0" if kind == "light" else "T"]
    np.testing.assert_array_equal(found[0], wavelengths)
    np.testing.assert_array_equal(found[1], values)
    told = {a.name: a.value for a in specification.attributes}
    assert told["spectralLayoutVersion"] == "1.0"
    if kind == "light":
        assert told["emissiveUnits"] == "W.m^-2.sr^-1.nm^-1"
        assert told["polarisationHandedness"] == "right"
    again = spectral_exr.read(path, kind=kind)
    np.testing.assert_array_equal(again.values, values)
    np.testing.assert_array_equal(again.wavelengths, wavelengths)


def test_polarisation_is_left_out_with_a_note(colour):
    from importlib.resources import files

    path = files("colour") / "io" / "tests" / "resources" / "Polarised.exr"
    if not path.is_file():
        pytest.skip("this colour-science does not ship its tests' images")
    image = spectral_exr.read(str(path))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        expected = colour.read_spectral_image_Fichet2021(str(path))["S0"]
    np.testing.assert_allclose(image.wavelengths, expected[0])
    np.testing.assert_array_equal(image.values, expected[1])
    assert "S1, S2, S3" in image.notes[0]


@pytest.mark.parametrize(
    "names",
    [
        [f"{w:g}nm" for w in WAVELENGTHS],
        [f"w{w:g}" for w in WAVELENGTHS],
        [f"{w:.1f}" for w in WAVELENGTHS],
        [f"cube.{w:.1f}nm" for w in WAVELENGTHS],
        [f"S0.{w:.6f}nm".replace(".", ",").replace(",", ".", 1) for w in WAVELENGTHS],
        [f"S0.{w:.3f}nm" for w in WAVELENGTHS],
        [f"S0.{w / 1000:.6f}um".replace(".", ",").replace(",", ".", 1) for w in WAVELENGTHS],
        [f"S0.{299792.458 / w:.9f}THz".replace(".", ",").replace(",", ".", 1) for w in WAVELENGTHS],
    ],
    ids=["nm", "w", "decimal", "layer", "Fichet", "point", "micrometres", "terahertz"],
)
def test_channels_are_known_by_their_wavelengths_in_any_order(tmp_path, names):
    order = np.random.default_rng(2).permutation(36)
    path = write_plain(tmp_path / "in.exr", lights()[..., order], [names[i] for i in order])
    image = spectral_exr.read(path)
    np.testing.assert_allclose(image.wavelengths, WAVELENGTHS, rtol=1e-6)
    np.testing.assert_array_equal(image.values, lights())


def test_fine_spectra_are_averaged_over_bands_and_lines_keep_their_power(tmp_path):
    """A mercury line of 1 nm at 546 nm, between two bands, is not lost."""
    fine = np.arange(380.0, 731.0, 1.0)
    values = np.ones((1, 1, len(fine)), np.float32)
    values[..., fine == 546] = 51.0
    path = write_plain(tmp_path / "in.exr", values, [f"{w:g}" for w in fine])
    spectral.to_primaries(path, tmp_path / "out.exr", PRIMARIES)
    measured, _ = io.read_measured(tmp_path / "out.exr")
    line = np.ones(36)
    line[WAVELENGTHS == 540] += 50 * 0.4 / 10  # its power shared by distance
    line[WAVELENGTHS == 550] += 50 * 0.6 / 10
    np.testing.assert_allclose(measured.values[0, 0], PRIMARIES.project(line), rtol=1e-5)


def test_what_is_not_known_stays_unknown(tmp_path):
    values = lights()
    values[1, 2, 7] = np.nan
    values[2, 3, 9] = np.inf
    path = write_plain(tmp_path / "in.exr", values, [f"{w:g}" for w in WAVELENGTHS])
    spectral.to_primaries(path, tmp_path / "out.exr", PRIMARIES)
    measured, _ = io.read_measured(tmp_path / "out.exr")
    unknown = np.zeros(SIZE, bool)
    unknown[1, 2] = unknown[2, 3] = True
    np.testing.assert_array_equal(measured.valid == 0, unknown)
    np.testing.assert_array_equal(np.isnan(measured.values).all(axis=-1), unknown)


def test_coarse_and_short_spectra_are_noted(tmp_path):
    wavelengths = np.arange(400.0, 701.0, 30.0)
    path = write_plain(
        tmp_path / "in.exr",
        np.ones((2, 2, 12), np.float32),
        [*(f"{w:g}nm" for w in wavelengths), "depth"],
    )
    notes = " ".join(spectral.to_primaries(path, tmp_path / "out.exr", PRIMARIES))
    assert "depth" in notes
    assert "30 nm apart" in notes
    assert "400 to 700 nm" in notes
    measured, _ = io.read_measured(tmp_path / "out.exr")
    np.testing.assert_allclose(measured.values, 1, rtol=1e-5)  # a perfect white is 1


def _names(prefix="", grid=WAVELENGTHS):
    return [f"{prefix}{w:g}nm" for w in grid]


def _spoilt(band, value):
    """Lights whose one band is something else in every pixel."""
    return np.where(np.arange(36) == band, np.float32(value), lights())


_AS_SPECTRA = "spectra: channels such as S0.550,000000nm, T.550,000000nm, 550nm or w550"
_HARDLY = "hardly any {0} above 0 (expected some {0}); check the sign, make it again"


@pytest.mark.parametrize(
    ("values", "names", "kind", "line"),
    [
        (
            lights()[..., :3],
            ["R", "G", "B"],
            "light",
            f"channels R, G, B (expected {_AS_SPECTRA}); rename the channels by their wavelengths",
        ),
        (
            lights(),
            _names("T."),
            "light",
            "spectra of reflectance (channels T.…nm) (expected light (S0.…nm)); "
            "read it as reflectance",
        ),
        (
            lights(),
            _names("S0."),
            "reflectance",
            "spectra of light (channels S0.…nm) (expected reflectance (T.…nm)); read it as light",
        ),
        (
            lights() * 0,
            _names(),
            "light",
            "no pixel with a value but 0 (expected some light); make it again",
        ),
        (
            lights() * np.nan,
            _names(),
            "light",
            "no pixel with a value but 0 (expected some light); make it again",
        ),
        (-lights(), _names(), "light", _HARDLY.format("light")),
        (-lights() / 300, _names(), "reflectance", _HARDLY.format("reflectance")),
        (
            _spoilt(5, -0.01),
            _names(),
            "light",
            "values below 0 in every pixel at 430 nm (expected light of 0 and more, but for noise);"
            " check what was subtracted, or remove the channel",
        ),
        (
            _spoilt(7, np.nan),
            _names(),
            "light",
            "no pixel with a value at 450 nm (expected every band known somewhere); "
            "remove the channel or make it again",
        ),
        (
            np.full((2, 2, 36), 90, np.float32),
            _names(),
            "reflectance",
            "reflectance up to 90 (expected factors between 0 and 1); "
            "divide by 100 if it is percent; if it is light, read it as light",
        ),
        (
            lights()[..., :20],
            _names(grid=WAVELENGTHS[:20]),
            "light",
            "spectra from 380 to 570 nm (expected at least 400 to 700 nm); "
            "measure or look up the missing wavelengths",
        ),
        (
            lights()[..., :3],
            _names(grid=[450, 550, 650]),
            "light",
            "3 wavelengths (expected 4 or more, of 400 to 700 nm); add bands",
        ),
        (
            lights(),
            [f"{w / 1000:g}" for w in WAVELENGTHS],
            "light",
            "wavelengths from 0.38 to 0.73 look like micrometres (expected nanometres); "
            "name the channels in nm",
        ),
        (
            lights(),
            ["380.0nm", *_names()[:-1]],
            "light",
            "two channels of 380 nm (expected each wavelength once); remove one",
        ),
        (
            lights(),
            ["S0.nm", *_names("S0.")[1:]],
            "light",
            "a channel 'S0.nm' (expected a wavelength above 0 in its name); rename it",
        ),
    ],
    ids=lambda value: value if isinstance(value, str) and " " not in value else "",
)
def test_bad_spectra_take_one_line(sixlight, tmp_path, values, names, kind, line):
    path = write_plain(tmp_path / "in.exr", values, names)
    outcome = sixlight("spectra", path, "-o", tmp_path / "out.exr", "--kind", kind)
    assert outcome.status == 2
    assert outcome.err == f"{path}: {line}\n"
    assert [p.name for p in tmp_path.iterdir()] == ["in.exr"]


def test_files_that_are_no_spectra_take_one_line(sixlight, tmp_path):
    text = tmp_path / "text.exr"
    text.write_text("wavelength_nm,a")
    for file, said in ((text, "not a readable image"), (tmp_path / "none.exr", "no such file")):
        outcome = sixlight("spectra", file, "-o", tmp_path / "out.exr")
        assert outcome.status == 2
        assert outcome.err.startswith(f"{file}: {said}")
        assert len(outcome.err.splitlines()) == 1
    assert not (tmp_path / "out.exr").exists()


def test_spectra_are_light_or_reflectance(tmp_path):
    with pytest.raises(InputError, match="light or reflectance"):
        spectral.to_primaries(tmp_path / "in.exr", tmp_path / "out.exr", PRIMARIES, kind="paint")


def test_nothing_is_overwritten_unasked(tmp_path):
    path = write_plain(tmp_path / "in.exr", lights(), _names())
    with pytest.raises(InputError, match="exists"):
        spectral.to_primaries(path, path, PRIMARIES)
    spectral.to_primaries(path, path, PRIMARIES, force=True)
    assert [p.name for p in tmp_path.iterdir()] == ["in.exr"]


def test_a_hyperspectral_cubemap_is_ready_for_the_renderer(tmp_path):
    """Six faces of D65 stay D65 through what every map goes through before it is shown."""
    faces = np.broadcast_to(lights()[0, -1], (48, 8, 36)).astype(np.float32)
    source = write_plain(tmp_path / "in.exr", faces, _names())
    spectral.to_primaries(source, tmp_path / "cubemap.exr", PRIMARIES)
    light, _ = io.read_measured(tmp_path / "cubemap.exr", cube=True)
    filled = fill(light)
    assert filled.shape == (6, 8, 8, 6)
    day = PRIMARIES.project(lights()[0, -1])
    np.testing.assert_allclose(mean(filled), day, rtol=1e-5)


@pytest.mark.slow
def test_a_hyperspectral_cubemap_is_previewed(sixlight, tmp_path):
    """A brown of daylight from above and tungsten from below lights the teapot."""
    faces = np.repeat(lights()[[0, 0, -1, 0, 0, 0], [0, 0, -1, 0, 0, 0]], 8, axis=0)
    source = write_plain(tmp_path / "in.exr", faces[:, None].repeat(8, axis=1), _names())
    cubemap = tmp_path / "cubemap.exr"
    made = sixlight("spectra", source, "-o", cubemap, "--primaries", "darling2011")
    assert (made.status, made.err) == (0, "")
    shown = sixlight("preview", cubemap, "-o", tmp_path / "shown", "--width", "128")
    assert shown.status == 0, shown.err
    xyz, _, _ = io.read_exr(tmp_path / "shown" / "preview_teapot.exr")
    assert np.isfinite(xyz).all()
    assert xyz.max() > 0


def test_what_preview_cannot_light_with_is_noted_and_refused(sixlight, tmp_path):
    latlong = write_plain(tmp_path / "latlong.exr", np.ones((4, 8, 36), np.float32), _names())
    assert "latlong" in sixlight("spectra", latlong, "-o", tmp_path / "six.exr").err
    odd = write_plain(tmp_path / "odd.exr", np.ones((60, 10, 36), np.float32), _names())
    assert "faces of 10 texels" in sixlight("spectra", odd, "-o", tmp_path / "ten.exr").err
    for name, said in (("six", "six square faces"), ("ten", "a power of two")):
        refused = sixlight("preview", tmp_path / f"{name}.exr", "-o", tmp_path / "shown")
        assert refused.status == 2
        assert said in refused.err
        assert len(refused.err.splitlines()) == 1
    assert not (tmp_path / "shown").exists()


def test_reflectance_spectra_become_what_a_capture_gives(tmp_path):
    """Six values of a painting: by eq. 1 from its spectra, beside a captured one's header."""
    chart = sets.surfaces("colorchecker24").values.T.reshape(4, 6, 36).astype(np.float32)
    source = write_plain(tmp_path / "in.exr", chart, _names("T."))
    spectral.to_primaries(source, tmp_path / "out.exr", PRIMARIES, kind="reflectance")
    measured, channels = io.read_measured(tmp_path / "out.exr")
    np.testing.assert_allclose(measured.values, PRIMARIES.project(chart), rtol=1e-5)
    about = io.read_exr(tmp_path / "out.exr")[2]
    captured = header.of_primaries(PRIMARIES, unit="reflectance factor", quantity="reflectance")
    assert captured.items() <= about.items()
    assert channels == PRIMARIES.channels


# ------------------------------------------------------------------------------------------ out


def test_estimated_spectra_keep_the_six_values(colour, tmp_path):
    values = np.random.default_rng(3).uniform(-0.02, 3.0, (12, 2, 6)).astype(np.float32)
    values[3, 1] = np.nan
    source = write_light(tmp_path / "cubemap.exr", values, orientation="this way", name="room")
    (note,) = spectral.to_spectra(source, tmp_path / "spectra.exr")
    assert note.startswith("ESTIMATED")
    spectral.to_primaries(tmp_path / "spectra.exr", tmp_path / "again.exr", PRIMARIES)
    again, _ = io.read_measured(tmp_path / "again.exr")
    # float32 through 36 wavelengths and back
    np.testing.assert_allclose(again.values, values, atol=1e-5)
    np.testing.assert_array_equal(again.valid == 0, np.isnan(values).all(axis=-1))
    about = io.read_exr(tmp_path / "again.exr")[2]
    assert about["orientation"] == "this way"
    assert about["unit"] == "W/(sr m2 nm)"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        components, specification = colour.read_spectral_image_Fichet2021(
            str(tmp_path / "spectra.exr"), additional_data=True
        )
    np.testing.assert_array_equal(components["S0"][0], WAVELENGTHS)
    told = {a.name: str(a.value) for a in specification.attributes}
    assert told["ImageDescription"].startswith("ESTIMATED")
    assert "ESTIMATED" in told["sixlight:estimate"]


def test_estimates_taken_to_other_primaries_stay_marked(tmp_path):
    day = PRIMARIES.project(lights()).astype(np.float32)
    source = write_light(tmp_path / "cubemap.exr", day)
    spectral.to_spectra(source, tmp_path / "spectra.exr")
    other = primaries.load("signed6")
    notes = spectral.to_primaries(tmp_path / "spectra.exr", tmp_path / "other.exr", other)
    assert "estimates" in notes[-1]
    about = io.read_exr(tmp_path / "other.exr")[2]
    assert "ESTIMATED" in about["estimate"]
    assert about["primaries"] == "signed6"
    assert spectral.to_primaries(tmp_path / "spectra.exr", tmp_path / "same.exr", PRIMARIES) == ()
    assert "estimate" not in io.read_exr(tmp_path / "same.exr")[2]


def test_an_estimate_shows_the_maps_own_colours(tmp_path):
    """The estimate's XYZ by the observer is near that by the primaries' matrix: D65, within 5 %."""
    day = PRIMARIES.project(lights()[:, -1:]).astype(np.float32)
    source = write_light(tmp_path / "cubemap.exr", day)
    spectral.to_spectra(source, tmp_path / "spectra.exr")
    image = spectral_exr.read(tmp_path / "spectra.exr")
    np.testing.assert_allclose(
        sets.xyz(image.values), day @ PRIMARIES.xyz_from_primaries.T, rtol=0.05
    )


def test_reflectances_go_out_as_reflectances(tmp_path):
    chart = PRIMARIES.project(sets.surfaces("colorchecker24").values.T)
    values = chart.reshape(4, 6, 6).astype(np.float32)
    source = write_light(tmp_path / "r.exr", values, quantity="reflectance", unit="factor")
    spectral.to_spectra(source, tmp_path / "out.exr", PRIMARIES)
    image = spectral_exr.read(tmp_path / "out.exr", kind="reflectance")
    np.testing.assert_allclose(PRIMARIES.project(image.values), values, atol=1e-5)
    with pytest.raises(InputError, match="read it as reflectance"):
        spectral_exr.read(tmp_path / "out.exr")


def test_a_map_in_unknown_primaries_is_refused(tmp_path):
    values = np.ones((2, 2, 6), np.float32)
    source = write_light(tmp_path / "a.exr", values, primaries="mine")
    with pytest.raises(InputError, match="mine"):
        spectral.to_spectra(source, tmp_path / "out.exr")
    source = write_light(tmp_path / "b.exr", values, xyz_from_primaries="1 2 x")
    with pytest.raises(InputError, match=r"b\.exr"):
        spectral.to_spectra(source, tmp_path / "out.exr", PRIMARIES)
    plain = write_plain(tmp_path / "c.exr", lights(), _names())
    with pytest.raises(InputError, match="sigma"):
        spectral.to_spectra(plain, tmp_path / "out.exr")
