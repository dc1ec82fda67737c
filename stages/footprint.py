"""The mean of a photograph over each texel's footprint, compiled.

`unwrap` says what is done and why; here are its loops. A texel depends on nothing but its own
corners and pixels, and its sums are taken in one order: the result is the same for any number of
threads. A row of cells is worked out in three passes, so that the compiler, or `stages/lanes.py`,
has many numbers side by side: where the parts lie, which pixels that takes in, and their sums.
Indices in such loops are without a sign, else each would be tried for being counted from an end.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stages import lanes
from stages.compiled import compiled
from stages.types import Float

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
_UNKNOWN = np.float32(np.nan)
# In place of a pixel's weight: it is 1, and so are those of its neighbours right and below.
_ALL_FOUR = np.float32(4.0)

_RUN = 256  # cells in a run, at the most
_ENOUGH = 1024  # parts in a list; a run's may be beyond that
_AHEAD = 12  # parts, before they are read, at which their pixels are asked for
_LIST = _ENOUGH + max(_FEW_PARTS * _RUN, _MOST_PARTS * _MOST_PARTS) + _AHEAD


class Parts(NamedTuple):
    """A list of places in the photograph, the parts of cells, as `_LIST` numbers of each kind.

    It is made of runs, which are neighbouring cells of a row that are divided alike: first all
    their first parts, then all their second ones, and so on.

    x, y      px from the middle of the first pixel
    share     of the cell's area; a cell's add up to 1
    pixel     number of the one above and left; -1 where the photograph is not read
    w00..w11  shares of the pixels above left, above right, below left and below right
    runs      (n, 2) cells of each run, and where in the list it ends
    """

    x: Float
    y: Float
    share: Float
    pixel: NDArray[np.int32]
    w00: Float
    w01: Float
    w10: Float
    w11: Float
    runs: NDArray[np.int64]


@compiled
def widen(knots, every, weights, wide):
    """Cubic interpolation along the rows of a face's knots.

    knots    (m, n + 3) float64, one beyond every end
    every    steps from one knot to the next
    weights  (every, 4) of the four knots about each step
    wide     (m, n * every + 1) float64, written
    """
    n = knots.shape[1] - 3
    for row in range(knots.shape[0]):
        for x in range(n):
            a, b, c, d = knots[row, x], knots[row, x + 1], knots[row, x + 2], knots[row, x + 3]
            for k in range(every):
                wide[row, x * every + k] = (
                    weights[k, 0] * a + weights[k, 1] * b + weights[k, 2] * c + weights[k, 3] * d
                )
        wide[row, n * every] = knots[row, n + 1]


@compiled
def heighten(wide, every, weights, plane, first, last):
    """The same across the rows, to rows first..last of the plane (n * every + 1, ...) float32."""
    for row in range(first, last):
        y, k = row // every, row % every
        if k == 0:
            for x in range(plane.shape[1]):
                plane[row, x] = wide[y + 1, x]
        else:
            a, b, c, d = weights[k, 0], weights[k, 1], weights[k, 2], weights[k, 3]
            for x in range(plane.shape[1]):
                plane[row, x] = (
                    a * wide[y, x] + b * wide[y + 1, x] + c * wide[y + 2, x] + d * wide[y + 3, x]
                )


@compiled
def know(values, variance, valid, weight, box):
    """How well pixels are known: `valid`, and 0 where anything is not finite.

    values, variance  (H, W, C) float32
    valid             (H, W) float32
    weight            (H, W) float32, written inside the box x0, y0, x1, y1
    """
    x0, y0, x1, y1 = box
    height, width, channels = values.shape
    # Four numbers are read from a pixel on, also where there are fewer: not past the array's end.
    end = height * width * channels - channels - lanes.COUNT
    for y in range(y0, y1):
        first, stop = (y * width + x0) * channels, (y * width + x1) * channels
        if stop <= end and _all_finite(values.ravel(), variance.ravel(), first, stop):
            for x in range(x0, x1):
                weight[y, x] = valid[y, x]
            continue
        for x in range(x0, x1):
            known = (y * width + x) * channels <= end
            for k in range(channels):
                known &= math.isfinite(values[y, x, k] + variance[y, x, k])
            weight[y, x] = valid[y, x] if known else _ZERO


@compiled
def _all_finite(a, b, first, stop):
    """Whether all sums a + b in a range are, many of them at a time."""
    off = False
    for i in range(first, stop):
        total = a[np.uintp(i)] + b[np.uintp(i)]
        off |= total - total != _ZERO
    return not off


@compiled
def mark(weight, box):
    """Makes _ALL_FOUR of a pixel's weight where it is 1, as are those right and below.

    weight  (H, W) float32, changed inside the box x0, y0, x1, y1 but for its last row and column
    """
    x0, y0, x1, y1 = box
    for y in range(y0, y1 - 1):
        for x in range(x0, x1 - 1):  # to the right and below none has been marked yet
            i, j = np.uintp(x), np.uintp(x + 1)
            above = (weight[y, i] == _ONE) & (weight[y, j] == _ONE)
            below = (weight[y + 1, i] == _ONE) & (weight[y + 1, j] == _ONE)
            weight[y, i] = _ALL_FOUR if above & below else weight[y, i]


@compiled
def average(
    x,
    y,
    hidden,
    split,
    to_image,
    values,
    variance,
    start,
    weight,
    box,
    noise_area_px,
    into,
    channels,
    mean,
    spread,
    valid,
    first,
    last,
):
    """Weighted means of one image over the texels of rows first..last of a face.

    x, y            (N split + 1, N split + 1) float32 of the cells' corners, px in the first image
    hidden          the same, bool
    split           cells along a texel's side
    to_image        (2, 3) from the first image's px to this one's, from the middle of its first
    values, variance  (H, W, C) float32, contiguous
    start           of their channels that are read
    weight          (H, W) float32, as `mark` leaves it
    box             x0, y0, x1, y1 of the pixels that have one
    noise_area_px   three float32
    into            of the channels below that are written
    channels        how many, up to three
    mean, spread    (N, N, C) float32, of values and their variance, written where known
    valid           (N, N) float32, lowered to the share that is known
    """
    n, cells = valid.shape[0], valid.shape[0] * split
    px = np.empty((split + 1, cells + 1), np.float32)
    py = np.empty((split + 1, cells + 1), np.float32)
    columns, rows = np.empty(cells, np.int32), np.empty(cells, np.int32)
    texel = np.empty(cells, np.int64)
    for k in range(cells):
        texel[k] = k // split
    sums = np.empty((n, 8))  # long sums of float32 lose digits
    across, down = np.empty(n, np.float32), np.empty(n, np.float32)
    parts = Parts(
        np.empty(_LIST, np.float32),
        np.empty(_LIST, np.float32),
        np.empty(_LIST, np.float32),
        np.zeros(_LIST, np.int32),
        np.empty(_LIST, np.float32),
        np.empty(_LIST, np.float32),
        np.empty(_LIST, np.float32),
        np.empty(_LIST, np.float32),
        np.empty((_ENOUGH, 2), np.int64),
    )
    for row in range(first, last):
        top = row * split
        for k in range(split + 1):
            _place(x[top + k], y[top + k], to_image, px[k], py[k])
        sums[:] = 0.0
        across[:] = _ONE
        down[:] = _ONE
        for k in range(split):
            _divide(px[k], py[k], px[k + 1], py[k + 1], columns, rows)
            _mark_hidden(hidden[top + k], hidden[top + k + 1], columns)
            cell = np.int64(0)
            while cell < cells:
                begin = cell
                cell, runs = _list(
                    px[k], py[k], px[k + 1], py[k + 1], hidden[top + k], hidden[top + k + 1],
                    columns, rows, begin, texel, across, down, parts,
                )  # fmt: skip
                count = parts.runs[runs - 1, 1]
                _find(parts.x, parts.y, box, weight.shape[1], count, parts.pixel)
                _weigh(parts.x, parts.y, parts.share, False, count, parts.w00, parts.w01)
                _weigh(parts.x, parts.y, parts.share, True, count, parts.w10, parts.w11)
                _add(parts, runs, values, variance, start, weight, texel[begin:cell], sums)
        _finish(
            px[0], py[0], px[split], py[split], split, across, down, sums,
            noise_area_px, into, channels, mean[row], spread[row], valid[row],
        )  # fmt: skip


@compiled
def blank(mean, spread, valid, first, last):
    """Makes NaN of rows first..last where nothing is valid."""
    for row in range(first, last):
        for column in range(valid.shape[1]):
            if valid[row, column] <= _ZERO:
                for k in range(mean.shape[2]):
                    mean[row, column, k] = spread[row, column, k] = _UNKNOWN


@compiled
def _place(x, y, to_image, px, py):
    """Where a row of corners x, y of the first image lies in this one: px, py, written."""
    (xx, xy, xc), (yx, yy, yc) = to_image
    for i in range(len(px)):
        px[i] = xx * x[i] + xy * y[i] + xc
        py[i] = yx * x[i] + yy * y[i] + yc


@compiled
def _divide(x, y, below_x, below_y, columns, rows):
    """Into how many parts a row of cells between corners is to be divided, both ways: written."""
    for i in range(len(columns)):
        top = (x[i + 1] - x[i]) ** 2 + (y[i + 1] - y[i]) ** 2
        bottom = (below_x[i + 1] - below_x[i]) ** 2 + (below_y[i + 1] - below_y[i]) ** 2
        columns[i] = _enough(max(top, bottom))
    for i in range(len(rows)):
        left = (below_x[i] - x[i]) ** 2 + (below_y[i] - y[i]) ** 2
        right = (below_x[i + 1] - x[i + 1]) ** 2 + (below_y[i + 1] - y[i + 1]) ** 2
        rows[i] = _enough(max(left, right))


@compiled
def _enough(square):
    """How many parts a side of that many px^2 has to be divided into."""
    parts, most = np.float32(math.sqrt(square)) * (_ONE / _PART_PX), np.float32(_MOST_PARTS - 1)
    return np.int32(parts if parts < most else most) + np.int32(1)


@compiled
def _mark_hidden(hidden, below, columns):
    """Makes 0 of the columns of cells that have hidden corners."""
    for i in range(len(columns)):
        if hidden[i] | hidden[i + 1] | below[i] | below[i + 1]:
            columns[i] = 0


@compiled
def _list(
    x, y, below_x, below_y, hidden, below_hidden, columns, rows, cell, texel, across, down, parts
):
    """Lists the parts of a row's cells from `cell` on, until they are enough.

    texel         which a cell belongs to
    across, down  of texels, lowered to one over how many parts lie along a side of their cells
    returns       the next cell, and how many runs there are in the list
    """
    count = runs = 0
    while cell < len(columns) and count < _ENOUGH:
        wide, high = np.int64(columns[cell]), np.int64(rows[cell])
        step, step_down = _ONE, _ONE
        run = 1
        if 0 < wide * high <= _FEW_PARTS:
            while cell + run < len(columns) and run < _RUN:
                next_one = np.uintp(cell + run)
                if columns[next_one] != wide or rows[next_one] != high:
                    break
                run += 1
            step, step_down = _ONE / np.float32(wide), _ONE / np.float32(high)
            for k in range(wide * high * run):
                parts.share[np.uintp(count + k)] = step * step_down
            for line in range(high):
                v = (np.float32(line) + _HALF) * step_down
                for k in range(wide):
                    u = (np.float32(k) + _HALF) * step
                    for c in range(run):
                        i, j = np.uintp(cell + c), np.uintp(cell + c + 1)
                        place = _between(x[i], x[j], below_x[i], below_x[j], u, v)
                        parts.x[np.uintp(count + c)] = place
                    for c in range(run):
                        i, j = np.uintp(cell + c), np.uintp(cell + c + 1)
                        place = _between(y[i], y[j], below_y[i], below_y[j], u, v)
                        parts.y[np.uintp(count + c)] = place
                    count += run
        else:
            h00, h01 = hidden[cell], hidden[cell + 1]
            h10, h11 = below_hidden[cell], below_hidden[cell + 1]
            if not (h00 and h01 and h10 and h11):
                gone = h00 and h01, h10 and h11, h00 and h10, h01 and h11
                x00, x01, x10, x11 = x[cell], x[cell + 1], below_x[cell], below_x[cell + 1]
                y00, y01, y10, y11 = y[cell], y[cell + 1], below_y[cell], below_y[cell + 1]
                wide, high, needle, c, s, weights = _parts(
                    (x00, y00), (x01, y01), (x10, y10), (x11, y11), gone
                )
                step, step_down = _ONE / np.float32(wide), _ONE / np.float32(high)
                even = step * step_down
                for line in range(high):
                    for k in range(wide):
                        u, v, w = (np.float32(k) + _HALF) * step, _HALF, even
                        if needle:
                            u, v, w = _along(k, step, c, s)
                            w *= even / weights
                        else:
                            v = (np.float32(line) + _HALF) * step_down
                        parts.x[count] = _between(x00, x01, x10, x11, u, v)
                        parts.y[count] = _between(y00, y01, y10, y11, u, v)
                        parts.share[count] = w
                        count += 1
                if needle:
                    step = step_down = _ZERO
        for c in range(run):
            to = np.uintp(texel[np.uintp(cell + c)])
            across[to], down[to] = min(across[to], step), min(down[to], step_down)
        parts.runs[runs, 0], parts.runs[runs, 1] = run, count
        runs += 1
        cell += run
    return cell, runs


@compiled
def _find(x, y, box, width, count, pixel):
    """The pixels above and left of places; -1 where not all four about them are in the box."""
    x0, y0, x1, y1 = box
    left, top = np.float32(x0), np.float32(y0)
    right, bottom = np.float32(x1 - 1), np.float32(y1 - 1)
    for i in range(count):
        inside = (x[i] >= left) & (x[i] < right) & (y[i] >= top) & (y[i] < bottom)
        place = np.int32(y[i]) * np.int32(width) + np.int32(x[i])
        pixel[i] = place if inside else np.int32(-1)


@compiled
def _weigh(x, y, share, below, count, left, right):
    """Shares of the upper two of the pixels about places, or of those below: written."""
    for i in range(count):
        fx, fy = x[i] - np.float32(np.int32(x[i])), y[i] - np.float32(np.int32(y[i]))
        w = share[i] * (fy if below else _ONE - fy)
        left[i], right[i] = w * (_ONE - fx), w * fx


@compiled
def _add(parts, runs, values, variance, start, weight, texel, sums):
    """Adds what the parts of runs of cells take in to the sums of their texels.

    texel  which a cell belongs to, from the first in the list on
    sums   (n, 8) float64: of three values times the pixels' weights, of the weights, of three
           variances times their squares, of their squares
    """
    width, pixel = weight.shape[1], values.shape[2]
    line = width * pixel
    begin = cell = 0
    for k in range(runs):
        run, end = parts.runs[k, 0], parts.runs[k, 1]
        for c in range(run):
            part, stop = np.uintp(begin + c), np.uintp(end)
            soon = np.int64(parts.pixel[part + np.uintp(_AHEAD)])
            lanes.fetch(weight, soon)
            lanes.fetch(values, start + soon * pixel)
            lanes.fetch(values, start + soon * pixel + line)
            lanes.fetch(variance, start + soon * pixel)
            lanes.fetch(variance, start + soon * pixel + line)
            total, spread = lanes.none(), lanes.none()
            whole = known = squares = _ZERO
            while part < stop:
                at = np.int64(parts.pixel[part])
                above = start + at * pixel
                below = above + line
                w00, w01 = parts.w00[part], parts.w01[part]
                w10, w11 = parts.w10[part], parts.w11[part]
                if at < 0:
                    pass
                elif lanes.number(weight, at) == _ALL_FOUR:
                    total = lanes.plus_mean(total, values, above, below, pixel, w00, w01, w10, w11)
                    spread = lanes.plus_mean(
                        spread, variance, above, below, pixel, w00, w01, w10, w11
                    )
                    whole += parts.share[part]
                else:
                    for place, sure, w in (
                        (above, lanes.number(weight, at), w00),
                        (above + pixel, lanes.number(weight, at + 1), w01),
                        (below, lanes.number(weight, at + width), w10),
                        (below + pixel, lanes.number(weight, at + width + 1), w11),
                    ):
                        if sure > _ZERO:  # else there may be NaN
                            once = w * min(sure, _ONE)
                            twice = once * min(sure, _ONE)
                            total = lanes.plus_part(total, values, place, once)
                            spread = lanes.plus_part(spread, variance, place, twice)
                            known += once
                            squares += twice
                part += np.uintp(run)
            to = texel[np.uintp(cell)] * 8
            lanes.add_to(sums, to, total, whole + known)
            lanes.add_to(sums, to + 4, spread, whole + squares)
            cell += 1
        begin = end


@compiled
def _finish(
    x, y, below_x, below_y, split, across, down, sums, noise_area_px, into, channels, mean, spread,
    valid,
):  # fmt: skip
    """Makes means of a row of texels' sums.

    x, y, below_x, below_y  of the cells' corners above and below
    across, down            one over how many parts lie along a side of their cells
    sums                    see `_add`
    """
    n = len(valid)
    ax, ay = np.empty(n + 1, np.float32), np.empty(n + 1, np.float32)
    bx, by = np.empty(n + 1, np.float32), np.empty(n + 1, np.float32)
    for i in range(n + 1):
        ax[i], ay[i] = x[i * split], y[i * split]
        bx[i], by[i] = below_x[i * split], below_y[i * split]
    for i in range(n):
        across[i] /= np.float32(split)
        down[i] /= np.float32(split)
    xx, yy, xy = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    _measure(ax, ay, bx, by, across, down, xx, yy, xy)
    factors = np.empty((3, n), np.float32)
    for k in range(channels):
        _share(xx, yy, xy, noise_area_px[k], factors[k])
    per_cell = 1.0 / (split * split)
    for i in range(n):
        at = np.uintp(i)
        known, squares = np.float32(sums[at, 3] * per_cell), np.float32(sums[at, 7] * per_cell)
        if known <= _LEAST:
            valid[at] = _ZERO
            continue
        once = twice = _ONE / np.float32(sums[at, 3])
        whole = known > _WHOLE
        if not whole:
            valid[at] = min(valid[at], known)
            twice = _ONE / np.float32(sums[at, 7])
        for k in range(channels):
            factor = factors[np.uintp(k), at]
            if not whole:
                moments = xx[at], yy[at], xy[at]
                factor = _in_part(moments, noise_area_px[k], known, squares)
            to = np.uintp(into + k)
            mean[at, to] = np.float32(sums[at, np.uintp(k)]) * once
            spread[at, to] = np.float32(sums[at, np.uintp(k + 4)]) * (twice * factor)


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
    top = _ZERO if gone[0] else _ONE
    bottom = _ZERO if gone[1] else _ONE
    left = _ZERO if gone[2] else _ONE
    right = _ZERO if gone[3] else _ONE
    tx, ty = top * (p01[0] - p00[0]), top * (p01[1] - p00[1])
    bx, by = bottom * (p11[0] - p10[0]), bottom * (p11[1] - p10[1])
    lx, ly = left * (p10[0] - p00[0]), left * (p10[1] - p00[1])
    rx, ry = right * (p11[0] - p01[0]), right * (p11[1] - p01[1])
    columns = int(_enough(max(tx * tx + ty * ty, bx * bx + by * by)))
    rows = int(_enough(max(lx * lx + ly * ly, rx * rx + ry * ry)))
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
    return columns, rows, False, _ZERO, _ZERO, _ONE


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
def _between(a, b, c, d, u, v):
    """Bilinear at u, v of a cell, between what a, b above and c, d below have at its corners."""
    left, right = a + v * (c - a), b + v * (d - b)
    return left + u * (right - left)


@compiled
def _measure(ax, ay, bx, by, across, down, xx, yy, xy):
    """The moments of a row of texels: written.

    ax, ay  (n + 1,) px of their upper corners; bx, by of their lower ones
    """
    for i in range(len(xx)):
        xx[i], yy[i], xy[i] = _moments(
            ax[i], ay[i], ax[i + 1], ay[i + 1], bx[i], by[i], bx[i + 1], by[i + 1],
            across[i], down[i],
        )  # fmt: skip


@compiled
def _share(xx, yy, xy, s, factor):
    """S / (S - 1 + A) of a row of texels of such moments, known throughout: see `unwrap`. Written.

    A footprint's area is the root of its moments' determinant. Noise that S pixels have in common
    widens it by S - 1 px^2 both ways: a long and narrow texel gains more by it than a square one.
    """
    for i in range(len(factor)):
        factor[i] = s / _drawn((xx[i], yy[i], xy[i]), s)


@compiled
def _in_part(moments, s, known, squares):
    """The same of a texel that is known in part: less is drawn in."""
    more = s - _ONE
    drawn = (_drawn(moments, s) - more) * known * known / squares
    return s / (more + max(drawn, _row_drawn(moments)))


@compiled
def _drawn(moments, s):
    xx, yy, xy = moments
    more = s - _ONE
    return np.float32(math.sqrt(max((xx + more) * (yy + more) - xy * xy, s * s)))


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
def _moments(p00x, p00y, p01x, p01y, p10x, p10y, p11x, p11y, across, down):
    """Of a texel's footprint, times 12: second moments xx, yy and xy, px^2.

    p00x..p11y     px (x, y) of the texel's corners
    across, down   one over how many parts lie along its sides

    So a side of s px has s^2. Bilinear interpolation adds 1.5^2 in the mean: over many positions
    it draws in 1.5 px, one over the mean sum of its squared weights. A texel that is read but once
    has its own: 1 / (f^2 + (1 - f)^2) at the fraction f between two pixels.
    """
    ax, ay = p11x - p10x, p11y - p10y
    dx, dy = p11x - p01x, p11y - p01y
    many, many_down = _ONE - across * across, _ONE - down * down
    xx, yy = many * ax * ax + many_down * dx * dx, many * ay * ay + many_down * dy * dy
    xy = many * ax * ay + many_down * dx * dy
    return (
        xx + _drawn_in(_HALF * (p00x + p11x), xx),
        yy + _drawn_in(_HALF * (p00y + p11y), yy),
        xy,
    )


@compiled
def _drawn_in(middle, square):
    tap = _TAP_PX * _TAP_PX
    f = middle - np.floor(middle)
    f = _ONE - (f + f) * (_ONE - f)
    return tap + (_ONE / (f * f) - tap) * max(_ONE - square, _ZERO)
