from pathlib import Path

import chart_session
import numpy as np
import pytest
from chart_session import seen, session, step

from calibration import sets
from calibration.adaptation import D65, cat02
from calibration.bands import sensitivities
from calibration.difference import delta_e_2000, lab
from calibration.errors import InputError
from calibration.fit import METHODS, MOST_AMPLIFIED, fit
from calibration.primaries import Primaries, gaussians, load
from calibration.spectra import WAVELENGTHS, Spectra, read_spectra
from calibration.training import TrainingSet, computed

DATA = Path(__file__).parents[2] / "shared" / "data"


@pytest.fixture(scope="module")
def primaries():
    return load()


@pytest.fixture(scope="module")
def camera():
    return sets.camera("nikon5100")


@pytest.fixture(scope="module")
def filters():
    return chart_session.glasses()


@pytest.fixture(scope="module")
def bands():
    return chart_session.bands()


@pytest.fixture(scope="module")
def known(camera, filters, primaries):
    return fit(computed(camera, filters), primaries)


def whites_error(transform, bands, primaries, lights):
    """CIEDE2000 of a white under each light (n, 36), its own colour as the white."""
    xyz_from = primaries.xyz_from_primaries
    true = primaries.project(lights) @ xyz_from.T
    seen = lights @ bands @ transform.matrix.T @ xyz_from.T
    return delta_e_2000(lab(true / true[:, 1:2]), lab(seen / true[:, 1:2]))


def chart_fit(primaries, given, **options):
    return fit(seen(given), primaries, **options)


# ---- the solution


@pytest.mark.parametrize("method", METHODS)
def test_a_camera_whose_bands_are_the_primaries_gets_the_identity(primaries, method):
    rng = np.random.default_rng(1)
    radiances = rng.random((2, 100, 36))
    samples = TrainingSet(
        channels=tuple(f"x.{i}" for i in range(6)),
        lights=("a", "b"),
        signals=primaries.project(radiances),
        spectra=radiances,
        variances=np.zeros((2, 100, 6)),
        counts=np.ones(100),
    )
    got = fit(samples, primaries, method=method, noise_level=1e-6)
    np.testing.assert_allclose(got.matrix, np.eye(6), atol=1e-6)
    np.testing.assert_allclose(got.figures["spectral_error"], 0.0, atol=1e-3)
    np.testing.assert_allclose(got.figures["noise_amplification"], 1.0, atol=1e-3)


def test_pinv_is_numpys_pseudo_inverse(primaries):
    signals, variances, radiances = session()
    got = chart_fit(primaries, (signals, variances, radiances), method="pinv")
    s = np.concatenate(list(signals.values())).T
    t = primaries.project(np.concatenate([r.values.T for r in radiances.values()])).T
    np.testing.assert_allclose(got.matrix, t @ np.linalg.pinv(s), rtol=1e-6)


def test_ridge_has_the_least_expected_error_at_its_noise(primaries):
    """Against pinv and every small change of itself, with noise really drawn."""
    level = 0.01
    given = session(noise=0.0)
    got = chart_fit(primaries, given, noise_level=level, method="ridge")
    plain = chart_fit(primaries, given, method="pinv")
    rng = np.random.default_rng(2)
    s = np.repeat(np.concatenate(list(given[0].values())), 400, axis=0)
    t = primaries.project(np.concatenate([r.values.T for r in given[2].values()]))
    luminance = (t @ primaries.xyz_from_primaries[1]).reshape(4, 24)
    scale = np.repeat(luminance.max(axis=1), 24 * 400)
    t = np.repeat(t, 400, axis=0) / scale[:, None]
    noisy = s * (1 + level * rng.normal(size=s.shape)) / scale[:, None]

    def error(matrix):
        return np.sum((noisy @ matrix.T - t) ** 2, axis=0)

    least = error(got.matrix)
    assert np.all(least < error(plain.matrix))
    for _ in range(20):
        changed = got.matrix * (1 + 0.05 * rng.normal(size=got.matrix.shape))
        assert np.all(error(changed) > least)


def test_ridge_amplifies_noise_less_and_says_truly_how_much(primaries):
    given = session(noise=0.0)
    ridge = chart_fit(primaries, given, method="ridge", noise_level=0.01)
    plain = chart_fit(primaries, given, method="pinv")
    assert max(ridge.figures["noise_amplification"]) < 4.0
    assert max(plain.figures["noise_amplification"]) > 8.0
    rng = np.random.default_rng(3)
    s = np.concatenate(list(given[0].values()))
    drawn = s * (1 + 1e-3 * rng.normal(size=(500, *s.shape)))
    off = (drawn - s) @ ridge.matrix.T
    measured = np.sqrt(np.mean(off**2, axis=(0, 1)) / np.mean((s @ ridge.matrix.T) ** 2, axis=0))
    np.testing.assert_allclose(ridge.figures["noise_amplification"], measured / 1e-3, rtol=0.02)


def test_how_bright_a_light_was_does_not_count_with_ridge(primaries):
    signals, variances, radiances = session()
    plain = chart_fit(primaries, (signals, variances, radiances), method="ridge")
    factor = {"A": 0.001, "D65": 0.01, "F2": 0.0002, "D50": 0.004}
    scaled = (
        {k: v * factor[k] for k, v in signals.items()},
        {k: v * factor[k] ** 2 for k, v in variances.items()},
        {k: Spectra(v.wavelengths, v.names, v.values * factor[k]) for k, v in radiances.items()},
    )
    bright = chart_fit(primaries, scaled, method="ridge")
    np.testing.assert_allclose(bright.matrix, plain.matrix, rtol=1e-6)


def test_clipped_patches_are_left_out(primaries):
    signals, variances, radiances = session()
    signals["A"][18, 0] = np.nan
    got = chart_fit(primaries, (signals, variances, radiances))
    assert got.figures["samples"] == 95
    assert got.figures["samples_left_out"] == 1


def test_a_light_that_clips_a_band_in_every_patch_is_named(primaries):
    signals, variances, radiances = session()
    signals["A"][:, 2] = np.nan
    with pytest.raises(InputError, match="light 'A': no patch is known in every band"):
        chart_fit(primaries, (signals, variances, radiances))


@pytest.mark.slow
def test_left_out_lights_are_seen_only_from_outside(primaries):
    """A light whose readings are wrong is found by fitting the others."""
    signals, variances, radiances = session()
    wrong = radiances["F2"]
    tilted = wrong.values * (1 + 0.3 * step(550, 20))[:, None]
    radiances["F2"] = Spectra(wrong.wavelengths, wrong.names, tilted)
    got = chart_fit(primaries, (signals, variances, radiances)).figures
    good = chart_fit(primaries, session()).figures
    assert got["leave_one_light_out_delta_e"]["worst_light"] == "F2"
    assert good["leave_one_light_out_delta_e"]["mean"] < got["leave_one_light_out_delta_e"]["mean"]


def test_one_light_has_no_leave_one_light_out(primaries):
    got = chart_fit(primaries, session(lights=("D65",)))
    assert "leave_one_light_out_delta_e" not in got.figures


# ---- by colour


@pytest.fixture(scope="module")
def five():
    return session(lights=("A", "D65", "D50", "F2", "F11"), noise=0.001)


@pytest.mark.slow
def test_by_colour_is_no_worse_than_the_pseudo_inverse_on_lights_never_seen(five, bands, primaries):
    """Lamps that no light of the session is: the colours of a chart, rendered, and of white."""
    lamps = sets.lights("cie-led+cie-fl3+planckian").values.T
    chart = np.vstack([sets.surfaces("colorchecker24").values.T, np.ones(36)])
    true = sets.xyz(lamps[:, None] * chart)
    xyz_from = primaries.xyz_from_primaries

    def error(transform):
        light = lamps @ bands[1] @ transform.matrix.T
        seen = (light[:, None] * primaries.project(chart)) @ xyz_from.T
        to_d65 = [cat02(white, D65) / white[1] for white in true[:, -1]]
        pairs = zip(true, seen, to_d65, strict=True)
        return np.mean([delta_e_2000(lab(t @ a.T), lab(s @ a.T)) for t, s, a in pairs])

    by_colour = chart_fit(primaries, five, method="delta-e")
    plain = chart_fit(primaries, five, method="pinv")
    chosen = by_colour.figures["chosen"]
    left_out = chosen["rendered_delta_e_left_out"]
    assert chosen["method"] == "curves"
    assert left_out["curves"] < left_out["ridge"]
    assert error(by_colour) < error(plain)
    assert max(by_colour.figures["noise_amplification"]) < 12.0


def test_white_at_half_a_percent_of_band_noise_stays_within_one_delta_e(five, bands, primaries):
    """The mean difference of noise really drawn, over five lights; camera and filters set most."""
    got = chart_fit(primaries, five, method="delta-e")
    rng = np.random.default_rng(9)
    to_xyz = primaries.xyz_from_primaries @ got.matrix
    means = []
    for light in sets.lights("darling2011").only(["A", "D65", "D75", "F2", "F11"]).values.T:
        signal = light @ bands[1]
        noisy = signal * (1 + 0.005 * rng.normal(size=(5000, 6)))
        white = to_xyz @ signal
        adapted = cat02(white, D65) / white[1] @ to_xyz
        means.append(delta_e_2000(lab(adapted @ signal), lab(noisy @ adapted.T)).mean())
    assert np.mean(means) < 1.0


def test_with_too_few_lights_ridge_is_kept_and_said(primaries):
    given = session(lights=("D65", "A"))
    got = chart_fit(primaries, given, method="delta-e")
    ridge = chart_fit(primaries, given, method="ridge")
    np.testing.assert_array_equal(got.matrix, ridge.matrix)
    assert got.figures["chosen"]["method"] == "ridge"
    assert "three lights" in got.figures["chosen"]["because"]


def test_what_stands_out_is_named_to_be_measured_again(primaries):
    signals, variances, radiances = session()
    values = radiances["D50"].values.copy()
    values[:, 6] *= 1 + 0.5 * step(600, 10)
    radiances["D50"] = Spectra(WAVELENGTHS, radiances["D50"].names, values)
    got = chart_fit(primaries, (signals, variances, radiances), method="ridge")
    assert got.figures["remeasure"][0].startswith("patch 7 under D50: ")
    assert len(got.figures["sample_delta_e"]) == 24
    assert list(got.figures["light_delta_e"]) == ["A", "D65", "F2", "D50"]


# ---- reflectance


def test_m_r_gives_a_charts_reflectance_and_white_stays_white(bands, primaries):
    given = session(lights=("A", "D65", "D50", "F2"), noise=0.001)
    got = fit(seen(given, quantity="reflectance"), primaries)
    assert got.quantity == "reflectance"
    np.testing.assert_allclose(got.matrix @ np.ones(6), 1.0, atol=0.01)
    light, chart = sets.lights("darling2011")["D75"], sets.surfaces("colorchecker24").values.T
    signal = (chart * light) @ bands[1] / ((chart[18] * light) @ bands[1])
    expected = primaries.project(chart / chart[18])
    assert np.sqrt(np.mean((signal @ got.matrix.T - expected) ** 2)) < 0.04


# ---- from known sensitivities


def test_white_in_room_light_keeps_its_colour(camera, filters, bands):
    """Daylight, tungsten and their mixtures: the light most rooms have. Colour alone, as of a
    bracket that is exposed so well that noise hardly needs heed."""
    primaries = load("darling2011")
    known = fit(computed(camera, filters), primaries, noise_level=0.007)
    daylight, tungsten = sets.lights("daylight").values.T, sets.lights("planckian").values.T[1:9]
    mixed = 0.5 * daylight[::4, None] + 0.5 * tungsten[None]
    for lights, mean, most in (
        (daylight, 0.2, 0.3),
        (tungsten, 0.3, 0.6),
        (mixed.reshape(-1, 36), 0.2, 0.4),
        (sets.lights("darling2011").values.T, 0.5, 1.3),
    ):
        errors = whites_error(known, bands[1], primaries, lights)
        assert errors.mean() < mean
        assert errors.max() < most


def test_equal_energy_light_comes_out_in_the_unit_that_is_stated(known, bands):
    """Radiance 1 gives signal 1 in the most sensitive band, and comes back as about 1."""
    signal = np.ones(36) @ bands[1]
    assert signal.max() == pytest.approx(1.0)
    np.testing.assert_allclose(known.matrix @ signal, 1.0, atol=0.12)
    assert not known.absolute
    assert "equal-energy" in known.units


def test_noise_stays_bounded(known):
    """Twelve times is what is allowed; see the pseudo-inverse's dozens above."""
    assert max(known.figures["noise_amplification"]) < 12.0
    assert known.figures["leave_one_light_out_delta_e"]["mean"] < 1.0


@pytest.mark.skipif(not DATA.is_dir(), reason="the measured cameras are not beside the checkout")
@pytest.mark.parametrize("primaries_name", ["darling2011", "signed6"])
@pytest.mark.parametrize(
    "camera_name", ["Canon_EOS_600D", "Canon_EOS_R5", "Nikon_D5100", "Sony_ILCE-7M3"]
)
def test_a_white_through_real_filters_stays_within_one_delta_e(camera_name, primaries_name):
    """At half a percent of noise in every band: the mean over draws and the paper's lights."""
    camera = read_spectra(DATA / "cameras" / f"{camera_name}.csv", "power")
    wratten = read_spectra(DATA / "filters" / "wratten.csv", "fraction").resampled()
    yellow = read_spectra(DATA / "filters" / "Tiffen_Deep_yellow_15.csv", "fraction").resampled()
    glass = np.hstack([wratten["38A"][:, None], yellow.values])
    pair = Spectra(WAVELENGTHS, ("cyan", "yellow"), glass)
    primaries = load(primaries_name)
    got = fit(computed(camera, pair), primaries)
    assert max(got.figures["noise_amplification"]) < 12.0
    _, curves = sensitivities(camera, pair)
    rng = np.random.default_rng(9)
    to_xyz = primaries.xyz_from_primaries @ got.matrix
    means = []
    for light in sets.lights("darling2011").values.T:
        noisy = light @ curves * (1 + 0.005 * rng.normal(size=(1000, 6)))
        white = to_xyz @ (light @ curves)
        adapted = cat02(white, D65) / white[1]
        means.append(delta_e_2000(lab(adapted @ white), lab(noisy @ (adapted @ to_xyz).T)).mean())
    assert np.mean(means) < 1.0


def test_where_noise_would_be_amplified_too_much_more_of_it_is_expected(camera, filters, primaries):
    """Filters that hardly differ, and next to no noise expected: the bound acts."""
    alike = filters.values[:, [0, 0]] * np.stack([np.ones(36), 1.0 - 0.3 * step(560, 15)], axis=1)
    nearly = Spectra(WAVELENGTHS, ("a", "b"), alike)
    got = fit(computed(camera, nearly), primaries, noise_level=1e-4)
    assert max(got.figures["noise_amplification"]) <= MOST_AMPLIFIED
    assert got.noise_level > 1e-4
    plain = fit(computed(camera, nearly), primaries, method="pinv")
    assert max(plain.figures["noise_amplification"]) > MOST_AMPLIFIED


def test_the_white_noise_that_is_stated_is_that_of_noise_really_drawn(known, bands, primaries):
    rng = np.random.default_rng(5)
    lights = sets.scaled_to_unit_luminance(sets.lights("room").values).T
    to_xyz = primaries.xyz_from_primaries @ known.matrix
    squares = []
    for light in lights:
        signal = light @ bands[1]
        noisy = signal * (1 + 0.005 * rng.normal(size=(2000, 6)))
        white = to_xyz @ signal
        adapted = cat02(white, D65) / white[1]
        off = delta_e_2000(lab(adapted @ white), lab(noisy @ (adapted @ to_xyz).T))
        squares.append(np.mean(off**2))
    stated = known.figures["white_noise_delta_e"]["mean"]
    assert stated == pytest.approx(np.mean(np.sqrt(squares)), rel=0.05)


def test_the_filters_come_in_the_captures_order(camera, filters, primaries, known):
    turned = fit(computed(camera, filters, filter_names=["yellow", "cyan"]), primaries)
    assert turned.channels[0] == "yellow.R"
    np.testing.assert_allclose(turned.matrix[:, [3, 4, 5, 0, 1, 2]], known.matrix, rtol=1e-6)


def test_nine_bands_and_eight_primaries_are_as_welcome(camera, filters):
    eight = Primaries("eight", gaussians(np.linspace(430, 650, 8), 15.0), np.full((3, 8), 1 / 8))
    red = (0.05 + 0.9 * step(590, 8))[:, None]
    three = Spectra(WAVELENGTHS, (*filters.names, "red"), np.hstack([filters.values, red]))
    got = fit(computed(camera, three), eight)
    assert got.matrix.shape == (8, 9)


@pytest.mark.skipif(not DATA.is_dir(), reason="the measured cameras are not beside the checkout")
@pytest.mark.parametrize("name", ["Canon_EOS_600D", "Sony_ILCE-7RM3", "Nikon_D700"])
def test_other_cameras_keep_white_too(name, filters, primaries):
    camera = read_spectra(DATA / "cameras" / f"{name}.csv", "power")
    got = fit(computed(camera, filters), primaries)
    _, bands = sensitivities(camera, filters)
    daylight = sets.lights("daylight").values.T
    assert whites_error(got, bands, primaries, daylight).mean() < 0.5


# ---- what is refused


def test_a_band_that_sees_nothing_is_named(camera, filters, primaries):
    blocking = Spectra(WAVELENGTHS, filters.names, filters.values * (WAVELENGTHS > 780)[:, None])
    with pytest.raises(InputError, match="no light together"):
        sensitivities(camera, blocking)
    half = Spectra(WAVELENGTHS, ("a", "b"), filters.values * [[1.0, 0.0]])
    with pytest.raises(InputError, match=r"b\.R sees nothing under 2000 K"):
        fit(computed(camera, half), primaries)


def test_the_same_filter_twice_is_refused(camera, filters, primaries):
    twice = Spectra(WAVELENGTHS, ("a", "b"), filters.values[:, [0, 0]])
    with pytest.raises(InputError, match="follow from the other bands"):
        fit(computed(camera, twice), primaries)


def test_too_few_samples_are_refused(primaries):
    few = TrainingSet(
        channels=tuple("abcdef"),
        lights=("a",),
        signals=np.eye(6)[None, :5],
        spectra=np.ones((1, 5, 36)),
        variances=None,
        counts=np.ones(5),
    )
    with pytest.raises(InputError, match="5 whole samples for 6 bands"):
        fit(few, primaries)
