"""From the photographs of the sphere straight to the cubemap: the only resampling there is.

Each texel is the mean over its area of the radiance the sphere showed there. It is split into a
grid of parts, along each side about as many as it spans pixels, so that none is stepped over: in
front a texel is a pixel or two each way; near the rim it is a small fraction of a pixel across the
rim and tens of pixels along it. At each part the photograph is interpolated bilinearly. (Kernels
with negative lobes are sharper by a little and wrong by much beside a lamp ten thousand times
brighter than its wall.)

The mirror is worked out exactly at corners of texels, and where it bends slowly at every few of
them, with cubic interpolation between, good to a hundredth of a pixel; parts lie bilinearly between
corners. The loops over texels and parts are compiled: `stages/footprint.py`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages.align import Alignment
from stages.cube import directions_on, face_directions
from stages.mirror import Array, Sphere
from stages.types import Float, Measured

# Inside the rim the photograph counts from the first distance on, and fully from the second, in
# px: a pixel nearer than that mixes in what lies beside the sphere, demosaicing one more.
_RIM_PX = (1.0, 3.0)
# Pixels over which the noise of a demosaiced channel is one, for `unwrap`: measured on flat noise
# through `demosaic`. A plain mean of what a Bayer mosaic samples would have 4 / .58 and 2 / .63.
BAYER_NOISE_AREA_PX = (6.2, 2.9, 6.2)
# How much of its noise a texel a pixel and a half wide, as they are by default, has in common
# between red, green and blue of one photograph, for `transform`: demosaicing makes red and blue
# with green's help. Measured likewise: .12 and .03 on flat light, .2 and .07 where it changes.
BAYER_NOISE_CORRELATION = ((1.0, 0.15, 0.05), (0.15, 1.0, 0.15), (0.05, 0.15, 1.0))

_CELLS = 512  # along a face, at the least, between whose corners the mirror counts as bilinear ...
_CELL_PX = 3.5  # ... and the most pixels a cell may have in the middle of the front face
_KNOTS = 128  # along a face, at the least, at which the mirror is worked out first
# px of knots' fourth differences; with more, all is worked out about them. See `_bends`: what is
# interpolated is off by less than a hundredth of a pixel.
_BENT_PX = 0.025
_EXACT_AT_ONCE = 1 << 17  # corners: memory stays below some 30 MB
_ROWS = 64  # that a thread does at a time
_AT_ONCE = 3  # channels that are read together


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

    A texel's parts count alike, though its solid angle is a little denser towards the middle of
    the face; that moves its mean by less than 3 % of a texel at N = 8, 1 / (4 N) at most.

    With independent noise the mean of A pixels of variance v has v / A; with S of them in common
    it has v for one pixel and S v / A for many, and between them about v S / (S - 1 + A). A, one
    over the sum of the squared weights, is that of the footprint's shape: see `_moments`.
    """
    from stages.footprint import blank

    cells = _Cells.of(sphere, face_size)
    channels = [image.values.shape[-1] for image in images]
    cube = (6, face_size, face_size)
    values = np.empty((*cube, sum(channels)), np.float32)
    cubemap = Measured(values, np.empty_like(values), np.ones(cube, np.float32))
    into = 0
    for number, image in enumerate(images):
        area = np.ones(channels[number]) if noise_area_px is None else np.asarray(noise_area_px)
        view = _View.of(image, sphere, alignment, number)
        for start in range(0, channels[number], _AT_ONCE):
            some = slice(start, min(start + _AT_ONCE, channels[number]))
            view.average(cells, some, into + start, area, cubemap)
        into += channels[number]
    _in_threads(
        lambda f, a, b: blank(cubemap.values[f], cubemap.variance[f], cubemap.valid[f], a, b),
        face_size,
    )
    return cubemap


@dataclass(frozen=True)
class _Cells:
    """Where the corners of a cubemap's cells are seen in the first image.

    corners  (6, 2, M + 1, M + 1) float32, x and y px
    hidden   (6, M + 1, M + 1) bool, in the blind cone
    split    cells along a texel's side
    """

    corners: Float
    hidden: NDArray[np.bool_]
    split: int

    @classmethod
    def of(cls, sphere: Sphere, face_size: int) -> _Cells:
        in_front = sphere.rim_px / face_size  # px of a texel in the middle of the front face
        split = int(max(1, np.ceil(_CELLS / face_size), np.ceil(in_front / _CELL_PX)))
        size = face_size * split
        every = max(1, size // _KNOTS)
        while size % every:
            every -= 1
        corners, hidden = _corners(sphere, size, every)
        return cls(corners, hidden, split)


def _corners(sphere: Sphere, size: int, every: int) -> tuple[Float, NDArray[np.bool_]]:
    """px (6, 2, size + 1, size + 1) of the cells' corners, and which of them are hidden.

    The mirror is worked out at knots, `every` corners apart, and between them interpolated by the
    cubic through four; but at every corner about those knots where it bends too much for that, at
    the pole and at the edges of a room's walls, and wherever the blind cone may reach.
    """
    from stages import footprint

    count = size // every
    knots = np.arange(-2, count + 3) * (2.0 * every / size) - 1.0
    pixels, seen = sphere.pixel_of(face_directions(knots[None, :], knots[:, None]))
    planes = np.moveaxis(pixels, -1, 1)
    corners = np.empty((6, 2, size + 1, size + 1), np.float32)
    wide = np.empty((6, 2, count + 3, size + 1))
    weights = _cubic(np.arange(every) / every)

    def interpolate(face: int, first: int, last: int) -> None:
        for axis in range(2):
            footprint.heighten(wide[face, axis], every, weights, corners[face, axis], first, last)

    for face, axis in np.ndindex(6, 2):
        footprint.widen(planes[face, axis, 1:-1, 1:-1], every, weights, wide[face, axis])
    _in_threads(interpolate, size + 1)
    hidden = np.zeros((6, size + 1, size + 1), bool)
    # A knot more all round, where the edge of the blind cone may bulge in between two.
    doubtful = _about(_bends(planes), count) | _about(~seen[:, 1:-1, 1:-1], count)
    edge = np.linspace(-1.0, 1.0, size + 1)
    between = np.arange(every + 1)
    faces, rows, columns = np.nonzero(doubtful)
    for some in np.array_split(np.arange(len(faces)), 1 + len(faces) * every**2 // _EXACT_AT_ONCE):
        face = faces[some, None, None]
        row = rows[some, None, None] * every + between[:, None]
        column = columns[some, None, None] * every + between
        exact, there = sphere.pixel_of(directions_on(face, edge[column], edge[row]))
        corners[face, 0, row, column] = exact[..., 0]
        corners[face, 1, row, column] = exact[..., 1]
        hidden[face, row, column] = ~there
    return corners, hidden


def _bends(planes: Array) -> NDArray[np.bool_]:
    """At which knots (6, n, n) pixels (6, 2, n + 4, n + 4) have fourth differences to speak of.

    Between knots that bend evenly, the cubic is off by at most 3/128 of theirs, each way. Across a
    kink it is off by up to .19 of the step that the slope makes over a knot's distance, and one of
    the knots beside it has a fourth difference of half that step or more: by 3/8 of that.
    """
    difference = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
    n = planes.shape[-1] - 4
    down = sum(d * planes[:, :, k : k + n, 2:-2] for k, d in enumerate(difference))
    across = sum(d * planes[:, :, 2:-2, k : k + n] for k, d in enumerate(difference))
    return (np.maximum(np.abs(down), np.abs(across)) > _BENT_PX).any(axis=1)


def _about(knots: NDArray[np.bool_], count: int) -> NDArray[np.bool_]:
    """Which squares (6, count, count) have such knots (6, n, n) at or about their corners."""
    near = range(knots.shape[-1] - count + 1)
    down = np.logical_or.reduce([knots[:, k : k + count] for k in near])
    return np.asarray(np.logical_or.reduce([down[:, :, k : k + count] for k in near]))


def _cubic(t: Array) -> Array:
    """Weights (n, 4) of the values at -1, 0, 1 and 2 in the cubic through them, at t (n,)."""
    a, b, c, d = t + 1.0, t, t - 1.0, t - 2.0
    return np.stack([-b * c * d / 6.0, a * c * d / 2.0, -a * b * d / 2.0, a * b * c / 6.0], axis=-1)


def _in_threads(work: Callable[[int, int, int], object], rows: int) -> None:
    """work(face, first, last) for all rows of all faces, in threads; errors are raised."""
    parts = ((f, y, min(y + _ROWS, rows)) for f in range(6) for y in range(0, rows, _ROWS))
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        for _ in pool.map(lambda part: work(*part), parts):
            pass


def _near(rim: Array, height: int, width: int) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Rows and columns (k,) of the pixels about the rim, along which points (n, 2) are given.

    Those further in are well inside of it; those further out nothing reads.
    """
    middle = rim.mean(axis=0)
    size = np.linalg.norm(rim - middle, axis=-1)
    y = np.arange(height) + 0.5 - middle[1]

    def ends(radius: float) -> list[NDArray[np.int_]]:
        half = np.sqrt(np.maximum(radius**2 - y**2, 0.0))
        places = (np.ceil(middle[0] + side * half - 0.5) for side in (-1.0, 1.0))
        return [np.clip(place, 0, width).astype(int) for place in places]

    (begin, end), (inner, outer) = ends(size.max() + 4.0), ends(size.min() - 2.0 * _RIM_PX[1])
    first, length = np.concatenate([begin, outer]), np.concatenate([inner - begin, end - outer])
    row = np.repeat(np.tile(np.arange(height), 2), length)
    column = np.arange(len(row)) - np.repeat(np.cumsum(length) - length - first, length)
    return row, column


@dataclass(frozen=True)
class _View:
    """One filter's image about the sphere.

    values, variance  (H, W, C) float32, contiguous
    weight            (H, W) how well pixels are known, inside the box
    box               x0, y0, x1, y1, whole px
    to_image          (2, 3) from the first image's px to those from the middle of the first pixel
    """

    values: Float
    variance: Float
    weight: Float
    box: tuple[int, int, int, int]
    to_image: Array

    @classmethod
    def of(cls, image: Measured, sphere: Sphere, alignment: Alignment, number: int) -> _View:
        from stages import footprint

        height, width = image.valid.shape
        rim = alignment.to_image(number, sphere.outline())
        # The rim lies in the frame; only another filter's shift may carry it past an edge.
        x0, y0 = (int(v) for v in np.maximum(np.floor(rim.min(axis=0)) - 1, 0))
        x1, y1 = (int(v) for v in np.minimum(np.ceil(rim.max(axis=0)) + 1, (width, height)))
        values = np.ascontiguousarray(image.values, np.float32)
        variance = np.ascontiguousarray(image.variance, np.float32)
        weight = np.empty((height, width), np.float32)
        footprint.know(values, variance, image.valid, weight, (x0, y0, x1, y1))
        row, column = _near(rim - (x0, y0), y1 - y0, x1 - x0)
        row, column = row + y0, column + x0
        pixels = np.stack([column + 0.5, row + 0.5], axis=-1)
        inside = sphere.inside_px(alignment.to_first(number, pixels))
        ramp = np.clip((inside - _RIM_PX[0]) / (_RIM_PX[1] - _RIM_PX[0]), 0.0, 1.0)
        weight[row, column] *= (ramp**2 * (3.0 - 2.0 * ramp)).astype(np.float32)
        footprint.mark(weight, (x0, y0, x1, y1))
        origin, *units = alignment.to_image(number, np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]))
        to_image = np.column_stack([*(u - origin for u in units), origin - 0.5])
        return cls(values, variance, weight, (x0, y0, x1, y1), to_image)

    def average(
        self, cells: _Cells, channels: slice, into: int, noise_area_px: NDArray, cubemap: Measured
    ) -> None:
        """Writes the means of up to three channels over all texels, and lowers `valid`.

        into     number of the first of them in the cubemap
        """
        from stages import footprint

        area = tuple(np.float32(s) for s in np.resize(noise_area_px[channels], _AT_ONCE))
        to_image = tuple(tuple(np.float32(v) for v in row) for row in self.to_image)

        def rows(face: int, first: int, last: int) -> None:
            x, y = cells.corners[face]
            footprint.average(
                x,
                y,
                cells.hidden[face],
                cells.split,
                to_image,
                self.values,
                self.variance,
                channels.start,
                self.weight,
                self.box,
                area,
                into,
                channels.stop - channels.start,
                cubemap.values[face],
                cubemap.variance[face],
                cubemap.valid[face],
                first,
                last,
            )

        _in_threads(rows, cubemap.valid.shape[1])
