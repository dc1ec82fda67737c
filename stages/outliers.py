"""Pixels that stand out alone: hot ones, with a dark current, and dead ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.compiled import compiled
from stages.types import Float

SIGMAS = np.float32(8.0)  # one in 1e15 of a normal distribution
RANGES = np.float32(2.5)  # times the range of the neighbours beyond their extremes
FEWER_RANGES = np.float32(1.5)  # where the four next pixels show nothing of it:
QUIET_SHARE = np.float32(0.05)  # in their mean, which so many sigmas make known to .033
QUIET_SIGMAS = np.float32(15.0)
GLINT_SHARE = np.float32(0.1)  # what the lens spreads of a point of light onto the next pixels
GLINT_SIGMAS = np.float32(4.0)

# Of two beside each other, what the four pixels next to both have. Of a point of light between the
# two that is an eighth, however sharp the lens, as pixels are as wide as they are far apart.
PAIR_SHARE = np.float32(0.04)
PAIR_SIGMAS = np.float32(40.0)  # so that the mean of four is known to a quarter of that share

_HALF = np.float32(0.5)
_PLACES = np.array([(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if y or x], np.float32)
_SLOPE = (_PLACES @ np.linalg.pinv(_PLACES)).astype(np.float32)  # eight values' plane, at each


def mark_outliers(
    mosaic: Float, variance: Float, top: int, bottom: int, defective: NDArray[np.bool_]
) -> None:
    """Marks what stands out in some rows of a merged mosaic (H, W).

    A hot pixel adds the same signal per second in every exposure, so it shows only beside its
    neighbours: it lies far outside the range of the eight next of its CFA position, which their
    common slope has no part in, by its noise and by that range, and no pixel next to it stands
    out in its own colour, as those do about a glint, which the lens spreads. Less far is enough
    where the four next to it show nothing together, not even in their mean. One that stands out
    next to it may be hot too, where the pixels beside both show nothing. Pixels beside lost ones
    or the frame's edge are not judged.
    """
    if mosaic.shape[1] >= 5:
        _mark(mosaic, variance, max(top, 2), min(bottom, len(mosaic) - 2), _SLOPE, defective)


@compiled
def _mark(mosaic, variance, top, bottom, slope, defective):
    width = mosaic.shape[1]
    far = np.empty(width - 4, np.float32)
    eight = np.empty(8, np.float32)
    for y in range(top, bottom):
        # Opposite ones of the eight, whose mean no slope changes, leave few to look at closer.
        _from_opposite_ones(mosaic[y - 2], mosaic[y], mosaic[y + 2], far)
        for x in range(2, width - 2):
            error2 = variance[y, x]
            if not far[x - 2] * far[x - 2] > SIGMAS * SIGMAS * error2:
                continue
            out, spread, own = _beyond(mosaic, y, x, slope, eight)
            if not (out * out > SIGMAS * SIGMAS * error2 and abs(out) > FEWER_RANGES * spread):
                continue
            far_out = abs(out) > RANGES * spread
            loud, glints, dy, dx, mean = 0, 0, 0, 0, np.float32(0)  # next to it, and where
            for i, j in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                _, _, beside = _beyond(mosaic, y + i, x + j, slope, eight)
                share = beside / own
                mean += share / np.float32(4)
                sure = beside * beside > GLINT_SIGMAS * GLINT_SIGMAS * variance[y + i, x + j]
                loud += sure and abs(share) > GLINT_SHARE
                if sure and share > GLINT_SHARE:
                    glints, dy, dx = glints + 1, i, j
            if far_out and glints == 0:
                defective[y, x] = True
            elif loud == 0 and own * own > QUIET_SIGMAS * QUIET_SIGMAS * error2:
                defective[y, x] |= abs(mean) < QUIET_SHARE
            elif far_out and glints == 1 and own * own > PAIR_SIGMAS * PAIR_SIGMAS * error2:
                mean = np.float32(0)
                for side in (-1, 1):  # what lies beside both
                    i, j = y + side * dx, x + side * dy
                    mean += _beyond(mosaic, i, j, slope, eight)[2]
                    mean += _beyond(mosaic, i + dy, j + dx, slope, eight)[2]
                defective[y, x] |= abs(mean) < np.float32(4) * PAIR_SHARE * abs(own)


@compiled
def _from_opposite_ones(above, here, below, far):
    """How far (W - 4,) a row's pixels lie outside of two means; 0 unless far by their range."""
    left, middle, right = here[:-4], here[2:-2], here[4:]
    above, below = above[2:-2], below[2:-2]
    for i in range(len(far)):
        across, down = (left[i] + right[i]) * _HALF, (above[i] + below[i]) * _HALF
        high, low = max(across, down), min(across, down)
        out = max(middle[i] - high, low - middle[i])
        far[i] = out if out > FEWER_RANGES * (high - low) else np.float32(0)


@compiled
def _beyond(mosaic, y, x, slope, eight):
    """How far a pixel lies beyond the range of its eight, that range, and how far over their mean;
    their common slope taken off. NaN beside what is not known."""
    height, width = mosaic.shape
    n = 0
    for dy in (-2, 0, 2):
        for dx in (-2, 0, 2):
            if dy != 0 or dx != 0:
                i, j = y + dy, x + dx
                # Beyond the frame's edge the other ones of the CFA position stand in.
                i = i + 2 if i < 0 else (i - 2 if i >= height else i)
                j = j + 2 if j < 0 else (j - 2 if j >= width else j)
                eight[n] = mosaic[i, j]
                n += 1
    high, low, total = np.float32(-np.inf), np.float32(np.inf), np.float32(0)
    for n in range(8):
        plane = np.float32(0)
        for m in range(8):
            plane += slope[n, m] * eight[m]
        level = eight[n] - plane
        high, low, total = max(high, level), min(low, level), total + level
        if np.isnan(level):
            return level, level, level
    value = mosaic[y, x]
    return value - min(max(value, low), high), high - low, value - total / np.float32(8)
