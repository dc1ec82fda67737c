"""Close the holes of a cubemap for renderers that cannot live with them."""

from __future__ import annotations

import numpy as np

from stages import cube
from stages.types import Float, Measured


def fill(measured: Measured) -> Float:
    """A cubemap without holes; what was measured stays as it is.

    measured  (6, N, N, C), N a power of two; `valid` says how much of each texel is known
    returns   (6, N, N, C) float32, everywhere finite. Unknown texels take a smooth continuation
              of their surroundings, partly known ones the matching mixture

    Pull-push (Gortler et al. 1996): means weighted by valid and solid angle go down a pyramid
    until nothing is unknown, then each level fills its holes from the coarser one.
    """
    n = measured.values.shape[1]
    weight = (measured.valid * cube.solid_angles(n))[..., None]
    levels = [(np.where(weight > 0, measured.values, 0.0).astype(np.float64), weight)]
    while levels[-1][0].shape[1] > 1:
        values, weight = levels[-1]
        total = _sum_of_fours(weight)
        mean = _sum_of_fours(values * weight) / np.where(total > 0, total, 1.0)
        levels.append((mean, total))

    values, weight = levels.pop()
    known = weight.sum()
    assert known > 0, "a cubemap of which nothing is known cannot be filled"
    mean = (values * weight).sum((0, 1, 2)) / known
    filled = np.where(weight > 0, values, mean)
    while levels:
        values, weight = levels.pop()
        size = values.shape[1]
        share = np.clip(weight / cube.solid_angles(size)[..., None], 0.0, 1.0)
        smooth = cube.sample(filled, cube.directions(size))
        filled = values * share + smooth * (1.0 - share)
    return filled.astype(np.float32)


def _sum_of_fours(a):
    return a[:, ::2, ::2] + a[:, 1::2, ::2] + a[:, ::2, 1::2] + a[:, 1::2, 1::2]
