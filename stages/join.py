"""Several views of one world made one map, without what stood before one of the cameras.

In each direction the views are averaged, each by how finely and how surely it shows what is there:
by its angular resolution squared over its variance, smoothed, so that no texel's own noise decides
how much it counts. Where a view shows what others do not - a camera, its tripod, the photographer -
it counts for nothing. All weights change over a degree or more, and so there is no seam.

Whether a view is supported by another is asked of its light on coarser texels, against the range of
the other's light within a degree or two: what is near stands a little elsewhere in each view, and
an edge must not count as a contradiction. Where two views contradict each other and no third one
tells, the one that looks past its own camera is believed, as cameras have people behind them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

from stages import cube
from stages.mirror import Array, Sphere
from stages.types import Float, Measured

_SIZE = 128  # texels along a face, .7 degrees, that views are compared and weighted on
_BLUR = 0.7  # texels, sigma: views differ in sharpness by less than that where they are good
_REACH_RAD = np.radians(1.4)  # within which another view may show the same
_ALIKE = 0.05  # of the light, by which views may differ: reflectance, blur, what is left of drift
_CONTRAST = 0.3  # of that between what is within reach, likewise
_SIGMAS = 3.0  # of the noise, likewise
_OWN = 0.8  # what a view's own word weighs beside another's support
# Before its own camera a view's word weighs little, to the first angle, and fully from the second
# on: photographers stand some 15 degrees to each side, and reach down to the floor.
_BEHIND_CAMERA, _FROM_RAD, _TO_RAD = 0.05, np.radians(45.0), np.radians(80.0)
_HIDDEN, _SEEN = 0.4, 0.8  # of the best support: with less nothing counts, with more all
_FEATHER = 2.0  # texels, sigma of the weights' edges
_BROAD = 6.0  # texels, sigma of the smoothing of variances
_FLOOR = 1e-5  # of a weight, left where nothing else is known


@dataclass(frozen=True)
class Joined:
    """One map of several views.

    light    (6, N, N, P), in the first view's world
    shares   how much of the sphere of directions each view gave, the first first; sums to 1
    removed  how much of the sphere each view saw that the others saw past: cameras, people
    """

    light: Measured
    shares: tuple[float, ...]
    removed: tuple[float, ...]


def join(views: Sequence[Measured], spheres: Sequence[Sphere]) -> Joined:
    """The mean of several views, each weighted by what it is worth in each direction.

    views    (6, N, N, P) light, in one world; NaN where not known
    spheres  as each view's camera saw it, with their turns into that world

    `valid` is that of the view that knows most; variances are those of independent views.
    """
    n, channels = views[0].values.shape[1], views[0].values.shape[-1]
    coarse = [_Coarse.of(view, sphere) for view, sphere in zip(views, spheres, strict=True)]
    visible = _visible(coarse)
    size = coarse[0].known.shape[1]
    weights = np.stack(
        [(_FLOOR + v) * c.worth for v, c in zip(visible, coarse, strict=True)], axis=-1
    )
    weights /= np.maximum(weights.sum(axis=-1, keepdims=True), 1e-30)
    if n != size:
        weights = cube.sample(weights, cube.directions(n))
    weights = np.maximum(weights, 1e-9) * np.stack([view.valid for view in views], axis=-1)
    total = weights.sum(axis=-1)
    known = total > 0
    weights /= np.where(known, total, 1.0)[..., None]
    values = np.zeros((6, n, n, channels), np.float32)
    variance = np.zeros_like(values)
    for k, view in enumerate(views):
        w = weights[..., k, None].astype(np.float32)
        there = w > 0
        values += np.where(there, view.values, 0.0) * w
        variance += np.where(there, view.variance, 0.0) * w * w
    values[~known] = variance[~known] = np.nan
    valid = np.max([view.valid for view in views], axis=0)
    omega = cube.solid_angles(n)[..., None]
    shares = np.sum(weights * omega, axis=(0, 1, 2)) / np.sum(known * omega[..., 0])
    coarse_omega = cube.solid_angles(size) / (4.0 * pi)
    removed = [
        float(np.sum((v < 0.5) * (c.known > 0.5) * coarse_omega))
        for v, c in zip(visible, coarse, strict=True)
    ]
    return Joined(Measured(values, variance, valid), tuple(shares.tolist()), tuple(removed))


@dataclass(frozen=True)
class _Coarse:
    """A view on coarser texels, for comparing and weighting.

    values    (6, m, m, P), 0 where not known
    variance  (6, m, m, P)
    known     (6, m, m) share of a texel that is
    vote      (6, m, m) how much its word weighs, by how finely it shows what is there, 0..1
    behind    (6, m, m) how much of that is left before its own camera
    worth     (6, m, m) weight in the mean of views, smooth; 0 where not known
    """

    values: Float
    variance: Float
    known: Float
    vote: Array
    behind: Array
    worth: Array

    @classmethod
    def of(cls, view: Measured, sphere: Sphere) -> _Coarse:
        n = view.values.shape[1]
        every = 1
        while n % (2 * every) == 0 and n // (2 * every) >= _SIZE:
            every *= 2
        there = (view.valid > 0)[..., None]
        valid = view.valid[..., None]
        known = _means(valid, every)
        share = np.maximum(known, 1e-6)
        values = _means(np.where(there, view.values, 0.0) * valid, every) / share
        # Neighbours in a magnified map have their noise in common: less is gained than by count.
        variance = _means(np.where(there, view.variance, 0.0) * valid, every) / share / every
        seen = known[..., 0]
        values = cube.blurred(values * known, _BLUR) / np.maximum(cube.blurred(known, _BLUR), 1e-6)
        values = np.where(known > 0, values, 0.0)
        size = n // every
        d = cube.directions(size)
        fine = sphere.pixels_per_radian(d)
        angle = np.arccos(np.clip(d @ sphere.towards_camera, -1.0, 1.0))
        behind = _BEHIND_CAMERA + (1.0 - _BEHIND_CAMERA) * _step(angle, _FROM_RAD, _TO_RAD)
        # Worth falls to nothing over the last texels of what is known, from within.
        feather = _step(cube.blurred(seen[..., None], _FEATHER)[..., 0], 0.5, 1.0)
        # Of the light, so that somebody dark is not surer than the bright wall behind him.
        light = np.maximum((values**2 + variance).sum(axis=-1), 1e-30)
        noise = np.log(np.maximum(variance.sum(axis=-1) / light, 1e-12))
        smooth = cube.blurred(np.stack([noise * seen, seen], axis=-1), _BROAD)
        noise = smooth[..., 0] / np.maximum(smooth[..., 1], 1e-6)
        worth = (feather + _FLOOR * seen) * (fine / fine.max()) ** 2 * np.exp(-noise)
        vote = seen * np.sqrt(fine / fine.max())
        return cls(
            values.astype(np.float32), variance.astype(np.float32), seen, vote, behind, worth
        )


def _visible(views: Sequence[_Coarse]) -> list[Array]:
    """How much of what each view shows is there for the others too: (6, m, m) each, 0..1."""
    reach = max(1, round(_REACH_RAD / (pi / 2 / views[0].known.shape[1])))
    ranges = [_range(view, reach) for view in views]
    support = []
    for i, view in enumerate(views):
        own = view.behind * view.vote * _OWN
        for j, other in enumerate(views):
            if j != i:
                own = own + other.behind * other.vote * _agreement(view, other, ranges[j])
        support.append(np.where(view.known > 0.0, own, 0.0))
    best = np.maximum(np.max(support, axis=0), 1e-12)
    visible = []
    for view, own in zip(views, support, strict=True):
        share = np.where(view.known > 0, _step(own / best, _HIDDEN, _SEEN), 1.0)[..., None]
        # What stands at the edge of what is hidden is a mixture, and hidden too.
        hidden = 1.0 - _neighbourhood(share, np.minimum, 2)
        blurred = cube.blurred(hidden, _FEATHER)[..., 0]
        visible.append(1.0 - _step(blurred, 0.0, 0.5))
    return visible


def _agreement(view: _Coarse, other: _Coarse, limits: tuple[Float, Float]) -> Array:
    """Whether another view shows, near by, what this one shows: (6, m, m), 0..1."""
    low, high = limits
    # The coarser of two views shows less than all of an edge's contrast.
    beyond = _CONTRAST * (high - low)
    off = np.maximum(view.values - high - beyond, 0.0)
    off += np.maximum(low - beyond - view.values, 0.0)
    light = 0.5 * (view.values**2 + other.values**2).sum(axis=-1)
    noise = (view.variance + other.variance).sum(axis=-1)
    allowed = _ALIKE**2 * light + _SIGMAS**2 * noise
    ratio = np.minimum((off**2).sum(axis=-1) / np.maximum(allowed, 1e-30), 1e6)
    agreement: Array = 1.0 / (1.0 + ratio**2)
    return agreement


def _range(view: _Coarse, reach: int) -> tuple[Float, Float]:
    """The least and the most light (6, m, m, P) within `reach` texels, of what is known."""
    unknown = (view.known < 0.5)[..., None]
    low = _neighbourhood(np.where(unknown, np.inf, view.values), np.minimum, reach)
    high = _neighbourhood(np.where(unknown, -np.inf, view.values), np.maximum, reach)
    return low, high


def _neighbourhood(cubemap: Float, extreme, reach: int) -> Float:
    """The extreme of each texel's surroundings, so many texels to each side."""
    for _ in range(reach):
        wide = cube.with_border(cubemap)
        rows = extreme(extreme(wide[:, :-2], wide[:, 1:-1]), wide[:, 2:])
        cubemap = extreme(extreme(rows[:, :, :-2], rows[:, :, 1:-1]), rows[:, :, 2:])
    return cubemap


def _means(cubemap, every: int) -> Float:
    """Means over `every` x `every` texels."""
    n = cubemap.shape[1] // every
    means: Float = cubemap.reshape(6, n, every, n, every, -1).mean(axis=(2, 4))
    return means


def _step(x, low: float, high: float) -> Array:
    """0 below `low`, 1 above `high`, smooth between."""
    t: NDArray[np.float64] = np.clip((np.asarray(x, np.float64) - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)
