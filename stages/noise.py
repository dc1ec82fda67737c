"""The noise of a developed sample: variance = gain * signal + read^2, in units of full scale.

`gain` is photon noise (one over the electrons at full scale), `read` all that is there without
light: amplifier and quantisation. What pixels differ in response (`prnu`) is no noise between
exposures, as it is the same in each, but an error of what they say together.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages.types import Float

BINS = 24  # of signal, per pair of exposures
SAMPLES = 150_000  # of all pairs; of one at most a third: each bin's variance is known to 3 %
NARROWEST = 3.0  # raw steps a bin is wide: within one step samples hardly differ
FEWEST = 100  # differences in a bin, so that its variance is known to 14 %
TYPICAL_READ_STEPS = 2.0
FAR = 2.0  # times the median of how far bins are off, in sigmas: .67 if they were normal

# Where the pixels' response is told from.
FEWEST_BLOCKS = 40  # plain ones
GRAINIEST = 0.03  # share of the signal that noise may be: it hides a response of a third of it
SMOOTH_DEGREE, SHAPE_DEGREE = 3, 7  # of polynomials; between them lies what only texture does
TEXTURED, PLAIN = 4.0, 2.0  # standard deviations of noise
TEXTURE_SCATTER = 0.7  # share by which blocks stray from their common spectrum of texture
LEAST_TEXTURE, MOST_TEXTURE = 0.05, 0.3  # in the rest, of that in a shape; of 0.3 on it is defects


@dataclass(frozen=True)
class Model:
    """Noise at each of I sensitivities, and what it was measured by: a photon transfer curve.

    gain, read  (I,)
    transfer    (n, 4) a bin a row: sensitivity's index, signal, its sample's variance as seen, and
                by the model. Only of exposures of one sensitivity.
    """

    gain: NDArray[np.float64]
    read: NDArray[np.float64]
    transfer: NDArray[np.float64]


@dataclass(frozen=True)
class Pair:
    """The same pixels in two exposures, none saturated.

    shorter, longer  (n,) full scale
    ratio            shorter / longer of the exposures' light
    of               index of the sensitivity of each
    """

    shorter: Float
    longer: Float
    ratio: float
    of: tuple[int, int] = (0, 0)


def typical(levels: float) -> tuple[float, float]:
    """(gain, read) where nothing can be measured: one electron a raw step, read noise two steps.

    That is a 14-bit camera at its unity-gain ISO (about 400); at base ISO it overstates photon
    noise by less than two times.

    levels  raw steps between black and saturation
    """
    return 1.0 / levels, TYPICAL_READ_STEPS / levels


def measure(
    pairs: Sequence[Pair], levels: float, count: int = 1, start: Model | None = None
) -> Model:
    """The noise of a camera at `count` sensitivities, from pairs of exposures.

    levels  raw steps between black and saturation: the least read noise is that of rounding
    start   what is known already, to tell the signal in a pair by; None: nothing

    What a pixel is cancels in the difference d = shorter - ratio longer, its response
    included, and only noise is left: with s the signal in the shorter exposure,
    var(d) = s (gain_shorter + ratio gain_longer) + read_shorter^2 + ratio^2 read_longer^2. So d is
    binned by s, its robust variance taken in each bin, and the model laid through the bins of all
    pairs, each weighted by how well it is known. A sensitivity for which there are too few
    differences, or no photon noise in them, is `typical`.
    """
    usual = typical(levels)
    most = SAMPLES // max(3, len(pairs))
    gain, read = np.full(count, usual[0]), np.full(count, usual[1])
    if start is not None:
        gain, read = start.gain, start.read
    rows = np.empty((0, 6))
    for _ in range(2 if start is None else 1):  # the bins want to know the noise, a little
        binned = [_bins(pair, most, levels, gain, read) for pair in pairs]
        rows = np.concatenate([np.empty((0, 6)), *binned])
        gain, read = _fitted(rows, levels, count)
    signal, ratio, variance, _, a, b = rows.T
    a, b = a.astype(int), b.astype(int)
    one = a == b
    # Of one sample: with equal noise in both, var(d) = gain s (1 + ratio) + read^2 (1 + ratio^2).
    model = gain[a] * signal * (1 + ratio) + read[a] ** 2 * (1 + ratio**2)
    single = gain[a] * signal + read[a] ** 2
    transfer = np.stack([a, signal, variance * single / model, single], axis=1)[one]
    return Model(gain, read, transfer)


def _fitted(rows, levels: float, count: int):
    """Gain and read (I,) that fit binned variances best."""
    signal, ratio, variance, n, a, b = rows.T
    a, b = a.astype(int), b.astype(int)
    gain, read = (np.full(count, v) for v in typical(levels))
    rounding = (1 / levels) ** 2 / 12
    used = np.flatnonzero(np.bincount(np.concatenate([a, b]), minlength=count) >= 3)
    if len(n) < 3 or not len(used):
        return gain, read
    photons, dark = (np.zeros((len(n), count)) for _ in range(2))
    each = np.arange(len(n))
    for of, s, r in ((a, signal, np.ones_like(ratio)), (b, ratio * signal, ratio**2)):
        photons[each, of] += s
        dark[each, of] += r
    design = np.concatenate([photons[:, used], dark[:, used]], axis=1)
    solved = np.zeros(2 * len(used))
    expected = variance
    for _ in range(8):  # weights from the model, not from the bins' own scatter about it
        weight = np.sqrt(n / 2) / np.maximum(expected, 1e-3 * variance.max())
        off = np.abs(variance - expected) * weight
        # A bin of an edge or of something that moved counts by how usual it is (Huber 1964).
        weight *= np.sqrt(np.minimum(1.0, FAR * max(np.median(off), 0.67) / np.maximum(off, 1e-9)))
        solved = np.linalg.lstsq(design * weight[:, None], variance * weight, rcond=None)[0]
        expected = design @ solved
    slope, offset = solved[: len(used)], solved[len(used) :]
    found = used[slope > 0]
    gain[found] = slope[slope > 0]
    read[found] = np.sqrt(np.maximum(offset[slope > 0], rounding))
    return gain, read


def _bins(pair: Pair, most: int, levels: float, gains, reads):
    """Rows of signal, ratio, variance of the difference, count and both sensitivities: (bins, 6).

    The signal is binned by its best estimate from both samples, x_short / v_short +
    x_long / (ratio v_long) to scale: that one alone has no part in the difference's noise. Sorted
    by either sample, or by their sum, each bin would hold a choice of differences.
    """
    shorter, longer, ratio = pair.shorter, pair.longer, pair.ratio
    thin = 1 + len(shorter) // most
    shorter, longer = shorter[::thin].astype(np.float64), longer[::thin].astype(np.float64)
    bins = min(BINS, len(shorter) // FEWEST)
    if bins == 0:
        return np.empty((0, 6))
    a, b = pair.of
    difference = shorter - ratio * longer
    roughly = np.maximum(shorter + longer, 0) * (ratio / (1 + ratio))
    short_variance = gains[a] * roughly + reads[a] ** 2
    long_variance = gains[b] * roughly * ratio + ratio**2 * reads[b] ** 2  # of ratio * longer
    share = long_variance / (short_variance + long_variance)
    signal = share * shorter + (1 - share) * ratio * longer
    order = np.argsort(signal)
    difference, signal = difference[order], signal[order]
    edges = _edges(np.quantile(signal, np.linspace(0, 1, bins + 1)), NARROWEST / levels)
    rows = []
    ends = [0, *np.searchsorted(signal, edges[1:-1]), len(signal)]
    for members in itertools.starmap(slice, itertools.pairwise(ends)):
        if members.stop - members.start >= FEWEST:
            variance, count = _clipped_variance(difference[members], signal[members], 1 / levels)
            rows.append((signal[members].mean(), ratio, variance, count, a, b))
    return np.array(rows).reshape(-1, 6)


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


def uncertainty(model: Model, of: int = 0) -> tuple[float, float]:
    """Standard deviations of gain and read noise, by how the bins scatter about the model.

    of       index of the sensitivity
    returns  NaN where nothing was measured at it: fewer than three bins, or no photon noise in them
    """
    _, signal, variance, expected = model.transfer[model.transfer[:, 0] == of].T
    if len(signal) < 3:
        return float("nan"), float("nan")
    design = np.stack([signal, np.ones_like(signal)], axis=1) / expected[:, None]
    scatter = np.sum((variance / expected - 1) ** 2) / (len(signal) - 2)
    gain, square = np.sqrt(np.diag(scatter * np.linalg.pinv(design.T @ design)))
    return float(gain), float(square / (2 * model.read[of]))


def response(blocks: Float, noise: Float) -> float | None:
    """The pixels' unequal response (prnu), a share of the signal; None where nothing shows it.

    blocks  (n, b, b) parts of a mosaic of high dynamic range, CFA cells whole; NaN where unknown
    noise   (n, b, b) variance of the noise in them

    A block's logarithm is split into three, independent of one another where noise is normal:
    what anything smooth has (a cubic that the four CFA positions share, and a plane of each), what
    is finer but still a shape (degrees up to SHAPE_DEGREE, shared), and the rest. In the rest is
    the noise, which is known, the response, and a little of the scene's texture. How much of that
    is told by the shapes, which texture fills first and pixels no more than the rest: blocks are
    chosen and set right by those, and not by the rest itself, the least of which would be too
    little. The response is the mean of what remains, each block by how well it is known.
    """
    bases = _Bases.of(blocks.shape[1])
    values = blocks.reshape(len(blocks), -1).astype(np.float64)
    variance = noise.reshape(values.shape)
    known = (values > 0).all(axis=1) & np.isfinite(variance).all(axis=1)  # NaN is not above 0
    values, variance = values[known], variance[known]
    clear = np.mean(variance / values**2, axis=1) < GRAINIEST**2
    if np.count_nonzero(clear) < FEWEST_BLOCKS:
        return None
    logs = np.log(values[clear])
    smooth, shape = logs @ bases.smooth, logs @ bases.shape
    fitted = smooth @ bases.smooth.T + shape @ bases.shape.T
    relative = variance[clear] / np.exp(2 * fitted)  # of the value's estimate, not of itself

    freedom, shapes = bases.left.sum(), bases.shape.shape[1]
    noise_rest = relative @ bases.left / freedom
    noise_shape = relative @ np.sum(bases.shape**2, axis=1) / shapes
    rest = np.sum((logs - fitted) ** 2, axis=1) / freedom - noise_rest
    seen = np.sum(shape**2, axis=1) / shapes - noise_shape

    plainest = np.argsort(seen)[:FEWEST_BLOCKS]
    prnu2 = max(float(np.median(rest[plainest])), 0.0)
    plain = np.zeros(len(seen), np.bool_)
    for _ in range(30):
        texture = seen - prnu2
        spread = np.sqrt(2 / shapes) * (noise_shape + prnu2)
        spread_rest = np.sqrt(2 / freedom) * (noise_rest + prnu2)
        textured, plain = texture > TEXTURED * spread, np.abs(texture) < PLAIN * spread
        share = 0.0
        if np.count_nonzero(textured) >= FEWEST_BLOCKS:
            share = float(np.median((rest[textured] - prnu2) / texture[textured]))
            share = min(max(share, 0.0), MOST_TEXTURE)
        doubt = TEXTURE_SCATTER * max(share, LEAST_TEXTURE) * np.abs(texture)
        variances = spread_rest**2 + (share * spread) ** 2 + doubt**2
        off = rest - share * texture - prnu2
        weight = (off**2 < 16 * variances) / variances
        step = np.sum(weight * off) / max(np.sum(weight), 1e-30)
        before, prnu2 = prnu2, max(prnu2 + float(step), 0.0)
        if abs(prnu2 - before) < 1e-12:
            break
    return None if np.count_nonzero(plain) < FEWEST_BLOCKS else float(np.sqrt(prnu2))


@dataclass(frozen=True)
class _Bases:
    """Orthonormal functions on a block of b x b samples, two to a CFA cell.

    smooth  (b b, k) a cubic, and a plane of each CFA position
    shape   (b b, s) the further polynomials up to SHAPE_DEGREE
    left    (b b,) share of a sample's variance that neither takes
    """

    smooth: NDArray[np.float64]
    shape: NDArray[np.float64]
    left: NDArray[np.float64]

    @classmethod
    def of(cls, size: int) -> _Bases:
        legendre = np.polynomial.legendre.legvander(np.linspace(-1, 1, size), SHAPE_DEGREE)
        y, x = np.indices((size, size))
        planes = [
            ((y % 2 == row) & (x % 2 == column)) * np.outer(legendre[:, i], legendre[:, j])
            for row, column in itertools.product((0, 1), (0, 1))
            for i, j in ((0, 0), (0, 1), (1, 0))
        ]

        def of_degrees(lowest: int, highest: int):
            return [
                np.outer(legendre[:, i], legendre[:, degree - i])
                for degree in range(lowest, highest + 1)
                for i in range(degree + 1)
            ]

        smooth = planes + of_degrees(2, SMOOTH_DEGREE)
        functions = smooth + of_degrees(SMOOTH_DEGREE + 1, SHAPE_DEGREE)
        q = np.linalg.qr(np.stack([f.ravel() for f in functions], axis=1))[0]
        return cls(q[:, : len(smooth)], q[:, len(smooth) :], 1 - np.sum(q**2, axis=1))
