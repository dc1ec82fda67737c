"""From the photographs of the sphere straight to the cubemap: the only resampling there is.

Each texel is the mean over its area of the radiance the sphere showed there. It is split into a
grid of parts, along each side about as many as it spans pixels, so that none is stepped over: in
front a texel is a pixel or two each way; near the rim it is a small fraction of a pixel across the
rim and tens of pixels along it. At each part the photograph is interpolated bilinearly. (Kernels
with negative lobes are sharper by a little and wrong by much beside a lamp ten thousand times
brighter than its wall.)

Two things make it quick. The mirror is worked out exactly at corners of texels, and where it bends
slowly at every few of them, with cubic interpolation between; parts lie bilinearly between corners.
And texels are done a tile at a time, each tile with one count of parts, so that its parts are one
small product of matrices and reading the photograph there is one call of OpenCV's.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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

_LEAST = 1e-3  # of a texel's weight; with less it is not known
_CELLS = 512  # along a face, at the least, between whose corners the mirror counts as bilinear ...
_CELL_PX = 3.5  # ... and the most pixels a cell may have in the middle of the front face
_KNOTS = 256  # along a face, at the least, between which cubic interpolation is good to 1e-3 px ...
_POLE_RAD = 0.2  # ... but within this of -Z, where the mirror turns about a point
_TILE = 64  # cells along a side of a tile; near the rim a quarter of it, as counts change fast
_PART_PX = 1.15  # the most a part may have: a little over a pixel still reads all of them alike
_FEW_PARTS = 8  # of a cell: with more, tiles are small and needles are looked for ...
_NEEDLE_PX = 1.5  # ... cells no wider than that
_MOST_PARTS = 96  # of a cell's side: a stop for what nobody has, a rim of 10000 px about the camera
_TAP_PX = 1.5  # a side: what bilinear interpolation draws in, in the mean over positions


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
    tiles = list(cells.tiles())
    channels = [image.values.shape[-1] for image in images]
    cube = (6, face_size, face_size)
    values = np.full((*cube, sum(channels)), np.nan, np.float32)
    variance = np.full_like(values, np.nan)
    valid = np.zeros(cube, np.float32)
    first = 0
    for number, image in enumerate(images):
        view = _View(image, sphere, alignment, number, noise_area_px)
        columns = slice(first, first + channels[number])
        for tile in tiles:
            place = tile.place
            written = values[(*place, columns)], variance[(*place, columns)]
            known = view.average(tile, cells.split, *written)
            valid[place] = known if number == 0 else np.minimum(valid[place], known)
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

    def tiles(self) -> Iterator[_Tile]:
        """Tiles whose cells are much alike; those that are hidden altogether are left out."""
        size = self.corners.shape[1] - 1
        whole = max(1, _TILE // self.split) * self.split
        small = max(1, _TILE // 4 // self.split) * self.split
        for face in range(6):
            for y in range(0, size, whole):
                for x in range(0, size, whole):
                    tile = self._tile(face, y, x, whole)
                    if tile is not None and len(tile.parts.u) <= _FEW_PARTS:
                        yield tile
                    elif tile is not None:
                        for v in range(y, min(y + whole, size), small):
                            for u in range(x, min(x + whole, size), small):
                                part = self._tile(face, v, u, small)
                                if part is not None:
                                    yield part

    def _tile(self, face: int, y: int, x: int, step: int) -> _Tile | None:
        here = np.s_[face, y : y + step + 1, x : x + step + 1]
        hidden, corners = self.hidden[here], self.corners[here]
        blind = None
        down, across = corners[1:] - corners[:-1], corners[:, 1:] - corners[:, :-1]
        if hidden.any():
            if hidden.all():
                return None
            # Between hidden corners lies the rim's other side, or nothing.
            down[hidden[1:] & hidden[:-1]] = 0.0
            across[hidden[:, 1:] & hidden[:, :-1]] = 0.0
            blind = hidden[1:, 1:] & hidden[1:, :-1] & hidden[:-1, 1:] & hidden[:-1, :-1]
        h, w = (n // self.split for n in (len(down), across.shape[1]))
        top, left = y // self.split, x // self.split
        place = face, slice(top, top + h), slice(left, left + w)
        return _Tile(place, corners, blind, _Parts.of(across, down))


@dataclass(frozen=True)
class _Parts:
    """The places a cell is read at: u to the right and v down, in [0, 1], and their weights.

    side  how many lie along a cell's side, across and down
    """

    u: Float
    v: Float
    weight: Float
    side: tuple[float, float]
    half: _Parts | None = None

    @classmethod
    def of(cls, across: Float, down: Float) -> _Parts:
        """As many as a tile's cells need, given their sides in px, for no pixel to be missed.

        Near the rim a cell is a needle: long, less than a pixel wide, and slanting. Places in a
        row along it are enough, each with the weight of the cell's width there.
        """
        columns, rows = (
            max(1, int(np.ceil(np.sqrt((d[..., 0] ** 2 + d[..., 1] ** 2).max()) / _PART_PX)))
            for d in (across, down)
        )
        if rows * columns > _FEW_PARTS:
            i, j = across[:-1].reshape(-1, 2), down[:, :-1].reshape(-1, 2)
            xx, xy, yy = (float((p * q).sum()) for p, q in ((i, i), (i, j), (j, j)))
            angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)  # of the long axis, in u and v
            along = np.array([np.cos(angle), np.sin(angle)])
            length = float(np.linalg.norm(i * along[0] + j * along[1], axis=-1).max())
            width = float(np.linalg.norm(j * along[0] - i * along[1], axis=-1).max())
            count = int(np.ceil(length * np.abs(along).sum() / _PART_PX))
            if width < _NEEDLE_PX and count < rows * columns:
                return cls._row(along, count, cls._row(along, -(-count // 2)))
        half = cls._grid(min(-(-rows // 2), _MOST_PARTS), min(-(-columns // 2), _MOST_PARTS))
        return cls._grid(min(rows, _MOST_PARTS), min(columns, _MOST_PARTS), half)

    @classmethod
    def _grid(cls, rows: int, columns: int, half: _Parts | None = None) -> _Parts:
        v, u = ((np.arange(n, dtype=np.float32) + np.float32(0.5)) / n for n in (rows, columns))
        count = rows * columns
        weight = np.full(count, 1.0 / count, np.float32)
        return cls(np.tile(u, rows), np.repeat(v, columns), weight, (columns, rows), half)

    @classmethod
    def _row(cls, along: Array, count: int, half: _Parts | None = None) -> _Parts:
        extent = np.abs(along).sum()
        t = ((np.arange(count) + 0.5) / count - 0.5) * extent
        # How wide the unit square is across the row at t: level in its middle, then down to 0.
        level = 0.5 * np.abs(np.abs(along[0]) - np.abs(along[1]))
        weight = np.clip((0.5 * extent - np.abs(t)) / max(0.5 * extent - level, 1e-9), 0.0, 1.0)
        # Where the row leaves the square, the nearest place in it.
        u, v = (np.clip(0.5 + t * a, 0.0, 1.0).astype(np.float32) for a in along)
        weight = (weight / weight.sum()).astype(np.float32)
        return cls(u, v, weight, (np.inf, np.inf), half)


@dataclass(frozen=True)
class _Tile:
    """Cells that are read alike.

    place    of their texels in the cubemap
    corners  (n + 1, m + 1, 2) of the cells, px in the first image
    blind    (n, m) bool, cells of which nothing can be seen; None where there is none
    parts    the places each is read at
    """

    place: tuple[int, slice, slice]  # face, rows, columns
    corners: Float
    blind: NDArray[np.bool_] | None
    parts: _Parts


def _corners(sphere: Sphere, size: int, every: int) -> tuple[Float, NDArray[np.bool_]]:
    """px (6, size + 1, size + 1, 2) of the cells' corners, and which of them are hidden."""
    edge = np.linspace(-1.0, 1.0, size + 1)
    if every == 1:
        exact, seen = sphere.pixel_of(face_directions(edge[None, :], edge[:, None]))
        return exact.astype(np.float32), ~seen
    step = 2.0 * every / size
    knots = np.arange(-1, size // every + 2) * step - 1.0
    at_knots, seen = sphere.pixel_of(face_directions(knots[None, :], knots[:, None]))
    along = _between(np.moveaxis(at_knots.astype(np.float32), 2, 0), every)
    both = _between(np.moveaxis(along, 2, 0), every)  # (row, column, face, 2)
    corners: Float = np.ascontiguousarray(np.transpose(both, (2, 0, 1, 3)))
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


def _between(knots: Float, every: int) -> Float:
    """Catmull and Rom's cubic through knots along the first axis, `every` steps from one to next.

    knots    (n + 3, ...), one beyond either end
    returns  (n * every + 1, ...)
    """
    n = len(knots) - 3
    out = np.empty((n * every + 1, *knots.shape[1:]), np.float32)
    out[::every] = knots[1:-1]
    for k in range(1, every):
        t = k / every
        weights = (
            t * (-0.5 + t * (1.0 - 0.5 * t)),
            1.0 + t * t * (1.5 * t - 2.5),
            t * (0.5 + t * (2.0 - 1.5 * t)),
            t * t * (0.5 * t - 0.5),
        )
        out[k::every] = sum(np.float32(w) * knots[i : i + n] for i, w in enumerate(weights))
    return out


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


class _View:
    """One filter's image about the sphere, its pixels weighted by how well they are known."""

    def __init__(
        self,
        image: Measured,
        sphere: Sphere,
        alignment: Alignment,
        number: int,
        noise_area_px: Sequence[float] | None,
    ):
        height, width = image.valid.shape
        self._alignment, self._number = alignment, number
        rim = alignment.to_image(number, sphere.outline())
        # The rim lies in the frame; only another filter's shift may carry it past an edge.
        x0, y0 = np.maximum(np.floor(rim.min(axis=0)).astype(int) - 1, 0)
        x1, y1 = np.minimum(np.ceil(rim.max(axis=0)).astype(int) + 1, (width, height))
        values, variance = image.values[y0:y1, x0:x1], image.variance[y0:y1, x0:x1]
        weight = image.valid[y0:y1, x0:x1].astype(np.float32)
        near, ramp = _near_rim(
            sphere,
            np.arange(x0, x1) + 0.5,
            np.arange(y0, y1) + 0.5,
            lambda p: alignment.to_first(number, p),
        )
        weight[near] *= ramp
        ones = np.ones(values.shape[-1], np.float32)
        weight[~np.isfinite(values @ ones + variance @ ones)] = 0.0
        self._origin = np.array([x0 + 0.5, y0 + 0.5], np.float32)
        s = ones if noise_area_px is None else np.asarray(noise_area_px, np.float32)
        self._noise_area = [float(area) for area in s]
        self._values = _layers(values, weight)
        self._variance = _layers(variance, weight * weight)

    def average(self, tile: _Tile, split: int, values: Float, variance: Float) -> Float:
        """Weighted means of the image over the texels of a tile.

        split             cells along a texel's side
        values, variance  (n, m, C), to be written to
        returns           (n, m) share that is known
        """
        moved = self._alignment.to_image(self._number, tile.corners)
        at: Float = (moved - self._origin).astype(np.float32)
        read = _read(self._values, at, tile.parts, tile.blind, split)
        # Variance is as rough as the light and no rougher: parts of two pixels will do for it.
        spread = _read(self._variance, at, tile.parts.half or tile.parts, tile.blind, split)
        known, squares = read[..., -1].copy(), spread[..., -1]
        whole = bool(known.min() > 1.0 - 1e-6)
        if not whole:
            unknown = known <= _LEAST
            known = np.where(unknown, np.float32(np.nan), known)
            read /= known[..., None]
            squares = np.maximum(squares, np.float32(1e-12))
        moments = _moments(at[::split, ::split], *(n * split for n in tile.parts.side))
        factors: dict[float, Float] = {}
        for c, s in enumerate(self._noise_area):
            values[..., c] = read[..., c]
            if s not in factors:
                drawn = _drawn(moments, s)
                if whole:
                    factors[s] = s / drawn
                else:
                    # Of a footprint known in part, less is drawn in.
                    part = (drawn - s + 1.0) * known**2 / squares
                    drawn = s - 1.0 + np.maximum(part, _row_drawn(moments))
                    factors[s] = s / drawn / squares
            np.multiply(spread[..., c], factors[s], out=variance[..., c])
        return np.ones_like(known) if whole else np.where(unknown, 0.0, np.minimum(known, 1.0))


def _read(layers: list[Float], at: Float, parts: _Parts, blind, split: int) -> Float:
    """Means (n, m, C + 1) over texels of layers (h, w, <= 4).

    at     (n split + 1, m split + 1, 2) px of the cells' corners
    blind  (n split, m split) bool, cells that show nothing, or None
    """
    import cv2

    h, w = at.shape[0] - 1, at.shape[1] - 1
    u, v = parts.u, parts.v
    share = np.stack([(1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u], axis=-1)
    x, y = (
        share
        @ np.stack([a[:-1, :-1].ravel(), a[:-1, 1:].ravel(), a[1:, :-1].ravel(), a[1:, 1:].ravel()])
        for a in (at[..., 0], at[..., 1])
    )
    means = []
    for layer in layers:
        read = cv2.remap(layer, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        mean = read[0] if len(u) == 1 else parts.weight @ read.reshape(len(u), -1)
        means.append(mean.reshape(h, w, -1))
    texels = means[0] if len(means) == 1 else np.concatenate(means, axis=-1)
    if blind is not None:
        texels[blind] = 0.0
    if split > 1:
        # One side after the other: long sums of float32 lose digits.
        c = texels.shape[-1]
        texels = texels.reshape(h, w // split, split, c).mean(axis=2)
        texels = texels.reshape(h // split, split, w // split, c).mean(axis=1)
    return np.asarray(texels)


def _layers(values: Float, weight: Float) -> list[Float]:
    """Values (h, w, C) times their weight (h, w), then the weight itself, by up to four channels.

    OpenCV reads four channels in hardly more time than one.
    """
    import cv2

    h, w, channels = values.shape
    partly = weight != 1.0
    factor = weight[partly][:, None]
    layers = []
    for start in range(0, channels + 1, 4):
        some = [np.ascontiguousarray(values[..., start : start + 4])] if start < channels else []
        if channels < start + 4:
            some.append(np.ones((h, w, 1), np.float32))
        layer: Float = np.asarray(cv2.merge(some), np.float32).reshape(h, w, -1)
        layer[partly] = np.where(factor > 0.0, layer[partly] * factor, np.float32(0.0))
        layers.append(layer)
    return layers


def _moments(corners: Float, columns: float, rows: float) -> tuple[Float, Float, Float]:
    """Of texels' footprints (n, m), times 12: second moments xx, yy and xy, px^2.

    corners        (n + 1, m + 1, 2) px of the texels' corners
    columns, rows  parts along a texel's side

    So a side of s px has s^2. Bilinear interpolation adds 1.5^2 in the mean: over many positions
    it draws in 1.5 px, one over the mean sum of its squared weights. A texel that is read but once
    has its own: 1 / (f^2 + (1 - f)^2) at the fraction f between two pixels.
    """
    across, down = corners[1:, 1:] - corners[1:, :-1], corners[1:, 1:] - corners[:-1, 1:]
    ax, ay = across[..., 0], across[..., 1]
    dx, dy = down[..., 0], down[..., 1]
    many, many_down = np.float32(1.0 - 1.0 / columns**2), np.float32(1.0 - 1.0 / rows**2)
    xx, yy = many * ax * ax + many_down * dx * dx, many * ay * ay + many_down * dy * dy
    xy = many * ax * ay + many_down * dx * dy
    for axis, squares in enumerate((xx, yy)):
        tap = np.float32(_TAP_PX**2)
        if columns * rows > 1 and squares.min() >= 1.0:
            squares += tap
            continue
        middle = 0.5 * (corners[:-1, :-1, axis] + corners[1:, 1:, axis])
        f = middle - np.floor(middle)
        alone = 1.0 / (1.0 - 2.0 * f * (1.0 - f)) ** 2
        squares += tap + (alone - tap) * np.maximum(np.float32(1.0) - squares, np.float32(0.0))
    return xx, yy, xy


def _drawn(moments: tuple[Float, Float, Float], noise_area_px: float) -> Float:
    """S - 1 + A (n, m): see `unwrap`. A footprint's area is the root of its moments' determinant.

    Noise that S pixels have in common widens the footprint by S - 1 px^2 both ways: a long and
    narrow texel gains more by it than a square one.
    """
    xx, yy, xy = moments
    more = np.float32(noise_area_px - 1.0)
    drawn: Float = np.sqrt(np.maximum((xx + more) * (yy + more) - xy * xy, noise_area_px**2))
    return drawn


def _row_drawn(moments: tuple[Float, Float, Float]) -> Float:
    """The least A (n, m) of footprints known in part: that of a single row of pixels.

    Along the rim texels are needles, and those at its very edge are known by how far interpolation
    reaches back inside: one row of pixels across, but all of them along. Over the steps of the
    row that reach runs from 0 to 1, which draws in 3/4 (its mean squared over its mean square).
    1 for wider ones.
    """
    xx, yy, xy = moments
    middle, half = 0.5 * (xx + yy), np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    needle = middle - half < _NEEDLE_PX**2 + _TAP_PX**2
    row: Float = np.where(needle, np.maximum(0.75 * np.sqrt(middle + half), 1.0), 1.0)
    return row
