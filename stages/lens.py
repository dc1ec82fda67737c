"""A lens's radial distortion, as Brown and Conrady describe it and OpenCV writes it.

A place at x, y of the ideal image, in units of the focal length from the optical axis, is seen at
x, y times 1 + k1 r^2 + k2 r^4 + k3 r^6, with r its distance from the axis in the same unit: from
undistorted to distorted. k1 below 0 is a barrel, above 0 a pincushion. (Duane C. Brown,
"Close-range camera calibration", Photogrammetric Engineering 37, 1971; OpenCV's camera model
without k4..k6 and without tangential terms.)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ROUNDS = 20  # of Newton's method, which doubles the digits each time


def distorted(places, k: Sequence[float]) -> Array:
    """Where ideal places (..., 2), in focal lengths from the axis, are seen."""
    xy = np.asarray(places, np.float64)
    if not any(k):
        return xy
    return np.asarray(xy * _factor(np.sum(xy * xy, axis=-1, keepdims=True), k))


def undistorted(places, k: Sequence[float]) -> Array:
    """The inverse of `distorted`, to rounding; what lies beyond the `reach` comes from its end."""
    xy = np.asarray(places, np.float64)
    if not any(k):
        return xy
    fold = _fold(k)
    seen = np.linalg.norm(xy, axis=-1, keepdims=True)
    r = np.minimum(seen, fold)
    for _ in range(_ROUNDS):
        r -= (r * _factor(r * r, k) - seen) / np.maximum(_slope(r * r, k), 0.1)
        r = np.clip(r, 0.0, fold)
    return np.asarray(xy * (r / np.where(seen > 0, seen, 1.0) + (seen == 0)))


def stretch(places, k: Sequence[float]) -> Array:
    """The matrices (..., 2, 2) by which `distorted` moves its neighbours at ideal places."""
    xy = np.asarray(places, np.float64)
    square = np.sum(xy * xy, axis=-1)[..., None, None]
    k1, k2, k3 = k
    bend = 2.0 * (k1 + square * (2.0 * k2 + square * 3.0 * k3))
    return np.asarray(_factor(square, k) * np.eye(2) + bend * xy[..., :, None] * xy[..., None, :])


def reach(k: Sequence[float]) -> float:
    """How far out, in focal lengths as seen, distances grow with the ideal ones; often infinite.

    Beyond that the formula folds back, and no photograph was taken like that.
    """
    fold = _fold(k)
    return float(fold * _factor(fold * fold, k)) if np.isfinite(fold) else fold


def _fold(k: Sequence[float]) -> float:
    """The ideal distance, in focal lengths, that is seen furthest out."""
    k1, k2, k3 = k
    squares = np.roots([7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])
    folds = [float(s.real) for s in squares if abs(s.imag) < 1e-9 and s.real > 0]
    return float(np.sqrt(min(folds))) if folds else float("inf")


def _factor(square, k: Sequence[float]):
    k1, k2, k3 = k
    return 1.0 + square * (k1 + square * (k2 + square * k3))


def _slope(square, k: Sequence[float]):
    """Of r times its factor, by r."""
    k1, k2, k3 = k
    return 1.0 + square * (3.0 * k1 + square * (5.0 * k2 + square * 7.0 * k3))
