"""Least squares for rendering primaries: normal equations without a Jacobian, and the descent.

A colour is light times surface: XYZ = M (S * R), with S = light @ curves and R = surface @ curves.
So the slope of a residual by a curve's sample w is g (light[w] R + S surface[w]), g its slope by
S R, and the sums over all colours that J'J consists of come apart into small products over lights
and over surfaces. J, which would be thousands of colours times hundreds of unknowns, is never made.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calibration import sets
from calibration.adaptation import D65, cat02
from calibration.slopes import delta_e_2000_slopes, lab_slopes
from calibration.spectra import Spectra


class Equations(NamedTuple):
    """A sum of squares at some point, and what Gauss and Newton say of its neighbourhood.

    cost     the weighted sum of squares
    left     (n, n) J'J        right  (n,) J'r
    errors   (L, S) CIEDE2000 of each colour
    """

    cost: float
    left: NDArray[np.float64]
    right: NDArray[np.float64]
    errors: NDArray[np.float64]


@dataclass(frozen=True)
class Colours:
    """The colours that primaries are to reproduce: every surface under every light.

    lights    (L, 36) each with Y = 1 on white
    surfaces  (S, 36)
    to_d65    (L, 3, 3) adaptation from each light's own white
    target    (L, S, 3) CIELAB from full spectra
    counts    (L, S) how much a colour counts, sum 1
    weights   (L, S) what its error's square is multiplied by
    """

    lights: NDArray[np.float64]
    surfaces: NDArray[np.float64]
    to_d65: NDArray[np.float64]
    target: NDArray[np.float64]
    counts: NDArray[np.float64]
    weights: NDArray[np.float64]

    @classmethod
    def of(cls, lights: Spectra, surfaces: Spectra, white_share: float) -> Colours:
        """Surfaces and a white, which counts as white_share of them all, under lights."""
        light = sets.scaled_to_unit_luminance(lights.values).T
        surface = np.vstack([surfaces.values.T, np.ones(len(surfaces.wavelengths))])
        to_d65 = np.stack([cat02(white, D65) for white in sets.xyz(light)])
        xyz = np.einsum("lij,lsj->lsi", to_d65, sets.xyz(light[:, None] * surface))
        counts = np.ones((len(light), len(surface)))
        counts[:, -1] = white_share * len(surfaces)
        counts /= counts.sum()
        return cls(light, surface, to_d65, lab_slopes(xyz)[0], counts, counts)

    def nearer_the_mean(self, errors: NDArray[np.float64]) -> Colours:
        """The same, weighted so that the sum of squares becomes about the mean error squared.

        errors  (L, S) CIEDE2000 of each colour now
        """
        mean = np.sum(self.counts * errors)
        # Below a part of the mean a colour is as good as right; its weight must not run away.
        return replace(self, weights=self.counts * mean / np.maximum(errors, 0.3 * mean))

    def thinned(self, most: int) -> Colours:
        """Evenly chosen lights and surfaces, white among them, about `most` colours or fewer."""
        keep = min(1.0, np.sqrt(most / self.counts.size))
        lights = _evenly(len(self.lights), keep)
        surfaces = np.append(_evenly(len(self.surfaces) - 1, keep), len(self.surfaces) - 1)
        counts = self.counts[np.ix_(lights, surfaces)]
        counts[:, -1] *= (len(surfaces) - 1) / (len(self.surfaces) - 1)
        counts /= counts.sum()
        return Colours(
            self.lights[lights],
            self.surfaces[surfaces],
            self.to_d65[lights],
            self.target[np.ix_(lights, surfaces)],
            counts,
            counts,
        )

    def linear_matrix(self, curves: NDArray[np.float64]) -> NDArray[np.float64]:
        """The matrix (3, P) with the least squares in adapted XYZ: where a descent starts."""
        products = (self.lights @ curves)[:, None] * (self.surfaces @ curves)
        xyz = sets.xyz(self.lights[:, None] * self.surfaces)
        roots = np.sqrt(self.counts)[..., None] / (0.1 + xyz[..., 1:2])
        count = curves.shape[1]
        flat = (products * roots).reshape(-1, count)
        # A touch of ridge: curves that overlap would otherwise start from huge differences.
        ridge = 1e-3 * np.sqrt(np.mean(flat**2) * len(flat))
        flat = np.vstack([flat, ridge * np.eye(count)])
        goal = np.vstack([(xyz * roots).reshape(-1, 3), np.zeros((count, 3))])
        matrix: NDArray[np.float64] = np.asarray(np.linalg.lstsq(flat, goal)[0].T, np.float64)
        return matrix

    def equations(self, curves: NDArray[np.float64], matrix: NDArray[np.float64]) -> Equations:
        """The sum of squares by (curve 1's 36 samples, curve 2's ..., matrix row by row)."""
        light, surface = self.lights, self.surfaces
        s, r = light @ curves, surface @ curves
        products = s[:, None] * r
        seen = np.einsum("lij,lsj->lsi", self.to_d65, products @ matrix.T)
        found, by_xyz = lab_slopes(seen)
        parts, by_lab = delta_e_2000_slopes(self.target, found)
        slopes = by_lab @ (by_xyz @ self.to_d65[:, None])  # parts by XYZ, not yet adapted
        square = np.einsum("ls,lski,lskj->ijls", self.weights, slopes, slopes, optimize=True)
        pull = np.einsum("ls,lski,lsk->ils", self.weights, slopes, parts, optimize=True)
        squares = np.sum(parts**2, axis=-1)

        count, bands = curves.shape[1], len(curves)
        size = count * bands
        left = np.empty((size + 3 * count, size + 3 * count))
        right = np.empty(size + 3 * count)
        for q in range(count):
            of_q = slice(q * bands, (q + 1) * bands)
            half = np.tensordot(matrix[:, q], square, 1)  # (3, L, S): XYZ with channel q
            for p in range(q + 1):
                of_p = slice(p * bands, (p + 1) * bands)
                both = np.tensordot(matrix[:, p], half, 1)
                by_light = (both * r[:, p]) @ r[:, q]
                by_surface = s[:, p] @ (both * s[:, q, None])
                block = (light.T * by_light) @ light + (surface.T * by_surface) @ surface
                block += (light.T * s[:, q]) @ both @ (surface * r[:, p, None])
                block += ((light.T * s[:, p]) @ both @ (surface * r[:, q, None])).T
                left[of_p, of_q] = block
                left[of_q, of_p] = block.T
            channel_pull = np.tensordot(matrix[:, q], pull, 1)
            right[of_q] = light.T @ (channel_pull @ r[:, q]) + surface.T @ (s[:, q] @ channel_pull)
            for i in range(3):
                of_row = slice(size + i * count, size + (i + 1) * count)
                by_light = s * (half[i] @ (r * r[:, q, None]))  # (L, P)
                by_surface = r * (half[i].T @ (s * s[:, q, None]))  # (S, P)
                block = by_light.T @ light + by_surface.T @ surface
                left[of_row, of_q] = block
                left[of_q, of_row] = block.T
        flat = products.reshape(-1, count)
        for i in range(3):
            of_row = slice(size + i * count, size + (i + 1) * count)
            right[of_row] = flat.T @ pull[i].ravel()
            for j in range(3):
                of_column = slice(size + j * count, size + (j + 1) * count)
                left[of_row, of_column] = flat.T @ (flat * square[i, j].ravel()[:, None])
        return Equations(float(np.sum(self.weights * squares)), left, right, np.sqrt(squares))


def _evenly(count: int, share: float) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, count - 1, max(1, round(count * share))).astype(np.intp))


def descend(
    equations: Callable[[NDArray[np.float64]], Equations],
    start: NDArray[np.float64],
    *,
    steps: int,
    lowest: NDArray[np.float64] | float = -np.inf,
    tolerance: float = 1e-5,
) -> tuple[NDArray[np.float64], Equations]:
    """The minimum downhill from start, by Levenberg and Marquardt's damped steps.

    equations  of a point (n,)
    steps      at most so many are tried
    lowest     what no coordinate may fall below: one that lies there and would, stays
    tolerance  stops when three steps together lower the cost by less than this part of it
    returns    the point, and its equations
    """
    at, here = start, equations(start)
    damping = 1e-3
    lately: list[float] = []
    for _ in range(steps):
        scale = np.diag(here.left)
        # The added share of the mean steadies directions in which nothing happens.
        damped = here.left + np.diag(damping * (scale + 1e-6 * scale.mean()))
        there = _stepped(at, damped, here.right, lowest)
        then = equations(there)
        if not then.cost < here.cost:  # so too when it is NaN
            damping *= 4.0
            if damping > 1e8:
                break
            continue
        lately = [*lately[-2:], 1.0 - then.cost / here.cost]
        at, here = there, then
        damping = max(damping / 5.0, 1e-9)
        if len(lately) == 3 and sum(lately) < tolerance:
            break
    return at, here


def _stepped(at, left, right, lowest) -> NDArray[np.float64]:
    """at - left^-1 right in the coordinates that can move; those that would fall too low stop."""
    free = (at > lowest) | (right < 0.0)
    there = at.copy()
    # What would fall below is put there and kept, and the others solved again, as in NNLS.
    for _ in range(5):
        step = right[free] - left[np.ix_(free, ~free)] @ (at - there)[~free]
        there[free] = at[free] - np.linalg.solve(left[np.ix_(free, free)], step)
        fallen = there < lowest
        there = np.maximum(there, lowest)
        if not fallen.any():
            break
        free &= ~fallen
    return there
