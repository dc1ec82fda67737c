"""How often raw values occur."""

from __future__ import annotations

from stages.compiled import compiled


@compiled
def count_from(floor, samples, top, step, left, counts):
    """Adds samples of `floor` and more to a histogram; gives how many samples it looked at.

    samples    (H, W) uint16
    top, step  first row, and rows from one to the next
    left       first column; every second is taken
    counts     (n,) int64, of values floor, floor + 1 ...
    """
    height, width = samples.shape
    looked = 0
    for y in range(top, height, step):
        line = samples[y]
        highest = line[0]
        for x in range(width):  # most rows of short exposures end here
            highest = max(highest, line[x])
        if highest >= floor:
            for x in range(left, width, 2):
                if line[x] >= floor:
                    counts[line[x] - floor] += 1
        looked += (width - left + 1) // 2
    return looked
