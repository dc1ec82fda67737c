"""A bracket to one HDR mosaic."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.errors import fault
from stages import noise
from stages.types import Exposure, Float, Radiance

SAMPLED = 1_000_000  # samples of each exposure that ratios and noise are solved from
TILE = 64  # rows at a time, so that the sums stay in the processor's cache

# Overlaps of exposures.
DARKEST = 0.01  # full scale in the shorter exposure; below, an error of the black level shows
BRIGHTEST = 0.9  # in the longer one
FEWEST, MOST = 50, 200_000  # samples; more than that are thinned, they are sure enough
RATIO_FLOOR = 5e-4  # linearity of a good sensor: no ratio is known better, however many samples

# Prior of a shutter's time about its true nominal value: mechanical shutters scatter by so much.
SHUTTER_SCATTER = 0.03

# Defective pixels.
OUTLIER_SIGMAS = 8.0  # one in 1e15 of a normal distribution
OUTLIER_RANGES = 2.0  # times the range of the neighbours beyond their extremes
GLINT_SHARE = 0.1  # what the lens spreads of a point of light onto the next pixels, at least


def merge(bracket: Iterable[Exposure]) -> Radiance:
    """A bracket as one mosaic: the weighted mean of all that did not saturate, per unit of light.

    bracket  exposures of one scene by one camera, any order; iterated twice, one exposure at
             a time, so that it may read its files as it goes

    The first pass takes a coarse mean, and of a subset of samples solves the exposures' ratios
    and the noise. The second takes the mean with inverse variances as weights,
    t^2 / (gain t L + read^2), with L from the first: a weight of the sample's own noisy value
    would prefer samples that came out low. What saturated has no part; nor has a sample with
    a saturated neighbour of its colour, as it may itself have stayed below only by chance (the
    shortest exposure is spared: there is none to turn to). `variance` is that of the noise alone;
    an error of a ratio or of the black level is not in it. Movement is not looked for.
    """
    first = _survey(bracket)
    solved, model = _solve(first)
    gain, read = (np.float32(v) for v in model)
    if first.brightest < max(5 * model[1], 0.002):
        raise fault(
            f"the bracket is black: its brightest signal is {first.brightest:.2g} of full scale",
            "",
            "expose longer, or take off the lens cap",
        )
    shortest = int(np.argmin(solved))
    weighted = np.zeros_like(first.mean)
    weight = np.zeros_like(first.mean)
    for k, exposure in enumerate(bracket):
        t = np.float32(solved[k])
        counts = exposure.usable if k == shortest else _clear_of_saturation(exposure.usable)
        for rows in _tiles(len(weight)):
            w = counts[rows] * (t / (gain * t * np.maximum(first.mean[rows], 0) + read * read))
            weighted[rows] += w * exposure.mosaic[rows]
            weight[rows] += w * t
    lost = weight == 0
    if lost.mean() > 0.99:
        raise fault(
            f"{lost.mean():.1%} of the samples saturate in every exposure",
            "",
            "add shorter exposures",
        )
    weight[lost] = np.nan
    mosaic = np.divide(weighted, weight, out=weighted)
    variance = np.divide(1, weight, out=weight)
    defective = _defective(mosaic, variance)
    mosaic[defective] = np.nan
    variance[defective] = np.nan
    return Radiance(
        mosaic=mosaic,
        variance=variance,
        valid=~(lost | defective),
        defective=defective,
        cfa=first.cfa,
        tagged=first.tagged,
        solved=tuple(float(t) for t in solved),
        noise=model,
        clipped=first.clipped,
        lost=float(lost.mean()),
    )


def true_shutter(tag_s: float) -> float:
    """The time a camera aims at where its tag says `tag_s`, seconds.

    Tags are rounded for people: shutters run in thirds or halves of a stop from one second, so
    1/60 stands for 1/64 and 0.3 for 2^(-5/3). A tag that is not a customary name is kept.
    """
    thirds, halves = (np.abs(names / tag_s - 1).min() < 0.002 for names in (_THIRDS, _HALVES))
    if thirds or halves:
        steps = 3 if thirds else 2  # a name of both, as 1/60, is the same power in both
        return float(2.0 ** (np.round(steps * np.log2(tag_s)) / steps))
    return tag_s


# fmt: off
_THIRDS = np.array([
    *(1 / d for d in (
        32000, 25000, 20000, 16000, 12800, 12500, 10000, 8000, 6400, 5000, 4000, 3200, 2500, 2000,
        1600, 1250, 1000, 800, 640, 500, 400, 320, 250, 200, 160, 125, 100, 80, 60, 50, 40, 30, 25,
        20, 15, 13, 10, 8, 6, 5, 4, 3, 2.5, 1.6, 1.3)),
    0.3, 0.4, 0.5, 0.6, 0.8, 1, 1.3, 1.6, 2, 2.5, 3, 3.2, 4, 5, 6, 8, 10, 13, 15, 20, 25, 30,
])
_HALVES = np.array([
    *(1 / d for d in (24000, 12000, 6000, 3000, 1500, 750, 350, 180, 90, 45, 1.5)),
    0.7, 1.5, 12, 24,
])
# fmt: on


@dataclass(frozen=True)
class _Survey:
    """What the first pass over a bracket of K exposures gathers.

    mean       (H, W) of the usable samples per unit of nominal light; 0 where there are none
    samples    (K, n) of the same pixels in every exposure; NaN where saturated
    tagged     (K,) light
    nominal    (K,) light with the shutter's true nominal time
    clipped    (K,) share of samples that saturated
    levels     raw steps of full scale
    brightest  the highest of the exposures' 99.9th percentiles, of full scale
    """

    mean: Float
    cfa: NDArray[np.int_]
    samples: Float
    tagged: tuple[float, ...]
    nominal: tuple[float, ...]
    clipped: tuple[float, ...]
    levels: float
    brightest: float


def _survey(bracket: Iterable[Exposure]) -> _Survey:
    samples: list[Float] = []
    tagged, nominal, clipped, brightest = [], [], [], []
    total = light = np.empty((0, 0), np.float32)
    for exposure in bracket:
        mosaic, usable = exposure.mosaic, exposure.usable
        if not samples:
            total, light = np.zeros_like(mosaic), np.zeros_like(mosaic)
            cfa, levels = exposure.cfa, exposure.levels
            step = int(np.sqrt(mosaic.size / SAMPLED)) // 2 * 2 + 1  # odd: all CFA positions
        assert mosaic.shape == total.shape, "exposures of different sizes"
        assert np.array_equal(exposure.cfa, cfa), "exposures of different CFA"
        tagged.append(exposure.light)
        nominal.append(exposure.light * true_shutter(exposure.time_s) / exposure.time_s)
        clipped.append(1 - float(np.count_nonzero(usable)) / usable.size)
        for rows in _tiles(len(mosaic)):
            total[rows] += mosaic[rows] * usable[rows]
            light[rows] += np.float32(nominal[-1]) * usable[rows]
        some = mosaic[::step, ::step].ravel()
        brightest.append(float(np.percentile(some, 99.9)))
        samples.append(np.where(usable[::step, ::step].ravel(), some, np.float32(np.nan)))
    assert samples, "a bracket without exposures"
    return _Survey(
        mean=np.divide(total, light, out=total, where=light > 0),
        cfa=cfa,
        samples=np.array(samples),
        tagged=tuple(tagged),
        nominal=tuple(nominal),
        clipped=tuple(clipped),
        levels=levels,
        brightest=max(brightest),
    )


def _solve(survey: _Survey) -> tuple[NDArray[np.float64], tuple[float, float]]:
    """The light (K,) of each exposure and the noise model, from what exposures have in common."""
    order = np.argsort(survey.nominal, kind="stable")
    pairs = [  # (shorter, longer): neighbours and the next but one
        (order[i], order[j])
        for i in range(len(order))
        for j in range(i + 1, min(i + 3, len(order)))
    ]
    overlaps = {}
    for j, k in pairs:
        both = survey.samples[k] < BRIGHTEST  # false for NaN
        both &= survey.samples[j] < BRIGHTEST
        overlaps[j, k] = survey.samples[j][both], survey.samples[k][both]

    light = np.array(survey.nominal)
    model = noise.typical(survey.levels)
    for _ in range(2):  # ratios want the noise to tell outliers, noise wants the ratios
        ratios = {
            pair: ratio
            for pair, (shorter, longer) in overlaps.items()
            if (ratio := _log_ratio(shorter, longer, light[pair[0]] / light[pair[1]], model))
        }
        light = _light_from_ratios(ratios, survey)
        model = noise.measure(
            [(*overlaps[j, k], light[j] / light[k]) for j, k in ratios], survey.levels
        )
    return light, model


def _log_ratio(shorter, longer, start: float, model) -> tuple[float, float] | None:
    """log(shorter / longer) of two exposures' light and its standard error; None where unknown.

    The ratio of sums over samples that agree is the best estimate under photon noise and, unlike
    a regression on either exposure, not pulled to one side by that exposure's noise. Samples are
    chosen by the sum of both, which is (nearly) independent of their difference.
    """
    gain, read = model
    signal = (shorter + longer) * (start / (1 + start))
    lit = np.flatnonzero(signal > DARKEST)
    if len(lit) < FEWEST:
        return None
    lit = lit[:: 1 + len(lit) // MOST]
    shorter, longer, signal = shorter[lit], longer[lit], signal[lit]
    ratio = float(np.median(shorter / longer))
    for _ in range(4):
        sigma = np.sqrt(gain * signal * (1 + ratio) + read**2 * (1 + ratio**2))
        agree = np.abs(shorter - np.float32(ratio) * longer) < 4 * sigma
        if np.count_nonzero(agree) < FEWEST:
            return None
        total = shorter[agree].sum(dtype=np.float64)
        ratio = total / longer[agree].sum(dtype=np.float64)
        if not ratio > 0:
            return None
    error = np.sqrt(np.sum(sigma[agree] ** 2, dtype=np.float64)) / total
    return float(np.log(ratio)), float(np.hypot(error, RATIO_FLOOR))


def _light_from_ratios(ratios, survey: _Survey) -> NDArray[np.float64]:
    """Light (K,) that agrees best with all measured ratios, and on the whole with the tags.

    Least squares in log light: the ratios, each with its error, and every exposure's nominal light
    as a weak prior. All priors weigh the same, so the scale, which no ratio knows,
    is where they are right on average; an exposure with no overlap keeps its nominal light. The
    nominal light is that of the true shutter series or, where the ratios fit them better, of the
    tags to the letter: electronic shutters keep to theirs.
    """
    series, strays = _fit(ratios, np.log(survey.nominal))
    to_the_letter, strays_from_tags = _fit(ratios, np.log(survey.tagged))
    clearly_better = strays_from_tags + 1e-6 < strays / 2
    return np.exp(to_the_letter if clearly_better else series)


def _fit(ratios, prior):
    """Log light (K,) and by how much (sum of squares) it strays from its prior (K,)."""
    rows = [np.eye(len(prior)) / SHUTTER_SCATTER]
    values = [prior / SHUTTER_SCATTER]
    for (j, k), (ratio, error) in ratios.items():
        row = np.zeros((1, len(prior)))
        row[0, [j, k]] = 1 / error, -1 / error
        rows.append(row)
        values.append([ratio / error])
    log_light = np.linalg.lstsq(np.concatenate(rows), np.concatenate(values), rcond=None)[0]
    return log_light, float(np.sum((log_light - prior) ** 2))


def _clear_of_saturation(usable) -> NDArray[np.bool_]:
    """Usable samples (H, W) with no saturated one among the eight next of their CFA position."""
    import cv2

    clear = np.empty_like(usable)
    for y in range(2):
        for x in range(2):
            plane = np.ascontiguousarray(usable[y::2, x::2]).view(np.uint8)
            clear[y::2, x::2] = cv2.erode(plane, np.ones((3, 3), np.uint8)).view(np.bool_)
    return clear


def _defective(mosaic: Float, variance: Float) -> NDArray[np.bool_]:
    """Pixels (H, W) that stand out alone: hot ones, with their own dark current, and dead ones.

    A hot pixel adds the same signal per second in every exposure, so it shows only beside its
    neighbours: it lies far outside the range of the eight next of its CFA position, by its noise
    and by that range, and no pixel next to it stands out in its own colour, as those do
    about a glint, which the lens spreads. Pixels beside lost ones or the frame's edge are not
    judged: what is not known counts as infinitely bright. Two hot ones side by side escape.
    """
    import cv2

    around = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], np.uint8)
    excess = np.zeros_like(mosaic)  # over the neighbours' mean
    candidate = np.zeros(mosaic.shape, np.bool_)
    for y, x in np.ndindex(2, 2):
        plane = np.ascontiguousarray(mosaic[y::2, x::2])
        plane[~np.isfinite(plane)] = np.inf
        high = cv2.dilate(plane, around, borderType=cv2.BORDER_CONSTANT, borderValue=np.inf)
        low = cv2.erode(plane, around)
        judged = np.isfinite(plane) & np.isfinite(high)
        plane[~judged], high[~judged], low[~judged] = 0, 0, 0
        out = plane - np.clip(plane, low, high)  # beyond the neighbours' range, signed
        candidate[y::2, x::2] = (out * out > OUTLIER_SIGMAS**2 * variance[y::2, x::2]) & (
            np.abs(out) > OUTLIER_RANGES * (high - low)
        )
        mean = cv2.filter2D(plane, -1, around / np.float32(8))
        excess[y::2, x::2] = np.where(judged, plane - mean, 0)
    row, column = np.nonzero(candidate)
    own = excess[row, column]
    excess, variance = np.pad(excess, 1), np.pad(variance, 1, constant_values=np.inf)
    glint = np.zeros(len(row), np.bool_)
    for dy, dx in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        beside = row + 1 + dy, column + 1 + dx
        real = excess[beside] ** 2 > 16 * variance[beside]
        glint |= real & (excess[beside] / own > GLINT_SHARE)
    defective = np.zeros_like(candidate)
    defective[row, column] = ~glint
    return defective


def _tiles(height: int):
    return (slice(top, top + TILE) for top in range(0, height, TILE))
