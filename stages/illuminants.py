"""The lights of a place: where most of its light comes from, and of what colour it is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration import chromaticity
from stages import cube
from stages.types import Measured

Array = NDArray[np.float64]

LEAST_SHARE = 0.01  # of all light, for a light to be told of
_STANDS_OUT = 8.0  # times the median: walls in a room differ by less, what lights them by more
_STEP = 2.0  # between the levels at which what is bright is told apart
_APART = 8.0  # times the level at which two join, for both to be lights of their own
_MAP_SIZE = 32  # texels a side, 2.8 degrees, on which that is done: bars do not divide a window


@dataclass(frozen=True)
class Illuminant:
    """A part of the environment that lights the rest of it.

    direction       (3,) unit vector to the middle of its light; None for what is left of the
                    environment, which has no one place
    solid_angle_sr  it fills
    share           of the light that comes from all directions known, by luminance, 0..1
    light           (P,) its radiance, mean over its solid angle, in the primaries
    sigma           (P,) standard deviation of that, the texels' noise taken as independent
    """

    direction: Array | None
    solid_angle_sr: float
    share: float
    light: Array
    sigma: Array


def illuminants(light: Measured, luminance) -> list[Illuminant]:
    """What stands out of an environment, the most light first; what is left of it comes last.

    light      (6, N, N, P) in the primaries
    luminance  (P,) by which a texel's luminance is the sum of its primaries: the row Y of the
               matrix to XYZ

    Something stands out where it is connected and brighter than eight times the median. Two that
    join at some lower level are two lights where each is eight times as bright as that, as a lamp
    is beside a window; what lies between, as the wall it lights, goes with the nearest.
    """
    n = light.values.shape[1]
    solid_angles = np.broadcast_to(cube.solid_angles(n), (6, n, n))
    known = (light.valid > 0) & np.isfinite(light.values).all(axis=-1)
    weight = np.where(known, solid_angles, 0.0)
    flux = weight * np.where(known, light.values @ np.asarray(luminance, np.float64), 0.0)
    total = max(float(flux.sum()), np.finfo(float).tiny)  # of a black place nothing is told apart
    size = min(n, _MAP_SIZE)
    place = np.arange(n) * size // n
    coarse_weight, coarse_flux = (_gathered(v, place) for v in (weight, flux))
    y = np.divide(coarse_flux, coarse_weight, out=np.zeros_like(flux, shape=(6, size, size)),
                  where=coarse_weight > 0)  # fmt: skip
    floor = _STANDS_OUT * float(np.median(y[coarse_weight > 0]))
    of_light = _told_apart(y, coarse_flux / total, floor)[:, place][:, :, place]
    of_light[flux <= floor * weight] = -1
    found = [_one(light, weight, flux / total, of_light == k) for k in range(of_light.max() + 1)]
    told = [k for k, one in enumerate(found) if one.share >= LEAST_SHARE]
    rest = _one(light, weight, flux / total, known & ~np.isin(of_light, told))
    return [
        *sorted((found[k] for k in told), key=lambda one: -one.share),
        replace(rest, direction=None),
    ]


def impossible(light: Measured, xyz_from_primaries) -> float:
    """The share of the light, 0..1, whose colour no light has: outside the spectral locus.

    light               (6, N, N, P) in the primaries
    xyz_from_primaries  (3, P)

    Judged over 2.8 degrees, so that noise averages out. A few hundredths are noise in the dark;
    more says that M_S was fitted for other filters, or for another camera.
    """
    n = light.values.shape[1]
    place = np.arange(n) * min(n, _MAP_SIZE) // n
    known = (light.valid > 0) & np.isfinite(light.values).all(axis=-1)
    flux = np.where(known, cube.solid_angles(n), 0.0)[..., None] * np.where(
        known[..., None], light.values @ np.asarray(xyz_from_primaries).T, 0.0
    )
    xyz = _gathered(flux, place)
    amount = np.abs(xyz).sum(axis=-1)
    wrong = (amount > 0) & ~chromaticity.possible(xyz)
    return float(amount[wrong].sum() / max(amount.sum(), np.finfo(float).tiny))


def _gathered(values, place):
    """Sums (6, n, n, ...) of the texels (6, N, N, ...) in each coarser one, n of them a side."""
    first = np.searchsorted(place, np.arange(place[-1] + 1))
    return np.add.reduceat(np.add.reduceat(values, first, axis=1), first, axis=2)


def _told_apart(y, share, floor: float) -> NDArray[np.int_]:
    """The number of the light each texel (6, N, N) belongs to; -1 where it belongs to none."""
    of_light = np.full(y.shape, -1)
    top = float(y.max())
    if not top > floor > 0.0:
        return of_light
    direction = cube.directions(y.shape[1])
    steps = int(np.ceil(np.log(top / floor) / np.log(_STEP)))
    count = 0
    for level in np.maximum(top / _STEP ** np.arange(1, steps + 1), floor):
        parts = _connected(y > level)
        for part in range(parts.max() + 1):
            texels = parts == part
            inside = [k for k in np.unique(of_light[texels]) if k >= 0]
            apart = [
                k
                for k in inside
                if y[of_light == k].max() > _APART * level
                and share[of_light == k].sum() >= LEAST_SHARE
            ]
            if len(apart) < 2:  # one light as a whole
                of_light[texels] = inside[0] if inside else count
                count += not inside
                continue
            centres = np.stack([_centre(direction, share, of_light == k) for k in apart])
            loose = texels & ~np.isin(of_light, apart)
            of_light[loose] = np.asarray(apart)[np.argmax(direction[loose] @ centres.T, axis=-1)]
    return of_light


def _connected(mask) -> NDArray[np.int_]:
    """Numbers the connected parts of a mask (6, N, N), also over the edges of faces; -1 outside."""
    from scipy.ndimage import label
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    labels = np.zeros(mask.shape, np.intp)
    count = 0
    for face in range(6):
        labels[face], found = label(mask[face], structure=np.ones((3, 3)))
        labels[face][labels[face] > 0] += count
        count += found
    beside = cube.with_border(labels[..., None])[..., 0]
    pairs = [
        np.stack([inner.ravel(), outer.ravel()])
        for inner, outer in (
            (labels[:, 0, :], beside[:, 0, 1:-1]),
            (labels[:, -1, :], beside[:, -1, 1:-1]),
            (labels[:, :, 0], beside[:, 1:-1, 0]),
            (labels[:, :, -1], beside[:, 1:-1, -1]),
        )
    ]
    a, b = np.concatenate(pairs, axis=1)
    both = (a > 0) & (b > 0)
    a, b = a[both] - 1, b[both] - 1
    graph = coo_matrix((np.ones(len(a)), (a, b)), shape=(count, count))
    _, of_label = connected_components(graph, directed=False)
    return np.where(labels > 0, of_label[labels - 1] if count else -1, -1)


def _centre(direction, share, texels) -> Array:
    centre = share[texels] @ direction[texels]
    return np.asarray(centre / max(float(np.linalg.norm(centre)), 1e-12))


def _one(light: Measured, weight, share, texels) -> Illuminant:
    """The light of some texels (6, N, N)."""
    omega, total = weight[texels], float(weight[texels].sum())
    if not total > 0.0:
        nothing = np.zeros(light.values.shape[-1])
        return Illuminant(None, 0.0, 0.0, nothing, nothing)
    direction = cube.directions(weight.shape[1])
    return Illuminant(
        _centre(direction, share, texels),
        total,
        float(share[texels].sum()),
        omega @ light.values[texels].astype(np.float64) / total,
        np.sqrt(omega**2 @ light.variance[texels].astype(np.float64)) / total,
    )
