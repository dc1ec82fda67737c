"""One HDR mosaic to three colours at every pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.types import Float, Measured, Radiance

TILE = 128  # rows at a time, even; what is in work stays in the processor's cache
HALO = 4  # rows and columns a tile sees beyond itself, even so that the CFA keeps its phase
BELIEVE = 4.0  # a difference counts as structure when its square exceeds so many variances of it

# The eight next samples of a CFA position, and the pixels beside one.
_SAME = [(y, x) for y in (-2, 0, 2) for x in (-2, 0, 2) if y or x]
_BESIDE = [(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if y or x]
_GREEN = 1


def demosaic(radiance: Radiance) -> Measured:
    """Red, green and blue (H, W, 3) at every pixel of a merged mosaic, with variance.

    Green first, along the direction in which it and the pixel's own colour change less
    (Hamilton and Adams 1997, US 5 629 734), then red and blue as their neighbours' mean by
    likeness in green, moved by the difference in green. Three things are made for HDR: every value
    is held within the range of the samples of its colour beside it, so that nothing rings or
    fringes about a lamp; a difference counts only as far as it exceeds its noise, so that
    flat parts become plain means; and all is odd in the signal's sign, so noise around
    black keeps its mean. No logarithm, no ratio of samples.

    Defective pixels get the mean of the samples of their colour about them. A pixel is valid when
    no other sample in its 3 x 3 is unknown: all three colours are then there. That is what
    keeps the rims of clipped lamps from turning magenta.

    variance  that of the weighted means with the weights used, taken as if these did not depend on
              the noise and samples were independent; neighbouring pixels share samples
    """
    mosaic, variance, known = _filled(radiance)
    gains = _balance(mosaic, known, radiance.cfa)
    height, width = mosaic.shape
    values = np.empty((height, width, 3), np.float32)
    variances = np.empty((height, width, 3), np.float32)

    pad_right = HALO + width % 2  # whole CFA cells
    pad_bottom = HALO + height % 2
    around = ((HALO, pad_bottom), (HALO, pad_right))
    mosaic, variance = (np.pad(a, around, mode="reflect") for a in (mosaic, variance))
    for top in range(0, height, TILE):
        rows = slice(top, min(top + TILE + 2 * HALO, len(mosaic)))
        tile, tile_variance = _tile(mosaic[rows], variance[rows], radiance.cfa, gains)
        bottom = min(top + TILE, height)
        values[top:bottom] = tile[: bottom - top, :width]
        variances[top:bottom] = tile_variance[: bottom - top, :width]

    known = np.pad(known, 1, mode="reflect")
    valid = known[1:-1, 1:-1].copy()
    for y, x in _BESIDE:
        valid &= known[1 + y : 1 + y + height, 1 + x : 1 + x + width]
    values[~valid] = np.nan
    variances[~valid] = np.nan
    return Measured(values=values, variance=variances, valid=valid.astype(np.float32))


def _filled(radiance: Radiance) -> tuple[Float, Float, NDArray[np.bool_]]:
    """Mosaic and variance without gaps, and which samples are known or stood in for.

    A defective sample gets the mean of the known ones next to it of its CFA position; its variance
    is the mean's plus their spread, which says how much the true one may differ. A lost one was
    brighter than all it stands among and gets the brightest of them: still too little,
    but it serves only as a far neighbour of pixels that are valid.
    """
    mosaic, variance = radiance.mosaic.copy(), radiance.variance.copy()
    known = radiance.valid.copy()
    row, column = np.nonzero(~radiance.valid)
    if not len(row):
        return mosaic, variance, known
    around = np.array([(row + dy, column + dx) for dy, dx in _SAME])  # (8, 2, n)
    size = np.array(mosaic.shape)[:, None]
    inside = np.all((around >= 0) & (around < size), axis=1)
    y, x = np.where(inside[:, None], around, 0).swapaxes(0, 1)
    use = inside & radiance.valid[y, x]
    values = np.where(use, mosaic[y, x], 0)
    n = use.sum(axis=0)
    mean = values.sum(axis=0) / np.maximum(n, 1)
    spread = np.sum(use * (values - mean) ** 2, axis=0) / np.maximum(n - 1, 1)
    noise = np.where(use, variance[y, x], 0).sum(axis=0) / np.maximum(n, 1) ** 2
    defective = radiance.defective[row, column]
    mosaic[row, column] = np.where(defective, mean, values.max(axis=0))
    variance[row, column] = noise + spread
    known[row, column] = defective & (n >= 3)
    return mosaic, variance, known


def _balance(mosaic: Float, known, cfa) -> NDArray[np.float32]:
    """Factors (3,) that bring the colours to green's level: differences between them mean shape.

    One constant a colour, the median over the brighter half of the wholly known CFA cells; 1 where
    there is no signal.
    """
    step = 2 * max(1, int(np.sqrt(mosaic.size / 4e6)))
    rows, columns = (n // 2 * 2 for n in mosaic.shape)
    cells = {(y, x): (slice(y, rows, step), slice(x, columns, step)) for y, x in np.ndindex(2, 2)}
    whole = np.all([known[at] for at in cells.values()], axis=0)
    planes = {at: mosaic[cells[at]][whole] for at in cells}
    green = np.mean([planes[at] for at in cells if cfa[at] == _GREEN], axis=0)
    gains = np.ones(3, np.float32)
    if green.size and np.median(green) > 0:
        bright = green >= np.median(green)
        for at in cells:
            level = np.median(planes[at][bright] / green[bright])
            if cfa[at] != _GREEN and level > 0:
                gains[cfa[at]] = np.clip(1 / level, 1 / 32, 32)
    return gains


def _tile(mosaic: Float, variance: Float, cfa, gains) -> tuple[Float, Float]:
    """Colours (h, w, 3) and variances of a padded tile's inside, halo off."""
    height, width = mosaic.shape
    green, green_variance = mosaic.copy(), variance.copy()
    for y, x in np.argwhere(cfa != _GREEN):
        at = _Sites(y, x, 2, height, width)
        green[at()], green_variance[at()] = _green(mosaic, variance, at, gains[cfa[y, x]])

    out = np.empty((height, width, 3), np.float32)
    out_variance = np.empty_like(out)
    out[..., _GREEN], out_variance[..., _GREEN] = green, green_variance
    for y, x in np.ndindex(2, 2):
        at = _Sites(y, x, HALO, height, width)
        for colour in (0, 2):
            if cfa[y, x] == colour:
                value, var = mosaic[at()], variance[at()]
            else:
                there = [
                    at(dy, dx) for dy, dx in _BESIDE if cfa[(y + dy) % 2, (x + dx) % 2] == colour
                ]
                value, var = _by_green(
                    mosaic, variance, green, green_variance, at(), there, 1 / gains[colour]
                )
            out[(*at(), colour)], out_variance[(*at(), colour)] = value, var
    inside = slice(HALO, -HALO)
    return out[inside, inside], out_variance[inside, inside]


class _Sites:
    """The sites of one CFA position (y, x) of a padded tile, or their neighbours at an offset."""

    def __init__(self, y: int, x: int, margin: int, height: int, width: int):
        self.corner = y + margin, x + margin
        self.end = height - margin, width - margin

    def __call__(self, dy: int = 0, dx: int = 0) -> tuple[slice, slice]:
        (top, left), (bottom, right) = self.corner, self.end
        return slice(top + dy, bottom + dy, 2), slice(left + dx, right + dx, 2)


def _green(mosaic: Float, variance: Float, at: _Sites, gain) -> tuple[Float, Float]:
    """Green and its variance at red or blue sites: two directions, weighted by their flatness.

    gain  of the sites' own colour to green; how the own colour bends along a direction says
          how green does
    """
    estimates = []
    for dy, dx in ((0, 1), (1, 0)):
        before, after = at(-dy, -dx), at(dy, dx)
        far = at(-2 * dy, -2 * dx), at(2 * dy, 2 * dx)
        a, b = mosaic[before], mosaic[after]
        mean_variance = (variance[before] + variance[after]) / 4
        bend = gain * (mosaic[at()] / 2 - (mosaic[far[0]] + mosaic[far[1]]) / 4)
        bend_variance = gain**2 * (variance[at()] / 4 + (variance[far[0]] + variance[far[1]]) / 16)
        believed = _believed(bend, bend_variance)
        low, high = np.minimum(a, b), np.maximum(a, b)
        value = np.clip((a + b) / 2 + believed * bend, low, high)
        steep = high - low + 2 * np.abs(bend)
        steep_variance = 4 * (mean_variance + bend_variance)
        weight = 1 / (steep * steep + 2 * BELIEVE * steep_variance + _TINY)
        estimates.append((value, mean_variance + believed**2 * bend_variance, weight))
    (across, across_variance, w), (down, down_variance, v) = estimates
    share = v / (v + w)
    value = across + share * (down - across)
    return value, (1 - share) ** 2 * across_variance + share**2 * down_variance


def _by_green(mosaic, variance, green, green_variance, here, there, gain) -> tuple[Float, Float]:
    """Red or blue at sites of another colour, and its variance.

    here   the sites
    there  where that colour's samples are: two beside each site, or four at its corners
    gain   of green to that colour
    """
    weights = []
    for p in there:
        unlike_variance = green_variance[p] + green_variance[here]
        weights.append(1 / ((green[p] - green[here]) ** 2 + 2 * BELIEVE * unlike_variance + _TINY))
    scale = 1 / sum(weights)
    mean = shift = mean_variance = shift_variance = 0
    low, high = np.inf, -np.inf
    for p, weight in zip(there, weights, strict=True):
        share = weight * scale
        mean = mean + share * mosaic[p]
        shift = shift + share * (green[here] - green[p])
        mean_variance = mean_variance + share**2 * variance[p]
        shift_variance = shift_variance + share**2 * green_variance[p]
        low, high = np.minimum(low, mosaic[p]), np.maximum(high, mosaic[p])
    shift, shift_variance = gain * shift, gain**2 * (shift_variance + green_variance[here])
    believed = _believed(shift, shift_variance)
    return (
        np.clip(mean + believed * shift, low, high),
        mean_variance + believed**2 * shift_variance,
    )


_TINY = 1e-30  # where there is neither difference nor noise


def _believed(difference, variance):
    """Share 0..1 of a difference that is structure, not noise; even in its sign."""
    square = difference * difference
    return square / (square + BELIEVE * variance + _TINY)
