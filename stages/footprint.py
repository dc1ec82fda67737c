"""The mean of a photograph over each texel's footprint, compiled.

`unwrap` says what is done and why; here are its loops. A texel depends on nothing but its own
corners and pixels, and its sums are taken in one order: the result is the same for any number of
threads.
"""

from __future__ import annotations

import math

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from stages.compiled import compiled

_LEAST = np.float32(1e-3)  # of a texel's weight; with less it is not known
# The most a part may have: a little over a pixel still reads all of them alike.
_PART_PX = np.float32(1.15)
_FEW_PARTS = 8  # of a cell: with more, needles are looked for ...
_NEEDLE_PX = np.float32(1.5)  # ... cells no wider than that
_MOST_PARTS = 96  # of a cell's side: a stop for what nobody has, a rim of 10000 px about the camera
# A side: what bilinear interpolation draws in, in the mean over positions.
_TAP_PX = np.float32(1.5)
_WHOLE = np.float32(1.0 - 1e-6)
_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)


@compiled
def between(knots, every, corners, first, last):
    """Catmull and Rom's cubic through knots of a face, both ways.

    knots    (n + 3, m + 3, 2) float64, one beyond every end
    every    steps from one knot to the next
    corners  (n * every + 1, m * every + 1, 2) float32, of which rows first..last are written
    """
    weight = np.empty((every, 4))
    for k in range(every):
        t = k / every
        weight[k, 0] = t * (-0.5 + t * (1.0 - 0.5 * t))
        weight[k, 1] = 1.0 + t * t * (1.5 * t - 2.5)
        weight[k, 2] = t * (0.5 + t * (2.0 - 1.5 * t))
        weight[k, 3] = t * t * (0.5 * t - 0.5)
    width = knots.shape[1]
    line = np.empty((width, 2))
    columns = corners.shape[1]
    for row in range(first, last):
        y, k = row // every, row % every
        if k == 0:
            for i in range(width):
                line[i, 0], line[i, 1] = knots[y + 1, i, 0], knots[y + 1, i, 1]
        else:
            a, b, c, d = weight[k]
            for i in range(width):
                for axis in range(2):
                    line[i, axis] = (
                        a * knots[y, i, axis]
                        + b * knots[y + 1, i, axis]
                        + c * knots[y + 2, i, axis]
                        + d * knots[y + 3, i, axis]
                    )
        for x in range(columns // every):
            for j in range(every):
                a, b, c, d = weight[j]
                for axis in range(2):
                    corners[row, x * every + j, axis] = (
                        a * line[x, axis]
                        + b * line[x + 1, axis]
                        + c * line[x + 2, axis]
                        + d * line[x + 3, axis]
                    )
        corners[row, columns - 1, 0] = line[width - 2, 0]
        corners[row, columns - 1, 1] = line[width - 2, 1]


@compiled
def layered(values, variance, weight, y0, x0, first, last, layers):
    """What `average` reads, the eight numbers of a pixel side by side.

    values, variance  (H, W, 3) float32
    weight            (h, w) float32, of the pixels from y0, x0 on; rows first..last are done
    layers            (h * w, 8) float32, written: three values times the weight, the weight, three
                      variances times its square, its square; 0 where anything is not finite
    """
    width = weight.shape[1]
    for y in range(first, last):
        for x in range(width):
            w, at = weight[y, x], y * width + x
            a, b, c = (
                values[y0 + y, x0 + x, 0],
                values[y0 + y, x0 + x, 1],
                values[y0 + y, x0 + x, 2],
            )
            d, e, f = (
                variance[y0 + y, x0 + x, 0],
                variance[y0 + y, x0 + x, 1],
                variance[y0 + y, x0 + x, 2],
            )
            if not math.isfinite(a + b + c + d + e + f):
                w = a = b = c = d = e = f = _ZERO
            q = w * w
            layers[at, 0], layers[at, 1], layers[at, 2], layers[at, 3] = w * a, w * b, w * c, w
            layers[at, 4], layers[at, 5], layers[at, 6], layers[at, 7] = q * d, q * e, q * f, q


@intrinsic
def _add(_, total, layers, above, below, a, b, c, d):
    """total (8,) += a layers[above] + b layers[above + 1] + c layers[below] + d layers[below + 1].

    In the processor's vector registers, which the compiler would not think of by itself.
    """

    def code(context, builder, signature, arguments):
        eight = ir.VectorType(ir.FloatType(), 8)
        everywhere = ir.Constant(ir.VectorType(ir.IntType(32), 8), [0] * 8)
        nothing = ir.Constant(eight, ir.Undefined)
        total, layers = (
            builder.bitcast(
                context.make_array(kind)(context, builder, array).data, eight.as_pointer()
            )
            for kind, array in zip(signature.args[:2], arguments[:2], strict=True)
        )
        above, below, *weights = arguments[2:]
        one = ir.Constant(above.type, 1)
        places = above, builder.add(above, one), below, builder.add(below, one)
        result = builder.load(total, align=4)
        for place, weight in zip(places, weights, strict=True):
            pixel = builder.load(builder.gep(layers, [place]), align=4)
            spread = builder.insert_element(nothing, weight, ir.Constant(ir.IntType(32), 0))
            spread = builder.shuffle_vector(spread, nothing, everywhere)
            product = builder.fmul(spread, pixel)
            result = builder.fadd(result, product)
        builder.store(result, total, align=4)
        return context.get_dummy_value()

    return types.void(total, layers, above, below, a, b, c, d), code


@compiled
def average(
    corners,
    hidden,
    blind,
    split,
    first,
    last,
    to_image,
    layers,
    size,
    noise_area_px,
    channels,
    values,
    variance,
    valid,
):
    """Weighted means of one image over the texels of rows first..last of a face.

    corners         (N split + 1, N split + 1, 2) float32 of the cells, px in the first image
    hidden          the same without its last axis, bool
    blind           whether any of it is hidden
    split           cells along a texel's side
    to_image        (2, 3) from the first image's px to this one's, from the middle of the first
                    pixel of the layers
    layers          see `layered`; the outermost pixels' weights are 0
    size            height and width of the layers
    noise_area_px   three float32
    channels        up to three
    values, variance  (N, N, C) float32, written
    valid           (N, N) float32, lowered to the share that is known
    """
    n, per_cell = valid.shape[0], _ONE / np.float32(split * split)
    height, width = size
    per_side = _ONE / np.float32(split)
    s0, s1, s2 = noise_area_px
    total, texel = np.empty(8, np.float32), np.empty(8)  # long sums of float32 lose digits
    (xx, xy, xc), (yx, yy, yc) = to_image
    for row in range(first, last):
        for column in range(n):
            for k in range(8):
                texel[k] = 0.0
            most_across, most_down = _ONE, _ONE
            left, top = column * split, row * split
            for cell in range(split * split):
                i, j = top, left
                if split > 1:
                    i, j = i + cell // split, j + cell % split
                u, v = corners[i, j, 0], corners[i, j, 1]
                p00 = xx * u + xy * v + xc, yx * u + yy * v + yc
                u, v = corners[i, j + 1, 0], corners[i, j + 1, 1]
                p01 = xx * u + xy * v + xc, yx * u + yy * v + yc
                u, v = corners[i + 1, j, 0], corners[i + 1, j, 1]
                p10 = xx * u + xy * v + xc, yx * u + yy * v + yc
                u, v = corners[i + 1, j + 1, 0], corners[i + 1, j + 1, 1]
                p11 = xx * u + xy * v + xc, yx * u + yy * v + yc
                gone = False, False, False, False
                if blind:
                    h00, h01 = hidden[i, j], hidden[i, j + 1]
                    h10, h11 = hidden[i + 1, j], hidden[i + 1, j + 1]
                    if h00 and h01 and h10 and h11:
                        continue
                    gone = h00 and h01, h10 and h11, h00 and h10, h01 and h11
                columns, rows, needle, c, s, weights = _parts(p00, p01, p10, p11, gone)
                across, down = _ONE / np.float32(columns), _ONE / np.float32(rows)
                for k in range(8):
                    total[k] = _ZERO
                even = across * down
                if needle:
                    even /= weights
                for part_row in range(rows):
                    for part_column in range(columns):
                        if needle:
                            u, v, w = _along(part_column, across, c, s)
                            w *= even
                        else:
                            u = (np.float32(part_column) + _HALF) * across
                            v = (np.float32(part_row) + _HALF) * down
                            w = even
                        x, y = _between(p00, p01, p10, p11, u, v)
                        if not (x >= _ZERO and y >= _ZERO):
                            continue
                        px, py = int(x), int(y)
                        if px >= width - 1 or py >= height - 1:
                            continue
                        fx, fy = x - np.float32(px), y - np.float32(py)
                        low, high = w * (_ONE - fy), w * fy
                        at = py * width + px
                        _add(  # type: ignore[call-arg]  # an intrinsic's first is the compiler's
                            total,
                            layers,
                            at,
                            at + width,
                            low * (_ONE - fx),
                            low * fx,
                            high * (_ONE - fx),
                            high * fx,
                        )
                for k in range(8):
                    texel[k] += total[k]
                if needle:
                    across = down = _ZERO
                most_across = min(most_across, across)
                most_down = min(most_down, down)
            known, squares = texel[3] * per_cell, texel[7] * per_cell
            if known <= _LEAST:
                valid[row, column] = _ZERO
                continue
            u, v = corners[top, left, 0], corners[top, left, 1]
            p00 = xx * u + xy * v + xc, yx * u + yy * v + yc
            u, v = corners[top, left + split, 0], corners[top, left + split, 1]
            p01 = xx * u + xy * v + xc, yx * u + yy * v + yc
            u, v = corners[top + split, left + split, 0], corners[top + split, left + split, 1]
            p11 = xx * u + xy * v + xc, yx * u + yy * v + yc
            u, v = corners[top + split, left, 0], corners[top + split, left, 1]
            p10 = xx * u + xy * v + xc, yx * u + yy * v + yc
            moments = _moments(p00, p01, p10, p11, most_across * per_side, most_down * per_side)
            whole = known > _WHOLE
            if not whole:
                valid[row, column] = min(valid[row, column], known)
            share, squared = _ONE / texel[3], _ONE / texel[7]
            f0 = _shared(moments, s0, whole, known, squares) * squared
            f1 = f0 if s1 == s0 else _shared(moments, s1, whole, known, squares) * squared
            f2 = f0 if s2 == s0 else _shared(moments, s2, whole, known, squares) * squared
            values[row, column, 0] = texel[0] * share
            variance[row, column, 0] = texel[4] * f0
            if channels > 1:
                values[row, column, 1] = texel[1] * share
                variance[row, column, 1] = texel[5] * f1
            if channels > 2:
                values[row, column, 2] = texel[2] * share
                variance[row, column, 2] = texel[6] * f2


@compiled
def _parts(p00, p01, p10, p11, gone):
    """How a cell is divided into parts that are read bilinearly.

    p00..p11  px (x, y) of its corners: top left, top right, bottom left, bottom right
    gone      whether its top, bottom, left and right side lies wholly in the blind cone: between
              hidden corners lies the rim's other side, or nothing
    returns   columns and rows of parts, or how many in a row along a needle, and 1; whether it is
              a needle; the direction of its long axis, in the cell's u and v; the parts' mean
              weight

    Near the rim a cell is a needle: long, less than a pixel wide, and slanting. Places in a row
    along it are enough, each with the weight of the cell's width there.
    """
    per_part = _ONE / _PART_PX
    top = _ZERO if gone[0] else _ONE
    bottom = _ZERO if gone[1] else _ONE
    left = _ZERO if gone[2] else _ONE
    right = _ZERO if gone[3] else _ONE
    tx, ty = top * (p01[0] - p00[0]), top * (p01[1] - p00[1])
    bx, by = bottom * (p11[0] - p10[0]), bottom * (p11[1] - p10[1])
    lx, ly = left * (p10[0] - p00[0]), left * (p10[1] - p00[1])
    rx, ry = right * (p11[0] - p01[0]), right * (p11[1] - p01[1])
    columns = int(math.sqrt(max(tx * tx + ty * ty, bx * bx + by * by)) * per_part) + 1
    rows = int(math.sqrt(max(lx * lx + ly * ly, rx * rx + ry * ry)) * per_part) + 1
    if columns * rows > _FEW_PARTS:
        ix, iy, jx, jy = _HALF * (tx + bx), _HALF * (ty + by), _HALF * (lx + rx), _HALF * (ly + ry)
        angle = _HALF * np.float32(
            math.atan2(np.float32(2.0) * (ix * jx + iy * jy), ix * ix + iy * iy - jx * jx - jy * jy)
        )
        c, s = np.float32(math.cos(angle)), np.float32(math.sin(angle))
        length = math.hypot(ix * c + jx * s, iy * c + jy * s) * (abs(c) + abs(s))
        count = int(length / _PART_PX) + 1
        if math.hypot(jx * c - ix * s, jy * c - iy * s) < _NEEDLE_PX and count < rows * columns:
            count, weights = min(count, _MOST_PARTS * _MOST_PARTS), _ZERO
            for k in range(count):
                weights += _along(k, _ONE / np.float32(count), c, s)[2]
            return count, 1, True, c, s, weights / np.float32(count)
    return min(columns, _MOST_PARTS), min(rows, _MOST_PARTS), False, _ZERO, _ZERO, _ONE


@compiled
def _along(k, step, c, s):
    """Place u, v in [0, 1] of a needle's part, and its weight.

    k, step  which part, and one over how many
    c, s     direction of the needle
    """
    extent = abs(c) + abs(s)
    t = ((np.float32(k) + _HALF) * step - _HALF) * extent
    # How wide the cell is across the row: level in its middle, then down to 0.
    slope = max(_HALF * (extent - abs(abs(c) - abs(s))), np.float32(1e-9))
    w = min((_HALF * extent - abs(t)) / slope, _ONE)
    # Where the row leaves the cell, the nearest place in it.
    return min(max(_HALF + t * c, _ZERO), _ONE), min(max(_HALF + t * s, _ZERO), _ONE), w


@compiled
def _between(p00, p01, p10, p11, u, v):
    """The place at u, v of a cell: bilinear between its corners."""
    x, y = p00[0] + v * (p10[0] - p00[0]), p00[1] + v * (p10[1] - p00[1])
    to_x, to_y = p01[0] + v * (p11[0] - p01[0]), p01[1] + v * (p11[1] - p01[1])
    return x + u * (to_x - x), y + u * (to_y - y)


@compiled
def _shared(moments, s, whole, known, squares):
    """S / (S - 1 + A): see `unwrap`. A footprint's area is the root of its moments' determinant.

    Noise that S pixels have in common widens the footprint by S - 1 px^2 both ways: a long and
    narrow texel gains more by it than a square one. Of a footprint known in part, less is drawn in.
    """
    xx, yy, xy = moments
    more = s - _ONE
    drawn = math.sqrt(max((xx + more) * (yy + more) - xy * xy, s * s))
    if not whole:
        drawn = more + max((drawn - more) * known * known / squares, _row_drawn(moments))
    return s / drawn


@compiled
def _row_drawn(moments):
    """The least that a footprint known in part draws in: a single row of pixels.

    Along the rim texels are needles, and those at its very edge are known by how far interpolation
    reaches back inside: one row of pixels across, but all of them along. Over the steps of the
    row that reach runs from 0 to 1, which draws in 3/4 (its mean squared over its mean square).
    1 for wider ones.
    """
    xx, yy, xy = moments
    middle, apart = _HALF * (xx + yy), _HALF * (xx - yy)
    half = np.float32(math.sqrt(apart * apart + xy * xy))
    if middle - half < _NEEDLE_PX * _NEEDLE_PX + _TAP_PX * _TAP_PX:
        return max(np.float32(0.75) * np.float32(math.sqrt(middle + half)), _ONE)
    return _ONE


@compiled
def _moments(p00, p01, p10, p11, across, down):
    """Of a texel's footprint, times 12: second moments xx, yy and xy, px^2.

    p00..p11       px (x, y) of the texel's corners
    across, down   one over how many parts lie along its sides

    So a side of s px has s^2. Bilinear interpolation adds 1.5^2 in the mean: over many positions
    it draws in 1.5 px, one over the mean sum of its squared weights. A texel that is read but once
    has its own: 1 / (f^2 + (1 - f)^2) at the fraction f between two pixels.
    """
    ax, ay = p11[0] - p10[0], p11[1] - p10[1]
    dx, dy = p11[0] - p01[0], p11[1] - p01[1]
    many, many_down = _ONE - across * across, _ONE - down * down
    xx, yy = many * ax * ax + many_down * dx * dx, many * ay * ay + many_down * dy * dy
    xy = many * ax * ay + many_down * dx * dy
    return (
        xx + _drawn_in(_HALF * (p00[0] + p11[0]), xx),
        yy + _drawn_in(_HALF * (p00[1] + p11[1]), yy),
        xy,
    )


@compiled
def _drawn_in(middle, square):
    tap = _TAP_PX * _TAP_PX
    if square >= _ONE:
        return tap
    f = middle - np.float32(math.floor(middle))
    f = _ONE - (f + f) * (_ONE - f)
    return tap + (_ONE / (f * f) - tap) * (_ONE - square)
