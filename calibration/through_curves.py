"""The best linear estimate for all the light that is likely, by the camera's estimated curves.

A chart's few colours under a few lights leave a matrix badly determined, but they say enough of the
camera's curves (`calibration.bands`) to compute what it would see of much more light. Where the
curves are not sure the computed signals have so much more variance, as if by noise: integrating
over all that the curves may be gives just that. With K the second moment E[s s'] of the light
expected, A the primaries' curves, B the camera's by their mean and C_b the covariance of band b,

    M = A' K B (B' K B + N)^-1,        N = diag of  level^2 (B' K B)_bb + trace(C_b K).
"""

from __future__ import annotations

import functools
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration import sets, training
from calibration.bands import estimated
from calibration.linear import Samples
from calibration.primaries import Primaries

# How much the session's own lights count beside those of rooms: the user took them for a reason.
# Lights left out hardly tell 0 from .5; with more, the accidents of a few lights are learnt.
_OWN_SHARE = 0.3


@dataclass(frozen=True)
class ThroughCurves:
    """The solver of M_S from what a session's samples say of the camera's curves."""

    samples: Samples
    primaries: Primaries
    noise_level: float

    def solved(self, without: Collection[str] = ()) -> NDArray[np.float64]:
        """The matrix (P, B) from the readings of all lights, or of all but some."""
        known = self.samples.without(without)
        scale = known.scale[:, None]
        curves = estimated(known.signals / scale, known.spectra / scale)
        own = known.spectra[[known.brightest(light) for light in known.lights]]
        moment = (1.0 - _OWN_SHARE) * _room_moment() + _OWN_SHARE * _moment(own)
        left = curves.mean.T @ moment @ curves.mean
        noise = self.noise_level**2 * np.diag(left) + curves.variances(moment)
        right = curves.mean.T @ moment @ self.primaries.curves
        return np.asarray(np.linalg.solve(left + np.diag(noise), right).T, np.float64)


@functools.cache
def _room_moment() -> NDArray[np.float64]:
    return _moment(sets.lights(training.ROOM_LIGHTS).values.T)


def _moment(lights) -> NDArray[np.float64]:
    """E[s s'] (36, 36) of lights (L, 36), each with Y = 1, on the room's surfaces and white.

    Of the products of all lights l with all surfaces r it is E[l l'] E[r r'], element by element.
    """
    rows, counts = training.with_white(sets.surfaces(training.ROOM_SURFACES))
    lights = lights / sets.xyz(lights)[:, 1:2]
    of_surfaces = (rows.T * (counts / counts.sum())) @ rows
    moment: NDArray[np.float64] = (lights.T @ lights / len(lights)) * of_surfaces
    return moment
