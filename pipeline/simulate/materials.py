"""Measured spectra for things in a room: reflectances, lights, daylight, the sphere's steel.

Everything is taken from data that others measured: reflectances and lamps from colour-science
(the 24 patches of BabelColor's average ColorChecker and the 190 training patches of rawtoaces),
n and k of stainless steel from refractiveindex.info (CC0). A thing of the room names the colour
it should have, and gets the measured reflectance that comes nearest to it.
"""

from __future__ import annotations

import importlib
import warnings
from functools import cache
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from calibration.difference import lab
from calibration.errors import fault
from calibration.spectra import WAVELENGTHS, resample

FINE = np.arange(380.0, 731.0, 5.0)  # nm; those sensors, filters and lamps are tabulated at

# Efficacy of radiation at 555 nm, lm/W: the definition of the candela.
KM = 683.002


def require(module: str) -> ModuleType:
    """The optional package `module`, or an InputError that says how to install it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise fault(
            f"simulating needs the package {module}, which cannot be imported ({error})",
            "",
            "pip install 'sixlight[simulate]'",
        ) from error


@cache
def colour_science() -> ModuleType:
    """The package `colour`, without its remarks on plotting packages that are not installed."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*related API features are not available.*")
        return importlib.import_module("colour")


@cache
def lamp(name: str) -> NDArray[np.float64]:
    """A lamp of colour-science by name at FINE (71,).

    Scaled to a luminance of 1 cd/m2 where it stands for spectral radiance in W/(sr m2 nm).
    """
    spectrum = colour_science().SDS_ILLUMINANTS[name]
    return unit_luminance(np.interp(FINE, spectrum.wavelengths, spectrum.values))


@cache
def daylight(kelvin: float) -> NDArray[np.float64]:
    """CIE daylight of a correlated colour temperature at WAVELENGTHS, 1 cd/m2."""
    colour = colour_science()
    xy = colour.temperature.CCT_to_xy_CIE_D(kelvin)
    spectrum = colour.sd_CIE_illuminant_D_series(xy)
    return unit_luminance(resample(spectrum.wavelengths, spectrum.values[:, None])[:, 0])


@cache
def blackbody(kelvin: float) -> NDArray[np.float64]:
    """Planck's law at WAVELENGTHS, scaled to 1 cd/m2."""
    wavelength_m = WAVELENGTHS * 1e-9
    c2 = 1.438776877e-2  # m K, second radiation constant
    return unit_luminance(wavelength_m**-5 / np.expm1(c2 / (wavelength_m * kelvin)))


@cache
def _matching(count: int) -> NDArray[np.float64]:
    """CIE 1931 2 degree colour matching functions (K, 3) at FINE or WAVELENGTHS."""
    colour = colour_science()
    curves = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    onto = FINE if count == len(FINE) else WAVELENGTHS
    return np.stack([np.interp(onto, curves.wavelengths, c) for c in curves.values.T], axis=1)


def xyz(radiance) -> NDArray[np.float64]:
    """Tristimulus values (..., 3), Y in cd/m2, of radiance (..., 36 or 71) in W/(sr m2 nm)."""
    radiance = np.asarray(radiance, np.float64)
    count = radiance.shape[-1]
    step = 10.0 if count == len(WAVELENGTHS) else 5.0
    return KM * step * (radiance @ _matching(count))


def unit_luminance(values) -> NDArray[np.float64]:
    """The spectrum (36 or 71,) scaled to a luminance of 1 cd/m2."""
    return np.asarray(values, np.float64) / xyz(values)[1]


@cache
def _measured() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """All measured reflectances (n, 36) and their CIELAB values (n, 3) under D65."""
    colour = colour_science()
    from colour.characterisation import read_training_data_rawtoaces_v1

    checker = colour.SDS_COLOURCHECKERS["BabelColor Average"].values()
    training = read_training_data_rawtoaces_v1()
    curves = [np.interp(WAVELENGTHS, s.wavelengths, s.values) for s in checker]
    for column in training.values.T:
        if column.max() <= 0.95:  # a few give back more than they get
            curves.append(np.interp(WAVELENGTHS, training.wavelengths, column))
    reflectances = np.clip(np.array(curves), 0.005, 0.95)
    light = daylight(6504.0)
    return reflectances, lab(xyz(reflectances * light), xyz(light))


@cache
def paint(srgb: str) -> NDArray[np.float64]:
    """The measured reflectance (36,) whose colour under D65 is nearest to "#rrggbb"."""
    encoded = np.array([int(srgb[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    to_xyz = np.array(  # IEC 61966-2-1
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    )
    wanted = lab(to_xyz @ linear, to_xyz @ np.ones(3))
    reflectances, colours = _measured()
    return reflectances[np.argmin(((colours - wanted) ** 2).sum(axis=1))]


@cache
def checker_patches() -> NDArray[np.float64]:
    """Reflectances (71, 24) of the ColorChecker's patches at FINE, in their usual order."""
    colour = colour_science()
    patches = colour.SDS_COLOURCHECKERS["BabelColor Average"].values()
    return np.stack([np.interp(FINE, s.wavelengths, s.values) for s in patches], axis=1)


@cache
def stainless_steel() -> NDArray[np.complex128]:
    """n + i k of austenitic stainless steel at WAVELENGTHS (Karlsson and Ribbing 1982)."""
    from refractiveindex import RefractiveIndexMaterial

    steel = RefractiveIndexMaterial("other", "stainless steel", "Karlsson-austenitic")
    n = [float(steel.get_refractive_index(w)) for w in WAVELENGTHS]
    k = [float(steel.get_extinction_coefficient(w)) for w in WAVELENGTHS]
    return np.array(n) + 1j * np.array(k)
