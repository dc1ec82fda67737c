"""A bracket to one HDR mosaic."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from calibration.errors import fault
from stages.bracket import Bracket, Decoded, InMemory, workers
from stages.sensor import Known, Sensor, sensor_of
from stages.survey import Look, look
from stages.types import Radiance

if TYPE_CHECKING:
    from stages.combine import Readings

__all__ = ["InMemory", "Known", "merge", "warnings"]

WORTH_A_WARNING = 0.001  # share of the pixels that moved
BAND = 64  # rows a thread merges at a time, which stay in its cache


def merge(bracket: Bracket, known: Known | None = None) -> Radiance:
    """A bracket as one mosaic: the weighted mean of all that did not saturate, per unit of light.

    known   of the camera, in place of what the photographs say
    raises  InputError where the bracket is black, saturates throughout, or is hardly any samples

    Each photograph is decoded once. Of blocks of its samples the exposures' ratios and the noise
    are solved. Then the photographs are read again, all together, a few rows at a time, so that
    memory does not grow with their number: of a pixel's samples s in exposures of light t the mean
    is taken with inverse variances as weights, sum(t s / v) / sum(t^2 / v) with
    v = gain t L + read^2: the maximum-likelihood estimate, whose variance 1 / sum(t^2 / v) is the
    Cramer-Rao bound. L comes from the longest exposure that counts and, where that is little
    more than noise, from the pixels about (`combine._expected`): weights of the sample's own noise
    would prefer samples that came out low.

    What saturated has no part; nor has a sample with a saturated neighbour of its colour, as it may
    itself have stayed below only by chance, unless the next shorter exposure shows that the light
    lies well below (the shortest is spared: there is none to turn to). Where all saturate the light
    is `lost`.

    Where chi-square says that samples contradict each other, the largest set that agrees is taken
    (`contradictions._agreed`). `variance` is that of the noise, and of the pixels' unequal
    response; an error of a ratio or of the black level is not in it.
    """
    known = known or Known()
    with bracket.decoded(look) as decoded:
        sensor = sensor_of(decoded.seen, known)
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


def _merged(decoded: Decoded[Look], sensor: Sensor) -> Radiance:
    """All exposures together, some rows at a time, in threads."""
    # The compiler is loaded here.
    from stages.combine import HALO, Rows, combine
    from stages.contradictions import Bounds, Marked, settle
    from stages.outliers import mark_outliers

    height, width = sensor.size
    mosaic, variance = (np.empty(sensor.size, np.float32) for _ in range(2))
    moved, defective = (np.zeros(sensor.size, np.bool_) for _ in range(2))
    readings = _readings(sensor)
    bounds = Bounds.of(len(sensor.active), float(sensor.gain.min()))

    def combined(top: int) -> NDArray[np.int64]:
        rows = slice(top, min(top + BAND, height))
        above = min(top, HALO)
        raw = decoded.rows(top - above, min(rows.stop + HALO, height))
        chi_square = np.empty((2, rows.stop - top + 2, width), np.float32)
        band = Rows(mosaic[rows], variance[rows], *chi_square)
        clipped = combine(raw, above, readings, band)
        settle(raw, above, readings, bounds, band, Marked(moved[rows], defective[rows]))
        if sensor.prnu:
            variance[rows] += (np.float32(sensor.prnu) * mosaic[rows]) ** 2
        return clipped

    def outliers(top: int) -> None:
        mark_outliers(mosaic, variance, top, min(top + BAND, height), defective)

    with ThreadPoolExecutor(workers()) as pool:
        tops = range(0, height, BAND)
        counted = np.sum(list(pool.map(combined, tops)), axis=0)
        list(pool.map(outliers, tops))

    lost = np.isnan(mosaic) & ~defective
    mosaic[defective] = variance[defective] = np.nan
    moved &= ~defective
    clipped = np.zeros(len(sensor.frames))
    clipped[readings.exposure] = counted
    shortest = sensor.active[0]
    first = sensor.frames[shortest]
    full = first.saturation_level - first.black_level
    return Radiance(
        mosaic=mosaic,
        variance=variance,
        valid=~(lost | defective),
        lost=lost,
        defective=defective,
        moved=moved,
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


def _readings(sensor: Sensor) -> Readings:
    """How to read raw samples in steps above black, as they are; light then is in steps too."""
    from stages.combine import Readings

    width = sensor.size[1]
    index = np.array(sensor.active[::-1])
    first = sensor.frames[index[0]]
    full = first.saturation_level - first.black_level
    steps = float(full.mean())

    def by_row(values, kind):  # (..., 2, 2) of CFA positions to (..., 2, W)
        return np.ascontiguousarray(np.tile(values, width // 2 + 1)[..., :width].astype(kind))

    return Readings(
        index,
        light=(sensor.light[index] * steps).astype(np.float32),
        gain=(sensor.gain[index] * steps).astype(np.float32),
        read2=((sensor.read[index] * steps) ** 2).astype(np.float32),
        limit=by_row(np.ceil(sensor.limit[index]), np.uint16),
        black=by_row(first.black_level, np.float32),
        scale=by_row(steps / full, np.float32),
    )
