import numpy as np

from calibration import sets
from calibration.bands import sensitivities
from calibration.fit import fit
from calibration.linear import Samples
from calibration.primaries import load
from calibration.spectra import WAVELENGTHS, Spectra
from calibration.through_curves import ThroughCurves
from calibration.training import TrainingSet, computed


def samples_of(lights, signals, spectra, primaries):
    """Of signals (L, n, B) and spectra (L, n, 36)."""
    counts = np.ones(signals.shape[1])
    seen = TrainingSet(tuple("abcdef"), lights, signals, spectra, np.zeros(signals.shape), counts)
    return Samples.of(seen, primaries, 0.005)


def test_a_session_without_noise_gives_nearly_what_known_curves_give():
    """Both are tried on lamps that neither has seen: the primaries' rms errors agree."""
    primaries, camera = load("signed6"), sets.camera("nikon5100")
    cyan = 0.9 / (1.0 + np.exp((WAVELENGTHS - 600.0) / 16.0))
    yellow = 0.9 / (1.0 + np.exp(-(WAVELENGTHS - 480.0) / 8.0))
    filters = Spectra(WAVELENGTHS, ("cyan", "yellow"), np.stack([cyan, yellow], axis=1))
    _, curves = sensitivities(camera, filters)
    names = ("A", "D65", "D50", "F2", "F11")
    lamps = sets.scaled_to_unit_luminance(sets.lights("darling2011").only(names).values)
    patches = sets.surfaces("colorchecker24").values.T
    spectra = np.stack([patches * lamp for lamp in lamps.T])
    exact = spectra @ curves
    samples = samples_of(names, exact, spectra, primaries)
    session = ThroughCurves(samples, primaries, 0.005).solved()
    known = fit(computed(camera, filters), primaries, noise_level=0.005).matrix
    plain = np.linalg.lstsq(exact.reshape(-1, 6), primaries.project(spectra).reshape(-1, 6))[0].T
    others = sets.scaled_to_unit_luminance(sets.lights("cie-led+planckian").values).T

    def error(matrix):
        return np.sqrt(np.mean((others @ curves @ matrix.T - primaries.project(others)) ** 2))

    assert error(session) < 1.1 * error(known)
    assert error(session) < error(plain)


def test_a_light_left_out_has_no_say():
    primaries = load("signed6")
    rng = np.random.default_rng(2)
    spectra = 0.5 + rng.random((3, 20, 36))
    signals = primaries.project(spectra)
    wrong = signals * [[[1.0]], [[1.0]], [[2.0]]]
    good, bad = (samples_of(("a", "b", "c"), s, spectra, primaries) for s in (signals, wrong))
    without = [ThroughCurves(s, primaries, 0.005).solved(["c"]) for s in (good, bad)]
    np.testing.assert_array_equal(*without)
    whole = [ThroughCurves(s, primaries, 0.005).solved() for s in (good, bad)]
    assert np.abs(whole[0] - whole[1]).max() > 0.01
