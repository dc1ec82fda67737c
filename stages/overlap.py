"""What two exposures have in common, of the blocks that a survey is made of."""

from __future__ import annotations

import numpy as np

from stages.compiled import compiled


@compiled
def overlap(shorter, longer, block, wanted, ratio, lean, lowest, highest, most):
    """Which samples neither saturate nor drown in noise; indices, ascending.

    shorter, longer  (n,) float32; NaN where saturated
    block            (n,) which block of the picture a sample is from
    wanted           (b,) whether a block's samples are
    ratio            of the exposures' light
    lean, lowest     what the shorter one's signal must exceed, told from both with such a weight
    highest          what the longer one's must not reach, told from both: a limit to one of
                     them would choose among its noise
    most             of more samples every second, third ... is taken
    """
    share, scale = 1 / (1 + ratio), ratio / (1 + lean * ratio)
    chosen, count = np.empty(len(shorter), np.int64), 0
    for i in range(len(shorter)):
        a, b = shorter[i], longer[i]
        if (a + b) * share < highest and (lean * a + b) * scale > lowest and wanted[block[i]]:
            chosen[count] = i
            count += 1
    return chosen[: count : 1 + count // most].copy()


@compiled
def block_sums(shorter, longer, signal, block, ratio, slope, offset, blocks):
    """Sums (3, blocks) of samples that agree: of both exposures', and the differences' variance;
    and how many they are (blocks,).

    signal         (n,) of the shorter, told from both
    slope, offset  variance of shorter - ratio longer, by the signal
    """
    sums, count = np.zeros((3, blocks)), np.zeros(blocks, np.int64)
    for i in range(len(block)):
        variance = slope * signal[i] + offset
        if (shorter[i] - ratio * longer[i]) ** 2 < 16 * variance:
            of = block[i]
            sums[0, of] += shorter[i]
            sums[1, of] += longer[i]
            sums[2, of] += variance
            count[of] += 1
    return sums, count
