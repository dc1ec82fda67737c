"""Where each filter's image lies against the first: glass in front of a lens moves the picture.

A plane glass that is not square to the axis shifts it; its thickness, and focusing anew, make it a
little larger or smaller; a filter that is screwed in by hand turns the camera. So a shift, a scale
and a turn are solved.

The filters change colours and brightness, so what is compared is texture: the logarithm of each
channel, less its local mean, over its local spread. Shift, scale and turn then make it match
best, in least squares over the sphere, its rim and what is seen around it, all channels together,
each with the weight its match deserves: what two filters both let through (green, for cyan
and yellow) decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

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
# Scale and turn, in rad, that glass and hand may be expected to make: what is not seen stays small.
_USUAL = 3e-3
LEAST_CORRELATION = 0.3  # correlation; textures that have nothing in common stay below


@dataclass(frozen=True)
class Alignment:
    """Where image k shows what image 0 shows at p:

        about_px + shifts[k] + scales[k] * turned(p - about_px)

    shifts       (F, 2) x, y in px; the first is 0
    correlation  (F,) of the texture in the best channel, after the shift
    error_px     (F,) standard error of a place along x or y, root mean square over the sphere, from
                 how well the image's parts agree
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

    def with_shift(self, shift) -> Alignment:
        """The same for images whose content lies `shift` = (x, y) px further, all of them."""
        x, y = self.about_px
        return replace(self, about_px=(x + float(shift[0]), y + float(shift[1])))

    def _matrix(self, number: int) -> Array | None:
        scale = 1.0 if self.scales is None else float(self.scales[number])
        turn = 0.0 if self.turns_deg is None else np.radians(float(self.turns_deg[number]))
        if scale == 1.0 and turn == 0.0:
            return None
        return np.asarray(scale * _rotation(turn))


def align(images: Sequence[Measured], sphere: Sphere) -> Alignment:
    """Solve for shifts, scales and turns of all images against the first.

    images   one a filter, (H, W, C) each
    sphere   as it is seen in the first
    raises   InputError where an image has no texture in common with the first
    """
    count = len(images)
    shifts, error = np.zeros((count, 2)), np.zeros(count)
    scales, turns = np.ones(count), np.zeros(count)
    correlation = np.ones(count)
    if count > 1:
        part, corner = _about(images[0], sphere)
        first, known = texture(_cut(images[0], part))
        about = np.array(sphere.centre_px) - corner
        for k in range(1, count):
            other, other_known = texture(_cut(images[k], part))
            start = coarse_shift(first, other)
            found = _match(first, known, other, other_known, start, about, sphere.rim_px)
            if not found.correlation > LEAST_CORRELATION:
                raise fault(
                    f"filter {k + 1}'s photograph does not match the first filter's "
                    f"(correlation {found.correlation:.2f})",
                    f"the same view, shifted by at most {REACH_PX} px",
                    "check that camera and sphere stood still between the filters",
                )
            shifts[k], correlation[k], error[k] = found.shift, found.correlation, found.error_px
            scales[k], turns[k] = found.scale, found.turn_deg
    return Alignment(shifts, correlation, error, sphere.centre_px, scales, turns)


def _about(image: Measured, sphere: Sphere) -> tuple[tuple[slice, slice], Array]:
    """The part of the image that holds the sphere and a fifth of its radius around it; its corner
    (x, y)."""
    rim, margin = sphere.outline(), 0.2 * sphere.rim_px + REACH_PX
    height, width = image.valid.shape
    x0, y0 = np.maximum(np.floor(rim.min(axis=0) - margin).astype(int), 0)
    x1, y1 = np.minimum(np.ceil(rim.max(axis=0) + margin).astype(int), (width, height))
    return (slice(y0, y1), slice(x0, x1)), np.array([x0, y0], np.float64)


def _cut(image: Measured, part) -> Measured:
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


def refined_shift(first, known, other, other_known, start: Array) -> tuple[Array, float, float]:
    """The shift alone; also the best channel's correlation and the standard error.

    first, other  (C, h, w), of `texture`, and where they are known (h, w)
    start         (2,) to within a pixel
    """
    found = _match(first, known, other, other_known, start)
    return found.shift, found.correlation, found.error_px


@dataclass(frozen=True)
class _Match:
    """What makes one texture match another: see `Alignment`."""

    shift: Array
    scale: float
    turn_deg: float
    correlation: float
    error_px: float


def _match(
    first, known, other, other_known, start: Array, about: Array | None = None, radius: float = 1.0
) -> _Match:
    """Gauss-Newton for the shift and, where a place is given to turn about, scale and turn.

    about   (2,) x, y px of these images
    radius  px about it, over which the error is told

    Both images' slopes are averaged (second order in the shift), and places that do not match, as
    a highlight clipped in one, lose their weight.
    """
    from scipy.ndimage import map_coordinates, spline_filter

    free = 2 if about is None else 4
    about = np.zeros(2) if about is None else about
    place, scale, turn = start.astype(np.float64), 1.0, 0.0
    slope_x, slope_y = np.gradient(first, axis=2), np.gradient(first, axis=1)
    spline = [spline_filter(c, order=3, output=np.float32) for c in other]
    margin = REACH_PX + 4
    inner = np.zeros(known.shape, bool)
    stride = max(1, round(np.sqrt(known.size / _ENOUGH)))
    inner[margin:-margin:stride, margin:-margin:stride] = True
    row, column = (np.arange(n) * _TILES // n for n in known.shape)
    tile = row[:, None] * _TILES + column
    failed = _Match(place, 1.0, 0.0, 0.0, np.inf)
    for _ in range(12):
        use = np.flatnonzero(inner & known)
        y, x = np.divmod(use, known.shape[1])
        away = np.stack([x + 0.5, y + 0.5], axis=-1) - about
        turned = scale * away @ _rotation(turn).T
        at = (turned + about + place - 0.5).T[::-1]
        seen = map_coordinates(other_known.astype(np.float32), at, order=0) > 0.5
        if seen.sum() < 100:
            return failed
        use, turned, at = use[seen], turned[seen], at[:, seen]
        # What a place does when x, y, scale and turn grow: the last two by a pixel at the radius.
        moves = np.zeros((free, 2, len(use)))
        moves[0, 0] = moves[1, 1] = 1.0
        if free > 2:
            moves[2], moves[3] = turned.T / radius, (turned[:, ::-1] * (-1, 1)).T / radius
        a = first.reshape(len(first), -1)[:, use].astype(np.float64)
        a_x, a_y = (s.reshape(len(first), -1)[:, use] for s in (slope_x, slope_y))
        normal, pulls, correlations = np.zeros((free, free)), np.zeros((free, _TILES**2)), []
        for c in range(len(other)):
            b, right, left, below, above = (
                map_coordinates(spline[c], at + np.array([[dy], [dx]]), order=3, prefilter=False)
                for dy, dx in ((0, 0), (0, 1), (0, -1), (1, 0), (-1, 0))
            )
            weight = np.ones_like(b)
            for _ in range(2):  # robust regression on the first image's channels
                weighted = a * weight
                ridge = 1e-6 * len(b) * np.eye(len(first))
                mix = np.linalg.solve(weighted @ a.T + ridge, weighted @ b)
                residual = b - mix @ a
                spread = 1.4826 * np.median(np.abs(residual)) + 1e-6
                weight = 1.0 / (1.0 + (residual / (2.0 * spread)) ** 2) ** 2
            slope = 0.5 * np.stack(
                [(right - left) / 2 + mix @ a_x, (below - above) / 2 + mix @ a_y]
            )
            change = np.einsum("kin,in->kn", moves, slope)
            weighted = change * (weight / spread**2)
            normal += weighted @ change.T
            pulls -= [np.bincount(tile.ravel()[use], w * residual, _TILES**2) for w in weighted]
            correlations.append(np.sqrt(max(0.0, 1.0 - residual @ residual / (b @ b + 1e-12))))
        if np.linalg.cond(normal[:2, :2]) > 1e8:
            return failed
        pull = pulls.sum(axis=1)
        for k in range(2, free):
            normal[k, k] += 1.0 / (_USUAL * radius) ** 2
            pull[k] -= ((scale - 1.0), turn)[k - 2] / (_USUAL**2 * radius)
        step = np.clip(np.linalg.solve(normal, pull), -1.0, 1.0)
        place = np.clip(place + step[:2], -REACH_PX - 1, REACH_PX + 1)
        if free > 2:
            scale, turn = scale + step[2] / radius, turn + step[3] / radius
        if np.abs(step).max() < 1e-3:
            break
    # How much the tiles disagree, as the sandwich of a robust regression has it: neighbouring
    # residuals are alike, so nothing can be learnt from their number.
    scatter = pulls - pulls.mean(axis=1, keepdims=True)
    inverse = np.linalg.inv(normal)
    variance = np.diag(inverse @ (scatter @ scatter.T) @ inverse)
    # Scale and turn move a place by its distance, whose mean square over a disc is half its own.
    error = np.sqrt(variance[:2].mean() + variance[2:].sum() / 4.0 + _DEMOSAIC**2)
    return _Match(place, float(scale), float(np.degrees(turn)), max(correlations), float(error))


def _rotation(angle_rad: float) -> Array:
    """By an angle from x, to the right, towards y, down."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s], [s, c]])
