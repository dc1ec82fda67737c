import numpy as np
import pytest

from calibration import sets
from calibration.errors import InputError
from calibration.spectra import WAVELENGTHS


def chromaticity(spectrum):
    xyz = sets.xyz(spectrum)
    return xyz[:2] / xyz.sum()


@pytest.mark.parametrize("name", sets.LIGHTS)
def test_every_light_is_scaled_to_unit_luminance_and_named_once(name):
    lights = sets.lights(name)
    assert lights.values.shape == (36, len(lights))
    assert lights.values.min() >= 0.0
    assert len(set(lights.names)) == len(lights)
    np.testing.assert_allclose(sets.xyz(lights.values.T)[:, 1], 1.0)


@pytest.mark.parametrize("name", sets.SURFACES)
def test_every_surface_is_a_reflectance(name):
    surfaces = sets.surfaces(name)
    assert surfaces.values.shape == (36, len(surfaces))
    assert surfaces.values.min() >= 0.0
    assert surfaces.values.max() < 1.1  # three of the 190 patches fluoresce
    assert len(set(surfaces.names)) == len(surfaces)


def test_equal_energy_light_has_unit_luminance_and_equal_tristimulus_values():
    np.testing.assert_allclose(sets.xyz(np.ones(36)), 1.0, atol=2e-3)
    assert sets.xyz(np.ones(36))[1] == pytest.approx(1.0)


# Published chromaticities: CIE 15:2004. Spectra are cut at 730 nm and in bands of 10 nm.
@pytest.mark.parametrize(
    ("name", "xy"),
    [
        ("A", (0.44758, 0.40745)),
        ("D50", (0.34567, 0.35851)),
        ("D65", (0.31272, 0.32903)),
        ("D75", (0.29903, 0.31488)),
        ("F2", (0.3721, 0.3751)),
        ("F7", (0.3129, 0.3292)),
        ("F11", (0.3805, 0.3769)),
        ("F12", (0.4370, 0.4042)),
    ],
)
def test_the_papers_lights_have_their_published_chromaticity(name, xy):
    lights = sets.lights("darling2011")
    assert len(lights) == 19
    np.testing.assert_allclose(chromaticity(lights[name]), xy, atol=1.2e-3)


def test_black_bodies_are_illuminant_a_at_its_temperature():
    a = sets.lights("darling2011")["A"]
    body = sets.planck(WAVELENGTHS, 2848.0 * 1.4388 / 1.4350)  # c2 has been revised since
    np.testing.assert_allclose(body / body[18], a / a[18], rtol=2e-3)


def test_the_colorcheckers_neutral_row_is_neutral_and_descends():
    neutral = sets.surfaces("colorchecker24").only([str(i) for i in range(19, 25)]).values
    middle = neutral[6:]  # white paint absorbs in the violet
    assert np.all(np.diff(middle.mean(axis=0)) < 0)
    assert (middle.max(axis=0) / middle.min(axis=0)).max() < 1.15


def test_sets_join():
    both = sets.surfaces("ces99+rawtoaces190")
    assert len(both) == 289
    assert both.names[0] == "CES01"


@pytest.mark.parametrize("of", [sets.lights, sets.surfaces, sets.camera])
def test_an_unknown_name_lists_the_known_ones(of):
    with pytest.raises(InputError, match=r"'nope' \(expected "):
        of("nope")


def test_no_one_can_change_the_observer_for_others():
    with pytest.raises(ValueError, match="read-only"):
        sets.observer()[0, 0] = 1.0


# As printed in Darling et al. (2011).
@pytest.mark.parametrize(
    ("place", "xy"),
    [
        ("cloudy outdoors", (0.317, 0.329)),
        ("desk lamp", (0.456, 0.404)),
        ("horizon booth", (0.500, 0.417)),
        ("office", (0.405, 0.404)),
        ("classroom", (0.393, 0.391)),
    ],
)
def test_the_places_have_the_chromaticities_measured_there(place, xy):
    np.testing.assert_allclose(chromaticity(sets.lights("places5")[place]), xy, atol=1e-9)


def test_no_light_trained_on_is_nearly_one_to_be_tested_on():
    trained = sets.lights("training").values
    tests = sets.lights("leds8+places5").values
    lamps = sets.lights("lamps").only(["Neodimium Incandescent", "T8 Luxline Plus White"]).values
    tests = np.concatenate([tests, lamps, sets.lights("cie-fl3")["FL3.13"][:, None]], axis=1)
    cosines = (trained.T @ tests) / np.outer(
        np.linalg.norm(trained, axis=0), np.linalg.norm(tests, axis=0)
    )
    assert cosines.max() <= 0.99


def test_the_lights_trained_on_are_the_same_every_time():
    first = sets._training().values
    sets._training.cache_clear()
    np.testing.assert_array_equal(sets._training().values, first)


def test_three_part_leds_are_about_white():
    leds = [n for n in sets.lights("training").names if n.startswith("three-part")]
    assert len(leds) >= 20
    for name in leds:
        x, y = chromaticity(sets.lights("training")[name])
        assert 0.25 < x < 0.52
        assert 0.25 < y < 0.45
