"""A look at each exposure of a bracket: blocks of its samples, side by side, and what they say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stages import noise
from stages.develop import pile_up
from stages.shutter import true_shutter
from stages.types import Exposure, Float, Frame

BLOCK = 16  # px, whole CFA cells
SAMPLED = 300_000  # samples, unless the photograph is smaller


@dataclass(frozen=True)
class Look:
    """What is kept of a frame: a frame of its blocks, and where its samples pile up (2, 2)."""

    blocks: Frame
    size: tuple[int, int]
    edge: NDArray[np.float64]


def look(frame: Frame) -> Look:
    """What `surveyed` wants of a frame, which need not be kept."""
    height, width = frame.samples.shape
    step = max(1.0, np.sqrt(frame.samples.size / SAMPLED))

    def chosen(length: int):  # rows or columns of blocks, evenly spread, on whole CFA cells
        count = int(length / (BLOCK * step))
        if step == 1 or count < 2:
            return np.arange(length)
        tops = np.linspace(0, (length - BLOCK) // 2, count).astype(int) * 2
        return (tops[:, None] + np.arange(BLOCK)).ravel()

    blocks = frame.samples[np.ix_(chosen(height), chosen(width))]
    return Look(replace(frame, samples=blocks), (height, width), pile_up(frame))


def first_alike(k: int, frames: Sequence[Frame]) -> int:
    """The first frame with the same samples: a file that was copied twice. No two exposures are."""
    mine = frames[k].samples
    if mine.min() == mine.max():  # nothing but black or white: no evidence
        return k
    return next(j for j in range(k + 1) if np.array_equal(frames[j].samples, mine))


@dataclass(frozen=True)
class Survey:
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


def surveyed(
    developed: Sequence[Exposure], frames: Sequence[Frame], alike: tuple[int, ...]
) -> Survey:
    """The survey of developed blocks, and the frames that they are."""
    isos = sorted({frame.iso for frame in frames})
    height, width = developed[0].mosaic.shape
    rows, columns = np.arange(height) // BLOCK, np.arange(width) // BLOCK
    return Survey(
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


def response(survey: Survey, light, gain, read) -> float:
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
    if height * width == 0:
        return 0.0

    def cut(image):
        whole = image.reshape(survey.shape)[: height * b, : width * b]
        return whole.reshape(height, b, width, b).swapaxes(1, 2).reshape(-1, b, b)

    return noise.response(cut(mean), cut(variance)) or 0.0
