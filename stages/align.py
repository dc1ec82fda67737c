"""Where each filter's image lies against the first: glass in front of a lens moves the picture.

The filters change colours and brightness, so what is compared is texture: the logarithm of each
channel, less its local mean, over its local spread. The shift then makes it match best, in least
squares over the sphere and what is seen around it, all channels together, each with the weight
its match deserves: what two filters both let through (green, for cyan and yellow) decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.errors import fault
from stages.mirror import Array, Sphere
from stages.types import Measured

_SMOOTH = 1.0  # px, sigma: below it lies what pixels alias and cubic interpolation gets wrong
_LOCAL = 6.0  # px, sigma of the local mean and spread
REACH_PX = 16  # px, the largest shift that is looked for
_ENOUGH = 2e5  # places compared; of larger images every second or third row and column
_TILES = 8  # along each side: parts that are asked for a shift of their own, for the error
_DEMOSAIC = 0.02  # px, error left in all: what demosaicing makes lies still while images shift
LEAST_CORRELATION = 0.3  # correlation; textures that have nothing in common stay below


@dataclass(frozen=True)
class Alignment:
    """Where image k shows what image 0 shows at p:

        about_px + shifts[k] + scales[k] * turned(p - about_px)

    shifts       (F, 2) x, y in px; the first is 0
    correlation  (F,) of the texture in the best channel, after the shift
    error_px     (F,) standard error of a shift, from how well the image's parts agree on it
    about_px     x, y of the place that neither scale nor turn moves: the sphere's centre
    scales       (F,) magnification against the first; all 1 where left out
    turns_deg    (F,) turn from x, to the right, towards y, down; all 0 where left out
    """

    shifts: Array
    correlation: Array
    error_px: Array
    about_px: tuple[float, float] = (0.0, 0.0)
    scales: Array | None = None
    turns_deg: Array | None = None

    def to_image(self, number: int, pixels) -> Array:
        """Positions (..., 2) px in image `number` of what the first shows at `pixels`."""
        matrix = self._matrix(number)
        about, shift = np.asarray(self.about_px), np.asarray(self.shifts[number])
        if matrix is None:
            return np.asarray(pixels + shift.astype(np.asarray(pixels).dtype))
        return np.asarray((pixels - about) @ matrix.T + (about + shift))

    def to_first(self, number: int, pixels) -> Array:
        """The inverse of `to_image`."""
        matrix = self._matrix(number)
        about, shift = np.asarray(self.about_px), np.asarray(self.shifts[number])
        if matrix is None:
            return np.asarray(pixels - shift)
        return np.asarray((pixels - about - shift) @ np.linalg.inv(matrix).T + about)

    def _matrix(self, number: int) -> Array | None:
        scale = 1.0 if self.scales is None else float(self.scales[number])
        turn = 0.0 if self.turns_deg is None else np.radians(float(self.turns_deg[number]))
        if scale == 1.0 and turn == 0.0:
            return None
        c, s = scale * np.cos(turn), scale * np.sin(turn)
        return np.array([[c, -s], [s, c]])


def align(images: Sequence[Measured], sphere: Sphere) -> Alignment:
    """Solve for the shifts of all images against the first.

    images   one a filter, (H, W, C) each
    sphere   as it is seen in the first
    raises   InputError where an image has no texture in common with the first
    """
    count = len(images)
    shifts, error = np.zeros((count, 2)), np.zeros(count)
    correlation = np.ones(count)
    if count > 1:
        first, known = texture(_about(images[0], sphere))
        for k in range(1, count):
            other, other_known = texture(_about(images[k], sphere))
            start = coarse_shift(first, other)
            shifts[k], correlation[k], error[k] = refined_shift(
                first, known, other, other_known, start
            )
            if not correlation[k] > LEAST_CORRELATION:
                raise fault(
                    f"filter {k + 1}'s photograph does not match the first filter's "
                    f"(correlation {correlation[k]:.2f})",
                    f"the same view, shifted by at most {REACH_PX} px",
                    "check that camera and sphere stood still between the filters",
                )
    return Alignment(shifts, correlation, error)


def _about(image: Measured, sphere: Sphere) -> Measured:
    """The part of the image that holds the sphere and a fifth of its radius around it."""
    rim, margin = sphere.outline(), 0.2 * sphere.rim_px + REACH_PX
    height, width = image.valid.shape
    x0, y0 = np.maximum(np.floor(rim.min(axis=0) - margin).astype(int), 0)
    x1, y1 = np.minimum(np.ceil(rim.max(axis=0) + margin).astype(int), (width, height))
    part = (slice(y0, y1), slice(x0, x1))
    return Measured(image.values[part], image.variance[part], image.valid[part])


def texture(image: Measured) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Locally normalised logarithm (C, h, w) of the image, and where it is known (h, w)."""
    import cv2

    def blur(x, sigma):
        return cv2.GaussianBlur(x, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)

    finite = (image.valid > 0.5) & np.isfinite(image.values).all(axis=-1)
    textures = []
    for c in range(image.values.shape[-1]):
        light = image.values[..., c]
        ceiling = light[finite].max(initial=0.0)
        light = blur(np.where(finite, light, ceiling).astype(np.float32), _SMOOTH)
        noise = np.sqrt(np.median(image.variance[..., c][finite])) if finite.any() else 0.0
        floor = 3.0 * noise + 0.01 * np.median(light) + 1e-12
        log = np.log(np.maximum(light, 0.0) + floor).astype(np.float32)
        detail = log - blur(log, _LOCAL)
        # Where there is nothing but noise, noise is not to be raised to texture.
        spread = np.sqrt(blur(detail * detail, _LOCAL) + 0.02**2)
        textures.append(detail / spread)
    known = blur(finite.astype(np.float32), _LOCAL / 2.0) > 0.99
    return np.stack(textures), known


def coarse_shift(first: NDArray[np.float32], other: NDArray[np.float32]) -> Array:
    """The whole-pixel shift (x, y) of greatest cross-correlation, within the reach."""
    from scipy.fft import irfft2, rfft2

    h, w = first.shape[1:]
    window = np.outer(np.hanning(h), np.hanning(w)).astype(np.float32)
    spectrum = np.conj(rfft2(first * window)) * rfft2(other * window)
    score = irfft2(spectrum, s=(h, w)).sum(axis=0)
    dy, dx = (np.fft.fftfreq(n, 1.0 / n) for n in (h, w))
    score = np.where((np.abs(dy)[:, None] <= REACH_PX) & (np.abs(dx) <= REACH_PX), score, -np.inf)
    row, column = np.unravel_index(np.argmax(score), score.shape)
    return np.array([dx[column], dy[row]])


def _shifted(image: NDArray[np.float32], shift: Array) -> NDArray[np.float32]:
    """The image (h, w) at p + shift, within the reach; Lanczos, three lobes.

    OpenCV's own warps round positions to a 32nd of a pixel, as much as is to be measured.
    """
    import cv2

    taps = np.arange(-REACH_PX - 4, REACH_PX + 5)

    def kernel(s):
        x = taps - s
        weight = np.where(np.abs(x) < 3, np.sinc(x) * np.sinc(x / 3.0), 0.0)
        return weight / weight.sum()

    across, down = kernel(shift[0]), kernel(shift[1])
    moved = cv2.sepFilter2D(image, cv2.CV_32F, across, down, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(moved, np.float32)


def refined_shift(first, known, other, other_known, start: Array) -> tuple[Array, float, float]:
    """Gauss-Newton for the shift; also the best channel's correlation and the standard error.

    Both images' slopes are averaged (second order in the shift), and places that do not match, as
    a highlight clipped in one, lose their weight.
    """
    shift = start.astype(np.float64)
    slope_x, slope_y = np.gradient(first, axis=2), np.gradient(first, axis=1)
    margin = REACH_PX + 4
    eye = np.eye(len(first))
    inner = np.zeros(known.shape, bool)
    stride = max(1, round(np.sqrt(known.size / _ENOUGH)))
    inner[margin:-margin:stride, margin:-margin:stride] = True
    row, column = (np.arange(n) * _TILES // n for n in known.shape)
    tile = row[:, None] * _TILES + column
    for _ in range(10):
        moved = np.stack([_shifted(c, shift) for c in other])
        moved_known = _shifted(other_known.astype(np.float32), np.rint(shift)) > 0.999
        use = inner & known & moved_known
        if use.sum() < 100:
            return shift, 0.0, np.inf
        moved_x, moved_y = np.gradient(moved, axis=2), np.gradient(moved, axis=1)
        a = first[:, use].astype(np.float64)
        normal, pulls, correlations = np.zeros((2, 2)), np.zeros((2, _TILES**2)), []
        for c in range(len(moved)):
            b = moved[c][use].astype(np.float64)
            weight = np.ones_like(b)
            for _ in range(2):  # robust regression on the first image's channels
                weighted = a * weight
                mix = np.linalg.solve(weighted @ a.T + 1e-6 * len(b) * eye, weighted @ b)
                residual = b - mix @ a
                scale = 1.4826 * np.median(np.abs(residual)) + 1e-6
                weight = 1.0 / (1.0 + (residual / (2.0 * scale)) ** 2) ** 2
            slope = 0.5 * np.stack(
                [
                    moved_x[c][use] + np.tensordot(mix, slope_x[:, use], 1),
                    moved_y[c][use] + np.tensordot(mix, slope_y[:, use], 1),
                ]
            )
            weighted = slope * (weight / scale**2)
            normal += weighted @ slope.T
            pulls -= [np.bincount(tile[use], w * residual, _TILES**2) for w in weighted]
            correlations.append(np.sqrt(max(0.0, 1.0 - residual @ residual / (b @ b + 1e-12))))
        if np.linalg.cond(normal) > 1e8:
            return shift, 0.0, np.inf
        step = np.linalg.solve(normal, pulls.sum(axis=1))
        shift = np.clip(shift + np.clip(step, -1.0, 1.0), -REACH_PX - 1, REACH_PX + 1)
        if np.abs(step).max() < 1e-3:
            break
    # How much the tiles disagree, as the sandwich of a robust regression has it: neighbouring
    # residuals are alike, so nothing can be learnt from their number.
    spread = pulls - pulls.mean(axis=1, keepdims=True)
    inverse = np.linalg.inv(normal)
    covariance = inverse @ (spread @ spread.T) @ inverse
    error = float(np.sqrt(np.trace(covariance) / 2.0 + _DEMOSAIC**2))
    return shift, float(max(correlations)), error
