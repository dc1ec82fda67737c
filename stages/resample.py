"""One layout to another, in any rotation: each pixel the mean of the source over its solid angle.

A pixel is split into a grid of parts, along each side as many as it spans pixels of the source, so
that none is stepped over; at each part the source is interpolated bilinearly, across the edges of
faces and sheets. All this is one sparse matrix from source to target, so that any number of
channels costs little more than one. Interpolation alone would give a lamp of one pixel too much
light or too little, by where it falls between the pixels and by how the layout is bent there: the
matrix is therefore balanced (R. Sinkhorn 1967) until each source pixel gives away just what it
has, its radiance times its solid angle, while every target pixel remains a mean.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.layouts import Array, Projection
from stages.types import Measured

_COUNTS = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64])  # parts along a pixel's side
_CUT = int(np.searchsorted(_COUNTS, 8))  # parts at least, of pixels that a rim cuts through
_CHUNK = 1 << 17  # parts at a time: memory stays below some 100 MB
_LEAST = 1e-3  # of a pixel's weight; with less it is not known
# Rounds, and over-relaxation (A. Thibault et al. 2017), which saves half of them: a lamp of one
# pixel alone in the dark keeps its light to 1.5 % instead of 15 (but on the rim of a disc, where
# pixels are slivers), a map with more in it to .1 %.
_BALANCING, _OVER = 12, 1.8


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

    Columns, weighted by the target's solid angles, add up to the source's, to about 1e-4.
    """
    from scipy.sparse import csr_array

    turn = np.eye(3) if rotation is None else np.asarray(rotation, np.float64)
    targets = int(np.prod(target.shape(rows)))
    sources = int(np.prod(source.shape(source_rows)))
    lengths = np.zeros(targets, np.int64)
    pieces = []
    pixel_of = _bordered(source, source_rows)
    for pixels, positions, weights in _parts(source, source_rows, target, rows, turn):
        taps, shares = _taps(source, source_rows, pixel_of, positions)
        n, per_row = len(pixels), taps.shape[1] * 4
        shares *= weights[..., None]
        piece = csr_array(
            (
                shares.reshape(-1),
                taps.reshape(-1),
                np.arange(n + 1, dtype=np.int32) * per_row,
            ),
            shape=(n, sources),
        )
        if per_row > 4:
            piece.sum_duplicates()
        lengths[pixels] = np.diff(piece.indptr)
        pieces.append((pixels, piece))
    start = np.concatenate([[0], np.cumsum(lengths)])
    data = np.empty(start[-1], np.float32)
    indices = np.empty(start[-1], np.int32)
    for pixels, piece in pieces:
        own = np.diff(piece.indptr)
        place = np.repeat(start[pixels] - piece.indptr[:-1], own) + np.arange(len(piece.data))
        data[place], indices[place] = piece.data, piece.indices
    matrix = csr_array((data, indices, start), shape=(targets, sources))
    if not source.whole:
        return matrix
    _balance(
        matrix,
        np.tile(source.solid_angles(source_rows).reshape(-1), source.sheets),
        np.tile(target.solid_angles(rows).reshape(-1), target.sheets),
    )
    return matrix


def _balance(matrix, has: Array, takes: Array) -> None:
    """Scales rows and columns of the matrix, in place; see the head of this file."""
    own = np.diff(matrix.indptr)
    transposed = matrix.T
    column = np.ones(len(has), np.float32)
    row = np.ones(len(takes), np.float32)
    for _ in range(_BALANCING):
        given = column * (transposed @ (row * takes).astype(np.float32))
        ratio = np.where(given > 0, has / np.where(given > 0, given, 1.0), 1.0)
        column *= (ratio**_OVER).astype(np.float32)
        total = matrix @ column
        row = np.where(total > 0, 1.0 / np.where(total > 0, total, 1.0), 0.0).astype(np.float32)
    matrix.data *= column[matrix.indices]
    matrix.data *= np.repeat(row, own)


def _parts(
    source: Projection, source_rows: int, target: Projection, rows: int, turn: Array
) -> Iterator[tuple[NDArray[np.intp], tuple[Any, ...], NDArray[np.float32]]]:
    """All pixels of the target that look anywhere, some at a time, split finely enough.

    yields  flat indices (n,) of pixels; where the source has their parts: sheet, u and v, (n, k)
            each; weights (n, k): their solid angles, of which those of a pixel add up to 1
    """
    sheets, height, width = target.shape(rows)
    seen = target.solid_angles(rows) > 0
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
            fine = source.pixels_per_radian(d, su, sv) * source_rows
            least = np.where(_cut(target, u, rows_v, width, height), _CUT, 0)
            columns = np.maximum(_enough(across * fine), least)
            lines = np.maximum(_enough(down * fine), least)
            kind = np.where(inside, columns * len(_COUNTS) + lines, -1)
            for k in np.unique(kind):
                if k < 0:
                    continue
                y, x = np.nonzero(kind == k)
                nx, ny = _COUNTS[k // len(_COUNTS)], _COUNTS[k % len(_COUNTS)]
                if nx == ny == 1:
                    pixels = (sheet * height + first + y) * width + x
                    alone = tuple(p[y, x][:, None] for p in position)
                    yield pixels, alone, np.ones((len(y), 1), np.float32)
                    continue
                at_once = max(1, _CHUNK // int(nx * ny))
                for some in range(0, len(y), at_once):
                    rest = slice(some, some + at_once)
                    pixels, d, weights = _split(
                        target, sheet, (height, width), first + y[rest], x[rest], nx, ny
                    )
                    yield pixels, source.position(d @ turn), weights


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
