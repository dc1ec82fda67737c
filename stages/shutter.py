"""What a shutter's time truly is where its tag is rounded for people."""

from __future__ import annotations

import numpy as np


def true_shutter(tag_s: float) -> float:
    """The time a camera aims at where its tag says `tag_s`, seconds.

    Tags are rounded for people: shutters run in thirds or halves of a stop from one second, so
    1/60 stands for 1/64 and 0.3 for 2^(-5/3). A tag that is not a customary name is kept.
    """
    thirds, halves = (np.abs(names / tag_s - 1).min() < 0.002 for names in (_THIRDS, _HALVES))
    if thirds or halves:
        steps = 3 if thirds else 2  # a name of both, as 1/60, is the same power in both
        return float(2.0 ** (np.round(steps * np.log2(tag_s)) / steps))
    return tag_s


# fmt: off
_THIRDS = np.array([
    *(1 / d for d in (
        32000, 25000, 20000, 16000, 12800, 12500, 10000, 8000, 6400, 5000, 4000, 3200, 2500, 2000,
        1600, 1250, 1000, 800, 640, 500, 400, 320, 250, 200, 160, 125, 100, 80, 60, 50, 40, 30, 25,
        20, 15, 13, 10, 8, 6, 5, 4, 3, 2.5, 1.6, 1.3)),
    0.3, 0.4, 0.5, 0.6, 0.8, 1, 1.3, 1.6, 2, 2.5, 3, 3.2, 4, 5, 6, 8, 10, 13, 15, 20, 25, 30,
])
_HALVES = np.array([
    *(1 / d for d in (24000, 12000, 6000, 3000, 1500, 750, 350, 180, 90, 45, 1.5)),
    0.7, 1.5, 12, 24,
])
# fmt: on
