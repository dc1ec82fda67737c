"""Fitting M_S and M_R to the colours they lead to, through the whole pipeline.

Camera bands of light go through M_S and those of a surface through M_R into the primaries, are
multiplied there, and come to XYZ, to D65 by CAT02 and to CIELAB. What is minimised is

    mean of CIEDE2000^2  +  what noise in the bands adds to that mean  +  k^2 * spectral excess

over lights x surfaces: the paper's own method for its simulation. The noise's share is, to first
order, a quadratic form in each matrix. The spectral excess is how much worse than ridge's own
optimum a matrix estimates the primaries, so that k = infinity is ridge and k = 0 is free of it;
without it a few chart colours would leave the primaries' metameric part undetermined.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.adaptation import D65, cat02
from calibration.descent import Equations, descend
from calibration.difference import lab
from calibration.slopes import delta_e_2000_slopes, lab_slopes

_MOST_STEPS = 40


@dataclass(frozen=True)
class Side:
    """Light, or surfaces: what the camera saw of each, and what it is in the primaries.

    true       (n, P) in the primaries
    signals    (n, B) camera signals; None where the spectra are known and no matrix is sought
    variances  (n, B) of one pixel's signals; None likewise
    ridge      (P, B) the matrix to start from and to stay near; None likewise
    metric     (B, B) of the spectral excess: sum over p of m_p metric m_p' of M - ridge, in units
               of a squared primary of the brightest sample
    """

    true: NDArray[np.float64]
    signals: Any = None
    variances: Any = None
    ridge: Any = None
    metric: Any = None

    @property
    def sought(self) -> bool:
        """Whether there is a matrix to be fitted."""
        return self.signals is not None

    def estimated(self, matrix) -> NDArray[np.float64]:
        """What the camera makes of each (n, P)."""
        if not self.sought:
            return self.true
        estimate: NDArray[np.float64] = self.signals @ matrix.T
        return estimate

    def only(self, rows) -> Side:
        def some(values):
            return None if values is None else values[rows]

        return replace(
            self,
            true=self.true[rows],
            signals=some(self.signals),
            variances=some(self.variances),
        )


@dataclass(frozen=True)
class Rendered:
    """Every light on every surface, and the colours that should come out.

    light       Side of L lights, scaled so that each lamp's white has Y = 1
    surface     Side of S surfaces
    true_lab    (L, S, 3) from full spectra
    xyz_of      (L, 3, P) primaries to XYZ adapted to D65, for each light's white
    weights     (L, S), summing to 1
    """

    light: Side
    surface: Side
    true_lab: NDArray[np.float64]
    xyz_of: NDArray[np.float64]
    weights: NDArray[np.float64]

    @classmethod
    def of(cls, light: Side, surface: Side, true_xyz, whites, xyz_from_primaries, weights):
        """true_xyz (L, S, 3) and whites (L, 3) in one scale; weights (L, S) in any."""
        to_d65 = np.stack([cat02(white, D65) / white[1] for white in whites])
        weights = np.asarray(weights, np.float64)
        return cls(
            light,
            surface,
            lab(np.einsum("lij,lsj->lsi", to_d65, true_xyz)),
            to_d65 @ xyz_from_primaries,
            weights / weights.sum(),
        )

    def only(self, rows, of: str = "lights") -> Rendered:
        """The same of some lights, or of some "surfaces", by index or mask."""
        if of == "surfaces":
            weights = self.weights[:, rows]
            side, true = self.surface.only(rows), self.true_lab[:, rows]
            return Rendered(self.light, side, true, self.xyz_of, weights / weights.sum())
        weights = self.weights[rows]
        return Rendered(
            self.light.only(rows),
            self.surface,
            self.true_lab[rows],
            self.xyz_of[rows],
            weights / weights.sum(),
        )

    def mean_error(self, m_s=None, m_r=None, noise: bool = True) -> float:
        """The weighted mean of `errors`."""
        return float(np.sum(self.weights * self.errors(m_s, m_r, noise)))

    def errors(self, m_s=None, m_r=None, noise: bool = False) -> NDArray[np.float64]:
        """CIEDE2000 (L, S); with noise, the root of its expected square."""
        parts, slopes, s, r = self.seen(m_s, m_r)
        square = np.sum(parts**2, axis=-1)
        if noise:
            for side, other, matrix in self._noisy(m_s, m_r, s, r):
                k = slopes * other[..., None, :]
                spread = np.einsum("lsip,pb->lsib", k, matrix) ** 2
                square = square + np.einsum("lsib,lsb->ls", spread, side)
        return np.sqrt(square)

    def _noisy(self, m_s, m_r, s, r):
        shape = self.weights.shape
        for side, other, matrix, axis in (
            (self.light, r[None], m_s, 1),
            (self.surface, s[:, None], m_r, 0),
        ):
            if side.sought:
                variances = np.expand_dims(side.variances, axis)
                yield (
                    np.broadcast_to(variances, (*shape, variances.shape[-1])),
                    np.broadcast_to(other, (*shape, other.shape[-1])),
                    matrix,
                )

    def seen(self, m_s, m_r):
        """Parts of the difference (L, S, 3), their slopes by primary (L, S, 3, P), s and r."""
        s, r = self.light.estimated(m_s), self.surface.estimated(m_r)
        xyz = np.einsum("lip,lp,sp->lsi", self.xyz_of, s, r, optimize=True)
        got, by_xyz = lab_slopes(xyz)
        parts, by_lab = delta_e_2000_slopes(self.true_lab, got)
        return parts, by_lab @ by_xyz @ self.xyz_of[:, None], s, r


def fitted(
    colours: Rendered, strength: float, start: Sequence[NDArray[np.float64]] | None = None
) -> tuple[Any, Any]:
    """M_S and M_R, those that are sought, with the least of what the module's head says.

    Arrays (P, B), or None where it is not sought.

    strength  k, dE per unit of primary: the brightest white is 1
    start     of what is sought, in that order; default ridge
    """
    sides = [side for side in (colours.light, colours.surface) if side.sought]
    anchors = [side.ridge for side in sides]
    shapes = [anchor.shape for anchor in anchors]
    bends = _quadratic(colours, strength)
    x = _flat(anchors if start is None else start)
    anchor = _flat(anchors)
    pull = [
        strength**2 * np.kron(np.eye(shape[0]), side.metric)
        for side, shape in zip(sides, shapes, strict=True)
    ]
    pulls = _blocks(pull)

    def at(vector):
        of_colours = _equations(colours, *_matrices(colours, _split(vector, shapes)))
        off = vector - anchor
        return Equations(
            of_colours.cost + vector @ bends @ vector + off @ pulls @ off,
            of_colours.left + bends + pulls,
            of_colours.right + bends @ vector + pulls @ off,
            of_colours.errors,
        )

    found, _ = descend(at, x, steps=_MOST_STEPS)
    return _matrices(colours, _split(found, shapes))


def _equations(colours: Rendered, m_s, m_r) -> Equations:
    """The mean squared difference and its normal equations, over what is sought.

    The slope by M_S[p, b] is slope_p r_p s_b: products, so each light's share is a small P x P
    matrix times the outer product of its signals, whatever the number of surfaces.
    """
    parts, slopes, s, r = colours.seen(m_s, m_r)
    errors = np.sqrt(np.sum(parts**2, axis=-1))
    root = np.sqrt(colours.weights)[..., None]
    parts, slopes = parts * root, slopes * root[..., None]
    cost = float(np.sum(parts**2))
    by_light, by_surface = slopes * r[None, :, None, :], slopes * s[:, None, None, :]
    light, surface = colours.light, colours.surface
    gradients, blocks = [], []
    if light.sought:
        q = np.einsum("lsip,lsiq->lpq", by_light, by_light, optimize=True)
        g = np.einsum("lsip,lsi->lp", by_light, parts)
        gradients.append((g.T @ light.signals).ravel())
        blocks.append(_outer(q, light.signals))
    if surface.sought:
        q = np.einsum("lsip,lsiq->spq", by_surface, by_surface, optimize=True)
        g = np.einsum("lsip,lsi->sp", by_surface, parts)
        gradients.append((g.T @ surface.signals).ravel())
        blocks.append(_outer(q, surface.signals))
    hessian = _blocks(blocks)
    if light.sought and surface.sought:
        q = np.einsum("lsip,lsiq->lspq", by_light, by_surface, optimize=True)
        cross = np.einsum(
            "lspq,lb,sc->pbqc", q, light.signals, surface.signals, optimize=True
        ).reshape(len(blocks[0]), -1)
        hessian[: len(cross), len(cross) :] = cross
        hessian[len(cross) :, : len(cross)] = cross.T
    return Equations(cost, hessian, np.concatenate(gradients), errors)


def _quadratic(colours: Rendered, strength: float) -> NDArray[np.float64]:
    """What noise in the bands adds to the mean squared difference, as a form in the matrices.

    The slopes are those at the true colours, and of the other side the truth is taken.
    """
    _, by_lab = delta_e_2000_slopes(colours.true_lab, colours.true_lab)
    s, r = colours.light.true, colours.surface.true
    xyz = np.einsum("lip,lp,sp->lsi", colours.xyz_of, s, r, optimize=True)
    slopes = by_lab @ lab_slopes(xyz)[1] @ colours.xyz_of[:, None]
    slopes = slopes * np.sqrt(colours.weights)[..., None, None]
    blocks = []
    if colours.light.sought:
        k = slopes * r[None, :, None, :]
        q = np.einsum("lsip,lsiq->lpq", k, k, optimize=True)
        blocks.append(_diagonal(q, colours.light.variances))
    if colours.surface.sought:
        k = slopes * s[:, None, None, :]
        q = np.einsum("lsip,lsiq->spq", k, k, optimize=True)
        blocks.append(_diagonal(q, colours.surface.variances))
    return _blocks(blocks)


def _outer(q, signals) -> NDArray[np.float64]:
    """Sum over i of q_i (P, P) times the outer product of signals_i (B,): (PB, PB)."""
    size = q.shape[1] * signals.shape[1]
    outer: NDArray[np.float64] = np.einsum(
        "ipq,ib,ic->pbqc", q, signals, signals, optimize=True
    ).reshape(size, size)
    return outer


def _diagonal(q, variances) -> NDArray[np.float64]:
    size = q.shape[1] * variances.shape[1]
    each = np.einsum("ipq,ib->pqb", q, variances)
    full = np.einsum("pqb,bc->pbqc", each, np.eye(variances.shape[1]))
    diagonal: NDArray[np.float64] = full.reshape(size, size)
    return diagonal


def _blocks(matrices: Sequence[NDArray[Any]]) -> NDArray[np.float64]:
    size = sum(len(m) for m in matrices)
    whole, at = np.zeros((size, size)), 0
    for m in matrices:
        whole[at : at + len(m), at : at + len(m)] = m
        at += len(m)
    return whole


def _flat(matrices) -> NDArray[np.float64]:
    return np.concatenate([np.ravel(m) for m in matrices])


def _split(vector, shapes):
    ends = np.cumsum([a * b for a, b in shapes])[:-1]
    return [v.reshape(shape) for v, shape in zip(np.split(vector, ends), shapes, strict=True)]


def _matrices(colours: Rendered, found):
    rest = iter(found)
    return tuple(next(rest) if side.sought else None for side in (colours.light, colours.surface))
