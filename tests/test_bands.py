import numpy as np
import pytest

from calibration import bands, sets
from calibration.errors import InputError
from calibration.spectra import WAVELENGTHS, Spectra


@pytest.fixture(scope="module")
def curves():
    """Six bands: a real camera behind smooth cyan and yellow curves."""
    cyan = 0.9 / (1.0 + np.exp((WAVELENGTHS - 600.0) / 16.0))
    yellow = 0.9 / (1.0 + np.exp(-(WAVELENGTHS - 480.0) / 8.0))
    filters = Spectra(WAVELENGTHS, ("cyan", "yellow"), np.stack([cyan, yellow], axis=1))
    return bands.sensitivities(sets.camera("nikon5100"), filters)[1]


def chart(names=("A", "D65", "D50", "F2", "F11")):
    """A ColorChecker's spectra (n, 36) under lights of the paper, each white at Y = 1."""
    lamps = sets.scaled_to_unit_luminance(sets.lights("darling2011").only(names).values)
    return np.concatenate([sets.surfaces("colorchecker24").values.T * lamp for lamp in lamps.T])


def seen(curves, spectra, noise, seed=0):
    exact = spectra @ curves
    return exact * (1.0 + noise * np.random.default_rng(seed).normal(size=exact.shape))


def test_the_estimated_curves_foretell_signals_of_lamps_never_seen(curves):
    """Of other lamps' light, within half a percent: no lamp of rooms is in the session."""
    spectra = chart()
    got = bands.estimated(seen(curves, spectra, 0.002), spectra)
    others = np.concatenate([sets.lights(n).values.T for n in ("planckian", "daylight", "cie-led")])
    off = others @ got.mean / (others @ curves) - 1.0
    assert np.sqrt(np.mean(off**2)) < 0.005


def test_what_is_said_to_be_unsure_is_as_far_off(curves):
    """Over sessions with other noise, the errors' mean square is the variance stated."""
    spectra = chart()
    lamps = sets.scaled_to_unit_luminance(sets.lights("lamps").values).T
    moment = lamps.T @ lamps / len(lamps)
    stated, found = 0.0, 0.0
    for seed in range(8):
        got = bands.estimated(seen(curves, spectra, 0.004, seed), spectra)
        stated = stated + got.variances(moment).mean() / 8
        found = found + np.mean((lamps @ (got.mean - curves)) ** 2) / 8
    assert 0.3 < found / stated < 3.0  # the prior is of smooth curves, these but one draw of them


def test_noisier_readings_are_found_noisier_and_leave_curves_less_sure(curves):
    spectra = chart()
    moment = spectra.T @ spectra / len(spectra)
    good, bad = (bands.estimated(seen(curves, spectra, n), spectra) for n in (0.001, 0.01))
    assert good.noise < bad.noise
    assert np.all(good.variances(moment) < bad.variances(moment))


def test_a_camera_with_other_columns_is_refused():
    glass = Spectra(WAVELENGTHS, ("cyan", "yellow"), np.ones((36, 2)))
    with pytest.raises(InputError, match="wavelength_nm,R,G,B"):
        bands.sensitivities(glass, glass)


def test_a_filter_without_a_curve_is_named():
    glass = Spectra(WAVELENGTHS, ("cyan", "yellow"), np.ones((36, 2)))
    with pytest.raises(InputError, match="the filter 'red', only cyan, yellow"):
        bands.sensitivities(sets.camera("nikon5100"), glass, ["cyan", "red"])
