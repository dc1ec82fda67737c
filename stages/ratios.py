"""The light of a bracket's exposures, from what they have in common."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.scale import keeps_to_tags

DARKEST = 0.01  # full scale in the shorter exposure; below, an error of the black level shows
BRIGHTEST = 0.85  # in the longer one
FEWEST, MOST = 50, 50_000  # samples; more than that are thinned, they are sure enough
RATIO_FLOOR = 5e-4  # linearity of a good sensor: no ratio is known better, however many samples

# Prior of a shutter's time about its true nominal value: mechanical shutters scatter by so much.
SHUTTER_SCATTER = 0.03

LINEARITY = 0.002  # share of the signal by which a good sensor's exposures differ unmoved


def log_ratio(
    shorter, longer, block, start: float, noise_shorter, noise_longer
) -> tuple[float, float, NDArray[np.bool_]] | None:
    """log(shorter / longer) of two exposures' light, its standard error, and which blocks do not
    contradict it; None where unknown.

    The ratio of sums over samples that agree is the best estimate under photon noise and, unlike
    a regression on either exposure, not pulled to one side by that exposure's noise. Samples are
    chosen by a mean of both that is independent of their difference where the choice is made,
    in the dark. What moved but little hides in the noise of its samples; it shows in the sums of
    whole blocks.

    shorter, longer  (n,) float32 of the same pixels; NaN where saturated
    block            (n,) which block of the picture a sample is from, the last being of the last
    start            the ratio, nearly
    noise_shorter, noise_longer  gain and read of each
    """
    from stages.overlap import block_sums, overlap

    (gain, read), (longer_gain, longer_read) = noise_shorter, noise_longer
    lean = (gain * DARKEST + start * longer_read**2) / (gain * DARKEST + read**2)
    blocks = int(block[-1]) + 1
    everywhere = np.ones(blocks, np.bool_)
    lit = overlap(shorter, longer, block, everywhere, start, lean, DARKEST, BRIGHTEST, MOST)
    if len(lit) < FEWEST:
        return None
    shorter, longer, block = shorter[lit], longer[lit], block[lit]
    signal = (lean * shorter + longer) * (start / (1 + lean * start))
    few = slice(None, None, 1 + len(lit) // 5000)
    ratio = float(np.median(shorter[few] / longer[few]))
    for _ in range(5):
        slope, offset = gain + ratio * longer_gain, read**2 + (ratio * longer_read) ** 2
        sums, agree = block_sums(shorter, longer, signal, block, ratio, slope, offset, blocks)
        known = sums[1] > 0
        off = (sums[0] - ratio * sums[1]) ** 2 / (sums[2] + (LINEARITY * sums[0]) ** 2 + ~known)
        # Half of the blocks at least are taken for still, whatever the noise was thought to be.
        still = known & (off <= max(9.0, 2 * float(np.median(off[known])) if known.any() else 0))
        short, long, noise2 = sums[:, still].sum(axis=1)
        if agree[still].sum() < FEWEST or short <= 0:
            return None
        ratio = float(short / long)
    error = float(np.hypot(np.sqrt(noise2) / short, RATIO_FLOOR))
    return float(np.log(ratio)), error, still | ~known


def light_from_ratios(ratios, nominal, tagged) -> NDArray[np.float64]:
    """Light (K,) that agrees best with all measured ratios, and on the whole with the tags.

    Least squares in log light: the ratios, each with its error, and every exposure's nominal light
    as a weak prior. All priors weigh the same, so the scale, which no ratio knows,
    is where they are right on average; an exposure with no overlap keeps its nominal light. The
    nominal light is that of the true shutter series or, where the ratios fit them better, of the
    tags to the letter: electronic shutters keep to theirs. What this bracket alone cannot tell
    the others may, see `stages.scale`.
    """
    series, strays = _fit(ratios, np.log(nominal))
    to_the_letter, strays_from_tags = _fit(ratios, np.log(tagged))
    return np.exp(to_the_letter if keeps_to_tags(strays, strays_from_tags) else series)


def _fit(ratios, prior):
    """Log light (K,) and by how much (sum of squares) it strays from its prior (K,)."""
    rows = [np.eye(len(prior)) / SHUTTER_SCATTER]
    values = [prior / SHUTTER_SCATTER]
    for (j, k), (ratio, error, _) in ratios.items():
        row = np.zeros((1, len(prior)))
        row[0, [j, k]] = 1 / error, -1 / error
        rows.append(row)
        values.append([ratio / error])
    log_light = np.linalg.lstsq(np.concatenate(rows), np.concatenate(values), rcond=None)[0]
    return log_light, float(np.sum((log_light - prior) ** 2))
