"""What a fit is made from: photographs of a chart, or known curves."""

import numpy as np
import pytest
from chart_session import bands, glasses, seen, session

from calibration import sets
from calibration.errors import InputError
from calibration.spectra import WAVELENGTHS, Spectra
from calibration.training import WHITE_SHARE, computed


def test_over_its_white_a_chart_is_the_same_in_any_exposure():
    signals, variances, radiances = session(noise=0.0)
    over = seen((signals, variances, radiances), quantity="reflectance")
    assert over.white.tolist() == [18] * 4
    np.testing.assert_allclose(over.signals[:, 18], 1.0)
    np.testing.assert_allclose(over.spectra[:, 18], 1.0)
    np.testing.assert_allclose(over.variances, (0.004 * over.signals) ** 2)
    assert over.counts.tolist() == [1.0] * 18 + [WHITE_SHARE * 24] + [1.0] * 5
    signals, variances = signals | {"A": 7 * signals["A"]}, variances | {"A": 49 * variances["A"]}
    brighter = seen((signals, variances, radiances), quantity="reflectance")
    np.testing.assert_allclose(brighter.signals, over.signals)
    np.testing.assert_allclose(brighter.variances, over.variances)


def test_computed_over_a_white_and_over_its_brightest_sample_are_the_same():
    camera = sets.camera("nikon5100"), glasses()
    lights, surfaces = sets.lights("darling2011"), sets.surfaces("colorchecker24")
    light = computed(*camera, lights=lights, surfaces=surfaces)
    assert light.signals.shape == (19, 25, 6)
    assert light.white.tolist() == [24] * 19
    assert not light.photographed
    over = computed(*camera, lights=lights, surfaces=surfaces, quantity="reflectance")
    np.testing.assert_allclose(over.signals, light.signals / light.signals[:, 24:])
    np.testing.assert_allclose(over.spectra[7, :24], surfaces.values.T)
    np.testing.assert_allclose(over.spectra[:, 24], 1.0)


def test_the_whites_of_computed_light_are_the_lights():
    lights = sets.lights("darling2011")
    whites = computed(sets.camera("nikon5100"), glasses(), lights=lights).whites()
    np.testing.assert_allclose(whites.spectra[:, 0], lights.values.T)
    np.testing.assert_allclose(whites.signals[:, 0], lights.values.T @ bands()[1])
    assert whites.counts.tolist() == [1.0]


def without_violet(radiances, *lights):
    """The readings, but that these lights have none at 380 nm, or a little noise."""
    dark = dict(radiances)
    for sign, light in zip((0.0, -1e-5, 1e-5), lights, strict=False):
        values = radiances[light].values.copy()
        values[0] = sign * values.max(axis=0)
        dark[light] = Spectra(WAVELENGTHS, radiances[light].names, values)
    return dark


def test_where_a_light_does_not_reach_others_show_what_patches_reflect():
    signals, variances, radiances = session(noise=0.0)
    over = seen((signals, variances, radiances), quantity="reflectance")
    dark = without_violet(radiances, "D65", "F2", "A")
    filled = seen((signals, variances, dark), quantity="reflectance")
    np.testing.assert_allclose(filled.spectra, over.spectra, rtol=1e-9)
    assert "D50" in over.lights  # which alone reaches there


def test_a_white_that_clips_or_that_no_light_shows_gives_no_reflectance():
    signals, variances, radiances = session()
    signals["F2"][18, 2] = np.nan
    dark = radiances
    for light in radiances:
        dark = without_violet(dark, light)
    seen((signals, variances, dark))
    with pytest.raises(InputError) as caught:
        seen((signals, variances, dark), quantity="reflectance")
    clipped, unread = str(caught.value).splitlines()
    assert "light 'F2': the white, patch 19, is not known everywhere" in clipped
    assert "no light shows what the patches reflect at 380 nm" in unread


# ---- what is refused


def test_lights_and_patches_that_do_not_match_are_all_named():
    signals, variances, radiances = session()
    del radiances["A"]
    radiances["F7"] = radiances["D50"]
    radiances["D65"] = radiances["D65"].only([str(i) for i in range(1, 23)])
    with pytest.raises(InputError) as caught:
        seen((signals, variances, radiances))
    said = str(caught.value)
    assert "'A' has photographs but no radiance" in said
    assert "'F7' has radiance but no photographs" in said
    assert "'D65' has no radiance of patch 23, 24" in said


def changed(given, light, change):
    signals, variances, radiances = given
    spectra = radiances[light]
    values = change(spectra.values.copy())
    return signals, variances, {
        **radiances, light: Spectra(spectra.wavelengths, spectra.names, values)
    }  # fmt: skip


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda v: v * 1e6, "light 'D65': the chart shines with"),
        (lambda v: v * 100, "light 'D65': 76 times the radiance per signal"),
        (lambda v: -v, "light 'D65', patch 1: a negative radiance"),
        (lambda v: np.ones_like(v), "patch 1: 1 at every wavelength"),
    ],
)
def test_readings_that_cannot_be_are_named(change, says):
    with pytest.raises(InputError) as caught:
        seen(changed(session(), "D65", change))
    assert says in str(caught.value)
    assert len(caught.value.problems) <= 11


def test_the_same_readings_for_two_lights_are_refused():
    signals, variances, radiances = session()
    radiances["D50"] = radiances["D65"]
    with pytest.raises(InputError, match="'D50' has the readings of 'D65'"):
        seen((signals, variances, radiances))


def test_lights_of_no_use_are_refused():
    twice = Spectra(WAVELENGTHS, ("a", "b"), np.linspace((1.0, 2.0), (2.0, 4.0), 36))
    with pytest.raises(InputError, match="light 'b' is 'a' again"):
        computed(sets.camera("nikon5100"), glasses(), lights=twice)
