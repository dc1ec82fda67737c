"""From the photographs of the sphere straight to the cubemap: the only resampling there is.

Each texel is the mean over its area of the radiance the sphere showed there. It is split into a
grid of parts, along each side about as many as it spans pixels, so that none is stepped over: in
front a texel is a pixel or two each way; near the rim it is a small fraction of a pixel across the
rim and tens of pixels along it. At each part the photograph is interpolated bilinearly. (Kernels
with negative lobes are sharper by a little and wrong by much beside a lamp ten thousand times
brighter than its wall.)

The mirror is worked out exactly at corners of texels, and where it bends slowly at every few of
them, with cubic interpolation between; parts lie bilinearly between corners. The loops over
texels and parts are compiled: `stages/footprint.py`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages.align import Alignment
from stages.cube import face_directions
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
_KNOTS = 256  # along a face, at the least, between which cubic interpolation is good to 1e-3 px ...
_POLE_RAD = 0.2  # ... but within this of -Z, where the mirror turns about a point
_ROWS = 64  # of cells, that a thread does at a time
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
    cells = _Cells.of(sphere, face_size)
    channels = [image.values.shape[-1] for image in images]
    cube = (6, face_size, face_size)
    values = np.full((*cube, sum(channels)), np.nan, np.float32)
    variance = np.full_like(values, np.nan)
    valid = np.ones(cube, np.float32)
    first = 0
    for number, image in enumerate(images):
        area = np.ones(channels[number]) if noise_area_px is None else np.asarray(noise_area_px)
        view = _View.of(image, sphere, alignment, number)
        for start in range(0, channels[number], _AT_ONCE):
            some = slice(start, min(start + _AT_ONCE, channels[number]))
            into = slice(first + some.start, first + some.stop)
            view.average(cells, some, area, values[..., into], variance[..., into], valid)
        first += channels[number]
    unknown = valid <= 0.0
    values[unknown] = variance[unknown] = np.nan
    return Measured(values, variance, valid)


@dataclass(frozen=True)
class _Cells:
    """Where the corners of a cubemap's cells are seen in the first image.

    corners  (6, M + 1, M + 1, 2) float32 px
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
    """px (6, size + 1, size + 1, 2) of the cells' corners, and which of them are hidden."""
    from stages.footprint import between

    edge = np.linspace(-1.0, 1.0, size + 1)
    if every == 1:
        exact, seen = sphere.pixel_of(face_directions(edge[None, :], edge[:, None]))
        return exact.astype(np.float32), ~seen
    step = 2.0 * every / size
    knots = np.arange(-1, size // every + 2) * step - 1.0
    at_knots, seen = sphere.pixel_of(face_directions(knots[None, :], knots[:, None]))
    corners = np.empty((6, size + 1, size + 1, 2), np.float32)
    _in_threads(
        lambda face, first, last: between(at_knots[face], every, corners[face], first, last),
        size + 1,
    )
    nearest = np.rint(np.arange(size + 1) / every).astype(int) + 1
    hidden = ~seen[:, nearest[:, None], nearest]
    # Near the pole exactly.
    pole = sphere.world_from_camera @ np.asarray(sphere.centre_mm) / sphere.distance_mm
    for face in range(6):
        knots_here = face_directions(edge[None, ::every], edge[::every, None])[face]
        near = np.argwhere(knots_here @ pole > np.cos(_POLE_RAD + step))
        if not len(near):
            continue
        low, high = near.min(axis=0) * every, near.max(axis=0) * every
        rows, columns = (slice(a, b + 1) for a, b in zip(low, high, strict=True))
        d = face_directions(edge[None, columns], edge[rows, None])[face]
        exact, seen_there = sphere.pixel_of(d)
        corners[face, rows, columns] = exact
        hidden[face, rows, columns] = ~seen_there
    return corners, hidden


def _in_threads(work: Callable[[int, int, int], object], rows: int, faces: int = 6) -> None:
    """work(face, first, last) for all rows of all faces, in threads; errors are raised."""
    parts = ((f, y, min(y + _ROWS, rows)) for f in range(faces) for y in range(0, rows, _ROWS))
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        for _ in pool.map(lambda part: work(*part), parts):
            pass


def _near_rim(sphere: Sphere, x: Array, y: Array, to_first) -> tuple[NDArray[np.bool_], Float]:
    """Which pixels (h, w) at columns x and rows y lie about the rim, and how far they count, 0..1.

    Those further in count fully; those further out nothing reads.
    to_first  positions (..., 2) of this image to those of the first, where the sphere is
    """
    corners = to_first(np.array([(x[0], y[0]), (x[-1], y[0]), (x[0], y[-1])]))
    across = (corners[1] - corners[0]) / max(1, len(x) - 1)
    down = (corners[2] - corners[0]) / max(1, len(y) - 1)
    rim = sphere.outline()
    middle = rim.mean(axis=0)
    size = np.linalg.norm(rim - middle, axis=-1)
    i, j = np.arange(len(x), dtype=np.float32), np.arange(len(y), dtype=np.float32)[:, None]
    first, across, down = (a.astype(np.float32) for a in (corners[0] - middle, across, down))
    apart = (first[0] + across[0] * i + down[0] * j) ** 2
    apart += (first[1] + across[1] * i + down[1] * j) ** 2
    inner, outer = max(size.min() - 2.0 * _RIM_PX[1], 0.0), size.max() + 4.0
    near = (apart >= inner**2) & (apart < outer**2)
    row, column = np.nonzero(near)
    inside = sphere.inside_px(to_first(np.stack([x[column], y[row]], axis=-1)))
    ramp = np.clip((inside - _RIM_PX[0]) / (_RIM_PX[1] - _RIM_PX[0]), 0.0, 1.0)
    return near, (ramp**2 * (3.0 - 2.0 * ramp)).astype(np.float32)


@dataclass(frozen=True)
class _View:
    """One filter's image about the sphere.

    weight    (h, w) how well its pixels are known, from that at `origin` on
    origin    x, y, whole px
    to_image  (2, 3) from the first image's px to those from the middle of the weights' first pixel
    """

    image: Measured
    weight: Float
    origin: tuple[int, int]
    to_image: Array

    @classmethod
    def of(cls, image: Measured, sphere: Sphere, alignment: Alignment, number: int) -> _View:
        height, width = image.valid.shape
        rim = alignment.to_image(number, sphere.outline())
        # The rim lies in the frame; only another filter's shift may carry it past an edge.
        x0, y0 = (int(v) for v in np.maximum(np.floor(rim.min(axis=0)) - 1, 0))
        x1, y1 = (int(v) for v in np.minimum(np.ceil(rim.max(axis=0)) + 1, (width, height)))
        weight = image.valid[y0:y1, x0:x1].astype(np.float32)
        near, ramp = _near_rim(
            sphere,
            np.arange(x0, x1, dtype=np.float64) + 0.5,
            np.arange(y0, y1, dtype=np.float64) + 0.5,
            lambda p: alignment.to_first(number, p),
        )
        weight[near] *= ramp
        origin, *units = alignment.to_image(number, np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]))
        to_image = np.column_stack([*(u - origin for u in units), origin - (x0 + 0.5, y0 + 0.5)])
        return cls(image, weight, (x0, y0), to_image)

    def average(
        self,
        cells: _Cells,
        channels: slice,
        noise_area_px: NDArray,
        values: Float,
        variance: Float,
        valid: Float,
    ) -> None:
        """Writes the means of up to three channels over all texels, and lowers `valid`."""
        from stages import footprint

        def three(image: Float) -> Float:
            some = image[..., channels]
            lacking = _AT_ONCE - some.shape[-1]
            return np.pad(some, ((0, 0), (0, 0), (0, lacking))) if lacking else some

        (x, y), (h, w) = self.origin, self.weight.shape
        layers = np.empty((h * w, 8), np.float32)
        image, spread = three(self.image.values), three(self.image.variance)
        _in_threads(
            lambda _, a, b: footprint.layered(image, spread, self.weight, y, x, a, b, layers), h, 1
        )
        count = values.shape[-1]
        area = tuple(np.float32(s) for s in np.resize(noise_area_px[channels], _AT_ONCE))
        to_image = tuple(tuple(np.float32(v) for v in row) for row in self.to_image)

        def rows(face: int, first: int, last: int) -> None:
            hidden = cells.hidden[face]
            footprint.average(
                cells.corners[face],
                hidden,
                bool(hidden.any()),
                cells.split,
                first,
                last,
                to_image,
                layers,
                (h, w),
                area,
                count,
                values[face],
                variance[face],
                valid[face],
            )

        _in_threads(rows, valid.shape[1])
