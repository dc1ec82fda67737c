"""A bracket's sensor: exposures' ratios, the noise, and the level where samples saturate."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calibration.errors import fault
from stages import noise
from stages.develop import develop, usable_below
from stages.ratios import BRIGHTEST, light_from_ratios, log_ratio
from stages.survey import Look, Survey, first_alike, response, surveyed
from stages.types import Frame

LEAST = 6  # px a side: the merge looks two pixels of a CFA position to either side
REACH = 2  # an exposure is compared with so many next longer ones


@dataclass(frozen=True)
class Known:
    """What is known of the camera beforehand, in place of what the data say.

    noise             gain, read and prnu (None: from the data) at an ISO
    saturation_level  raw value from which on samples saturate
    """

    noise: Mapping[float, tuple[float, float, float | None]] = field(default_factory=dict)
    saturation_level: float | None = None


@dataclass(frozen=True)
class Sensor:
    """How raw samples are to be read: the noise, what saturates, and how long exposures are.

    frames       (K,) of the blocks that were looked at
    size         (height, width) of the photographs
    light        (K,) solved
    series       (K,) with the shutter's true nominal times
    gain, read   (K,) full scale
    limit        (K, 2, 2) raw value from which on samples do not count
    active       indices of the exposures that count, shortest first
    prnu, transfer, alike
                 see Radiance
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


def sensor_of(looks: Sequence[Look], known: Known) -> Sensor:
    """The sensor as the blocks of a bracket's exposures show it."""
    assert looks, "a bracket without exposures"
    frames, size = [one.blocks for one in looks], looks[0].size
    assert all(one.size == size for one in looks), "exposures of different sizes"
    assert all(np.array_equal(f.cfa, frames[0].cfa) for f in frames), "exposures of different CFA"
    if min(size) < LEAST:
        raise fault(
            f"a picture of {size[1]} x {size[0]} samples",
            f"at least {LEAST} x {LEAST}",
            "take photographs that are larger, or a larger part of them",
        )
    alike = tuple(first_alike(k, frames) for k in range(len(frames)))
    limit = np.array([
        usable_below(
            frame,
            [b.edge for b in looks if b.blocks.iso == frame.iso],
            known.saturation_level,
        )
        for frame in frames
    ])  # fmt: skip
    developed = [develop(frame, below) for frame, below in zip(frames, limit, strict=True)]
    survey = surveyed(developed, frames, alike)
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
    prnu = named[0] if named else response(survey, light, gain, read)
    active = sorted((k for k in range(len(frames)) if alike[k] == k), key=lambda k: light[k])
    return Sensor(
        frames=frames,
        size=size,
        light=light,
        series=survey.nominal,
        gain=gain,
        read=read,
        prnu=prnu,
        transfer=model.transfer,
        limit=limit,
        active=tuple(active),
        alike=alike,
    )


def _solve(survey: Survey, known: Known) -> tuple[NDArray[np.float64], noise.Model]:
    """The light (K,) of each exposure and the noise, from what exposures have in common."""
    from stages.overlap import overlap

    order = [k for k in np.argsort(survey.nominal, kind="stable") if survey.alike[k] == k]
    compared = [(j, k) for i, j in enumerate(order) for k in order[i + 1 : i + 1 + REACH]]
    neighbours = set(itertools.pairwise(order))
    samples, block, iso_of = survey.samples, survey.block, survey.iso_of

    light = np.array(survey.nominal)
    start = noise.measure([], survey.levels, len(survey.isos))
    model = _told(start, survey, known)
    # Ratios want the noise to tell outliers, noise wants the ratios; at first roughly.
    for most in (noise.SAMPLES // 15, noise.SAMPLES):
        ratios = {}
        for j, k in compared:  # j shorter, k longer
            sensors = ((model.gain[i], model.read[i]) for i in (iso_of[j], iso_of[k]))
            ratio = log_ratio(samples[j], samples[k], block, light[j] / light[k], *sensors)
            if ratio:
                ratios[j, k] = ratio
        light = light_from_ratios(ratios, survey.nominal, survey.tagged)
        pairs = []
        for (j, k), (_, _, still) in ratios.items():
            if (j, k) in neighbours:
                ratio = light[j] / light[k]
                both = overlap(
                    samples[j],
                    samples[k],
                    block,
                    still,
                    ratio,
                    1.0,
                    -np.inf,
                    BRIGHTEST,
                    most,
                )
                pairs.append(
                    noise.Pair(samples[j][both], samples[k][both], ratio, (iso_of[j], iso_of[k]))
                )
        start = noise.measure(pairs, survey.levels, len(survey.isos), start)
        model = _told(start, survey, known)
    return light, model


def _told(model: noise.Model, survey: Survey, known: Known) -> noise.Model:
    """The model, with what is known in its place."""
    gain, read = model.gain.copy(), model.read.copy()
    for i, iso in enumerate(survey.isos):
        if iso in known.noise:
            gain[i], read[i], _ = known.noise[iso]
    return replace(model, gain=gain, read=read)
