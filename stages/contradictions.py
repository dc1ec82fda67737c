"""Pixels whose exposures contradict each other: what moved, and what is defective."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stages.combine import Readings, Rows
from stages.compiled import compiled
from stages.types import Float

CONTRADICTION = 1e-6  # chance that noise alone gives the chi-square of 3 x 3 pixels
DISAGREEMENT = 1e-4  # that it lets two exposures differ so much there
AGREEMENT = np.float32(4.0)  # sigmas between two samples
LINEARITY = np.float32(0.002)  # share of the signal by which a good sensor's exposures differ

_ZERO, _HALF, _ONE = (np.float32(v) for v in (0, 0.5, 1))


class Bounds(NamedTuple):
    """What chi-square may be.

    linear    what it is divided by: of a sensor so good that its linearity shows beside its noise
    surprise  (n,) by how much that of 3 x 3 pixels, all exposures, may exceed n degrees of freedom
    unlikely  (10,) what that of n pixels in two exposures may be
    """

    linear: np.float32
    surprise: Float
    unlikely: Float

    @classmethod
    def of(cls, exposures: int, gain: float) -> Bounds:
        """Gain is the least of the exposures', of full scale."""
        return cls(
            np.float32(1 + LINEARITY**2 / gain),
            _surprise(9 * exposures, CONTRADICTION),
            (np.arange(10) + _surprise(9, DISAGREEMENT)).astype(np.float32),
        )


def _surprise(freedom: int, chance: float) -> Float:
    """By how much chi-square of 0..freedom degrees exceeds them with so small a chance."""
    from scipy.special import chdtri

    degrees = np.arange(1, freedom + 1)
    return np.array([np.inf, *(chdtri(degrees, chance) - degrees)], np.float32)


class Marked(NamedTuple):
    """Masks (h, W) of what was found in some rows."""

    moved: NDArray[np.bool_]
    defective: NDArray[np.bool_]


def settle(raw, above: int, readings: Readings, bounds: Bounds, rows: Rows, marked: Marked) -> None:
    """Finds what moved and what is defective, and puts mosaic and variance right there.

    raw, above  as `combine` takes them
    rows        what it gave

    Chi-square is pooled over 3 x 3 pixels, since what moves is larger than one. What one pixel does
    alone is its own fault, or a particle's.
    """
    count, width = len(readings.exposure), raw.shape[2]
    lines = np.zeros((3, width + 2), np.float32)
    signal = np.empty((count, 9), np.float32)
    usable, sets = np.empty((count, 9), np.bool_), np.empty((2, count, count), np.bool_)
    _settle(raw, above, *readings, *bounds, *rows, *marked, lines, signal, usable, sets)


@compiled
def _settle(
    raw,
    above,
    exposure,
    light,
    gain,
    read2,
    limit,
    black,
    scale,
    linear,
    surprise,
    unlikely,
    mosaic,
    variance,
    excess,
    freedom,
    moved,
    defective,
    lines,
    signal,
    usable,
    sets,
):
    """See `settle`, and `Readings`, `Bounds`, `Rows` and `Marked`.

    lines           (3, W + 2) scratch, 0 at both ends
    signal, usable  (A, 9) samples of the 3 x 3 about a pixel above black, and whether they count
    sets            (2, A, A) scratch
    """
    height, width = mosaic.shape
    sums, pooled, free = lines[0], lines[1], lines[2]
    for y in range(height):
        _three_by_three(freedom[y], freedom[y + 1], freedom[y + 2], sums, free)
        _three_by_three(excess[y], excess[y + 1], excess[y + 2], sums, pooled)
        for x in range(width):
            pooled[x] = (pooled[x] + free[x]) / linear - free[x]
        for x in range(width):
            total = int(free[x] + _HALF)
            if pooled[x] <= surprise[total]:
                continue
            # What remains of the nine without their worst?
            worst, at_y, at_x = -np.float32(np.inf), y, x
            for i in range(y, y + 3):
                for j in range(max(x - 1, 0), min(x + 2, width)):
                    own = (excess[i, j] + freedom[i, j]) / linear - freedom[i, j]
                    if own > worst:
                        worst, at_y, at_x = own, i - 1, j
            rest = total - int(freedom[at_y + 1, at_x])
            alone = pooled[x] - worst <= surprise[max(rest, 0)]
            if alone and (at_y != y or at_x != x):
                continue
            for i in range(9):
                row, column = above + y + i // 3 - 1, x + i % 3 - 1
                there = 0 <= row < raw.shape[1] and 0 <= column < width
                for a in range(len(exposure)):
                    usable[a, i] = False
                    if there:
                        value = raw[exposure[a], row, column]
                        usable[a, i] = value < limit[a, row % 2, column]
                        level = np.float32(value) - black[row % 2, column]
                        signal[a, i] = level * scale[row % 2, column]
            mean, error2, many, known = _agreed(
                signal, usable, alone, light, gain, read2, unlikely, sets
            )
            mosaic[y, x], variance[y, x] = mean, error2
            defective[y, x] = alone and 2 * many <= known
            moved[y, x] = many < known and not alone


@compiled
def _three_by_three(above, here, below, sums, pooled):
    """Sums over the 3 x 3 about a row's pixels; sums (W + 2,), 0 at both ends."""
    width = len(here)
    for x in range(width):
        sums[x + 1] = above[x] + here[x] + below[x]
    for x in range(width):
        pooled[x] = sums[x] + sums[x + 1] + sums[x + 2]


@compiled
def _agreed(signal, usable, alone, light, gain, read2, unlikely, sets):
    """Mean and variance of the samples that agree; how many do, and of how many.

    signal, usable  (A, 9) of the 3 x 3 about a pixel
    alone           whether it is to be judged without its neighbours
    sets            (2, A, A) scratch

    Each exposure is held against each: two agree at a pixel when their samples there do, and by
    chi-square those of the 3 x 3 pixels about it. From each exposure a set is begun that takes
    in, the longest first, what agrees with all that are in it; the largest set is the answer, of
    equally large ones the best informed.
    """
    count, agree, taken = len(light), sets[0], sets[1]
    level, known = _ZERO, 0
    for j in range(count):  # the longer of a pair
        if usable[j, 4]:
            known += 1
            level = max(level, signal[j, 4] / light[j])
        for k in range(j + 1, count):
            alike = usable[j, 4] and usable[k, 4]
            if alike:
                ratio = light[k] / light[j]
                off, both = _ZERO, 0
                for i in range(9):
                    if usable[j, i] and usable[k, i]:
                        expected = ratio * signal[j, i]
                        noise2 = (gain[k] + ratio * gain[j]) * max(expected, _ZERO)
                        noise2 += read2[k] + ratio * ratio * read2[j]
                        noise2 += (LINEARITY * expected) * (LINEARITY * expected)
                        apart = signal[k, i] - expected
                        apart = apart * apart / noise2
                        alike = alike and (i != 4 or apart < AGREEMENT * AGREEMENT)
                        off += apart
                        both += 1
                alike = alike and (alone or off < unlikely[both])
            agree[j, k] = agree[k, j] = alike

    everything = _ZERO
    for k in range(count):
        everything += 2 * light[k] * light[k] / (gain[k] * light[k] * level + read2[k])
    best, chosen = -_ONE, 0
    for j in range(count):
        score = _ZERO
        for k in range(count):
            taken[j, k] = k == j
        for k in range(count):
            fits = usable[j, 4] and usable[k, 4]
            for i in range(count):
                fits = fits and (not taken[j, i] or i == k or agree[i, k])
            taken[j, k] = fits
            if fits:
                information = light[k] * light[k] / (gain[k] * light[k] * level + read2[k])
                score += _ONE + information / everything
        if score > best:
            best, chosen = score, j

    many, total, lit = 0, _ZERO, _ZERO
    for k in range(count):
        if taken[chosen, k]:
            many += 1
            total += signal[k, 4]
            lit += light[k]
    if many == 0:  # saturated all: nothing to put right
        return np.float32(np.nan), np.float32(np.nan), 0, known
    level = max(total / lit, _ZERO)
    told, total = _ZERO, _ZERO
    for k in range(count):
        if taken[chosen, k]:
            weight = light[k] / (gain[k] * light[k] * level + read2[k])
            told += weight * light[k]
            total += weight * signal[k, 4]
    return total / told, _ONE / told, many, known
