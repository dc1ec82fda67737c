"""Spectra from primaries: six numbers say little of 36, so what comes out is an estimate.

The best linear estimate in least squares that agrees with the numbers (Wiener's, without noise):
s = K A (A' K A)^-1 p, with A the primaries' curves, p = A' s the values, and K the second moment
E[s s'] of the spectra that are to be expected. Being linear it is exact in what counts here:
the estimate's own primaries are p again, to the last digits, at any brightness. So it may dip
below 0 a little, and that is kept: clipping would change the six values.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from calibration import sets
from calibration.primaries import Primaries

KINDS = ("light", "reflectance")

# What is expected of light: lamps and daylight as they are and as surfaces send them back.
LIGHTS = "darling2011+cie-led+cie-fl3+planckian+daylight"
SURFACES = "ces99+rawtoaces190"
# Whites and greys are a fifth of what is about, or a white would come out like the average surface,
# whose reflectance rises beyond 650 nm, where the primaries hardly look.
WHITE_SHARE = 0.2

# A share of K that is even in all wavelengths: what no sample has is not impossible.
_EVEN = 1e-4


def spectra_from_primaries(primaries: Primaries, kind: str = "light") -> NDArray[np.float64]:
    """The matrix (36, P) from values in the primaries to spectra on the common grid.

    kind  "light": light of LIGHTS, each with rms 1 (at equal Y the lamps with strong
          lines would decide alone), on SURFACES and white; "reflectance":
          SURFACES and white alone
    """
    curves, expected = primaries.curves, second_moment(kind)
    matrix = np.linalg.solve(curves.T @ expected @ curves, curves.T @ expected).T
    return np.asarray(matrix, np.float64)


def rms_error(primaries: Primaries, kind: str = "light") -> float:
    """The estimate's error over the spectra it is made from, as a share of their size, in rms."""
    return float(np.sqrt(np.trace(_missed(primaries, kind)) / np.trace(second_moment(kind))))


def deviation(primaries: Primaries, kind: str = "light") -> NDArray[np.float64]:
    """How far off the estimate is at each wavelength (36,), for a spectrum whose rms is 1.

    The standard deviation over the spectra it is made from of what six numbers do not say; noise
    of the numbers comes on top, through `spectra_from_primaries`.
    """
    variance = np.diag(_missed(primaries, kind)) / np.mean(np.diag(second_moment(kind)))
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


@cache
def second_moment(kind: str) -> NDArray[np.float64]:
    """E[s s'] (36, 36) of the spectra expected.

    Of the products of all lights l with all surfaces r it is E[l l'] E[r r'], element by element.
    """
    assert kind in KINDS, kind
    reflectances = sets.surfaces(SURFACES).values
    moment = (1.0 - WHITE_SHARE) * reflectances @ reflectances.T / reflectances.shape[1]
    moment = moment + WHITE_SHARE
    if kind == "light":
        lights = sets.lights(LIGHTS).values
        lights = lights / np.sqrt(np.mean(lights**2, axis=0))
        moment = moment * (lights @ lights.T / lights.shape[1])
    even = _EVEN * np.trace(moment) / len(moment)
    result = np.asarray(moment + even * np.eye(len(moment)))
    result.setflags(write=False)  # it is kept, and given out again
    return result


def _missed(primaries: Primaries, kind: str) -> NDArray[np.float64]:
    """E[e e'] (36, 36) of what the estimate is off by, e, over the spectra it is made from."""
    lost = np.eye(len(primaries.curves)) - (
        spectra_from_primaries(primaries, kind) @ primaries.curves.T
    )
    return np.asarray(lost @ second_moment(kind) @ lost.T)
