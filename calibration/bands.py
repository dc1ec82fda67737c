"""A camera's bands: known from its curves and its filters', or estimated from what it saw.

Known spectra s and what a band made of them, y = s'b + noise, say much about the band's curve b,
for curves of glass and dyes are smooth. With that as a Gaussian prior, b ~ N(0, K), what is known
of it afterwards is Gaussian too (Wiener's estimate again, as in `calibration.estimate`):

    covariance = (K^-1 + S' W S)^-1        mean = covariance S' W y

with S the spectra, row by row, and W the inverse variances of the noise. How smooth, how large and
how noisy is taken from the readings themselves: what makes them most probable (MacKay, "Bayesian
Interpolation", 1992), the same for all bands of a session.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.errors import fault
from calibration.spectra import WAVELENGTHS, Spectra

# What the evidence chooses from: the distance over which a curve keeps its value, nm; its size, as
# a multiple of the constant curve's that gives the same signals; the readings' relative noise,
# which holds whatever does not fit, such as flare and a chart that is lit unevenly.
_LENGTHS_NM = (15.0, 20.0, 27.0, 36.0)
_SIZES = (1.0, 3.0, 9.0)
_NOISES = (0.001, 0.002, 0.004, 0.008, 0.016)
_FLOOR = 0.01  # the noise is of at least this share of a band's greatest signal
_ROUGH = 1e-6  # share of the prior that is not smooth; keeps it invertible


def sensitivities(
    camera: Spectra, filters: Spectra, filter_names: Sequence[str] | None = None
) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    """Bands of a camera behind filters: their names (B,) and curves (36, B).

    Scaled so that equal-energy light of radiance 1 gives a signal of 1 in the band that sees most
    of it.
    """
    if sorted(camera.names) != ["B", "G", "R"]:
        raise fault(
            f"a camera with the curves {', '.join(camera.names)}",
            "wavelength_nm,R,G,B",
            "name the columns so",
        )
    names = tuple(filters.names if filter_names is None else filter_names)
    missing = [name for name in names if name not in filters.names]
    if missing:
        raise fault(
            f"no transmittance for the filter {missing[0]!r}, only {', '.join(filters.names)}",
            "a column named as each filter of the capture",
            "add or rename the column",
        )
    rgb = camera.only("RGB").resampled().values
    glass = filters.only(names).resampled().values
    bands = (glass[:, :, None] * rgb[:, None, :]).reshape(len(WAVELENGTHS), -1)
    channels = tuple(f"{name}.{colour}" for name in names for colour in "RGB")
    most = bands.sum(axis=0).max()
    if most <= 0.0:
        raise fault("camera and filters pass no light together", "", "check both files")
    return channels, bands / most


@dataclass(frozen=True)
class Curves:
    """Estimated curves of a camera's bands, and how well each is known.

    mean        (36, B)
    roots       (B, 36, 36) R of each band's covariance R'R
    length_nm   over which a curve keeps its value, by the evidence
    noise       relative noise of the readings, by the evidence
    """

    mean: NDArray[np.float64]
    roots: NDArray[np.float64]
    length_nm: float
    noise: float

    def variances(self, moment) -> NDArray[np.float64]:
        """Mean variance (B,) of the bands' signals, for the curves are not known better.

        moment  (36, 36) E[s s'] of the spectra seen
        """
        variances: NDArray[np.float64] = np.einsum(
            "bij,jk,bik->b", self.roots, moment, self.roots, optimize=True
        )
        return variances


def estimated(signals, spectra) -> Curves:
    """The curves that most probably made these signals of these spectra.

    signals  (n, B)          spectra  (n, 36), each light scaled to count alike
    """
    signals, spectra = np.asarray(signals, np.float64), np.asarray(spectra, np.float64)
    flat = np.sqrt(np.mean(signals**2, axis=0) / np.mean(spectra.sum(axis=1) ** 2))
    squares = signals**2 + (_FLOOR * signals.max(axis=0)) ** 2
    # Of relative noise 1; all else scales with its square.
    weights = 1.0 / squares
    left = np.einsum("nb,nv,nw->bvw", weights, spectra, spectra, optimize=True)
    right = np.einsum("nb,nv->bv", weights * signals, spectra)
    least = np.sum(weights * signals**2, axis=0)
    best: tuple[float, tuple[float, float, float]] = (-math.inf, (0.0, 0.0, 0.0))
    for length in _LENGTHS_NM:
        root = _prior_root(length)
        whitened, pulled = root.T @ left @ root, right @ root
        values, vectors = np.linalg.eigh(whitened)
        along = np.einsum("bv,bvw->bw", pulled, vectors) ** 2
        for size, noise in itertools.product(_SIZES, _NOISES):
            gain = (size * flat[:, None] / noise) ** 2
            misfit = (least - np.sum(gain * along / (1.0 + gain * values), axis=1)) / noise**2
            # The logarithm of the readings' probability, but for a constant.
            evidence = -0.5 * np.sum(misfit + np.sum(np.log1p(gain * values), axis=1))
            evidence -= signals.size * math.log(noise)
            if evidence > best[0]:
                best = evidence, (length, size, noise)
    length, size, noise = best[1]
    root = _prior_root(length)
    means, roots = [], []
    for b, level in enumerate(flat):
        scaled = size * level * root
        precision = np.eye(len(root)) + scaled.T @ left[b] @ scaled / noise**2
        factor = np.linalg.cholesky(precision)
        roots.append(np.linalg.solve(factor, scaled.T))
        means.append(roots[-1].T @ (roots[-1] @ right[b]) / noise**2)
    return Curves(np.stack(means, axis=1), np.stack(roots), length, noise)


def _prior_root(length_nm: float) -> NDArray[np.float64]:
    """L (36, 36) of the prior covariance L L': neighbours within length_nm are alike."""
    apart = (WAVELENGTHS[:, None] - WAVELENGTHS) / length_nm
    covariance = np.exp(-0.5 * apart**2) + _ROUGH * np.eye(len(WAVELENGTHS))
    return np.asarray(np.linalg.cholesky(covariance), np.float64)
