"""What a fitted matrix makes of a chart, patch by patch and wavelength by wavelength."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration import bands, sets
from calibration.adaptation import D65, cat02
from calibration.difference import delta_e_2000, lab
from calibration.primaries import Primaries
from calibration.training import TrainingSet


@dataclass(frozen=True)
class Residuals:
    """Colours of a chart's patches, as read and as a matrix makes them of the camera's signals.

    lights    (L,) names          patches  (n,) names
    read_xyz  (L, n, 3) as read, taken to D65 from each light's white (CAT02), which has Y = 1
    made_xyz  (L, n, 3) the same of matrix and primaries; NaN where a patch was left out
    """

    lights: tuple[str, ...]
    patches: tuple[str, ...]
    read_xyz: NDArray[np.float64]
    made_xyz: NDArray[np.float64]

    @property
    def read(self) -> NDArray[np.float64]:
        """CIELAB (L, n, 3) as read."""
        return lab(self.read_xyz)

    @property
    def made(self) -> NDArray[np.float64]:
        """CIELAB (L, n, 3) of matrix and primaries."""
        return lab(self.made_xyz)

    @property
    def delta_e(self) -> NDArray[np.float64]:
        """CIEDE2000 (L, n), NaN where a patch was left out."""
        return delta_e_2000(self.read, self.made)

    def worst(self, light: int, count: int) -> Sequence[tuple[str, float]]:
        """The patches that are furthest off under a light, and by how much."""
        off = np.nan_to_num(self.delta_e[light], nan=-1.0)
        order = np.argsort(-off)[:count]
        return [(self.patches[i], float(off[i])) for i in order if off[i] >= 0.0]


def residuals(matrix, chart: TrainingSet, primaries: Primaries) -> Residuals:
    """Colours of a chart's patches as read, and as a matrix (P, B) makes them of their signals."""
    read = sets.xyz(chart.spectra)
    made = chart.signals @ (primaries.xyz_from_primaries @ matrix).T
    made[~chart.known] = np.nan
    for i, white in enumerate(read[np.arange(len(chart.lights)), chart.white]):
        to_d65 = cat02(white, D65) / white[1]
        read[i], made[i] = read[i] @ to_d65.T, made[i] @ to_d65.T
    return Residuals(chart.lights, chart.names, read, made)


def made_curves(matrix, chart: TrainingSet) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Curves that spectra are weighted with on their way through camera and matrix, estimated.

    Where they equal the primaries' own the matrix is right for every light there is.

    matrix   (P, B)
    returns  (36, P) and their standard deviations (36, P), for the camera's curves are only known
             as far as the chart's spectra tell them apart: see calibration.bands.estimated
    """
    scale = sets.xyz(chart.spectra)[np.arange(len(chart.lights)), chart.white, 1][:, None, None]
    curves = bands.estimated(
        (chart.signals / scale)[chart.known], (chart.spectra / scale)[chart.known]
    )
    variances = np.sum(curves.roots**2, axis=1).T  # (36, B)
    matrix = np.asarray(matrix, np.float64)
    return curves.mean @ matrix.T, np.sqrt(variances @ (matrix**2).T)
