"""The samples of a pixel in all exposures as one value: the mean of the least variance.

Signals are counted in raw steps above black, light in steps per unit of radiance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stages.compiled import compiled
from stages.types import Float

# Rows above and below that a pixel's result depends on: chi-square is pooled over the next one,
# whose weights take light from two further, where samples two further still may saturate. One
# more, so that rows begin on whole CFA cells.
HALO = 6

# The noise of a sample is told from its signal's estimate, up to so many sigmas from that of the
# pixels about it: an estimate of the sample's own noisy value would make the weights follow it.
OWN_SIGNAL = np.float32(20.0)

# By how many sigmas light lies below the limit that none of its samples saturates.
SURELY = np.float32(3.0)

_ZERO, _ONE, _TWO, _EIGHTH = (np.float32(v) for v in (0, 1, 2, 0.125))


class Readings(NamedTuple):
    """How raw samples are to be read in the A exposures that count, longest first.

    exposure     (A,) of the bracket, their indices
    light        (A,) float32, steps per unit of radiance
    gain, read2  (A,) float32, variance of a sample is gain * signal + read2, in steps squared
    limit        (A, 2, W) uint16, raw value from which on samples do not count, by row of the CFA
    black        (2, W) float32, raw value of no light
    scale        (2, W) float32, what a raw step is worth, where colours' full scales differ
    """

    exposure: NDArray[np.intp]
    light: Float
    gain: Float
    read2: Float
    limit: NDArray[np.uint16]
    black: Float
    scale: Float


class Rows(NamedTuple):
    """Where the result of some rows goes; float32.

    mosaic, variance  (h, W); NaN where no sample counts
    excess            (h + 2, W) chi-square of the samples about their mean, less its freedom, of
                      the next rows above and below too; 0 beyond the frame
    freedom           (h + 2, W) its degrees of freedom
    """

    mosaic: Float
    variance: Float
    excess: Float
    freedom: Float


def combine(raw, above: int, readings: Readings, into: Rows) -> NDArray[np.int64]:
    """Weighted means of the exposures' samples; how many saturated in each (A,).

    raw    (K, h, W) uint16 of all exposures, HALO rows more above and below where the frame goes on
    above  rows of raw above those that are wanted
    """
    count, (height, width) = len(readings.exposure), raw.shape[1:]
    full = np.zeros((count, height), np.int64)
    usable = np.empty((count, height, width), np.uint8)
    _judge(raw, *readings, full, usable)

    first, last = max(above - 3, 0), min(above + len(into.mosaic) + 3, height)
    longest, lit = np.zeros((2, last - first, width + 4), np.float32)
    into.excess[[0, -1]] = into.freedom[[0, -1]] = 0
    lines = np.empty((8, width), np.float32)
    _combine(raw, usable, above, *readings, *into, first, longest, lit, lines)
    return full[:, above : above + len(into.mosaic)].sum(axis=1)


# Compiling takes long for what NumPy does in one word: assigning a row to a row brings along the
# text of the error that their shapes might raise. So elements are assigned, in loops of few
# arrays each: of more the compiler does not find out that they are apart.


@compiled
def _judge(raw, exposure, light, gain, read2, limit, black, scale, full, usable):
    """What saturated, counted by row, and what counts: 1 or 0; see `combine` and `Readings`.

    A sample that did not saturate counts, save where one of the next of its CFA position did: of
    light at the limit only those samples stay below it that came out low. There it counts where
    the light lies below the limit for sure, `_clear`. The shortest exposure is spared all this, as
    there is none to turn to.
    """
    count, height, width = usable.shape
    for a in range(count):
        for y in range(height):
            line, most = raw[exposure[a], y], limit[a, y % 2]
            full[a, y] = 0
            highest = line[0]
            for x in range(width):  # much faster than counting
                highest = max(highest, line[x])
            if highest >= min(most[0], most[1]):
                for x in range(width):
                    full[a, y] += line[x] >= most[x]
    around = np.empty(width + 4, np.uint16)
    for a in range(count):
        reach = 0 if a == count - 1 else 2
        for y in range(height):
            begin, end = max(y - reach, y % 2), min(y + reach + 1, height)
            found = 0
            for row in range(begin, end, 2):
                found += full[a, row]
            line, most, use = raw[exposure[a], y], limit[a, y % 2], usable[a, y]
            if found == 0 or reach == 0:
                for x in range(width):
                    use[x] = line[x] < most[x]
                continue
            for x in range(width + 4):
                around[x] = 0
            for row in range(begin, end, 2):
                other = raw[exposure[a], row]
                for x in range(width):
                    around[x + 2] = max(around[x + 2], other[x])
            for x in range(width):
                use[x] = max(around[x + 2], max(around[x], around[x + 4])) < most[x]
            shorter, dark, worth = raw[exposure[a + 1]], black[y % 2], scale[y % 2]
            ratio = light[a] / light[a + 1]
            for x in range(width):
                if use[x] == 0 and line[x] < most[x]:
                    top = (np.float32(most[x]) - dark[x]) * worth[x]
                    noise2 = gain[a] * top + read2[a]
                    eighth2 = ratio * (gain[a + 1] * top + ratio * read2[a + 1]) * _EIGHTH
                    below = top - SURELY * np.sqrt(noise2 + eighth2)
                    below = below / (ratio * worth[x]) + dark[x]
                    use[x] = _clear(shorter, y, x, below, limit[a + 1, y % 2, x])


@compiled
def _clear(shorter, y, x, below, limit):
    """Whether the mean of the eight next samples of the CFA position lies below a raw value.

    They are of the next shorter exposure, and none of them saturates. The pixel's own has no part:
    a choice by it would be one among its noise.
    """
    height, width = shorter.shape
    total, count = _ZERO, _ZERO
    for i in range(y - 2, y + 3, 2):
        for j in range(x - 2, x + 3, 2):
            if 0 <= i < height and 0 <= j < width and (i != y or j != x):
                if shorter[i, j] >= limit:
                    return False
                total += np.float32(shorter[i, j])
                count += _ONE
    return total < below * count


@compiled
def _combine(
    raw,
    usable,
    above,
    exposure,
    light,
    gain,
    read2,
    limit,
    black,
    scale,
    mosaic,
    variance,
    excess,
    freedom,
    first,
    longest,
    lit,
    lines,
):
    """See `combine`, `Readings` and `Rows`.

    usable        (A, h, W) uint8
    first         row that longest and lit begin with
    longest, lit  (n, W + 4) light by the longest exposure that counts, and that one's light: 0
                  where none counts; beyond the frame's edge on both sides the next columns of the
                  CFA position stand in
    lines         (8, W) scratch
    """
    height, width = raw.shape[1:]
    below = above + len(mosaic)
    signal, level, weight, spare = lines[0], lines[1], lines[2], lines[3]
    information, total, square, count = lines[4], lines[5], lines[6], lines[7]

    for y in range(first, first + len(longest)):
        row, by = longest[y - first], lit[y - first]
        inside, inside_by = row[2 : width + 2], by[2 : width + 2]
        for a in range(len(exposure) - 1, -1, -1):  # each in the place of the shorter ones
            _signal(raw[exposure[a], y], black[y % 2], scale[y % 2], signal)
            use, t, per = usable[a, y], light[a], _ONE / light[a]
            for x in range(width):
                inside[x] = signal[x] * per if use[x] else inside[x]
            for x in range(width):
                inside_by[x] = t if use[x] else inside_by[x]
        for x in range(2):
            row[x], row[width + 2 + x] = row[x + 4], row[width - 2 + x]
            by[x], by[width + 2 + x] = by[x + 4], by[width - 2 + x]

    for y in range(max(above - 1, 0), min(below + 1, height)):
        i = y - first
        up = longest[i - 2] if i >= 2 else longest[i + 2]
        down = longest[i + 2] if i + 2 < len(longest) else longest[i - 2]
        _expected(up, longest[i], down, lit[i], gain[0], _TWO * read2[0], level)
        for x in range(width):
            information[x] = total[x] = _ZERO
        for x in range(width):
            square[x] = count[x] = _ZERO
        for a in range(len(exposure)):
            _signal(raw[exposure[a], y], black[y % 2], scale[y % 2], signal)
            use, t, g, r = usable[a, y], light[a], gain[a], read2[a]
            for x in range(width):
                one = np.float32(use[x])
                count[x] += one
                weight[x] = one / (g * (t * level[x]) + r)
            for x in range(width):
                information[x] += weight[x] * (t * t)
                total[x] += weight[x] * t * signal[x]
            for x in range(width):
                square[x] += weight[x] * signal[x] * signal[x]
        wanted = above <= y < below
        mean = mosaic[y - above] if wanted else level
        error2 = variance[y - above] if wanted else spare
        over, free = excess[y - above + 1], freedom[y - above + 1]
        for x in range(width):
            free[x] = max(count[x] - _ONE, _ZERO)
            error2[x] = _ONE / information[x] if count[x] > _ZERO else np.float32(np.nan)
        for x in range(width):
            mean[x] = total[x] * error2[x]
        for x in range(width):
            chi_square = square[x] - total[x] * mean[x]
            over[x] = chi_square - free[x] if count[x] > _ZERO else _ZERO


@compiled
def _signal(line, black, scale, signal):
    """A row of an exposure in steps above black."""
    for x in range(len(signal)):
        signal[x] = (np.float32(line[x]) - black[x]) * scale[x]


@compiled
def _expected(up, here, down, lit, gain, read2, level):
    """What a unit of light gives (W,), for the weights: at least 0.

    The longest exposure's own where that is well known. Where it is noise for the most part, the
    mean of the eight next pixels of the CFA position, which has no part in the pixel's own noise;
    in between something of both: steps^2 / (steps^2 + OWN^2 noise^2) of its own.

    up, here, down, lit  (W + 4,) rows of `longest` two apart, and the light of here
    """
    for x in range(len(level)):
        around = (up[x] + up[x + 2] + up[x + 4]) + (down[x] + down[x + 2] + down[x + 4])
        around = max((around + here[x] + here[x + 4]) * _EIGHTH, _ZERO)
        steps = around * lit[x + 2]
        noise2 = (steps * gain + read2) * (OWN_SIGNAL * OWN_SIGNAL)
        share = steps * steps / (steps * steps + noise2)
        level[x] = max(around + (here[x + 2] - around) * share, _ZERO)
