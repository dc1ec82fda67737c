"""What a metal sphere reflects, by wavelength and angle, from its n and k."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration import sets
from calibration.errors import InputError, fault
from calibration.primaries import Primaries
from calibration.spectra import WAVELENGTHS, Spectra, read_spectra

MATERIALS = {
    "stainless steel": "Karlsson and Ribbing 1982, austenitic (like 316)",
    "chromium": "Rakic et al. 1998, Brendel-Bormann model",
    "nickel": "Johnson and Christy 1974",
    "aluminium": "Rakic 1995",
    "silver": "Johnson and Christy 1972",
}
"""Name and source; the tables in data/metals are from refractiveindex.info (CC0 1.0)."""

DEFAULT = "stainless steel"

_DATA = Path(__file__).parent / "data" / "metals"


def reflectance(material: str | Path, angle_rad) -> NDArray[np.float64]:
    """Reflectance (K, 36) of a bare polished metal on WAVELENGTHS for unpolarised light.

    material   one of MATERIALS, or a CSV of wavelength_nm,n,k
    angle_rad  (K,) angle of incidence, 0 at the normal, up to pi/2
    """
    return fresnel(optical_constants(material), np.asarray(angle_rad, np.float64)[:, None])


def fresnel(index, angle_rad) -> NDArray[np.float64]:
    """Reflectance of a boundary from air, mean of the two polarisations.

    index      complex n + i k
    angle_rad  angle of incidence, 0..pi/2; both broadcast
    """
    cos_i = np.cos(np.asarray(angle_rad, np.float64))
    square = np.asarray(index, np.complex128) ** 2
    inner = np.sqrt(square - 1.0 + cos_i**2)  # index times the cosine inside, Snell's law
    r_s = (cos_i - inner) / (cos_i + inner)
    r_p = (square * cos_i - inner) / (square * cos_i + inner)
    return (np.abs(r_s) ** 2 + np.abs(r_p) ** 2) / 2.0


def optical_constants(material: str | Path) -> NDArray[np.complex128]:
    """n + i k (36,) on WAVELENGTHS of one of MATERIALS, or of a CSV of wavelength_nm,n,k."""
    if str(material) in MATERIALS:
        return _shipped(str(material))
    if Path(material).suffix.lower() != ".csv":
        raise fault(
            f"no material is called {str(material)!r}",
            ", ".join(MATERIALS),
            "name one, or give a CSV of wavelength_nm,n,k",
        )
    return _from_file(Path(material))


def of_sphere(material: str | Path, known: Path | float | None, angle_rad) -> NDArray[np.float64]:
    """Reflectance (K, 36) by angle of a sphere of a metal, by what else is known of it.

    material   as in `reflectance`
    known      near normal: CSV of a measured curve, or a luminous reflectance; None: it is bare
    angle_rad  (K,) angle of incidence, rad
    raises     InputError where the curve is none of a mirror
    """
    if known is None:
        return reflectance(material, angle_rad)
    curve = near_normal(known) if isinstance(known, Path) else dimmed(material, known)
    return measured(curve, material, angle_rad)


def dimmed(material: str | Path, luminous: float) -> NDArray[np.float64]:
    """Near-normal reflectance (36,) of a metal that a worn or coated surface makes darker.

    What the bare metal absorbs is taken to be as much more at every wavelength as it takes.

    material  as in `reflectance`
    luminous  reflectance near normal, in (0, 1], weighted by the eye's sensitivity: of a patch of
              the sphere, say, in which a white of known luminance is seen
    raises    InputError where the metal would reflect less than nothing at some wavelength
    """
    eye = sets.observer()[:, 1]
    absorbed = 1.0 - reflectance(material, [0.0])[0]
    curve = 1.0 - (1.0 - luminous) / (1.0 - (1.0 - absorbed) @ eye / eye.sum()) * absorbed
    if curve.min() <= 0.0:
        raise fault(
            f"a reflectance of {luminous:g}, with which {material} would reflect"
            f" {curve.min():.2g} at {WAVELENGTHS[np.argmin(curve)]:g} nm",
            "a sphere of that metal",
            "correct the number or the material, or give a measured curve",
        )
    return np.asarray(curve)


def near_normal(path: str | Path) -> NDArray[np.float64]:
    """A measured near-normal reflectance (36,) from a CSV of wavelength_nm,reflectance."""
    spectra = read_spectra(path, kind="fraction")
    if spectra.names != ("reflectance",):
        raise fault(
            f"columns {', '.join(spectra.names)}",
            "wavelength_nm,reflectance",
            "give one curve of that name",
            path,
        )
    curve = _resampled(spectra, path).values[:, 0]
    if curve.min() <= 0.0 or curve.max() > 1.0:
        raise fault(
            f"reflectance from {curve.min():.3g} to {curve.max():.3g}",
            "a mirror's: above 0 and at most 1",
            "measure the sphere with its specular component included",
            path,
        )
    return curve


def measured(curve, material: str | Path, angle_rad) -> NDArray[np.float64]:
    """Reflectance (K, 36) by angle of a sphere whose near-normal reflectance was measured.

    What the sphere absorbs, 1 - reflectance, is taken to vary with the angle as the material's
    does. That ratio is much alike for all metals, goes to a reflectance of 1 at grazing angles as
    everything does, and can never exceed it. With steel's shape the error at 80 degrees is .07
    for aluminium, .06 for chromium, .01 for silver and nickel; scaling steel's reflectance itself
    errs by .19, .10, .15 and .03.

    curve      (36,) near-normal reflectance on WAVELENGTHS
    material   as in `reflectance`
    angle_rad  (K,)
    """
    angle_rad = np.asarray(angle_rad, np.float64)
    absorbed = 1.0 - reflectance(material, np.concatenate([[0.0], angle_rad]))
    return np.clip(1.0 - absorbed[1:] / absorbed[0] * (1.0 - np.asarray(curve)), 0.0, 1.0)


def in_primaries(
    primaries: Primaries,
    angle_rad,
    *,
    material: str | Path = DEFAULT,
    known: Path | float | None = None,
) -> NDArray[np.float64]:
    """A sphere's reflectance (K, P) by angle in rendering primaries; the rest as in `of_sphere`."""
    return primaries.project(of_sphere(material, known, angle_rad))


@functools.cache
def _shipped(material: str) -> NDArray[np.complex128]:
    index = _from_file(_DATA / f"{material.replace(' ', '_')}.csv")
    index.flags.writeable = False
    return index


def _from_file(path: Path) -> NDArray[np.complex128]:
    spectra = read_spectra(path)
    if sorted(spectra.names) != ["k", "n"]:
        raise fault(
            f"columns {', '.join(spectra.names)}", "wavelength_nm,n,k", "name the columns so", path
        )
    on_grid = _resampled(spectra, path)
    n, k = on_grid["n"], on_grid["k"]
    if n.min() <= 0.0 or k.min() < 0.0:
        raise fault(
            f"n down to {n.min():g}, k down to {k.min():g}",
            "n above 0, k from 0",
            "give k as a positive number",
            path,
        )
    return n + 1j * k


def _resampled(spectra: Spectra, path: str | Path) -> Spectra:
    try:
        return spectra.resampled()
    except InputError as error:
        raise error.at(path) from None
