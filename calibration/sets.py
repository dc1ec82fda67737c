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
    "room": "what lights rooms: black bodies from 2000 to 3400 K, daylight from 4000 to 20000 K, "
    "F1-F12, F40/C50, and the phosphor LEDs B1-B5 of CIE 15:2018",
}
SURFACES = {
    "colorchecker24": "the ColorChecker's patches 1-24, averaged over many (BabelColor)",
    "ces99": "the 99 colour evaluation samples of CIE 224:2017",
    "rawtoaces190": "the 190 training patches of ACES' rawtoaces",
    "white": "a perfect reflector",
}
CAMERAS = {"nikon5100": "Nikon D5100, R G B, measured by NPL (Darrodi et al. 2015)"}

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
    "room": _room,
}
_SURFACES: dict[str, Callable[[], Spectra]] = {
    "colorchecker24": _colorchecker24,
    "ces99": _ces99,
    "rawtoaces190": _rawtoaces190,
    "white": _white,
}
_CAMERAS: dict[str, Callable[[], Spectra]] = {"nikon5100": _nikon5100}
assert set(_LIGHTS) == set(LIGHTS)
assert set(_SURFACES) == set(SURFACES)
assert set(_CAMERAS) == set(CAMERAS)
