"""How blurred a photograph is, from the sharpest edges in it.

Nothing in a photograph is sharper than lens, pixel and demosaicing let it be, and a mirror sphere
makes everything small: furniture, window frames and shadows end within a fraction of a pixel.
So of all edges that are clean steps, level on both sides, the sharper third is as blurred as the
photograph itself. The rest ends softly by itself, or is a line or a corner.
"""

from __future__ import annotations

import numpy as np

from stages.types import Float

_LEAST = 30  # clean edges; from fewer nothing is concluded
_MOST = 1500  # edges that are looked at, those of most contrast
_SHARPER = 35.0  # percentile of their blur. On simulated spheres within .05 px of what is true.
_ACROSS = np.arange(-4.0, 4.01, 0.5)  # px along an edge's gradient
_LEVEL = 4  # of these at either end, where a clean step is level
_UNEVEN = 0.09  # of the step's height: what still counts as level
_MISFIT = 0.02  # of its height, rms, of a step blurred by a Gaussian


def edge_blur(light: Float, variance: Float) -> float:
    """Standard deviation, px, of the blur; NaN where there are too few edges to tell.

    light     (h, w) of one channel or of several together; NaN where not known
    variance  (h, w) its noise
    """
    import cv2
    from scipy.ndimage import map_coordinates, spline_filter
    from scipy.special import ndtr

    known = np.isfinite(light)
    if not known.any() or min(light.shape) < 12:
        return float("nan")
    filled = np.where(known, light, light[known].max()).astype(np.float32)
    smooth = cv2.GaussianBlur(filled, (0, 0), 0.8, borderType=cv2.BORDER_REPLICATE)
    down, across = np.gradient(smooth)
    steep = np.hypot(across, down)
    noise = float(np.sqrt(np.median(variance[known])))
    steps = known & (steep > 15.0 * noise)
    row, column = np.nonzero(steps)
    towards = np.stack([across[steps], down[steps]], axis=-1) / steep[steps, None]

    def beside(px):
        at = row + px * towards[:, 1], column + px * towards[:, 0]
        return map_coordinates(steep, at, order=1, mode="nearest")

    ridge = (steep[steps] >= beside(-1.0)) & (steep[steps] >= beside(1.0))
    around = cv2.GaussianBlur(np.abs(filled), (0, 0), 2.0)
    contrast = np.where(ridge, steep[steps] / np.maximum(around[steps], 1e-12), 0.0)
    chosen = np.argsort(-contrast)[: min(_MOST, int(ridge.sum()))]
    row, column, towards = row[chosen], column[chosen], towards[chosen]

    at = np.stack(
        [row[:, None] + _ACROSS * towards[:, 1:], column[:, None] + _ACROSS * towards[:, :1]]
    )
    profile = map_coordinates(spline_filter(filled), at, order=3, prefilter=False, mode="nearest")
    whole = map_coordinates(known.astype(np.float32), at, order=1).min(axis=1) > 0.99
    ends = profile[:, :_LEVEL], profile[:, -_LEVEL:]
    low, high = (end.mean(axis=1) for end in ends)
    height = high - low
    uneven = np.maximum(*(np.ptp(end, axis=1) for end in ends))
    clean = whole & (height > 20.0 * noise) & (uneven < _UNEVEN * height)
    if clean.sum() < _LEAST:
        return float("nan")
    unit = ((profile - low[:, None]) / height[:, None])[clean]
    sigma, place = np.arange(0.26, 1.8, 0.02), np.arange(-0.8, 0.81, 0.05)
    model = ndtr((_ACROSS - place[:, None]) / sigma[:, None, None]).reshape(-1, len(_ACROSS))
    cost = np.sum(model**2, axis=1) - 2.0 * unit @ model.T
    least = np.argmin(cost, axis=1)
    square = cost[np.arange(len(unit)), least] + np.sum(unit**2, axis=1)
    fits = square < len(_ACROSS) * _MISFIT**2
    if fits.sum() < _LEAST:
        return float("nan")
    return float(np.percentile(sigma[least[fits] // len(place)], _SHARPER))
