"""Circles inside which a picture is squeezed towards a rim, as a mirror sphere squeezes the world.

What a sphere reflects shrinks along the radius, ever more towards the rim, and hardly along it:
near the rim all edges run along it and all gradients along the radius, whatever the world is like.
Outside there is no such order. This holds for a whole ring of pixels, a fifth of the radius wide,
so that the most cluttered wall around does not hide it, where a rim of one pixel is lost among a
thousand edges. It tells the circle to a few percent of its radius, no better: where the rim is,
`locate` and `measure_rim` find.

Each pixel's gradient votes as an orientation, (cos 2 a, sin 2 a) of its angle a, an axis having no
sign (the structure tensor; Bigun and Granlund 1987, Optimal orientation detection of linear
symmetry). Against the direction from a centre, at an angle p, that is cos 2 (a - p) = 1 where the
gradient is radial, -1 where it is tangential and 0 on average where there is no order. Its mean
over the ring inside a circle, less that over the ring outside, is a correlation, done for all
centres at once by Fourier transform.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SMOOTH = 0.8  # px, sigma of the gradients
_CELLS = 112  # cells along the longer side, in which orientations are averaged
_FINER = 48  # cells to a circle's radius, when it is looked at again
_LEAST_CELLS = 3.0  # a circle's radius
_LEAST_PX = 8.0
_LARGEST = 0.55  # of the longer side: a circle's radius
_STEP = 0.05  # between radii, relative
_RING = (0.2, 0.25)  # of the radius: how wide the rings inside and outside are ...
_FINER_RING = (0.12, 0.12)  # ... and on the second look


@dataclass(frozen=True, eq=False)
class Squeezed:
    """A circle that a sphere's rim may be.

    circle  (3,) x, y, radius in px, to a few percent of the radius
    score   mean order inside less that outside, -2 .. 2, times the root of the radius in cells: by
            how much it exceeds chance
    """

    circle: Array
    score: float


def squeezed_circles(light: Array, count: int = 3) -> list[Squeezed]:
    """The circles inside which the picture is squeezed most, the best first.

    light    (h, w), logarithm of it, finite; some hundred px a side are plenty
    count    how many; they differ from each other, as circles about one sphere may as well
    """
    height, width = light.shape
    longest = max(height, width)
    cell = max(1, -(-longest // _CELLS))
    tensor = _orientations(light)
    least = max(_LEAST_CELLS, _LEAST_PX / cell)
    most = _LARGEST * longest / cell
    if min(height, width) < 2 * cell or most <= least:
        return []
    radii = np.exp(np.arange(np.log(least), np.log(most), _STEP))
    score = _scores(_cells(tensor, cell), radii, _RING)
    found = []
    for _ in range(count):
        k, y, x = (int(i) for i in np.unravel_index(np.argmax(score), score.shape))
        circle = cell * np.array([x + 0.5, y + 0.5, radii[k]])
        found.append(Squeezed(_looked_at_again(tensor, circle), float(score[k, y, x])))
        near = max(2, round(0.15 * radii[k]))
        about = slice(max(0, y - near), y + near + 1), slice(max(0, x - near), x + near + 1)
        score[(slice(max(0, k - 4), k + 5), *about)] = -np.inf
    return found


def _looked_at_again(tensor: Array, circle: Array) -> Array:
    """The best circle (3,) within a tenth of the radius of one, on finer cells."""
    x, y, radius = circle
    cell = max(1, round(radius / _FINER))
    reach = 1.35 * radius
    low = np.maximum([y - reach, x - reach], 0).astype(int)
    part = tensor[:, low[0] : int(y + reach) + 1, low[1] : int(x + reach) + 1]
    radii = radius / cell * np.arange(0.9, 1.08, 0.015)
    score = _scores(_cells(part, cell), radii, _FINER_RING)
    row, column = (np.arange(n) for n in score.shape[1:])
    away = np.hypot((row[:, None] + 0.5) * cell + low[0] - y, (column + 0.5) * cell + low[1] - x)
    score = np.where(away < 0.1 * radius + cell, score, -np.inf)
    k, i, j = (int(n) for n in np.unravel_index(np.argmax(score), score.shape))
    return np.array([(j + 0.5) * cell + low[1], (i + 0.5) * cell + low[0], radii[k] * cell])


def _orientations(light: Array) -> Array:
    """Cosine and sine (2, h, w) of twice the gradients' angles; near 0 where there is little."""
    from scipy.ndimage import gaussian_filter

    down = gaussian_filter(light, _SMOOTH, order=(1, 0))
    across = gaussian_filter(light, _SMOOTH, order=(0, 1))
    square = across**2 + down**2
    # Half of a picture is background or noise: what is weaker than its median says little.
    strong = square + np.median(square) + 1e-12
    return np.stack([across**2 - down**2, 2.0 * across * down]) / strong


def _cells(tensor: Array, cell: int) -> Array:
    """Means over cells of so many px a side."""
    _, height, width = tensor.shape
    h, w = height // cell, width // cell
    whole = tensor[:, : h * cell, : w * cell]
    return np.asarray(whole.reshape(2, h, cell, w, cell).mean(axis=(2, 4)))


def _scores(tensor: Array, radii: Array, rings: tuple[float, float]) -> Array:
    """Scores (R, h, w) of circles of those radii, in cells, about the cells."""
    from scipy.fft import irfft2, next_fast_len, rfft2

    h, w = tensor.shape[1:]
    size = next_fast_len(2 * h), next_fast_len(2 * w)
    y, x = np.fft.fftfreq(size[0], 1.0 / size[0])[:, None], np.fft.fftfreq(size[1], 1.0 / size[1])
    away = np.hypot(x, y)
    square = np.maximum(away, 1e-9) ** 2
    axis = np.stack([(x * x - y * y) / square, 2.0 * x * y / square])
    seen = rfft2(tensor, size)
    scores = np.empty((len(radii), h, w))
    for k, radius in enumerate(radii):
        inner, outer = (1.0 - rings[0]) * radius, (1.0 + rings[1]) * radius
        # Cells count by how much of their width lies in a ring.
        inside = np.clip(radius - away + 0.5, 0, 1) * np.clip(away - inner + 0.5, 0, 1)
        outside = np.clip(outer - away + 0.5, 0, 1) * np.clip(away - radius + 0.5, 0, 1)
        ring = inside / inside.sum() - outside / outside.sum()
        turned = np.sum(seen * np.conj(rfft2(axis * ring, size)), axis=0)
        scores[k] = irfft2(turned, size)[:h, :w] * np.sqrt(radius)
    return scores
