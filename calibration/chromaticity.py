"""What a light's XYZ says of it: chromaticity, colour temperature, whether light can look so."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.spectra import WAVELENGTHS

_NEAR = 0.05  # Duv beyond which CIE 15 calls no temperature correlated
_RANGE_K = 1000.0, 50000.0
_OUTSIDE = 0.01  # of X + Y + Z: the locus is drawn with chords of 10 nm, and noise is in all


@dataclass(frozen=True)
class Temperature:
    """kelvin  correlated colour temperature, K
    duv     distance from the Planckian locus in u, v of CIE 1960; above it, to the green, positive
    """

    kelvin: float
    duv: float


def chromaticity(xyz) -> tuple[float, float] | None:
    """x, y of a light's XYZ (3,); None where it adds up to nothing."""
    x, y, z = (float(v) for v in xyz)
    total = x + y + z
    return (x / total, y / total) if total > 0 else None


def temperature(xyz) -> Temperature | None:
    """The correlated colour temperature of a light's XYZ (3,), of any level.

    None where the light is no near-white: CIE 15 defines none further than .05 from the locus; and
    outside 1000 to 50000 K.
    Source: Y. Ohno, "Practical use and calculation of CCT and Duv" (2013).
    """
    from colour.temperature import uv_to_CCT_Ohno2013
    from colour.utilities import ColourRuntimeWarning

    xy = chromaticity(xyz)
    if xy is None:
        return None
    x, y = xy
    divisor = -2.0 * x + 12.0 * y + 3.0
    if divisor <= 0:
        return None
    with warnings.catch_warnings():
        # Of lights beyond the ends of its table, which are beyond _RANGE_K.
        warnings.simplefilter("ignore", ColourRuntimeWarning)
        kelvin, duv = uv_to_CCT_Ohno2013(np.array([4.0 * x / divisor, 6.0 * y / divisor]))
    low, high = _RANGE_K
    if not (abs(duv) <= _NEAR and low < kelvin < high):
        return None
    return Temperature(float(kelvin), float(duv))


def planckian_locus(count: int = 400) -> NDArray[np.float64]:
    """Rows T, u, v (count, 3): black bodies in CIE 1960's diagram over the range of `temperature`,
    at temperatures in equal ratios."""
    from colour.temperature import CCT_to_uv_Ohno2013

    kelvin = np.geomspace(*_RANGE_K, count)
    uv = CCT_to_uv_Ohno2013(np.stack([kelvin, np.zeros(count)], axis=1))
    return np.column_stack([kelvin, uv])


def possible(xyz) -> NDArray[np.bool_]:
    """Whether light can have these XYZ (..., 3): inside the spectral locus and the purple line.

    False says that a matrix was not made for the signals it was given, or that they are noise.
    """
    from calibration.sets import observer

    xyz = np.asarray(xyz, np.float64)
    locus = observer()[(WAVELENGTHS >= 400) & (WAVELENGTHS <= 700)]
    locus = locus / locus.sum(axis=1, keepdims=True)
    # Clockwise about the whites, with the purple line from the last to the first.
    edges = np.roll(locus, -1, axis=0) - locus
    outward = np.stack([-edges[:, 1], edges[:, 0]], axis=1)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    total = xyz.sum(axis=-1)
    beyond = xyz[..., :2] @ outward.T - total[..., None] * np.sum(locus[:, :2] * outward, axis=1)
    return np.asarray((total > 0) & (beyond.max(axis=-1) <= _OUTSIDE * total))
