"""Divide a white in the same light out of a photograph: what is left is reflectance."""

from __future__ import annotations

import numpy as np

from stages.types import Float, Measured
from stages.unwrap import BAYER_NOISE_AREA_PX

SMOOTH_PX = 8.0  # sigma: takes the white's noise down 11 times; shading changes over hundreds of px
LEAST = (
    0.05  # of the white's bright parts: with less, that is not the white or no light falls on it
)


def reflect(surface: Measured, white: Measured) -> Measured:
    """A surface's signals over those of a white in its place: shading and light cancel.

    surface  (H, W, C) camera signals through one filter
    white    (H, W, C) those of an even white card: same camera, place and light
    returns  (H, W, C) reflectance relative to the white's; NaN, valid 0, where either is unknown
             or the white is dark

    The white is smoothed first, so that the card's grain and its photograph's noise stay out of the
    surface. Where it ends, what lies beside it has no part in the mean. Variance by the linear
    propagation of both images' errors.
    """
    assert surface.values.shape == white.values.shape
    level, variance = _smooth(white)
    values = surface.values / level
    valid = np.where(np.isfinite(values).all(axis=-1), surface.valid, 0.0)
    values[valid == 0] = np.nan
    spread = surface.variance / level**2 + (values / level) ** 2 * variance
    spread[valid == 0] = np.nan
    return Measured(values.astype(np.float32), spread.astype(np.float32), valid.astype(np.float32))


def _smooth(white: Measured) -> tuple[Float, Float]:
    """The white's signals (H, W, C) as local means, and their variance; NaN where it is not."""
    import cv2

    known = (white.valid > 0) & np.isfinite(white.values).all(axis=-1)
    bright = np.percentile(white.values[known], 99, axis=0) if known.any() else np.inf
    with np.errstate(invalid="ignore"):
        known &= (white.values > LEAST * np.maximum(bright, 0)).all(axis=-1)

    def mean(image):
        return cv2.GaussianBlur(image, (0, 0), SMOOTH_PX, borderType=cv2.BORDER_REFLECT)

    share = mean(known.astype(np.float32))
    share[~known] = np.nan
    level, variance = np.empty_like(white.values), np.empty_like(white.values)
    for c in range(white.values.shape[-1]):
        level[..., c] = mean(np.where(known, white.values[..., c], np.float32(0))) / share
        # A Gaussian's mean is one of 4 pi sigma^2 px; demosaiced neighbours share their noise.
        counted = 4 * np.pi * SMOOTH_PX**2 / BAYER_NOISE_AREA_PX[c % 3]
        variance[..., c] = mean(np.where(known, white.variance[..., c], np.float32(0)))
        variance[..., c] /= share**2 * np.float32(counted)
    return level, variance
