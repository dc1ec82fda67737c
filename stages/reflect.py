"""Divide a white in the same light out of a photograph: what is left is reflectance."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from stages.types import Float, Measured
from stages.unwrap import BAYER_NOISE_AREA_PX

SMOOTH_PX = 8.0  # sigma: takes the white's noise down 11 times; shading changes over hundreds of px
LEAST = 0.05  # of the white's bright parts: with less it is not the white, or no light falls on it
_BLOCK = 4  # px a side: what is smooth over 8 px is computed once for so many, and interpolated


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
    lit = _lit(white)
    values, variance = np.empty_like(surface.values), np.empty_like(surface.values)
    for band, (level, error) in enumerate(_smooth(white, lit)):
        ratio = surface.values[..., band] / level
        values[..., band] = ratio
        variance[..., band] = (surface.variance[..., band] + ratio**2 * error) / level**2
    valid = np.where(np.isfinite(values).all(axis=-1), surface.valid, np.float32(0))
    values[valid == 0] = variance[valid == 0] = np.nan
    return Measured(values, variance, valid)


def _lit(white: Measured) -> NDArray[np.bool_]:
    """Where (H, W) the white is known and bright enough to be the white."""
    known = (white.valid > 0) & np.isfinite(white.values).all(axis=-1)
    if not known.any():
        return known
    bright = np.maximum(np.percentile(white.values[known], 99, axis=0), 0)
    with np.errstate(invalid="ignore"):
        return np.asarray(known & (white.values > LEAST * bright).all(axis=-1))


def _smooth(white: Measured, lit: NDArray[np.bool_]) -> Iterator[tuple[Float, Float]]:
    """Each band of the white (H, W), smoothed, and its variance; NaN where it is not lit.

    About each block a plane is laid through the lit pixels, with Gaussian weights: a local mean
    would lean to the inside at the frame's and the card's edges, by as much as shading changes
    there (W. S. Cleveland and S. J. Devlin, "Locally weighted regression", 1988).
    """
    import cv2

    sigma = SMOOTH_PX / _BLOCK
    place = np.arange(-round(4 * sigma), round(4 * sigma) + 1)
    weight = np.exp(-0.5 * (place / sigma) ** 2)
    weight /= weight.sum()
    height, width = lit.shape
    # One block more on each side, so that the outermost pixels lie between blocks too.
    pad = [(_BLOCK, _BLOCK + -size % _BLOCK) for size in (height, width)]

    def blocks(image) -> Float:
        padded = np.pad(np.where(lit, image, np.float32(0)), pad)
        small = (padded.shape[1] // _BLOCK, padded.shape[0] // _BLOCK)
        return np.asarray(cv2.resize(padded, small, interpolation=cv2.INTER_AREA), np.float32)

    def moment(image, x, y):
        """Weighted sums of image * x^x * y^y about each block, in sigma; 0 lies outside."""
        across, down = (weight * (place / sigma) ** power for power in (x, y))
        return cv2.sepFilter2D(image, cv2.CV_32F, across, down, borderType=cv2.BORDER_CONSTANT)

    def pixels(image) -> Float:
        size = (image.shape[1] * _BLOCK, image.shape[0] * _BLOCK)
        whole = cv2.resize(image, size, interpolation=cv2.INTER_LINEAR)
        part = whole[_BLOCK : _BLOCK + height, _BLOCK : _BLOCK + width]
        return np.where(lit, part, np.float32(np.nan))

    there = blocks(np.float32(1))
    s, x, y = moment(there, 0, 0), moment(there, 1, 0), moment(there, 0, 1)
    few = np.float32(1e-4)  # keeps the plane level where all that is lit lies in one spot
    xx, xy, yy = moment(there, 2, 0) + few, moment(there, 1, 1), moment(there, 0, 2) + few
    # The plane's height here, from its normal equations by Cramer's rule.
    a, b, c = xx * yy - xy * xy, xy * y - x * yy, x * xy - xx * y
    determinant = np.maximum(s * a + x * b + y * c, np.float32(1e-20))  # far from all that is lit
    for band in range(white.values.shape[-1]):
        value = blocks(white.values[..., band])
        plane = a * moment(value, 0, 0) + b * moment(value, 1, 0) + c * moment(value, 0, 1)
        # A Gaussian's mean is one of 4 pi sigma^2 px, a plane's height at an edge of fewer;
        # demosaiced neighbours share their noise.
        counted = np.float32(4 * np.pi * SMOOTH_PX**2 / BAYER_NOISE_AREA_PX[band % 3])
        noise = moment(blocks(white.variance[..., band]), 0, 0) / np.maximum(s, np.float32(1e-20))
        yield pixels(plane / determinant), pixels(noise * a / determinant / counted)
