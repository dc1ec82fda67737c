"""What the camera's noise does to the colour of a white lit by the map.

A map's `sigma.P1`.. are the diagonal of a covariance: a matrix spreads each band's noise over all
primaries. Here the bands' variances are still known, so the whole covariance is, exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration import uncertainty
from stages import cube
from stages.mirror import Array, Sphere
from stages.types import Float, Measured

FACINGS = {
    name: np.array(vector, np.float64)
    for name, vector in (
        ("+X", (1, 0, 0)),
        ("-X", (-1, 0, 0)),
        ("+Y", (0, 1, 0)),
        ("-Y", (0, -1, 0)),
        ("+Z", (0, 0, 1)),
        ("-Z", (0, 0, -1)),
    )
}
_RIM_PX = 2.0  # inside the rim pixels count half in `unwrap`
_FINE_ENOUGH = 256  # texels a side


@dataclass(frozen=True)
class WhiteNoise:
    """CIEDE2000, root mean square, that noise alone leaves on a perfect white lit by the map.

    median, p95  over all directions seen (by solid angle), of a white lit from that direction's
                 texel alone; None where so many texels hold no light above 0
    facing       of a diffuse white in the middle of the map, by where it faces: it gathers half
                 the map, and the texels' noise averages out

    The eye is adapted to the light as it is: a white without noise is (100, 0, 0) in CIELAB.
    """

    median: float | None
    p95: float | None
    facing: dict[str, float | None]


def assess(
    bands: Measured,
    matrix,
    reflectance: Float,
    xyz_from_primaries,
    common: Float,
) -> WhiteNoise:
    """How sure a white's colour is under the map, as far as noise goes.

    bands        (6, N, N, B) what the sphere reflected, in camera bands of independent noise
    matrix       (P, B) M_S
    reflectance  (6, N, N, P) the sphere's
    xyz_from_primaries  (3, P)
    common       (6, N, N, B) how many times a texel's variance counts in a sum over many, see
                 `shared_noise`; 1 where texels are independent

    Errors that all texels have in common (M_S, the solved exposures, the sphere's reflectance) are
    no noise and not in it.
    """
    n = bands.values.shape[1]
    every = _coarseness(n)
    thinned = np.s_[:, every // 2 :: every, every // 2 :: every]
    alone = _alone(
        bands.values[thinned],
        bands.variance[thinned],
        reflectance[thinned],
        matrix,
        xyz_from_primaries,
    )
    solid_angle = np.broadcast_to(cube.solid_angles(n), (6, n, n))[thinned]
    known = bands.valid[thinned] > 0
    alone = np.where(np.isnan(alone), np.inf, alone)  # no light above 0: as unsure as can be
    median, p95 = np.quantile(
        alone[known], [0.5, 0.95], weights=solid_angle[known], method="inverted_cdf"
    )
    facing = _facing(bands, matrix, reflectance, xyz_from_primaries, common, every)
    return WhiteNoise(
        _finite(median),
        _finite(p95),
        {name: _finite(v) for name, v in zip(FACINGS, facing, strict=True)},
    )


def _coarseness(face_size: int) -> int:
    """How many texels a side make one of the `_FINE_ENOUGH` that the figures are made from."""
    every = 1
    while face_size % (2 * every) == 0 and face_size // (2 * every) >= _FINE_ENOUGH:
        every *= 2
    return every


def _alone(values, variance, reflectance, matrix, xyz_from_primaries) -> Array:
    """dE (6, N, N) of a white lit by one texel; NaN where it is not known or no light."""
    result = np.empty(values.shape[:-1])
    for face in range(6):
        to_xyz = _xyz_from_bands(reflectance[face], matrix, xyz_from_primaries)
        xyz = np.einsum("...xb,...b->...x", to_xyz, values[face])
        covariance = uncertainty.of_primaries(variance[face], to_xyz)
        result[face] = uncertainty.white_delta_e(xyz, covariance)
    return result


def _facing(bands, matrix, reflectance, xyz_from_primaries, common, every: int) -> Array:
    """dE (6,) of a diffuse white by where it faces, in the order of FACINGS.

    Sums over `every` x `every` texels first: over so few directions neither the cosine nor the
    sphere's reflectance changes.
    """
    n = bands.values.shape[1]
    omega = np.where(bands.valid > 0, cube.solid_angles(n), 0.0).astype(np.float32)[..., None]
    seen = omega > 0
    signal = _summed(np.where(seen, omega * bands.values, 0), every)
    variance = _summed(np.where(seen, omega**2 * bands.variance * common, 0), every)
    share = _summed(seen, every)
    mirror = _summed(np.where(seen, reflectance, 0), every) / np.maximum(share, 1)
    mirror = np.where(share > 0, mirror, 1.0)

    cosine = cube.directions(n // every) @ np.stack(list(FACINGS.values())).T
    weights = np.maximum(cosine, 0.0) / np.pi
    light, covariance = np.zeros((6, 3)), np.zeros((6, 3, 3))
    for face in range(6):
        to_xyz = _xyz_from_bands(mirror[face], matrix, xyz_from_primaries)
        xyz = np.einsum("...xb,...b->...x", to_xyz, signal[face])
        of_xyz = uncertainty.of_primaries(variance[face], to_xyz)
        weight = weights[face].reshape(-1, 6).T
        light += weight @ xyz.reshape(-1, 3)
        covariance += uncertainty.of_sum(of_xyz.reshape(-1, 3, 3), weight)
    return uncertainty.white_delta_e(light, covariance)


def _xyz_from_bands(reflectance, matrix, xyz_from_primaries) -> Array:
    """M diag(1/r) M_S (..., 3, B): from bands as the sphere reflected them to XYZ as it arrived."""
    m_s, m = np.asarray(matrix, np.float64), np.asarray(xyz_from_primaries, np.float64)
    by_inverse = np.einsum("xp,pb->pxb", m, m_s).reshape(len(m_s), -1)
    flat: Array = (1.0 / np.asarray(reflectance, np.float64)) @ by_inverse
    return flat.reshape(*reflectance.shape[:-1], 3, m_s.shape[1])


def _summed(cubemap, every: int):
    """Sums (6, N / every, N / every, C) over squares of texels."""
    n = cubemap.shape[1] // every
    return cubemap.reshape(6, n, every, n, every, -1).sum(axis=(2, 4))


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def shared_noise(sphere: Sphere, face_size: int, noise_area_px: Sequence[float]) -> Float:
    """How many times (6, N, N, C) a texel's own variance counts in a sum over many texels.

    sphere         as the first filter's image shows it
    face_size      N
    noise_area_px  (C,) pixels over which a channel's noise is one: S

    A texel that covers a pixels knows its mean to v S / D, as `unwrap` has it, with D the pixels
    that bilinear interpolation draws in, on sides that the noise in common widens. Many texels
    together cover the sum of their a, and know the sum of their means as S v / a would each: the
    same noise is in neighbours, where a texel is smaller than a pixel in nearly all of them. The
    ratio is D / a.
    """
    every = _coarseness(face_size)  # what is smooth is worked out at fewer texels
    edge = np.linspace(-1.0, 1.0, face_size // every + 1)
    corner, _ = sphere.pixel_of(cube.face_directions(edge[None, :], edge[:, None]))
    across = _middle(np.diff(corner, axis=2), axis=1) / every  # (6, n, n, 2), px to the right
    down = _middle(np.diff(corner, axis=1), axis=2) / every
    area = np.abs(across[..., 0] * down[..., 1] - across[..., 1] * down[..., 0])
    # Bilinear interpolation of a point draws in 1.5^2 px in the mean: 1 over the mean of the
    # weights' squares, (2/3)^2. A side of n px draws in about sqrt(n^2 + 1.5^2).
    # Noise that S pixels share widens both by S - 1 px^2.
    s = np.asarray(noise_area_px, np.float64)
    sides = (_squared(side)[..., None] + 1.25 + s for side in (across, down))
    drawn = np.sqrt(np.prod(np.stack(list(sides)), axis=0))
    # Nearest the rim texels shrink to nothing, but what they show is taken from further inside.
    least = cube.solid_angles(face_size // every) / every**2 / _rim_pixel_sr(sphere)
    area = np.maximum(area, least)[..., None]
    common = np.asarray(np.maximum(drawn / area, 1.0), np.float32)
    return common.repeat(every, axis=1).repeat(every, axis=2)


def _rim_pixel_sr(sphere: Sphere) -> float:
    """Solid angle of the world in a pixel at the rim, where the photograph begins to count."""
    out = sphere.outward(sphere.outline(72))
    inside = sphere.outline(72) - _RIM_PX * out
    across, along = (
        sphere.direction_of(inside + step / 2.0) - sphere.direction_of(inside - step / 2.0)
        for step in (out, out[:, ::-1] * (1.0, -1.0))
    )
    return float(np.linalg.norm(np.cross(across, along), axis=-1).mean())


def _middle(edges: Array, axis: int) -> Array:
    """The mean of a texel's two opposite edges."""
    n = edges.shape[axis] - 1
    a, b = (edges.take(range(i, n + i), axis=axis) for i in (0, 1))
    result: NDArray[np.float64] = (a + b) / 2.0
    return result


def _squared(vectors: Array) -> Array:
    result: NDArray[np.float64] = (vectors**2).sum(axis=-1)
    return result
