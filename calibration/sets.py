"""Named sets of lights, surfaces and cameras, all from colour-science, on the common grid.

A name may join several sets with `+`: `surfaces("ces99+rawtoaces190")`.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Iterable
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from calibration.errors import fault
from calibration.spectra import WAVELENGTHS, Spectra, join, resample

COLORCHECKER_LABELS = (
    "dark skin", "light skin", "blue sky", "foliage", "blue flower", "bluish green",
    "orange", "purplish blue", "moderate red", "purple", "yellow green", "orange yellow",
    "blue", "green", "red", "yellow", "magenta", "cyan",
    "white 9.5 (.05 D)", "neutral 8 (.23 D)", "neutral 6.5 (.44 D)",
    "neutral 5 (.70 D)", "neutral 3.5 (1.05 D)", "black 2 (1.5 D)",
)  # fmt: skip
"""The ColorChecker's patches 1..24, row by row from the brown corner."""

LIGHTS = {
    "darling2011": "the 19 lights of Darling et al. (2011): A, D40 D50 D65 D75 D90, F1-F12 and a "
    "D50 booth, for which F40/C50 stands in: the booth they measured is not public",
    "cie-fl3": "CIE FL3.1-FL3.15, fluorescent lamps (CIE 15:2004)",
    "cie-hp": "CIE HP1-HP5, high-pressure discharge lamps (CIE 15:2004)",
    "cie-led": "CIE LED illuminants B1-B5, BH1, RGB1, V1, V2 (CIE 15:2018)",
    "lamps": "lamps for general lighting, of NIST's CQS data set (Davis and Ohno)",
    "planckian": "black bodies from 1800 to 20000 K in even steps of mired",
    "daylight": "CIE daylight from 4000 to 20000 K in even steps of mired",
    "leds8": "eight LED lamps that the shipped primaries are not trained on: B3, B5, BH1, RGB1 and "
    "V2 of CIE 15:2018; Luxeon WW 2880, PHOS-2 and 3-LED-1 of NIST's CQS data set",
    "places5": "stand-ins for the five places of Darling et al. (2011), which are not public: "
    "overcast sky (ID65), desk lamp (neodymium bulb), horizon booth (black body of 2240 K), office "
    "(T8 Luxline Plus White), classroom (FL3.13); each through a smooth filter exp(a x + b x^2), "
    "x in wavelength, that gives it the place's chromaticity; not trained on either",
    "training": "what the shipped primaries are trained on: darling2011, cie-led, cie-hp, cie-fl3, "
    "lamps and computed lights (tinted black bodies, three-part LEDs, mixtures), none within .99 "
    "cosine of leds8, of places5 or of the lamps these are made from",
    "room": "what lights rooms: black bodies from 2000 to 3400 K, daylight from 4000 to 20000 K, "
    "F1-F12, F40/C50, and the phosphor LEDs B1-B5 of CIE 15:2018",
}
SURFACES = {
    "colorchecker24": "the ColorChecker's patches 1-24, averaged over many (BabelColor)",
    "ces99": "the 99 colour evaluation samples of CIE 224:2017",
    "rawtoaces190": "the 190 training patches of ACES' rawtoaces",
    "cri14": "the 14 samples of the colour rendering index (CIE 13.3-1995)",
    "cqs15": "the 15 samples of NIST's colour quality scale (Davis and Ohno 2010, version 9.0)",
    "white": "a perfect reflector",
}
CAMERAS = {"nikon5100": "Nikon D5100, R G B, measured by NPL (Darrodi et al. 2015)"}

# The places of the paper's section "Simulation Results": their chromaticities as printed there, and
# the light of colour-science that is filtered to them. Where there is a choice it is a light unlike
# all others (the incandescent and daylight places cannot be), so that leaving it out costs least.
_PLACES = {
    "cloudy outdoors": ("ID65", (0.317, 0.329)),
    "desk lamp": ("Neodimium Incandescent", (0.456, 0.404)),
    "horizon booth": ("2240 K", (0.500, 0.417)),
    "office": ("T8 Luxline Plus White", (0.405, 0.404)),
    "classroom": ("FL3.13", (0.393, 0.391)),
}
_LEFT_OUT_LEDS = (
    "LED-B3", "LED-B5", "LED-BH1", "LED-RGB1", "LED-V2",
    "3-LED-1 (457/540/605)", "Luxeon WW 2880", "PHOS-2",
)  # fmt: skip
# Spectra with a larger cosine than this are one lamp measured twice, or as good as.
_ALIKE = 0.99
_TRAINING_SEED = 2011

# Lamps of one line or a narrow band, or for a projector: nobody lights a room with these.
_NOT_FOR_ROOMS = ("LPS", "SA", "SC", "Kinoton 75P")


def lights(name: str) -> Spectra:
    """The lights of a named set on WAVELENGTHS, relative, each scaled to Y = 1 on white."""
    spectra = _named(name, _LIGHTS, "lights")
    return Spectra(spectra.wavelengths, spectra.names, scaled_to_unit_luminance(spectra.values))


def surfaces(name: str) -> Spectra:
    """The reflectance factors of a named set on WAVELENGTHS."""
    return _named(name, _SURFACES, "surfaces")


def camera(name: str) -> Spectra:
    """A camera's relative spectral sensitivities R, G, B on WAVELENGTHS."""
    return _named(name, _CAMERAS, "cameras")


@functools.cache
def observer() -> NDArray[np.float64]:
    """The CIE 1931 2 degree colour matching functions on WAVELENGTHS (36, 3), sum of y = 1.

    So a light of unit spectral radiance at all wavelengths has Y = 1. They are values at the
    wavelengths, not band averages: summed against band-averaged light they are then exact for
    any line spectrum as far as they are straight between two bands.
    """
    cmf = _colour().MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    at = np.stack([np.interp(WAVELENGTHS, cmf.wavelengths, c) for c in cmf.values.T], axis=1)
    at /= at[:, 1].sum()
    at.flags.writeable = False
    return at


def xyz(spectra) -> NDArray[np.float64]:
    """Tristimulus values (..., 3) of spectra (..., 36) on WAVELENGTHS; equal energy 1 is Y = 1."""
    return np.asarray(spectra, np.float64) @ observer()


def scaled_to_unit_luminance(values) -> NDArray[np.float64]:
    """Light spectra (36, n) scaled so that each has Y = 1 on a perfect white."""
    values = np.asarray(values, np.float64)
    return values / (observer()[:, 1] @ values)


def _colour() -> ModuleType:
    with warnings.catch_warnings():
        # It warns that plotting is missing without matplotlib, which nothing here needs.
        warnings.filterwarnings("ignore", message='.*"Matplotlib" related API features')
        import colour  # 1.6 s

    return colour


def _named(name: str, known: dict[str, Callable[[], Spectra]], what: str) -> Spectra:
    unknown = [part for part in name.split("+") if part not in known]
    if unknown:
        raise fault(
            f"no {what} are called {unknown[0]!r}", ", ".join(known), "name one, or join with +"
        )
    return join(known[part]() for part in name.split("+"))


def _of(distributions, names: Iterable[str]) -> Spectra:
    """Named spectral distributions of colour-science, band-averaged."""
    names = tuple(names)
    columns = [
        resample(distributions[n].wavelengths, distributions[n].values[:, None]) for n in names
    ]
    return Spectra(WAVELENGTHS, names, np.concatenate(columns, axis=1))


@functools.cache
def _darling2011() -> Spectra:
    colour = _colour()
    fluorescent = _of(colour.SDS_ILLUMINANTS, [f"FL{i}" for i in range(1, 13)])
    return join(
        [
            _of(colour.SDS_ILLUMINANTS, ["A"]),
            _daylights([4000, 5000, 6500, 7500, 9000]),
            Spectra(WAVELENGTHS, tuple(f"F{i}" for i in range(1, 13)), fluorescent.values),
            # A 5000 K lamp made for viewing booths.
            _of(colour.SDS_LIGHT_SOURCES, ["F40/C50 (Broadband FL)"]),
        ]
    )


def _daylights(nominal_k: Iterable[float]) -> Spectra:
    """CIE daylight of nominal temperatures: D65 is 6504 K since c2 was revised to .014388 m K."""
    colour = _colour()
    names, columns = [], []
    for kelvin in nominal_k:
        xy = colour.temperature.CCT_to_xy_CIE_D(kelvin * 1.4388 / 1.4380)
        daylight = colour.sd_CIE_illuminant_D_series(xy)
        names.append(f"D{kelvin / 100:.0f}")
        columns.append(resample(daylight.wavelengths, daylight.values[:, None]))
    return Spectra(WAVELENGTHS, tuple(names), np.concatenate(columns, axis=1))


@functools.cache
def _daylight() -> Spectra:
    return _daylights(_even_mired(4000, 20000, 16))


@functools.cache
def _planckian() -> Spectra:
    return _black_bodies(_even_mired(1800, 20000, 24))


def _black_bodies(kelvin: NDArray[np.float64]) -> Spectra:
    names = tuple(f"{k:.0f} K" for k in kelvin)
    return Spectra(WAVELENGTHS, names, planck(WAVELENGTHS[:, None], kelvin))


def _even_mired(first_k: float, last_k: float, count: int) -> NDArray[np.float64]:
    """Temperatures in even steps of 1/K, which look about even."""
    return 1e6 / np.linspace(1e6 / first_k, 1e6 / last_k, count)


def planck(wavelength_nm, kelvin):
    """A black body's spectral radiance, W/(sr m2 nm)."""
    c1, c2 = 1.191042972e-16, 1.438776877e-2  # 2 h c^2 in W m2, h c / k in m K (CODATA 2018)
    metres = np.asarray(wavelength_nm, np.float64) * 1e-9
    return c1 / metres**5 / np.expm1(c2 / (metres * kelvin)) * 1e-9


def _starting(prefix: str) -> Spectra:
    table = _colour().SDS_ILLUMINANTS
    return _of(table, [name for name in table if name.startswith(prefix)])


@functools.cache
def _lamps() -> Spectra:
    table = _colour().SDS_LIGHT_SOURCES
    return _of(table, [name for name in table if name not in _NOT_FOR_ROOMS])


@functools.cache
def _leds8() -> Spectra:
    return join([_starting("LED-"), _lamps()]).only(_LEFT_OUT_LEDS)


@functools.cache
def _places() -> tuple[Spectra, Spectra]:
    """The stand-ins for the five places, and the lights they are made from."""
    colour = _colour()
    known = join(
        [
            _of(colour.SDS_ILLUMINANTS, ["ID65", "FL3.13"]),
            _lamps(),
            _black_bodies(np.array([2240.0])),
        ]
    )
    lamps = known.only(lamp for lamp, _ in _PLACES.values())
    filtered = [
        _filtered_to(spectrum, np.array(xy))
        for spectrum, (_, xy) in zip(lamps.values.T, _PLACES.values(), strict=True)
    ]
    return Spectra(WAVELENGTHS, tuple(_PLACES), np.stack(filtered, axis=1)), lamps


def _filtered_to(spectrum, xy) -> NDArray[np.float64]:
    """A light (36,) through the smooth filter exp(a x + b x^2) that gives it a chromaticity."""
    powers = _smooth_powers()
    exponents = np.zeros(2)
    for _ in range(50):  # Newton's steps: the filter's slopes are the powers themselves
        light = spectrum * np.exp(powers @ exponents)
        found = xyz(light)
        slopes = (light[:, None] * powers).T @ observer()  # (2, 3)
        total = found.sum()
        miss = found[:2] / total - xy
        if np.abs(miss).max() < 1e-12:
            break
        jacobian = (slopes[:, :2] - (found[:2] / total) * slopes.sum(axis=1)[:, None]) / total
        exponents -= np.linalg.solve(jacobian.T, miss)
    return light


def _smooth_powers() -> NDArray[np.float64]:
    """x and x^2 (36, 2), x from -1 to 1 over the range of wavelengths."""
    middle = (WAVELENGTHS[0] + WAVELENGTHS[-1]) / 2.0
    x = (WAVELENGTHS - middle) / (WAVELENGTHS[-1] - middle)
    return np.stack([x, x**2], axis=1)


@functools.cache
def _training() -> Spectra:
    measured = join(
        [_darling2011(), _starting("LED-"), _starting("HP"), _starting("FL3."), _lamps()]
    )
    measured = measured.only(dict.fromkeys(measured.names))  # F40/C50 is in two of them
    measured = _unlike_tests(measured)
    rng = np.random.default_rng(_TRAINING_SEED)
    computed = join([_tinted_black_bodies(rng, 40), _three_part_leds(rng, 30)])
    mixed = _mixtures(rng, computed, 20)
    return join([measured, _unlike_tests(computed), _unlike_tests(mixed)])


def _unlike_tests(spectra: Spectra) -> Spectra:
    """Those that are not within _ALIKE cosine of any light kept for tests."""
    places, lamps = _places()
    tests = np.concatenate([_leds8().values, places.values, lamps.values], axis=1)
    cosines = _unit(spectra.values).T @ _unit(tests)
    return spectra.only(
        name for name, row in zip(spectra.names, cosines, strict=True) if row.max() <= _ALIKE
    )


def _unit(columns) -> NDArray[np.float64]:
    return columns / np.linalg.norm(columns, axis=0)


def _tinted_black_bodies(rng, count: int) -> Spectra:
    """Black bodies and what smooth filters and walls make of them."""
    kelvin = 1e6 / rng.uniform(1e6 / 15000, 1e6 / 1900, count)
    tint = np.exp(_smooth_powers() @ rng.normal(0.0, 0.3, (2, count)))
    names = tuple(f"tinted {k:.0f} K, {i}" for i, k in enumerate(kelvin))
    return Spectra(WAVELENGTHS, names, planck(WAVELENGTHS[:, None], kelvin) * tint)


def _three_part_leds(rng, count: int) -> Spectra:
    """White lights of a blue, a green and a red part, each a Gaussian in wavelength.

    The blue part is a diode, the others diodes or phosphors; their amounts make a black body's
    chromaticity, a little off.
    """
    columns: list[NDArray[np.float64]] = []
    while len(columns) < count:
        diode = rng.random(2) < 0.4
        peaks = np.array([rng.uniform(435, 475), rng.uniform(515, 570), rng.uniform(595, 655)])
        sigmas = np.array(
            [
                rng.uniform(7, 13),
                rng.uniform(11, 18) if diode[0] else rng.uniform(25, 55),
                rng.uniform(6, 12) if diode[1] else rng.uniform(25, 55),
            ]
        )
        parts = np.exp(-0.5 * ((WAVELENGTHS[:, None] - peaks) / sigmas) ** 2)
        white = xyz(planck(WAVELENGTHS, 1e6 / rng.uniform(1e6 / 9000, 1e6 / 2300)))
        white = white / white.sum()
        xy = white[:2] + rng.normal(0.0, 0.006, 2)
        amounts = np.linalg.solve(xyz(parts.T).T, np.append(xy, 1.0 - xy.sum()))
        if amounts.min() > 0.0:
            columns.append(parts @ amounts)
    names = tuple(f"three-part LED {i}" for i in range(count))
    return Spectra(WAVELENGTHS, names, np.stack(columns, axis=1))


def _mixtures(rng, of: Spectra, count: int) -> Spectra:
    """Pairs of lights, as where a window and a lamp meet."""
    values = scaled_to_unit_luminance(of.values)
    first, second = rng.integers(len(of), size=(2, count))
    share = rng.uniform(0.15, 0.85, count)
    names = tuple(
        f"{s:.2f} {of.names[i]} + {1 - s:.2f} {of.names[j]}"
        for s, i, j in zip(share, first, second, strict=True)
    )
    return Spectra(WAVELENGTHS, names, share * values[:, first] + (1.0 - share) * values[:, second])


@functools.cache
def _room() -> Spectra:
    paper = _darling2011()
    return join(
        [
            _black_bodies(_even_mired(2000, 3400, 8)),
            _daylights(_even_mired(4000, 20000, 12)),
            paper.only([*(f"F{i}" for i in range(1, 13)), "F40/C50 (Broadband FL)"]),
            _starting("LED-B").only(f"LED-B{i}" for i in range(1, 6)),
        ]
    )


@functools.cache
def _colorchecker24() -> Spectra:
    patches = _of(_colour().SDS_COLOURCHECKERS["BabelColor Average"], COLORCHECKER_LABELS)
    return Spectra(WAVELENGTHS, tuple(str(i) for i in range(1, 25)), patches.values)


@functools.cache
def _ces99() -> Spectra:
    colour = _colour()
    # The samples are published per nm and per 5 nm; the fine ones are band-averaged here.
    from colour.quality.cfi2017 import load_TCS_CIE2017

    samples = load_TCS_CIE2017(colour.SpectralShape(380, 780, 1))
    names = tuple(f"CES{i:02d}" for i in range(1, samples.values.shape[1] + 1))
    return Spectra(WAVELENGTHS, names, resample(samples.wavelengths, samples.values))


@functools.cache
def _rawtoaces190() -> Spectra:
    _colour()
    from colour.characterisation import read_training_data_rawtoaces_v1

    patches = read_training_data_rawtoaces_v1()
    values = np.maximum(resample(patches.wavelengths, patches.values), 0.0)  # one is -2e-16
    return Spectra(WAVELENGTHS, tuple(patches.labels), values)


@functools.cache
def _cri14() -> Spectra:
    samples = _colour().quality.SDS_TCS["CIE 1995"]
    return _of(samples, samples)


@functools.cache
def _cqs15() -> Spectra:
    samples = _colour().quality.SDS_VS["NIST CQS 9.0"]
    return _of(samples, samples)


def _white() -> Spectra:
    return Spectra(WAVELENGTHS, ("white",), np.ones((len(WAVELENGTHS), 1)))


@functools.cache
def _nikon5100() -> Spectra:
    curves = _colour().MSDS_CAMERA_SENSITIVITIES["Nikon 5100 (NPL)"]
    return Spectra(WAVELENGTHS, ("R", "G", "B"), resample(curves.wavelengths, curves.values))


_LIGHTS: dict[str, Callable[[], Spectra]] = {
    "darling2011": _darling2011,
    "cie-fl3": lambda: _starting("FL3."),
    "cie-hp": lambda: _starting("HP"),
    "cie-led": lambda: _starting("LED-"),
    "lamps": _lamps,
    "planckian": _planckian,
    "daylight": _daylight,
    "leds8": _leds8,
    "places5": lambda: _places()[0],
    "training": _training,
    "room": _room,
}
_SURFACES: dict[str, Callable[[], Spectra]] = {
    "colorchecker24": _colorchecker24,
    "ces99": _ces99,
    "rawtoaces190": _rawtoaces190,
    "cri14": _cri14,
    "cqs15": _cqs15,
    "white": _white,
}
_CAMERAS: dict[str, Callable[[], Spectra]] = {"nikon5100": _nikon5100}
assert set(_LIGHTS) == set(LIGHTS)
assert set(_SURFACES) == set(SURFACES)
assert set(_CAMERAS) == set(CAMERAS)
