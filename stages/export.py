"""The maps other programs take, from the measured cubemap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stages.fill import fill
from stages.layouts import CUBE, LATLONG
from stages.resample import resample
from stages.types import Float, Measured

_LARGEST_HALF = 65504.0
_LEAST_EXACT_HALF = 6.1e-5  # below it half floats lose precision


@dataclass(frozen=True)
class Maps:
    """What renderers and viewers read.

    triples  (6, N, N, 3) each, three channels beside one another, without holes, divided by scale;
             the last is 0 where there are no channels left for it
    scale    a power of two: radiance is value * scale
    latlong  (2 N, 4 N, P), with the holes of what was measured
    """

    triples: tuple[Float, ...]
    scale: float
    latlong: Measured


def export(light: Measured) -> Maps:
    """Maps for half floats and three channels a file, and the latitude-longitude image.

    light  (6, N, N, P) cubemap
    """
    filled = fill(light)
    scale = half_float_scale(filled)
    stored = filled / np.float32(scale)
    maps = tuple(_three(stored[..., list(triple)]) for triple in triples(filled.shape[-1]))
    return Maps(maps, scale, resample(light, CUBE, LATLONG, 2 * light.values.shape[1]))


def triples(channels: int) -> tuple[range, ...]:
    """The channels of each map: three at a time, and what is left."""
    return tuple(range(k, min(k + 3, channels)) for k in range(0, channels, 3))


def _three(values: Float) -> Float:
    """Up to three channels (..., k) as three, the missing ones 0."""
    return np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, 3 - values.shape[-1])])


def half_float_scale(values) -> float:
    """The power of two that values are to be divided by to be stored as half floats.

    1 where they fit as they are: the largest below 65504, and the median above what half floats
    resolve. Otherwise the largest is brought to between 16384 and 32768.
    """
    magnitude = np.abs(values)
    largest, median = float(magnitude.max()), float(np.median(magnitude))
    if largest == 0 or (largest < _LARGEST_HALF and median > 16 * _LEAST_EXACT_HALF):
        return 1.0
    return float(2.0 ** (np.floor(np.log2(largest)) - 14))
