"""Lay the filters' images of a flat surface on the first's pixels.

A filter in front of the lens moves the picture by a part of a pixel. The shift is found as for the
sphere, from texture (see `stages.align`); each image is then resampled once, and the first not at
all. A surface with no texture, as a plain card, has nothing to be laid on anything: it stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.errors import fault
from stages.align import LEAST_CORRELATION, REACH_PX, coarse_shift, refined_shift, texture
from stages.types import Float, Measured

_WINDOW = 1600  # px: the shift is the whole image's, so its busiest part is enough to find it
_CONTRAST = 0.003  # rms of detail, of the mean: less is the grain of a plain surface


@dataclass(frozen=True)
class Registered:
    """All filters' bands on the first image's pixels.

    bands        (H, W, C * filters), a filter's channels beside each other; not valid where any
                 filter is not
    shifts       (F, 2) x, y in px: image k showed at p + shifts[k] what image 0 shows at p
    correlation  (F,) of the texture in the best channel; NaN where there is none
    error_px     (F,) standard error of a shift; NaN likewise
    """

    bands: Measured
    shifts: NDArray[np.float64]
    correlation: NDArray[np.float64]
    error_px: NDArray[np.float64]


def register(images: Sequence[Measured]) -> Registered:
    """Find the images' shifts against the first and take them out.

    images   one a filter, (H, W, C) each
    raises   InputError where images have texture but none in common
    """
    first = images[0]
    count = len(images)
    shifts = np.zeros((count, 2))
    correlation, error = np.ones(count), np.zeros(count)
    moved = [first]
    for k in range(1, count):
        part = _busiest(first)
        pair = [_cut(image, part) for image in (first, images[k])]
        if all(_textured(image) for image in pair):
            (a, a_known), (b, b_known) = map(texture, pair)
            shifts[k], correlation[k], error[k] = refined_shift(
                a, a_known, b, b_known, coarse_shift(a, b)
            )
            if not correlation[k] > LEAST_CORRELATION:
                raise fault(
                    f"filter {k + 1}'s photograph does not match the first filter's "
                    f"(correlation {correlation[k]:.2f})",
                    f"the same view, shifted by at most {REACH_PX} px",
                    "check that camera and surface stood still between the filters",
                )
        else:
            correlation[k] = error[k] = np.nan
        moved.append(shifted(images[k], shifts[k]))
    valid = np.minimum.reduce([image.valid for image in moved])
    values = np.concatenate([image.values for image in moved], axis=-1)
    variance = np.concatenate([image.variance for image in moved], axis=-1)
    values[valid == 0] = variance[valid == 0] = np.nan
    return Registered(Measured(values, variance, valid), shifts, correlation, error)


def shifted(image: Measured, shift) -> Measured:
    """The image at p + shift, by cubic convolution (Catmull and Rom).

    image    (H, W, C)
    shift    (2,) x, y in px
    returns  (H, W, C); not valid where any pixel that counts is not, or lies outside. The variance
             is that of the weighted sum, its pixels taken as independent
    """
    import cv2

    if not np.any(shift):
        return image
    whole = np.rint(shift).astype(int)
    across, down = (_cubic(s) for s in np.asarray(shift) - whole)
    count_across, count_down = (np.asarray(k != 0, np.float32) for k in (across, down))

    def weighted(layer, row, column):
        return cv2.sepFilter2D(
            _whole(layer, whole), cv2.CV_32F, row, column, borderType=cv2.BORDER_CONSTANT
        )

    known = (image.valid > 0) & np.isfinite(image.values).all(axis=-1)
    values, variance = np.empty_like(image.values), np.empty_like(image.values)
    for c in range(values.shape[-1]):
        value, spread = (
            np.where(known, a[..., c], np.float32(0)) for a in (image.values, image.variance)
        )
        values[..., c] = weighted(value, across, down)
        variance[..., c] = weighted(spread, across**2, down**2)
    around = weighted(known.astype(np.float32), count_across, count_down)
    valid = around > count_across.sum() * count_down.sum() - 0.5
    values[~valid] = variance[~valid] = np.nan
    return Measured(values, variance, valid.astype(np.float32))


def _cubic(fraction: float) -> NDArray[np.float64]:
    """Weights (5,) of the pixels at -2..2 for a value at `fraction` in [-.5, .5]; sum 1."""
    x = np.abs(np.arange(-2, 3) - fraction)
    near = 1.5 * x**3 - 2.5 * x**2 + 1.0
    far = -0.5 * x**3 + 2.5 * x**2 - 4.0 * x + 2.0
    return np.where(x <= 1.0, near, np.where(x < 2.0, far, 0.0))


def _whole(image: Float, shift) -> Float:
    """The image (H, W, ...) at p + a whole shift; 0 outside."""
    out = np.zeros_like(image)
    (x, y), (height, width) = shift, image.shape[:2]
    to = slice(max(0, -y), min(height, height - y)), slice(max(0, -x), min(width, width - x))
    out[to] = image[to[0].start + y : to[0].stop + y, to[1].start + x : to[1].stop + x]
    return out


def _cut(image: Measured, part) -> Measured:
    return Measured(image.values[part], image.variance[part], image.valid[part])


def _busiest(image: Measured) -> tuple[slice, slice]:
    """The window of the image with the most detail."""
    height, width = image.valid.shape
    detail = np.nan_to_num(np.abs(np.diff(image.values[..., 1], axis=1)))

    def starts(size: int) -> list[int]:
        last = max(0, size - _WINDOW)
        return sorted({0, last // 2, last})

    corners = [(y, x) for y in starts(height) for x in starts(width)]
    y, x = max(
        corners, key=lambda c: float(detail[c[0] : c[0] + _WINDOW, c[1] : c[1] + _WINDOW].sum())
    )
    return slice(y, y + _WINDOW), slice(x, x + _WINDOW)


def _textured(image: Measured) -> bool:
    """Whether any channel has detail that is clearly more than its noise."""
    import cv2

    known = (image.valid > 0) & np.isfinite(image.values).all(axis=-1)
    inner = cv2.erode(known.astype(np.uint8), np.ones((25, 25), np.uint8)) > 0
    if not inner.any():
        return False
    for c in range(image.values.shape[-1]):
        values = np.where(known, image.values[..., c], np.float32(0))
        fine, coarse = (cv2.GaussianBlur(values, (0, 0), sigma) for sigma in (1.0, 6.0))
        detail = float(np.mean((fine - coarse)[inner] ** 2))
        # Half of the noise of a demosaiced channel passes a blur of 1 px.
        noise = 0.5 * float(np.mean(image.variance[..., c][inner]))
        grain = (_CONTRAST * float(np.mean(values[inner]))) ** 2
        if detail > 2.0 * noise + grain:
            return True
    return False
