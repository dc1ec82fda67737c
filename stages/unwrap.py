"""From the photographs of the sphere straight to the cubemap: the only resampling there is.

Each texel is the mean over its solid angle of the radiance the sphere showed there. It is split
into a grid of parts, along each side as many as it spans pixels, so that no pixel is stepped over:
near the rim a texel is a small fraction of a pixel across the rim and tens of pixels along it. At
each part the photograph is interpolated bilinearly. (Kernels with negative lobes are sharper by a
little and wrong by much beside a lamp ten thousand times brighter than its wall.) All this is one
sparse matrix from pixels to texels, so the variance goes through the squares of its elements.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from stages.align import Alignment
from stages.cube import face_directions
from stages.mirror import Array, Sphere
from stages.types import Measured

# Inside the rim the photograph counts from the first distance on, and fully from the second, in
# px: a pixel nearer than that mixes in what lies beside the sphere, demosaicing one more.
_RIM_PX = (1.0, 3.0)
_COUNTS = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32])  # parts along a texel's side
_CHUNK = 1 << 17  # parts at a time: memory stays below some 100 MB
# Pixels over which the noise of a demosaiced channel is one, for `unwrap`: measured on flat noise
# through `demosaic`. A plain mean of what a Bayer mosaic samples would have 4 / .58 and 2 / .63.
BAYER_NOISE_AREA_PX = (6.2, 2.9, 6.2)

_LEAST = 1e-3  # of a texel's weight; with less it is not known


def default_face_size(sphere: Sphere) -> int:
    """Texels along a face: the power of two nearest a third of the rim's diameter, 64 at least.

    There a texel in the middle of the front face covers about one and a half pixels.
    """
    return max(64, int(2 ** np.round(np.log2(2.0 * sphere.rim_px / 3.0))))


def unwrap(
    images: Sequence[Measured],
    sphere: Sphere,
    alignment: Alignment,
    *,
    face_size: int,
    noise_area_px: Sequence[float] | None = None,
) -> Measured:
    """The cubemap of what the sphere reflected.

    images     one a filter, (H, W, C) each
    sphere     as it is seen in the first
    alignment  where the others lie
    face_size  N, texels along a face
    noise_area_px  (C,) how many pixels of a channel have one noise in common (the sum of its
               autocorrelation): `BAYER_NOISE_AREA_PX` for demosaiced images; 1 each where left out
    returns    (6, N, N, C * filters), a filter's channels beside each other; `valid` (6, N, N)
               falls from 1 to 0 over the last pixels of the rim and with the share of a texel
               that fell on pixels that are not known; NaN where it is 0

    With independent noise the mean of A pixels of variance v has v / A; with S of them in common
    it has v for one pixel and S v / A for many, and between them about v S / (S - 1 + A).
    """
    views = [
        _View(image, sphere.with_shift(shift), noise_area_px)
        for image, shift in zip(images, alignment.shifts, strict=True)
    ]
    channels = [image.values.shape[-1] for image in images]
    shape = (6 * face_size * face_size, sum(channels))
    values = np.full(shape, np.nan, np.float32)
    variance = np.full(shape, np.nan, np.float32)
    valid = np.zeros(shape[0], np.float32)
    for texels, positions, weights in _parts(sphere, face_size):
        first, least = 0, np.ones(len(texels), np.float32)
        for view, count, shift in zip(views, channels, alignment.shifts, strict=True):
            columns = slice(first, first + count)
            mean, spread, known = view.average(positions + np.asarray(shift), weights)
            values[texels, columns], variance[texels, columns] = mean, spread
            least = np.minimum(least, known)
            first += count
        valid[texels] = least
    cube = (6, face_size, face_size)
    return Measured(values.reshape(*cube, -1), variance.reshape(*cube, -1), valid.reshape(cube))


def _parts(
    sphere: Sphere, face_size: int
) -> Iterator[tuple[NDArray[np.intp], Array, NDArray[np.float32]]]:
    """All texels that can be seen, some at a time, in parts fine enough for the pixels.

    yields  flat indices (n,) of texels; px positions (n, k, 2) of their parts; weights (n, k):
            solid angles, of which those of all parts add up to 1, 0 where a part is hidden
    """
    # Each face is centre + u right + v down, u and v in [-1, 1].
    centre = face_directions(0.0, 0.0)
    right = np.sqrt(2.0) * face_directions(1.0, 0.0) - centre
    down = np.sqrt(2.0) * face_directions(0.0, 1.0) - centre

    edge = np.linspace(-1.0, 1.0, face_size + 1)
    corner, seen = sphere.pixel_of(face_directions(edge[None, :], edge[:, None]))
    across = np.linalg.norm(np.diff(corner, axis=2), axis=-1)
    along = np.linalg.norm(np.diff(corner, axis=1), axis=-1)
    across = np.maximum(across[:, 1:], across[:, :-1]).ravel()
    along = np.maximum(along[:, :, 1:], along[:, :, :-1]).ravel()
    seen = (seen[:, 1:, 1:] | seen[:, 1:, :-1] | seen[:, :-1, 1:] | seen[:, :-1, :-1]).ravel()
    # Which of _COUNTS is enough for parts of at most a pixel.
    columns = np.minimum(np.searchsorted(_COUNTS, across - 1e-9), len(_COUNTS) - 1)
    rows = np.minimum(np.searchsorted(_COUNTS, along - 1e-9), len(_COUNTS) - 1)
    group = np.where(seen, rows * len(_COUNTS) + columns, -1)

    order = np.argsort(group, kind="stable")
    bounds = np.searchsorted(group[order], np.arange(len(_COUNTS) ** 2 + 1))
    for key in range(len(_COUNTS) ** 2):
        members = order[bounds[key] : bounds[key + 1]]
        nv, nu = _COUNTS[key // len(_COUNTS)], _COUNTS[key % len(_COUNTS)]
        part_v, part_u = np.meshgrid(
            (np.arange(nv) + 0.5) / nv, (np.arange(nu) + 0.5) / nu, indexing="ij"
        )
        per_chunk = max(1, _CHUNK // (nu * nv))
        for start in range(0, len(members), per_chunk):
            texels = members[start : start + per_chunk]
            face, row, column = np.unravel_index(texels, (6, face_size, face_size))
            u = (column[:, None] + part_u.ravel()) * (2.0 / face_size) - 1.0
            v = (row[:, None] + part_v.ravel()) * (2.0 / face_size) - 1.0
            direction = (
                centre[face][:, None]
                + u[..., None] * right[face][:, None]
                + v[..., None] * down[face][:, None]
            )
            positions, visible = sphere.pixel_of(direction)
            solid_angle = (1.0 + u * u + v * v) ** -1.5
            solid_angle /= solid_angle.sum(axis=1, keepdims=True)
            yield texels, positions, np.where(visible, solid_angle, 0.0).astype(np.float32)


def _ramp(sphere: Sphere, x: Array, y: Array) -> Array:
    """How far each pixel counts, 0..1: (h, w), at columns x and rows y; smooth across the rim."""
    rim = sphere.outline()
    middle = rim.mean(axis=0)
    size = np.linalg.norm(rim - middle, axis=-1)
    apart = np.hypot(x - middle[0], (y - middle[1])[:, None])
    ramp = np.where(apart < size.min() - 2.0 * _RIM_PX[1], 1.0, 0.0)
    row, column = np.nonzero((ramp == 0.0) & (apart < size.max() + 1.0))
    inside = sphere.inside_px(np.stack([x[column], y[row]], axis=-1))
    near = np.clip((inside - _RIM_PX[0]) / (_RIM_PX[1] - _RIM_PX[0]), 0.0, 1.0)
    ramp[row, column] = near**2 * (3.0 - 2.0 * near)
    return ramp


class _View:
    """One filter's image about the sphere, its pixels weighted by how well they are known."""

    def __init__(self, image: Measured, sphere: Sphere, noise_area_px: Sequence[float] | None):
        height, width = image.valid.shape
        rim = sphere.outline()
        # The rim lies in the frame; only another filter's shift may carry it past an edge.
        x0, y0 = np.maximum(np.floor(rim.min(axis=0)).astype(int) - 1, 0)
        x1, y1 = np.minimum(np.ceil(rim.max(axis=0)).astype(int) + 1, (width, height))
        values, variance = image.values[y0:y1, x0:x1], image.variance[y0:y1, x0:x1]
        ramp = _ramp(sphere, np.arange(x0, x1) + 0.5, np.arange(y0, y1) + 0.5)
        finite = np.asarray(np.isfinite(values) & np.isfinite(variance)).all(axis=-1)
        weight = np.where(finite, image.valid[y0:y1, x0:x1] * ramp, 0.0)
        self._origin = np.array([x0, y0])
        self._size = weight.shape
        self._weight = weight.astype(np.float32).ravel()
        channels = values.shape[-1]
        self._noise_area = np.ones(channels) if noise_area_px is None else np.array(noise_area_px)
        self._values = np.where(np.expand_dims(finite, -1), values, 0.0).reshape(-1, channels)
        self._variance = np.where(np.expand_dims(finite, -1), variance, 0.0).reshape(-1, channels)

    def average(self, positions: Array, weights: NDArray[np.float32]):
        """Weighted means of the image, bilinear, at groups of positions.

        positions  (n, k, 2) px
        weights    (n, k)
        returns    values (n, C), variance (n, C), share of the weight that is known (n,)
        """
        from scipy.sparse import csr_array

        height, width = self._size
        xy = (positions - (self._origin + 0.5)).astype(np.float32)
        corner = np.clip(np.floor(xy), 0, np.array((width - 2, height - 2), np.float32))
        fraction = np.clip(xy - corner, 0.0, 1.0)
        column, row = np.moveaxis(corner.astype(np.int32), -1, 0)
        first = row * np.int32(width) + column
        fx, fy = fraction[..., 0], fraction[..., 1]
        taps = np.stack([first, first + 1, first + width, first + width + 1], axis=-1)
        share = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], axis=-1)
        share *= weights[..., None] * self._weight[taps]
        n = len(positions)
        per_row = taps.shape[1] * 4
        matrix = csr_array(
            (share.ravel(), taps.ravel(), np.arange(n + 1, dtype=np.int32) * per_row),
            shape=(n, height * width),
        )
        matrix.sum_duplicates()  # a pixel under several parts: its noise counts once, in full
        known = matrix.sum(axis=1)
        total = np.where(known > _LEAST, known, np.nan)[:, None]
        mean = (matrix @ self._values) / total
        matrix.data **= 2
        squares = np.where(known > _LEAST, matrix.sum(axis=1), np.nan)[:, None]
        area = total**2 / squares
        common = self._noise_area
        spread = (matrix @ self._variance) / squares * (common / (common - 1.0 + area))
        return mean, spread, np.where(known > _LEAST, np.minimum(known, 1.0), 0.0)
