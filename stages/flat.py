"""Flat frames: each pixel's response beside that of those about it, and a mosaic without it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stages.types import Float, Radiance

DEGREE = 4  # of the polynomial in x and y that vignetting and uneven light are laid off by
FITTED = 50_000  # samples it is fitted to
SMOOTH = 8.0  # cells of the CFA: standard deviation of the Gaussian that takes what is left
DEAD = 0.5  # a pixel that strays further from those about it corrects nothing


@dataclass(frozen=True)
class Response:
    """Pixels' response against that of those about them.

    values    (H, W) about 1; NaN where it is not known or the pixel is dead
    residual  standard deviation of what the flat frames leave of it
    """

    values: Float
    residual: float


def response(flat: Radiance) -> Response:
    """Response from photographs, merged, of something even: a wall out of focus, paper, the sky.

    Divided by a smooth fit to each CFA position (a polynomial, as a mean alone would be too bright
    at the edges of a vignetted frame, and a local mean), so that neither the light's unevenness nor
    the lens's vignetting matters, nor is corrected: only what changes from pixel to pixel, and
    small dust. Where the frames are noisier than pixels differ, each pixel's excess is drawn
    towards 0 by the share of noise in it (Wiener), so that few frames do no harm: two at least, as
    one does not tell its noise.
    """
    values, noise = (np.empty_like(flat.mosaic) for _ in range(2))
    for y, x in np.ndindex(2, 2):
        plane, known = flat.mosaic[y::2, x::2], flat.valid[y::2, x::2]
        around = _polynomial(plane, known)
        with np.errstate(divide="ignore", invalid="ignore"):
            around *= _mean(plane / around, known)
            values[y::2, x::2] = np.where(around > 0, plane / around, np.nan)
            noise[y::2, x::2] = flat.variance[y::2, x::2] / around**2
    values[~(np.abs(values - 1) < DEAD)] = np.nan
    # What the merge thought of the pixels' response is no noise of the flat frames.
    known = np.isfinite(values)
    seen = (1.4826 * float(np.median(np.abs(values[known] - 1)))) ** 2
    random = max(float(np.median(noise[known])) - flat.prnu**2, 0.0)
    unequal = max(seen - random, 0.0)
    share = unequal / seen if seen > 0 else 0.0
    return Response(1 + np.float32(share) * (values - 1), float(np.sqrt(unequal * (1 - share))))


def _polynomial(plane: Float, known) -> Float:
    """Least-squares polynomial (h, w) through what is known of a plane."""
    from numpy.polynomial import polynomial

    rows, columns = (np.linspace(-1, 1, n) for n in plane.shape)
    y, x = (i[:: 1 + known.sum() // FITTED] for i in np.nonzero(known))
    terms = polynomial.polyvander2d(rows[y], columns[x], (DEGREE, DEGREE))
    fitted = np.linalg.lstsq(terms, plane[y, x].astype(np.float64), rcond=None)[0]
    fitted = fitted.reshape(DEGREE + 1, DEGREE + 1)
    return polynomial.polygrid2d(rows, columns, fitted).astype(np.float32)


def _mean(plane: Float, known) -> Float:
    """Local mean (h, w) of what is known of a plane."""
    import cv2

    sums = [
        cv2.GaussianBlur(v.astype(np.float32), (0, 0), SMOOTH, borderType=cv2.BORDER_REFLECT)
        for v in (np.where(known, plane, 0), known)
    ]
    return np.divide(*sums, dtype=np.float32)


def flatten(radiance: Radiance, of: Response) -> Radiance:
    """A merged bracket with each pixel's own response divided out.

    What is left of it, `of.residual`, takes the place of `prnu` in the variance. Dead pixels
    become defective.
    """
    assert of.values.shape == radiance.mosaic.shape, "flat frames of another size"
    dead = np.isnan(of.values) & radiance.valid
    mosaic = radiance.mosaic / of.values
    noise = radiance.variance - np.float32(radiance.prnu**2) * radiance.mosaic**2
    # Rounding may leave less than nothing where prnu is nearly all of the variance.
    noise = np.maximum(noise, np.float32(1e-3) * radiance.variance)
    variance = noise / of.values**2 + np.float32(of.residual**2) * mosaic**2
    return replace(
        radiance.with_defects(dead),
        mosaic=mosaic,
        variance=variance,
        prnu=of.residual,
    )
