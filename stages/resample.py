"""One layout to another, in any rotation: each pixel the mean of the source over its solid angle.

A pixel is split into a grid of parts, along each side about twice as many as it spans pixels of the
source, so that none is stepped over; at each part the source is interpolated bilinearly, across the
edges of faces and sheets. All this is one sparse matrix from source to target, so that any number
of channels costs little more than one. Interpolation alone would give a lamp of one pixel too much
light or too little, by where it falls between the pixels and by how the layout is bent there: the
matrix is therefore balanced until each source pixel gives away just what it has, its radiance times
its solid angle, while every target pixel remains a mean: both hold at once, to _EXACT.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from stages.layouts import Array, Projection
from stages.types import Measured

_COUNTS = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48])  # parts along a pixel's side
_FINENESS = 2.0  # parts along a side of a pixel of the source
_CUT = int(np.searchsorted(_COUNTS, 8))  # parts at least, of pixels that a rim cuts through
_CHUNK = 1 << 17  # parts at a time: memory stays below some 100 MB
_LEAST = 1e-3  # of a pixel's weight; with less it is not known
_SERVED = 0.5  # of a source pixel's light: where interpolation finds less, the rest is handed out
_EXACT = 5e-4  # of a source pixel's light, what balancing leaves undone at most
_SLIVER = 0.01  # of a mean pixel's solid angle: smaller ones, at a pole or a rim, may miss that
_SINKHORN, _OVER = 4, 1.8  # rounds, and over-relaxation (A. Thibault et al. 2017)
_NEWTON, _GRADIENTS = 6, 30  # steps, and conjugate gradients in each


def resample(
    measured: Measured,
    source: Projection,
    target: Projection,
    rows: int,
    *,
    rotation=None,
) -> Measured:
    """An environment map in another layout.

    measured  (6, N, N, C) for a cube, otherwise (H, W, C); variance may be NaN throughout
    rows      of the result; of a cube, texels along a face
    rotation  (3, 3) orthogonal: what was seen in direction d is then seen in rotation @ d
    returns   likewise; `valid` is the share of a pixel that is known, as the source's `valid` has
              it; NaN where it is 0, and where a layout looks nowhere, as in a probe's corners

    Variances add up as those of independent pixels do: of a mean of A alike, v / A. Where noise is
    alike in neighbours, as in a map magnified from its photograph, the truth is up to as many
    times more as pixels have their noise in common.
    """
    source_rows = measured.values.shape[-3]
    channels = measured.values.shape[-1]
    sheets, height, width = target.shape(rows)
    matrix = matrix_between(source, source_rows, target, rows, rotation=rotation)

    values = measured.values.reshape(-1, channels)
    weight = np.where(np.isfinite(values).all(axis=-1), measured.valid.reshape(-1), 0.0)
    weight = weight.astype(np.float32)
    whole = bool((weight == 1.0).all())
    known = np.asarray(matrix.sum(axis=1)) if whole else matrix @ weight
    there = known > _LEAST
    over = np.where(there, known, np.nan).astype(np.float32)[:, None]
    mean = matrix @ (values if whole else _weighted(values, weight))
    mean /= over
    variance = np.full_like(mean, np.nan)
    if not np.isnan(measured.variance).all():
        matrix.data **= 2
        spread = measured.variance.reshape(-1, channels)
        variance = matrix @ (spread if whole else _weighted(spread, weight**2))
        variance /= over**2
    shape = (height, width) if sheets == 1 else (sheets, height, width)
    # Rows add up to 1 but for rounding, which is not to count as something unknown.
    valid = np.where(there, np.where(known > 1.0 - 1e-5, 1.0, known), 0.0).astype(np.float32)
    return Measured(
        mean.reshape(*shape, channels), variance.reshape(*shape, channels), valid.reshape(shape)
    )


def _weighted(values, weight):
    return np.where(weight[:, None] > 0, values, 0.0) * weight[:, None]


def matrix_between(
    source: Projection, source_rows: int, target: Projection, rows: int, *, rotation=None
):
    """The sparse matrix (target pixels, source pixels): rows add up to 1, or 0 where there is none.

    Columns, weighted by the target's solid angles, add up to the source's, to _EXACT of each.
    """
    turn = np.eye(3) if rotation is None else np.asarray(rotation, np.float64)
    targets = int(np.prod(target.shape(rows)))
    sources = int(np.prod(source.shape(source_rows)))
    pieces = [
        (pixels, _gathered(taps, shares, sources))
        for pixels, taps, shares in _interpolated(source, source_rows, target, rows, turn)
    ]
    matrix = _stitched(pieces, (targets, sources))
    del pieces
    if not source.whole:
        return matrix
    has = np.tile(source.solid_angles(source_rows).reshape(-1), source.sheets)
    takes = np.tile(target.solid_angles(rows).reshape(-1), target.sheets)
    few = _handed_out(matrix, source, source_rows, target, rows, turn, has, takes)
    if few.nnz:
        matrix = matrix + few
    _balance(matrix, has, takes)
    return matrix


def _gathered(taps, shares, sources: int):
    """Rows of a matrix: shares (n, k) of the source pixels `taps` (n, k)."""
    from scipy.sparse import csr_array

    n, per_row = taps.shape
    ends = np.arange(n + 1, dtype=np.int32) * per_row
    piece = csr_array((shares.reshape(-1), taps.reshape(-1), ends), shape=(n, sources))
    if per_row > 9:
        piece.sum_duplicates()
    return piece


def _stitched(pieces, shape):
    """One matrix of pieces (row numbers, rows), each row in one of them or in none."""
    from scipy.sparse import csr_array

    lengths = np.zeros(shape[0], np.int64)
    for pixels, piece in pieces:
        lengths[pixels] = np.diff(piece.indptr)
    start = np.concatenate([[0], np.cumsum(lengths)])
    data = np.empty(start[-1], np.float32)
    indices = np.empty(start[-1], np.int32)
    for pixels, piece in pieces:
        own = np.diff(piece.indptr)
        place = np.repeat(start[pixels] - piece.indptr[:-1], own) + np.arange(len(piece.data))
        data[place], indices[place] = piece.data, piece.indices
    return csr_array((data, indices, start), shape=shape)


def _handed_out(matrix, source: Projection, source_rows: int, target, rows: int, turn, has, takes):
    """What interpolation finds too little of, as a matrix of the same shape.

    Slivers at a disc's rim and pixels beside a pole may lie between all parts. What is missing of
    them goes to the target pixels that they really lie over, by parts of their own.
    """
    from scipy.sparse import csr_array

    found = matrix.T @ takes.astype(np.float32)
    few = np.flatnonzero((has > 0) & (found < _SERVED * has))
    _, height, width = source.shape(source_rows)
    sheet, y, x = np.unravel_index(few, (source.sheets, height, width))
    _, target_height, target_width = target.shape(rows)
    where, which, much = [few[:0]], [few[:0]], [np.zeros(0)]
    n = int(_COUNTS[_CUT])
    for s in range(source.sheets):
        own = np.flatnonzero(sheet == s)
        if len(own) == 0:
            continue
        for some in np.array_split(own, 1 + len(own) * n * n // _CHUNK):
            # _split leaves out pixels that look nowhere: those have no light to hand out.
            _, d, weights = _split(source, s, (height, width), y[some], x[some], n, n)
            their_sheet, u, v = target.position(d @ turn.T)
            column = np.clip((u * target_width).astype(np.intp), 0, target_width - 1)
            row = np.clip((v * target_height).astype(np.intp), 0, target_height - 1)
            pixel = (their_sheet * target_height + row) * target_width + column
            missing = (has[few[some]] - found[few[some]])[:, None] * weights
            there = (missing > 0) & (takes[pixel] > 0)
            where.append(pixel[there])
            which.append(np.broadcast_to(few[some][:, None], pixel.shape)[there])
            much.append(missing[there] / takes[pixel[there]])
    data = np.concatenate(much).astype(np.float32)
    return csr_array((data, (np.concatenate(where), np.concatenate(which))), shape=matrix.shape)


def _balance(matrix, has: Array, takes: Array) -> None:
    """Scales rows and columns of the matrix, in place, until rows add up to 1 and columns to `has`.

    A few rounds scale rows and columns in turn (R. Sinkhorn 1967), which evens out neighbours
    quickly but moves light over a distance only slowly. Newton's method on the logarithms of the
    columns' factors then does that: its equations are a Laplacian over source pixels that share a
    target, solved by conjugate gradients without being written out (M. Brauer, C. Clason,
    D. Lorenz, B. Wirth 2017: A Sinkhorn-Newton method for entropic optimal transport).
    """
    own = np.diff(matrix.indptr)
    transposed = matrix.T
    allowed = np.where(has > _SLIVER * has[has > 0].mean(), _EXACT * has, np.inf)
    has, takes = has.astype(np.float32), takes.astype(np.float32)
    column, row = np.ones_like(has), np.ones_like(takes)
    for _ in range(_SINKHORN):
        given = column * (transposed @ (row * takes))
        column *= np.where(given > 0, has * _inverse(given), 1.0).astype(np.float32) ** _OVER
        row = _inverse(matrix @ column)
    for _ in range(_NEWTON):
        given = column * (transposed @ (row * takes))
        missing = np.where(given > 0, has - given, 0.0).astype(np.float32)
        if (np.abs(missing) <= allowed).all():
            break

        def moved(x, given=given, column=column, row=row):
            mean = row * (matrix @ (column * x))
            return given * x - column * (transposed @ (row * takes * mean))

        step = _solved(moved, missing, _inverse(given), 0.5 * allowed)
        column = column * np.exp(np.clip(step, -2.0, 2.0))
        row = _inverse(matrix @ column)
    matrix.data *= column[matrix.indices]
    matrix.data *= np.repeat(row, own)


def _solved(product, right, inverse_diagonal, allowed):
    """x with product(x) = right to within `allowed`, by preconditioned conjugate gradients."""
    x, residual = np.zeros_like(right), right.copy()
    direction = z = inverse_diagonal * residual
    size = np.dot(residual, z)
    for _ in range(_GRADIENTS):
        image = product(direction)
        along = size / np.dot(direction, image)
        x += along * direction
        residual -= along * image
        if (np.abs(residual) <= allowed).all():
            break
        z = inverse_diagonal * residual
        size, before = np.dot(residual, z), size
        direction = z + (size / before) * direction
    return x


def _inverse(a):
    return np.where(a > 0, 1.0 / np.where(a > 0, a, 1.0), 0.0).astype(np.float32)


def _interpolated(
    source: Projection, source_rows: int, target: Projection, rows: int, turn: Array
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.int32], NDArray[np.float32]]]:
    """All pixels of the target that look anywhere, some at a time, split finely enough.

    yields  flat indices (n,) of pixels; the source pixels that each takes from (n, k), and its
            shares of them (n, k), which add up to 1
    """
    sheets, height, width = target.shape(rows)
    seen = target.solid_angles(rows) > 0
    pixel_of = _bordered(source, source_rows)
    u = (np.arange(width) + 0.5) / width
    v = (np.arange(height) + 0.5) / height
    # How much of a radian a pixel spans, right and down, and how many of the source's pixels lie
    # there on a radian: how many parts are enough.
    block = max(1, _CHUNK // width)
    for sheet in range(sheets):
        for first in range(0, height, block):
            rows_v = v[first : first + block, None]
            across = _span(target, sheet, u[None, :], rows_v, 0.5 / width, 0.0)
            down = _span(target, sheet, u[None, :], rows_v, 0.0, 0.5 / height)
            middle = target.direction(sheet, u[None, :], rows_v)
            inside = seen[first : first + block]
            # Only a mirror ball looks nowhere past its rim, and at it to -Z.
            d = np.where(np.isfinite(middle), middle, (0.0, 0.0, -1.0)) @ turn
            position = np.broadcast_arrays(*source.position(d))
            _, su, sv = position
            fine = _FINENESS * source_rows * source.pixels_per_radian(d, su, sv)
            cut = _cut(target, u, rows_v, width, height)
            least = np.where(cut, _CUT, 0)
            columns = np.maximum(_enough(across * fine), least)
            lines = np.maximum(_enough(down * fine), least)
            kind = np.where(inside, columns * len(_COUNTS) + lines, -1)
            # Where the source's pixels are about as large, which is most often: in one go.
            x, y, right, below, smooth = _steps(source, source_rows, position)
            smooth &= (kind >= 0) & ~cut & (columns < 2) & (lines < 2)
            if smooth.any():
                pixels = (sheet * height + first) * width + np.flatnonzero(smooth)
                taps, shares = _nine(
                    source,
                    source_rows,
                    pixel_of,
                    position[0][smooth],
                    x[smooth],
                    y[smooth],
                    right[smooth],
                    below[smooth],
                )
                yield pixels, taps, shares
                kind = np.where(smooth, -1, kind)
            for k in np.unique(kind):
                if k < 0:
                    continue
                y, x = np.nonzero(kind == k)
                nx, ny = _COUNTS[k // len(_COUNTS)], _COUNTS[k % len(_COUNTS)]
                at_once = max(1, _CHUNK // int(nx * ny))
                for some in range(0, len(y), at_once):
                    rest = slice(some, some + at_once)
                    pixels, d, weights = _split(
                        target, sheet, (height, width), first + y[rest], x[rest], nx, ny
                    )
                    taps, shares = _taps(source, source_rows, pixel_of, source.position(d @ turn))
                    shares *= weights[..., None]
                    yield pixels, taps.reshape(len(pixels), -1), shares.reshape(len(pixels), -1)


def _steps(source: Projection, rows: int, position):
    """Places x, y in the source's pixels, and how they change, (..., 2), to the right and down.

    position  sheet, u and v, (H, W) each, of a block of the target's pixels
    returns   x, y (H, W), right, down (H, W, 2), and where they change smoothly (H, W): not where
              the source's sheet does, or where its ends meet
    """
    _, height, width = source.shape(rows)
    sheet, u, v = position
    place = np.stack([u * width, v * height], axis=-1).astype(np.float32)
    smooth = np.ones(u.shape, bool)
    steps = []
    for axis in (1, 0):
        if u.shape[axis] < 2:
            return place[..., 0], place[..., 1], place, place, np.zeros(u.shape, bool)
        ahead = np.diff(place, axis=axis)
        even = (np.abs(ahead).max(axis=-1) < 2.0) & (np.diff(sheet, axis=axis) == 0)
        steps.append(np.gradient(place, axis=axis))
        pads = [(0, 0), (0, 0)]
        pads[axis] = (1, 0)
        smooth &= np.pad(even, pads, mode="edge")
        pads[axis] = (0, 1)
        smooth &= np.pad(even, pads, mode="edge")
    return place[..., 0], place[..., 1], steps[0], steps[1], smooth


def _nine(source: Projection, rows: int, pixel_of, sheet, x, y, right, down):
    """The nine pixels (n, 9) about each place, and their shares as the mean over four parts of it.

    x, y         (n,) in the source's pixels
    right, down  (n, 2) from one place to the next: less than two of them together, in x and in y
    """
    _, height, width = source.shape(rows)
    offsets = np.stack([right + down, right - down, down - right, -right - down], axis=1) / 4
    # the border's first pixel has its centre at 0
    px, py = x[:, None] + 0.5 + offsets[..., 0], y[:, None] + 0.5 + offsets[..., 1]
    column, row = np.floor(px.min(axis=1)), np.floor(py.min(axis=1))
    three = np.arange(3, dtype=np.float32)
    wx = np.maximum(1.0 - np.abs((px - column[:, None])[..., None] - three), 0.0)
    wy = np.maximum(1.0 - np.abs((py - row[:, None])[..., None] - three), 0.0)
    shares = (np.matmul(wy.transpose(0, 2, 1), wx) / 4).reshape(-1, 9).astype(np.float32)
    columns = np.clip(column.astype(np.int32)[:, None] + np.arange(3, dtype=np.int32), 0, width + 1)
    lines = np.clip(row.astype(np.int32)[:, None] + np.arange(3, dtype=np.int32), 0, height + 1)
    stride = np.int32(width + 2)
    lines += np.asarray(sheet, np.int32)[:, None] * np.int32(height + 2)
    taps = pixel_of[(lines[:, :, None] * stride + columns[:, None, :]).reshape(-1, 9)]
    shares[taps < 0] = 0.0
    return np.maximum(taps, 0), shares


def _cut(target: Projection, u, v, width: int, height: int):
    """Whether the rim of what is looked at may pass through a pixel."""
    corners = [
        target.density(u + i / width, v + j / height) == 0 for i in (-0.5, 0.5) for j in (-0.5, 0.5)
    ]
    return np.logical_or.reduce(corners)


def _span(target: Projection, sheet: int, u, v, du: float, dv: float) -> Array:
    """Length of the chord between the middles of two sides of each pixel."""
    there = target.direction(sheet, u + du, v + dv) - target.direction(sheet, u - du, v - dv)
    length = np.sqrt(np.einsum("...i,...i->...", there, there))
    return np.where(np.isfinite(length), length, np.nanmax(length, initial=0.0))


def _enough(spanned: Array) -> NDArray[np.intp]:
    """Which of _COUNTS makes parts of at most a pixel, or a little more."""
    return np.minimum(np.searchsorted(_COUNTS, spanned - 0.25), len(_COUNTS) - 1)


def _split(target: Projection, sheet: int, shape, y, x, nx: int, ny: int):
    """Pixels at rows y and columns x in nx by ny parts: flat indices, directions, weights."""
    height, width = shape
    u = (x[:, None] + (np.arange(nx) + 0.5) / nx) / width
    v = (y[:, None] + (np.arange(ny) + 0.5) / ny) / height
    u, v = np.broadcast_arrays(u[:, None, :], v[:, :, None])
    u, v = u.reshape(len(y), -1), v.reshape(len(y), -1)
    weights = target.density(u, v)
    total = weights.sum(axis=1, keepdims=True)
    d = target.direction(sheet, u, v)
    pixels = (sheet * height + y) * width + x
    if not weights.all():
        some = total[:, 0] > 0
        weights, total, d, pixels = weights[some], total[some], d[some], pixels[some]
        d = np.where((weights > 0)[..., None], d, (0.0, 0.0, 1.0))
    return pixels, d, (weights / total).astype(np.float32)


def _taps(source: Projection, rows: int, pixel_of, position):
    """The four pixels (n, k, 4) about each position, and their shares."""
    _, height, width = source.shape(rows)
    sheet, u, v = position
    x, y = u * width + 0.5, v * height + 0.5  # the border's first pixel has its centre at 0
    column = np.clip(np.floor(x), 0, width).astype(np.int32)
    row = np.clip(np.floor(y), 0, height).astype(np.int32)
    fx, fy = (x - column).astype(np.float32), (y - row).astype(np.float32)
    stride = np.int32(width + 2)
    first = (np.asarray(sheet, np.int32) * np.int32(height + 2) + row) * stride + column
    taps = pixel_of[np.stack([first, first + 1, first + stride, first + stride + 1], axis=-1)]
    shares = np.stack([(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy], axis=-1)
    shares[taps < 0] = 0.0
    return np.maximum(taps, 0), shares


def _bordered(source: Projection, rows: int) -> NDArray[np.int32]:
    """Pixel numbers of the sheets, each bordered by a pixel of what lies beyond; -1 where nothing.

    returns  (sheets * (rows + 2) * (columns + 2),)
    """
    sheets, height, width = source.shape(rows)
    blind = np.asarray(source.solid_angles(rows) <= 0)
    own = np.arange(sheets * height * width, dtype=np.int32).reshape(sheets, height, width)
    table = np.pad(own, [(0, 0), (1, 1), (1, 1)])
    # Others than itself: beyond the sheets, and within them where a layout looks nowhere.
    y, x = np.nonzero(np.pad(blind, 1, constant_values=True))
    for s in range(sheets):
        d = source.direction(s, (x - 0.5) / width, (y - 0.5) / height)
        nowhere = np.asarray(~np.isfinite(d).all(axis=-1))
        sheet, u, v = source.position(np.where(nowhere[..., None], (0.0, 0.0, 1.0), d))
        column = np.clip((u * width).astype(np.int32), 0, width - 1)
        row = np.clip((v * height).astype(np.int32), 0, height - 1)
        table[s, y, x] = np.where(
            np.logical_or(nowhere, blind[row, column]), -1, own[sheet, row, column]
        )
    return table.reshape(-1)
