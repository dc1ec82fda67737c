"""A map as the page in a browser shows it: light ready to shade with, and what is known of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stages.export import half_float_scale
from stages.fill import fill
from stages.light import Light, light
from stages.prefilter import area_average, mean
from stages.types import Float, Measured

MOST = 256  # texels along a face: what four megabytes hold


@dataclass(frozen=True)
class View:
    """What the page holds of a map.

    light  of the map without holes, divided by `scale`
    mean   (C,) over all directions, in the map's unit
    scale  a power of two, so that half floats hold the rest
    sigma  (6, N / 2, N / 2, C) standard deviation of one texel of the map, in the map's unit; the
           mean of four by their variance; NaN where none is known
    valid  (6, N, N) 0 not known .. 1 fully known
    finer  how many of the map's own texels lie along the side of one
    """

    light: Light
    mean: Float
    scale: float
    sigma: Float
    valid: Float
    finer: int


def view(measured: Measured, *, most: int = MOST) -> View:
    """The map at no more than `most` texels along a face, with its holes filled smoothly.

    measured  (6, N, N, C) cubemap of light, N a power of two
    """
    known = np.isfinite(measured.values).all(axis=-1)
    # A texel that says it is known and is not, is not.
    valid = np.where(known, measured.valid, 0).astype(np.float32)
    filled = fill(Measured(measured.values, measured.variance, valid))
    finer = max(1, filled.shape[1] // most)
    shown = area_average(filled, most) if finer > 1 else filled
    scale = half_float_scale(shown)
    variance = np.where((valid > 0)[..., None], measured.variance, np.nan)
    return View(
        light=light(shown / np.float32(scale)),
        mean=mean(shown),
        scale=scale,
        sigma=np.sqrt(_of_blocks(variance, min(2 * finer, filled.shape[1]))),
        valid=_of_blocks(valid[..., None], finer)[..., 0],
        finer=finer,
    )


def _of_blocks(cube, side):
    """Means (6, N / side, N / side, C) of what is not NaN in blocks of texels."""
    size = cube.shape[1] // side
    parts = cube.reshape(6, size, side, size, side, -1)
    known = np.isfinite(parts)
    count = known.sum(axis=(2, 4))
    total = np.where(known, parts, 0).sum(axis=(2, 4))
    result = np.full(count.shape, np.nan, np.float32)
    return np.divide(total, count, out=result, where=count > 0)
