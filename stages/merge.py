"""A bracket to one HDR mosaic."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from calibration.errors import fault
from stages import noise
from stages.develop import develop, pile_up, usable_below
from stages.scale import keeps_to_tags
from stages.types import Exposure, Float, Frame, Radiance

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)

# What ratios and noise are solved from: blocks of each exposure, side by side.
BLOCK = 16  # px, whole CFA cells
SAMPLED = 300_000  # samples, unless the photograph is smaller

# Overlaps of exposures.
DARKEST = 0.01  # full scale in the shorter exposure; below, an error of the black level shows
BRIGHTEST = 0.85  # in the longer one
FEWEST, MOST = 50, 50_000  # samples; more than that are thinned, they are sure enough
REACH = 2  # an exposure is compared with so many next longer ones
RATIO_FLOOR = 5e-4  # linearity of a good sensor: no ratio is known better, however many samples

# Prior of a shutter's time about its true nominal value: mechanical shutters scatter by so much.
SHUTTER_SCATTER = 0.03

# The noise of a sample is told from its signal's estimate, up to so many sigmas from that of the
# pixels about it: an estimate of the sample's own noisy value would make the weights follow it.
OWN_SIGNAL = 20.0

# An exposure of less than this share of the light of longer ones, none of them saturated, is left
# out where it says nothing else than they: it would lessen the variance by no more than that.
NEGLIGIBLE = 0.02

# Movement.
CONTRADICTION = 1e-6  # chance that noise alone gives the chi-square of 3 x 3 pixels
DISAGREEMENT = 1e-4  # that it lets two exposures differ so much there
AGREEMENT = 4.0  # sigmas between two samples
LINEARITY = 0.002  # share of the signal by which a good sensor's exposures differ unmoved
WORTH_A_WARNING = 0.001  # share of the pixels

# Defective pixels.
OUTLIER_SIGMAS = 8.0  # one in 1e15 of a normal distribution
OUTLIER_RANGES = 2.5  # times the range of the neighbours beyond their extremes
GLINT_SHARE = 0.1  # what the lens spreads of a point of light onto the next pixels, at least

# A tile's signals of all exposures stay in a core's own cache.
TILE_BYTES = 1_000_000
HALO = 2  # rows and columns a tile sees beyond itself: those of its CFA neighbours


class Decoded(Protocol[T_co]):
    """Exposures that have been decoded once and can be read again, a few rows at a time.

    seen  what was made of each frame while it was there
    """

    @property
    def seen(self) -> Sequence[T_co]: ...

    def rows(self, top: int, bottom: int) -> NDArray[np.uint16]:
        """Raw samples (K, bottom - top, W) of all exposures; called from several threads."""


class Bracket(Protocol):
    """Photographs of one scene by one camera, any order, wherever they are kept."""

    def decoded(self, look: Callable[[Frame], T]) -> AbstractContextManager[Decoded[T]]:
        """Decodes each frame once, looks at it, and keeps its samples for `rows`.

        look  is called from several threads; must not keep the frame's samples
        """


@dataclass(frozen=True)
class InMemory:
    """A bracket of frames that are in memory anyway."""

    frames: Sequence[Frame]

    def decoded(self, look: Callable[[Frame], T]) -> AbstractContextManager[Decoded[T]]:
        return nullcontext(_InMemory([look(frame) for frame in self.frames], self.frames))


@dataclass(frozen=True)
class _InMemory:
    seen: Sequence
    frames: Sequence[Frame]

    def rows(self, top: int, bottom: int) -> NDArray[np.uint16]:
        return np.stack([frame.samples[top:bottom] for frame in self.frames])


@dataclass(frozen=True)
class Known:
    """What is known of the camera beforehand, in place of what the data say.

    noise             gain, read and prnu (None: from the data) at an ISO
    saturation_level  raw value from which on samples saturate
    """

    noise: Mapping[float, tuple[float, float, float | None]] = field(default_factory=dict)
    saturation_level: float | None = None


def merge(bracket: Bracket, known: Known | None = None) -> Radiance:
    """A bracket as one mosaic: the weighted mean of all that did not saturate, per unit of light.

    Each photograph is decoded once. Of blocks of its samples the exposures' ratios and the noise
    are solved. Then the photographs are read again, all together, a few rows at a time, so that
    memory does not grow with their number: of a pixel's samples s in exposures of light t the mean
    is taken with inverse variances as weights, sum(t s / v) / sum(t^2 / v) with
    v = gain t L + read^2: the maximum-likelihood estimate, whose variance 1 / sum(t^2 / v) is the
    Cramer-Rao bound. L comes from the plain mean sum(s) / sum(t) and, where that is little more
    than noise, from the pixels about (`_signal`): weights of the sample's own noise would prefer
    samples that came out low.

    What saturated has no part; nor has a sample with a saturated neighbour of its colour, as it may
    itself have stayed below only by chance (the shortest exposure is spared: there is none to turn
    to). Where all saturate the light is `lost`.

    Where chi-square says that samples contradict each other, the largest set that agrees is taken
    (`_agreed`). `variance` is that of the noise, and of the pixels' unequal response; an
    error of a ratio or of the black level is not in it.
    """
    known = known or Known()
    with bracket.decoded(_look) as decoded:
        sensor = _sensor(decoded.seen, known)
        result = _merged(decoded, sensor)
    if result.lost.mean() > 0.99:
        raise fault(
            f"{result.lost.mean():.1%} of the samples saturate in every exposure",
            "",
            "add shorter exposures",
        )
    return result


def warnings(radiance: Radiance, names: Sequence[str]) -> list[str]:
    """What the photographer should know of a merged bracket, a sentence each.

    names  of the exposures, in order
    """
    said = []
    for name, first in zip(names, radiance.alike, strict=True):
        if name != names[first]:
            said.append(f"{name} is the same photograph as {names[first]} and counts once")
    for name, tagged, solved in zip(names, radiance.tagged, radiance.solved, strict=True):
        if abs(np.log2(solved / tagged)) > 0.25:  # more than tags are rounded by and shutters stray
            said.append(f"{name} is exposed {solved / tagged:.2f} times as long as it is tagged")
    moved = float(radiance.moved.mean())
    if moved > WORTH_A_WARNING:
        said.append(
            f"something moved or flickered in {moved:.1%} of the picture; what agrees was taken"
        )
    return said


# --------------------------------------------------------------------------- the first look


@dataclass(frozen=True)
class _Look:
    """What is kept of a frame: a frame of its blocks, and where its samples pile up (2, 2)."""

    blocks: Frame
    size: tuple[int, int]
    edge: NDArray[np.float64]


def _look(frame: Frame) -> _Look:
    height, width = frame.samples.shape
    step = max(1.0, np.sqrt(frame.samples.size / SAMPLED))

    def chosen(length: int):  # rows or columns of blocks, evenly spread, on whole CFA cells
        count = int(length / (BLOCK * step))
        if step == 1 or count < 2:
            return np.arange(length)
        tops = np.linspace(0, (length - BLOCK) // 2, count).astype(int) * 2
        return (tops[:, None] + np.arange(BLOCK)).ravel()

    blocks = frame.samples[np.ix_(chosen(height), chosen(width))]
    return _Look(replace(frame, samples=blocks), (height, width), pile_up(frame))


@dataclass(frozen=True)
class _Sensor:
    """How raw samples are to be read; what `_merged` wants to know.

    light        (K,) solved
    series       (K,) with the shutter's true nominal times
    gain, read   (K,) full scale
    limit        (K, 2, 2) raw value from which on samples do not count
    active       indices of the exposures that count, shortest first
    """

    frames: Sequence[Frame]
    size: tuple[int, int]
    light: NDArray[np.float64]
    series: tuple[float, ...]
    gain: NDArray[np.float64]
    read: NDArray[np.float64]
    prnu: float
    transfer: NDArray[np.float64]
    limit: NDArray[np.float64]
    active: tuple[int, ...]
    alike: tuple[int, ...]


def _sensor(looks: Sequence[_Look], known: Known) -> _Sensor:
    assert looks, "a bracket without exposures"
    frames, size = [one.blocks for one in looks], looks[0].size
    assert all(one.size == size for one in looks), "exposures of different sizes"
    assert all(np.array_equal(f.cfa, frames[0].cfa) for f in frames), "exposures of different CFA"
    alike = tuple(_first_alike(k, frames) for k in range(len(frames)))
    limit = np.array([
        usable_below(
            frame,
            [b.edge for b in looks if b.blocks.iso == frame.iso],
            known.saturation_level,
        )
        for frame in frames
    ])  # fmt: skip
    developed = [develop(frame, below) for frame, below in zip(frames, limit, strict=True)]
    survey = _survey(developed, frames, alike)
    light, model = _solve(survey, known)
    light = light[list(alike)]
    gain, read = (values[list(survey.iso_of)] for values in (model.gain, model.read))
    if survey.brightest < max(5 * read.max(), 0.002):
        raise fault(
            f"the bracket is black: its brightest signal is {survey.brightest:.2g} of full scale",
            "",
            "expose longer, or take off the lens cap",
        )
    named = [n[2] for iso, n in known.noise.items() if iso in survey.isos and n[2] is not None]
    prnu = named[0] if named else _response(survey, light, gain, read)
    active = sorted((k for k in range(len(frames)) if alike[k] == k), key=lambda k: light[k])
    return _Sensor(
        frames,
        size,
        light,
        survey.nominal,
        gain,
        read,
        prnu,
        model.transfer,
        limit,
        tuple(active),
        alike,
    )


def _first_alike(k: int, frames: Sequence[Frame]) -> int:
    """The first frame with the same samples: a file that was copied twice. No two exposures are."""
    mine = frames[k].samples
    if mine.min() == mine.max():  # nothing but black or white: no evidence
        return k
    return next(j for j in range(k + 1) if np.array_equal(frames[j].samples, mine))


@dataclass(frozen=True)
class _Survey:
    """Blocks of K exposures as numbers.

    samples    (K, n) of the same pixels in every exposure; NaN where saturated
    tagged     (K,) light
    nominal    (K,) light with the shutter's true nominal time
    isos       (I,) sensitivities, and iso_of (K,) the index of each exposure's
    alike      (K,) see Radiance
    levels     raw steps of full scale
    brightest  the highest of the exposures' 99.9th percentiles, of full scale
    shape      of the blocks' frame, whose samples these are
    block      (n,) which block a sample is from
    """

    samples: Float
    tagged: tuple[float, ...]
    nominal: tuple[float, ...]
    isos: tuple[float, ...]
    iso_of: tuple[int, ...]
    alike: tuple[int, ...]
    levels: float
    brightest: float
    shape: tuple[int, int]
    block: NDArray[np.intp]


def _survey(
    developed: Sequence[Exposure], frames: Sequence[Frame], alike: tuple[int, ...]
) -> _Survey:
    isos = sorted({frame.iso for frame in frames})
    height, width = developed[0].mosaic.shape
    rows, columns = np.arange(height) // BLOCK, np.arange(width) // BLOCK
    return _Survey(
        samples=np.array([np.where(e.usable, e.mosaic, np.nan).ravel() for e in developed]),
        tagged=tuple(e.light for e in developed),
        nominal=tuple(e.light * true_shutter(e.time_s) / e.time_s for e in developed),
        isos=tuple(isos),
        iso_of=tuple(isos.index(frame.iso) for frame in frames),
        alike=alike,
        levels=developed[0].levels,
        brightest=max(float(np.percentile(e.mosaic, 99.9)) for e in developed),
        shape=(height, width),
        block=(rows[:, None] * (columns[-1] + 1) + columns).ravel(),
    )


def _solve(survey: _Survey, known: Known) -> tuple[NDArray[np.float64], noise.Model]:
    """The light (K,) of each exposure and the noise, from what exposures have in common."""
    order = [k for k in np.argsort(survey.nominal, kind="stable") if survey.alike[k] == k]
    overlaps = {}
    for i, j in enumerate(order):
        for k in order[i + 1 : i + 1 + REACH]:  # j shorter, k longer
            ratio = survey.nominal[j] / survey.nominal[k]
            # Chosen by both: a limit to one would choose among its noise.
            signal = (survey.samples[j] + survey.samples[k]) / (1 + ratio)
            both = signal < BRIGHTEST  # false for NaN
            overlaps[j, k] = survey.samples[j][both], survey.samples[k][both], survey.block[both]
    neighbours = set(itertools.pairwise(order))

    light = np.array(survey.nominal)
    model = _told(noise.measure([], survey.levels, len(survey.isos)), survey, known)
    start = None
    for _ in range(2):  # ratios want the noise to tell outliers, noise wants the ratios
        ratios = {}
        for (j, k), samples in overlaps.items():
            sensitivities = survey.iso_of[j], survey.iso_of[k]
            sensors = ((model.gain[i], model.read[i]) for i in sensitivities)
            ratio = _log_ratio(*samples, light[j] / light[k], *sensors)
            if ratio:
                ratios[j, k] = ratio
        light = _light_from_ratios(ratios, survey)
        pairs = []
        for (j, k), (_, _, still) in ratios.items():
            if (j, k) in neighbours:
                shorter, longer, block = overlaps[j, k]
                keep = still[block]
                pairs.append(
                    noise.Pair(
                        shorter[keep],
                        longer[keep],
                        light[j] / light[k],
                        (survey.iso_of[j], survey.iso_of[k]),
                    )
                )
        start = noise.measure(pairs, survey.levels, len(survey.isos), start)
        model = _told(start, survey, known)
    return light, model


def _told(model: noise.Model, survey: _Survey, known: Known) -> noise.Model:
    """The model, with what is known in its place."""
    gain, read = model.gain.copy(), model.read.copy()
    for i, iso in enumerate(survey.isos):
        if iso in known.noise:
            gain[i], read[i], _ = known.noise[iso]
    return replace(model, gain=gain, read=read)


def _response(survey: _Survey, light, gain, read) -> float:
    """The pixels' unequal response from the blocks, merged; 0 where they do not tell."""
    light, gain, read = (v[:, None].astype(np.float32) for v in (light, gain, read))
    there = np.isfinite(survey.samples)
    total = np.where(there, survey.samples, 0).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = total / (there * light).sum(axis=0)
        weight = there * light / (gain * light * np.maximum(mean, 0) + read**2)
        variance = 1 / (weight * light).sum(axis=0)
        mean = (weight * np.where(there, survey.samples, 0)).sum(axis=0) * variance
    b = BLOCK
    height, width = (n // b for n in survey.shape)

    def cut(image):
        whole = image.reshape(survey.shape)[: height * b, : width * b]
        return whole.reshape(height, b, width, b).swapaxes(1, 2).reshape(-1, b, b)

    return noise.response(cut(mean), cut(variance)) or 0.0


# ------------------------------------------------------------------------------------- ratios


def _log_ratio(
    shorter, longer, block, start: float, noise_shorter, noise_longer
) -> tuple[float, float, NDArray[np.bool_]] | None:
    """log(shorter / longer) of two exposures' light, its standard error, and which blocks do not
    contradict it; None where unknown.

    The ratio of sums over samples that agree is the best estimate under photon noise and, unlike
    a regression on either exposure, not pulled to one side by that exposure's noise. Samples are
    chosen by a mean of both that is independent of their difference where the choice is made,
    in the dark. What moved but little hides in the noise of its samples; it shows in the sums of
    whole blocks.

    block  (n,) which block of the picture a sample is from
    """
    (gain, read), (longer_gain, longer_read) = noise_shorter, noise_longer
    blocks = int(block.max(initial=0)) + 1
    lean = (gain * DARKEST + start * longer_read**2) / (gain * DARKEST + read**2)
    signal = (lean * shorter + longer) * (start / (1 + lean * start))
    lit = np.flatnonzero(signal > DARKEST)
    if len(lit) < FEWEST:
        return None
    lit = lit[:: 1 + len(lit) // MOST]
    shorter, longer, signal, block = shorter[lit], longer[lit], signal[lit], block[lit]
    ratio = float(np.median(shorter / longer))
    for _ in range(5):
        variance = signal * (gain + ratio * longer_gain) + read**2 + (ratio * longer_read) ** 2
        agree = (shorter - np.float32(ratio) * longer) ** 2 < 16 * variance
        sums = [
            np.bincount(block, agree * v, minlength=blocks) for v in (shorter, longer, variance)
        ]
        known = sums[1] > 0
        off = (sums[0] - ratio * sums[1]) ** 2 / (sums[2] + (LINEARITY * sums[0]) ** 2 + ~known)
        # Half of the blocks at least are taken for still, whatever the noise was thought to be.
        still = known & (off <= max(9.0, 2 * float(np.median(off[known])) if known.any() else 0))
        short, long, noise2 = (float(v[still].sum()) for v in sums)
        if np.count_nonzero(agree & still[block]) < FEWEST or short <= 0:
            return None
        ratio = short / long
    error = float(np.hypot(np.sqrt(noise2) / short, RATIO_FLOOR))
    return float(np.log(ratio)), error, still | ~known


def _light_from_ratios(ratios, survey: _Survey) -> NDArray[np.float64]:
    """Light (K,) that agrees best with all measured ratios, and on the whole with the tags.

    Least squares in log light: the ratios, each with its error, and every exposure's nominal light
    as a weak prior. All priors weigh the same, so the scale, which no ratio knows,
    is where they are right on average; an exposure with no overlap keeps its nominal light. The
    nominal light is that of the true shutter series or, where the ratios fit them better, of the
    tags to the letter: electronic shutters keep to theirs. What this bracket alone cannot tell
    the others may, see `stages.scale`.
    """
    series, strays = _fit(ratios, np.log(survey.nominal))
    to_the_letter, strays_from_tags = _fit(ratios, np.log(survey.tagged))
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


# --------------------------------------------------------------------------- tile by tile


def workers() -> int:
    """Threads that decode and merge: the processors this process may use, as far as memory goes."""
    return min(4, len(os.sched_getaffinity(0)))


def _merged(decoded: Decoded[_Look], sensor: _Sensor) -> Radiance:
    """All exposures together, a tile at a time, bands of tiles in threads."""
    tiles = _Tiles(decoded, sensor)
    bands = [(top, min(top + BAND, sensor.size[0])) for top in range(0, sensor.size[0], BAND)]
    with ThreadPoolExecutor(workers()) as pool:
        clipped = np.sum(list(pool.map(tiles.merge, bands)), axis=0)
        for rows, found in pool.map(tiles.outliers, bands):
            tiles.defective[rows] |= found
    mosaic, variance, defective = tiles.mosaic, tiles.variance, tiles.defective
    mosaic[defective] = np.nan
    variance[defective] = np.nan
    lost = np.logical_and(tiles.lost, ~defective, out=tiles.lost)
    shortest = sensor.active[0]
    first = sensor.frames[shortest]
    full = first.saturation_level - first.black_level
    return Radiance(
        mosaic=mosaic,
        variance=variance,
        valid=~(lost | defective),
        lost=lost,
        defective=defective,
        moved=np.logical_and(tiles.moved, ~defective, out=tiles.moved),
        at_least=(sensor.limit[shortest] - first.black_level) / full / sensor.light[shortest],
        cfa=first.cfa,
        tagged=tuple(float(frame.light) for frame in sensor.frames),
        series=tuple(float(t) for t in sensor.series),
        solved=tuple(float(t) for t in sensor.light),
        noise=np.stack([sensor.gain, sensor.read], axis=1),
        prnu=float(sensor.prnu),
        transfer=sensor.transfer,
        clipped=tuple(float(n) / mosaic.size for n in clipped[list(sensor.alike)]),
        alike=sensor.alike,
    )


@dataclass(frozen=True)
class _Place:
    """A tile's rows and columns of the photograph; of what it sees of it, HALO wider all around
    but for the frame's edges; and its own within that."""

    own: tuple[slice, slice]
    seen: tuple[slice, slice]
    inside: tuple[slice, slice]

    @classmethod
    def of(cls, bounds: Sequence[tuple[int, int]], size: tuple[int, int]) -> _Place:
        seen = [
            (max(a - HALO, 0), min(b + HALO, n)) for (a, b), n in zip(bounds, size, strict=True)
        ]
        inside = [(a - c, b - c) for (a, b), (c, _) in zip(bounds, seen, strict=True)]
        rows, columns = ((slice(*a), slice(*b)) for a, b in (bounds, seen))
        return cls(rows, columns, (slice(*inside[0]), slice(*inside[1])))


class _Tiles:
    """Merges tiles of a bracket into arrays of the photograph's size.

    In work a signal is counted in raw steps above black, so that samples need no scaling: light
    is in steps per unit of radiance.
    """

    def __init__(self, decoded: Decoded[_Look], sensor: _Sensor):
        self.decoded, self.sensor = decoded, sensor
        self.mosaic, self.variance = (np.empty(sensor.size, np.float32) for _ in range(2))
        self.lost, self.defective, self.moved = (np.zeros(sensor.size, np.bool_) for _ in range(3))
        exposures = len(sensor.active)
        width = TILE_BYTES // (4 * exposures * (BAND + 2 * HALO)) // 2 * 2
        self.width = max(64, width)
        first = sensor.frames[sensor.active[0]]
        full = first.saturation_level - first.black_level
        steps = float(full.mean())
        self.black = self._pattern(first.black_level)
        self.scale = None if np.ptp(full) == 0 else self._pattern(steps / full)
        self.limit = [self._pattern(np.ceil(v), np.uint16) for v in sensor.limit]
        self.lowest_limit = np.ceil(sensor.limit.min(axis=(1, 2)))
        self.lowest_black = float(first.black_level.min())
        self.light = sensor.light * steps
        self.gain = sensor.gain * steps
        self.read2 = (sensor.read * steps) ** 2
        # Of a sensor so good that its linearity shows beside its noise, chi-square is lessened.
        self.linear = 1 + LINEARITY**2 / sensor.gain.min()
        self.surprise = _surprise(9 * exposures, CONTRADICTION)
        self.unlikely = np.arange(10) + _surprise(9, DISAGREEMENT)

    def _pattern(self, values, kind=np.float32):
        """What values (2, 2) of CFA positions are to a tile: a number, or an array of them."""
        values = np.asarray(values).astype(kind)
        if np.ptp(values) == 0:
            return values[0, 0]
        return np.tile(values, ((BAND + 2 * HALO) // 2, self.width // 2 + HALO))

    def merge(self, band: tuple[int, int]) -> NDArray[np.int64]:
        """Merges some rows; how many samples of each exposure saturated."""
        height, width = self.sensor.size
        top, bottom = max(band[0] - HALO, 0), min(band[1] + HALO, height)
        raw = self.decoded.rows(top, bottom)
        exposures, area = len(self.sensor.active), (bottom - top) * (self.width + 2 * HALO)
        memory = np.empty((2 * exposures + 8, area), np.float32)
        clipped = np.zeros(len(raw), np.int64)
        for left in range(0, width, self.width):
            place = _Place.of((band, (left, min(left + self.width, width))), self.sensor.size)
            clipped += self._tile(raw[:, :, place.seen[1]], place, memory)
        return clipped

    def _tile(self, raw, place: _Place, memory) -> NDArray[np.int64]:
        """Merges a tile, of raw samples (K, h, w) of what it sees; samples saturated (K,)."""
        import cv2

        shape = raw.shape[1:]
        room = iter(memory[:, : shape[0] * shape[1]].reshape(-1, *shape))
        clipped = np.zeros(len(raw), np.int64)
        total, lights, counts = (next(room) for _ in range(3))
        total[...] = 0
        light: Any = np.float32(0)  # these become (h, w) where some samples saturate
        count: Any = np.float32(0)
        clear = 0.0  # light of the exposures that nowhere saturate
        brightest = np.inf  # of the tile, per light
        used = []  # index, signal, mask
        for k in reversed(self.sensor.active):  # longest first
            t, highest = float(self.light[k]), float(raw[k].max())
            if self._negligible(k, t, clear, highest, brightest):
                continue
            mask, clipped[k] = self._usable(raw[k], k, highest, place.inside, room)
            if mask is not None and not mask.any():
                continue
            signal = self._signal(raw[k], next(room))
            if mask is None:
                count += np.float32(1)
                clear += t
                brightest = min(brightest, (highest - self.lowest_black) / t)
            else:
                signal *= mask
                if np.ndim(count) == 0:
                    for scalar, array in ((light, lights), (count, counts)):
                        array[...] = scalar
                    light, count = lights, counts
                count += mask
            if clear < 2 * t:  # what is shorter adds little
                total += signal
                if mask is None:
                    light += np.float32(t)
                else:
                    cv2.scaleAdd(mask, t, light, light)
            used.append((k, signal, mask))
        own, inside = place.own, place.inside
        if not used:
            self.mosaic[own] = self.variance[own] = np.nan
            self.lost[own] = True
            return clipped

        information, weighted, square, inverse, product = (next(room) for _ in range(5))
        for sum_ in (information, weighted, square):
            sum_[...] = 0
        expected = self._expected(total, light, used[0][0])
        for k, signal, mask in used:
            t = float(self.light[k])
            np.multiply(expected, np.float32(self.gain[k] * t), out=inverse)
            inverse += np.float32(self.read2[k])
            np.divide(np.float32(1) if mask is None else mask, inverse, out=inverse)
            np.multiply(signal, inverse, out=product)
            cv2.scaleAdd(inverse, t * t, information, information)
            cv2.scaleAdd(product, t, weighted, weighted)
            cv2.accumulateProduct(product, signal, square)

        freedom = count - np.float32(1)
        lost = None
        if np.ndim(count) and count.min() == 0:
            lost = count == 0
            information[lost] = np.nan
            self.lost[own] = lost[inside]
        variance = np.reciprocal(information, out=information)
        mosaic = np.multiply(weighted, variance, out=inverse)
        excess = np.subtract(square, np.multiply(weighted, mosaic, out=product), out=square)
        if lost is not None:
            excess[lost] = freedom[lost] = 0
        self._put_right(raw, place, mosaic, variance, excess, freedom)
        self.mosaic[own] = mosaic[inside]
        if self.sensor.prnu:
            part = np.multiply(mosaic, np.float32(self.sensor.prnu), out=product)
            cv2.accumulateSquare(part, variance)
        self.variance[own] = variance[inside]
        return clipped

    def _negligible(self, k: int, t: float, clear: float, highest: float, brightest: float) -> bool:
        """Whether an exposure could tell next to nothing, and does not contradict the longer ones.

        clear      light of longer exposures that do not saturate in the tile
        highest    raw value of this one
        brightest  of the tile, per light, by the longer ones
        """
        if t > NEGLIGIBLE * clear:
            return False
        level = max(t * brightest, 0)
        noise = np.sqrt(self.gain[k] * level + self.read2[k])
        return bool(highest - self.lowest_black <= 1.1 * level + 7 * noise)

    def _signal(self, raw, signal) -> Float:
        """Raw samples in steps above black."""
        np.copyto(signal, raw)
        signal -= self._cut(self.black, raw.shape)
        if self.scale is not None:
            signal *= self._cut(self.scale, raw.shape)
        return signal

    def _cut(self, pattern, shape):
        return pattern if np.ndim(pattern) == 0 else pattern[: shape[0], : shape[1]]

    def _usable(self, raw, k: int, highest: float, inside, room):
        """What of an exposure counts, 1 or 0 (h, w), and how many samples saturated.

        None where all do, as in most tiles.
        """
        import cv2

        if highest < self.lowest_limit[k]:
            return None, 0
        saturated = (raw >= self._cut(self.limit[k], raw.shape)).view(np.uint8)
        clipped = cv2.countNonZero(saturated[inside])
        if k != self.sensor.active[0]:
            saturated = cv2.dilate(saturated, _SAME_COLOUR)
        mask = next(room)
        np.copyto(mask, saturated)
        return np.subtract(np.float32(1), mask, out=mask), clipped

    def _expected(self, total, light, longest: int) -> Float:
        """What a unit of light gives (h, w), for the weights: at least 0.

        The plain mean where it is well known. Where it is noise for the most part, the mean of the
        eight next pixels of the CFA position, which has no part in the pixel's own noise;
        in between something of both.
        """
        import cv2

        gain, read2 = float(self.gain[longest]), float(self.read2[longest])
        least = float(total.min())
        mean = np.divide(total, np.maximum(light, _TINY), out=total)
        if least > 0 and least**2 > (3 * OWN_SIGNAL) ** 2 * (gain * least + 2 * read2):
            return mean
        around = cv2.filter2D(mean, -1, _MEAN_AROUND, borderType=cv2.BORDER_REFLECT_101)
        np.maximum(around, 0, out=around)
        steps = around * light
        # share of the own mean: steps^2 / (steps^2 + OWN^2 noise^2), noise^2 = gain steps + read^2
        noise2 = steps * np.float32(gain)
        noise2 += np.float32(2 * read2)
        noise2 *= np.float32(OWN_SIGNAL**2)
        steps *= steps
        noise2 += steps
        share = np.divide(steps, noise2, out=steps)
        mean -= around
        mean *= share
        mean += around
        return np.maximum(mean, 0, out=mean)

    def _put_right(self, raw, place: _Place, mosaic, variance, excess, freedom) -> None:
        """Finds what moved and what is defective, and puts mosaic and variance (h, w) right there.

        excess   (h, w) chi-square of the samples about their mean, what noise gives not taken off
        freedom  its degrees of freedom, one number or (h, w)

        Chi-square is pooled over 3 x 3 pixels, since what moves is larger than one. What one pixel
        does alone is its own fault, or a particle's.
        """
        import cv2

        excess *= np.float32(1 / self.linear)
        excess -= freedom
        pooled = cv2.boxFilter(excess, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)[
            place.inside
        ]
        if np.ndim(freedom):
            # Some of the nine may have less freedom, and be surprising earlier: a first choice.
            bound = self.surprise[(5 * freedom[place.inside]).astype(np.uint8)]
        else:
            bound = self.surprise[int(9 * freedom)]
            if pooled.max() <= bound:
                return
        row, column = np.nonzero(pooled > bound)
        pooled = pooled[row, column]
        row, column = row + place.inside[0].start, column + place.inside[1].start
        y, x, there = _nine(row, column, raw.shape[1:])
        free = np.where(there, np.broadcast_to(freedom, excess.shape)[y, x], 0)
        nine_excess = np.where(there, excess[y, x], -np.inf)
        worst = nine_excess.max(axis=0)
        total = np.rint(free.sum(axis=0)).astype(np.intp)
        # What remains of the nine without their worst?
        alone = pooled - worst <= self.surprise[np.maximum(total - int(free.max(initial=0)), 0)]
        judged = pooled > self.surprise[total]
        judged &= ~alone | (nine_excess[4] == worst)
        row, column, alone = row[judged], column[judged], alone[judged]

        top, left = (seen.start for seen in place.seen)
        for start in range(0, len(row), AT_ONCE):
            some = slice(start, start + AT_ONCE)
            at = row[some], column[some]
            mosaic[at], variance[at], excluded, few = self._agreed(raw, *at, alone[some])
            at = at[0] + top, at[1] + left
            self.defective[at] = alone[some] & few
            self.moved[at] = ~alone[some] & excluded

    def _agreed(self, raw, row, column, alone):
        """Mean and variance (n,) of the samples that agree; whether any were left out; and whether
        those that agree are no majority.

        raw          (K, h, w) of what a tile sees
        row, column  (n,) pixels of it
        alone        (n,) whether a pixel is to be judged without its neighbours

        Each exposure is held against each: two agree at a pixel when their samples there do, and
        by chi-square those of the 3 x 3 pixels about it. From each exposure a set is begun that
        takes in, the longest first, what agrees with all that are in it; the largest set is
        the answer, of equally large ones the best informed.
        """
        active = np.array(self.sensor.active)
        y, x, there = _nine(row, column, raw.shape[1:])

        def of(pattern):
            return pattern if np.ndim(pattern) == 0 else pattern[y, x]

        values = raw[:, y, x]  # (K, 9, n)
        usable = np.stack([values[k] < of(self.limit[k]) for k in active]) & there
        signal = values[active].astype(np.float32) - of(self.black)
        if self.scale is not None:
            signal *= of(self.scale)
        light, gain, read2 = (
            v[active].astype(np.float32)[:, None] for v in (self.light, self.gain, self.read2)
        )

        own = usable[:, 4]
        count = len(active)
        agree = np.zeros((count, count, len(row)), np.bool_)
        for j in range(count):  # the longer of a pair: active are in order of light
            level = np.maximum(signal[j], 0)
            for k in range(j):
                ratio = light[k] / light[j]
                expected = ratio * signal[j]
                noise2 = (gain[k] + ratio * gain[j]) * (ratio * level)
                noise2 += read2[k] + ratio**2 * read2[j] + (LINEARITY * expected) ** 2
                off = (signal[k] - expected) ** 2 / noise2
                both = usable[k] & usable[j]
                same = both[4] & (off[4] < AGREEMENT**2)
                same &= alone | (np.sum(off * both, axis=0) < self.unlikely[both.sum(axis=0)])
                agree[j, k] = agree[k, j] = same
        level = np.max(np.where(own, signal[:, 4], 0) / light, axis=0)
        information = light**2 / (gain * light * level + read2)
        best = np.full(len(row), -1.0)
        chosen = np.zeros_like(own)
        for j in range(count):
            taken = np.zeros_like(own)
            taken[j] = own[j]
            for k in reversed(range(count)):
                if k != j:
                    taken[k] = own[k] & own[j] & (agree[k] | ~taken).all(axis=0)
            score = taken.sum(axis=0) + np.sum(taken * information, axis=0) / (
                2 * np.sum(information, axis=0)
            )
            better = own[j] & (score > best)
            best = np.where(better, score, best)
            chosen = np.where(better, taken, chosen)

        central = np.where(chosen, signal[:, 4], 0)
        level = np.maximum(central.sum(axis=0), 0)
        level /= np.maximum((chosen * light).sum(axis=0), _TINY)
        weight = chosen * light / (gain * light * level + read2)
        information = np.sum(weight * light, axis=0)
        information[information == 0] = np.nan  # saturated all: nothing to put right
        few = 2 * chosen.sum(axis=0) <= own.sum(axis=0)
        excluded = (own & ~chosen).any(axis=0)
        return np.sum(weight * central, axis=0) / information, 1 / information, excluded, few

    def outliers(self, band: tuple[int, int]) -> tuple[slice, NDArray[np.bool_]]:
        """Pixels of some rows that stand out alone: hot ones, with a dark current, and dead ones.

        A hot pixel adds the same signal per second in every exposure, so it shows only beside its
        neighbours: it lies far outside the range of the eight next of its CFA position, which
        their common slope has no part in, by its noise and by that range, and no pixel next to it
        stands out in its own colour, as those do about a glint, which the lens spreads. Pixels
        beside lost ones or the frame's edge are not judged. Two hot ones side by side escape.
        """
        first = max(band[0] - 2 * HALO, 0)
        seen = slice(first, band[1] + 2 * HALO)
        mosaic, variance = self.mosaic[seen], self.variance[seen]
        found = np.zeros((band[1] - band[0], mosaic.shape[1]), np.bool_)
        rows = slice(max(band[0] - first, 2), min(band[1] - first, len(mosaic) - 2))
        if rows.stop <= rows.start or mosaic.shape[1] < 5:
            return slice(*band), found

        # Opposite ones of the eight, whose mean no slope changes, leave few to be looked at closer.
        found_at = []
        for top in range(rows.start, rows.stop, CLOSE):
            bottom = min(top + CLOSE, rows.stop)
            middle, left, right = (mosaic[top:bottom, c] for c in _BESIDE)
            across = left + right
            across *= np.float32(0.5)
            down = mosaic[top - 2 : bottom - 2, 2:-2] + mosaic[top + 2 : bottom + 2, 2:-2]
            down *= np.float32(0.5)
            high, low = np.maximum(across, down), np.minimum(across, down, out=across)
            out = np.maximum(middle - high, low - middle)
            high -= low
            high *= np.float32(OUTLIER_RANGES)
            far = out > high
            out *= np.abs(out)
            far &= out > np.float32(OUTLIER_SIGMAS**2) * variance[top:bottom, 2:-2]
            row, column = np.nonzero(far)
            found_at.append((row + top, column + 2))
        row, column = (np.concatenate(each) for each in zip(*found_at, strict=True))

        def excess(row, column):
            """Beyond the range of the eight, that range, and over their mean; slope taken off."""
            eight = np.stack([_at(mosaic, row + dy, column + dx) for dy, dx in _EIGHT])
            eight -= np.einsum("ij,jn->in", _SLOPE, eight)
            value = _at(mosaic, row, column)
            high, low = eight.max(axis=0), eight.min(axis=0)
            return value - np.clip(value, low, high), high - low, value - eight.mean(axis=0)

        out, spread, own = excess(row, column)
        alone = out**2 > OUTLIER_SIGMAS**2 * variance[row, column]
        alone &= np.abs(out) > OUTLIER_RANGES * spread
        row, column, own = row[alone], column[alone], own[alone]
        glint = np.zeros(len(row), np.bool_)
        for dy, dx in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            _, _, beside = excess(row + dy, column + dx)
            real = beside**2 > 16 * _at(variance, row + dy, column + dx)
            glint |= real & (beside / own > GLINT_SHARE)
        found[row[~glint] - (band[0] - first), column[~glint]] = True
        return slice(*band), found


BAND = 64  # rows a thread merges at a time
CLOSE = 16  # rows whose outliers are looked for at a time, for the cache
_BESIDE = slice(2, -2), slice(None, -4), slice(4, None)
AT_ONCE = 8192  # contradicting pixels, so that what is in work stays small
_TINY = np.float32(1e-20)
_SAME_COLOUR = np.zeros((5, 5), np.uint8)  # a pixel and the eight next of its CFA position
_SAME_COLOUR[::2, ::2] = 1
_MEAN_AROUND = _SAME_COLOUR.astype(np.float32) / 8
_MEAN_AROUND[2, 2] = 0
_NINE = tuple(itertools.product((-1, 0, 1), (-1, 0, 1)))
_EIGHT = tuple((dy, dx) for dy, dx in itertools.product((-2, 0, 2), (-2, 0, 2)) if dy or dx)
_PLACES = np.array(_EIGHT, np.float32)
_SLOPE = _PLACES @ np.linalg.pinv(_PLACES)  # (8, 8) eight values' plane through zero, at each


def _nine(row, column, shape):
    """Rows and columns (9, n) of the 3 x 3 about pixels, and whether they exist in an array."""
    y, x = np.stack([(row + dy, column + dx) for dy, dx in _NINE], axis=1)
    there = (y >= 0) & (y < shape[0]) & (x >= 0) & (x < shape[1])
    return np.where(there, y, 0), np.where(there, x, 0), there


def _at(image, row, column):
    """Values (n,) of pixels; of those beyond an edge the next ones of the same CFA position."""
    height, width = image.shape
    row = np.where(row < 0, row + 2, np.where(row >= height, row - 2, row))
    column = np.where(column < 0, column + 2, np.where(column >= width, column - 2, column))
    return image[row, column]


def _surprise(freedom: int, chance: float) -> NDArray[np.float32]:
    """By how much chi-square of 0..freedom degrees exceeds them with so small a chance."""
    from scipy.special import chdtri

    degrees = np.arange(1, freedom + 1)
    return np.array([np.inf, *(chdtri(degrees, chance) - degrees)], np.float32)
