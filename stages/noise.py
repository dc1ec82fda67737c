"""The noise of a developed sample: variance = gain * signal + read^2, in units of full scale.

`gain` is photon noise (one over the electrons at full scale), `read` all that is there without
light: amplifier and quantisation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stages.types import Float

BINS = 24  # of signal, per pair of exposures
SAMPLES = 50_000  # of a pair: each bin's variance is then known to 3 %
NARROWEST = 3.0  # raw steps a bin is wide: within one step samples hardly differ
FEWEST = 100  # differences in a bin, so that its variance is known to 14 %
TYPICAL_READ_STEPS = 2.0


def typical(levels: float) -> tuple[float, float]:
    """(gain, read) where nothing can be measured: one electron a raw step, read noise two steps.

    That is a 14-bit camera at its unity-gain ISO (about 400); at base ISO it overstates photon
    noise by less than two times.

    levels  raw steps between black and saturation
    """
    return 1.0 / levels, TYPICAL_READ_STEPS / levels


def measure(pairs: Sequence[tuple[Float, Float, float]], levels: float) -> tuple[float, float]:
    """(gain, read) of a camera from the same samples in two exposures, several times over.

    pairs   (shorter, longer, ratio): samples (n,) in full scale, none saturated, of the same
            pixels, with the ratio shorter / longer of the exposures' light
    levels  raw steps between black and saturation: the least read noise is that of rounding

    What a pixel is cancels in the difference d = shorter - ratio longer, its sensitivity
    included, and only noise is left: with s the signal in the shorter exposure,
    var(d) = gain s (1 + ratio) + read^2 (1 + ratio^2). So d is binned by s, its robust variance
    taken in each bin, and a line laid through the bins, each weighted by how well it is known.
    Where there are too few differences, or no photon noise in them, the answer is `typical`.
    """
    gain, read = typical(levels)
    for _ in range(2):  # the bins want to know the noise, a little
        binned = [_bins(*pair, levels, gain, read) for pair in pairs]
        signal, ratio, variance, n = np.concatenate([np.empty((0, 4)), *binned]).T
        if len(n) < 3:
            return typical(levels)
        design = np.stack([signal * (1 + ratio), 1 + ratio**2], axis=1)
        expected = variance
        for _ in range(4):  # weights from the line, not from the bins' own scatter about it
            weight = np.sqrt(n / 2) / np.maximum(expected, 1e-3 * variance.max())
            slope, offset = np.linalg.lstsq(
                design * weight[:, None], variance * weight, rcond=None
            )[0]
            expected = design @ (slope, offset)
        if slope <= 0:
            return typical(levels)
        gain, read = float(slope), float(np.sqrt(max(offset, (1 / levels) ** 2 / 12)))
    return gain, read


def _bins(shorter: Float, longer: Float, ratio: float, levels: float, gain: float, read: float):
    """Rows of signal, ratio, variance of the difference, count: (bins, 4) of about equal count.

    The signal is binned by its best estimate from both samples, x_short / v_short +
    x_long / (ratio v_long) to scale: that one alone has no part in the difference's noise. Sorted
    by either sample, or by their sum, each bin would hold a choice of differences.
    """
    thin = 1 + len(shorter) // SAMPLES
    shorter, longer = shorter[::thin].astype(np.float64), longer[::thin].astype(np.float64)
    bins = min(BINS, len(shorter) // FEWEST)
    if bins == 0:
        return np.empty((0, 4))
    difference = shorter - ratio * longer
    roughly = np.maximum(shorter + longer, 0) * (ratio / (1 + ratio))
    share = (gain * roughly + ratio * read**2) / (gain * roughly + read**2)
    signal = (share * shorter + longer) / (share + 1 / ratio)
    edges = _edges(np.quantile(signal, np.linspace(0, 1, bins + 1)), NARROWEST / levels)
    bin_of = np.searchsorted(edges[1:-1], signal, side="right")
    rows = []
    for i in range(len(edges) - 1):
        members = bin_of == i
        if np.count_nonzero(members) >= FEWEST:
            variance, count = _clipped_variance(difference[members], signal[members], 1 / levels)
            rows.append((signal[members].mean(), ratio, variance, count))
    return np.array(rows).reshape(-1, 4)


def _edges(quantiles, narrowest: float) -> list[float]:
    """Of ascending edges those at least so far apart."""
    edges = [quantiles[0]]
    for edge in quantiles[1:]:
        if edge - edges[-1] >= narrowest:
            edges.append(edge)
    return edges if len(edges) > 1 else [quantiles[0], quantiles[-1]]


def _clipped_variance(x, signal, step: float) -> tuple[float, int]:
    """Variance of x about a line in the signal, without what lies 4 sigma off; and how many remain.

    Begun at the shortest interval that holds two fifths of all x, so that even half of them may
    belong to something that moved. The line takes out what a small error of the ratio leaves over
    a wide bin. Not a median of absolute deviations: raw steps can be as wide as the noise, and a
    median sticks to them.

    step  one raw step: the least sigma to begin at
    """
    ordered = np.sort(x)
    widths = ordered[len(x) * 2 // 5 :] - ordered[: len(x) - len(x) * 2 // 5]
    first = int(np.argmin(widths))
    sigma = max(widths[first] / 1.049, step)  # of a normal distribution +-.524 sigma
    kept = np.abs(x - ordered[first] - widths[first] / 2) <= 4 * sigma
    for _ in range(3):
        s = signal - signal[kept].mean()
        slope = np.sum(x[kept] * s[kept]) / max(np.sum(s[kept] ** 2), 1e-30)
        residual = x - slope * s
        residual = residual - residual[kept].mean()
        kept = np.abs(residual) <= max(4 * residual[kept].std(), step)
    return float(residual[kept].var()), int(kept.sum())
