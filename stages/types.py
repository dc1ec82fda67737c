"""The nouns that travel between stages: arrays with what is known of their error."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float32]


@dataclass(frozen=True)
class Frame:
    """One raw file as it was read; nothing has been done to the samples.

    samples           (H, W) uint16, the visible raw image
    cfa               (2, 2) int, colour 0 red, 1 green, 2 blue at [row % 2, column % 2]
    black_level       (2, 2) raw value of no light, per CFA position
    saturation_level  (2, 2) raw value of full scale, per CFA position
    time_s            shutter as tagged, seconds
    iso, f_number     as tagged; f_number 1 where the file has none
    """

    samples: NDArray[np.uint16]
    cfa: NDArray[np.int_]
    black_level: NDArray[np.float64]
    saturation_level: NDArray[np.float64]
    time_s: float
    iso: float
    f_number: float

    @property
    def light(self) -> float:
        """What the camera signal is divided by: time_s * ISO/100 / f_number^2, as tagged."""
        return self.time_s * self.iso / 100.0 / self.f_number**2


@dataclass(frozen=True)
class Exposure:
    """One developed photograph.

    mosaic  (H, W) float32, 0 at the black level, 1 at the saturation level, noise signed
    usable  (H, W) bool, false where the sample saturated
    cfa     (2, 2) int, as in Frame
    light   time_s * ISO/100 / f_number^2, as tagged
    time_s  shutter as tagged, seconds
    levels  raw steps between black and saturation (mean of the CFA positions): quantisation
    """

    mosaic: Float
    usable: NDArray[np.bool_]
    cfa: NDArray[np.int_]
    light: float
    time_s: float
    levels: float


@dataclass(frozen=True)
class Measured:
    """Values with what is known of their error; images, cubes and lists alike.

    values    (..., C) float32, linear; NaN where not known
    variance  (..., C) float32, of the values, same unit squared; NaN where not known
    valid     (...,) float32, 0 not known .. 1 fully known
    """

    values: Float
    variance: Float
    valid: Float


@dataclass(frozen=True)
class Radiance:
    """A merged bracket: one HDR mosaic, in camera signal units.

    mosaic    (H, W) float32, camera signal per unit of light; NaN where no exposure knows it
    variance  (H, W) float32, of the mosaic; NaN there too
    valid     (H, W) bool
    lost      (H, W) bool, saturated in every exposure: not valid, and at least `at_least`
    defective (H, W) bool, hot, stuck and dead pixels: not valid, but their neighbours may stand in
              for them, as they may not where the light itself was too bright
    moved     (H, W) bool, the exposures contradict each other: valid, from those that agree
    at_least  (2, 2) per CFA position, what light must exceed to saturate every exposure
    cfa       (2, 2) int, as in Frame
    tagged    (K,) light of each exposure as tagged, in the order given
    solved    (K,) the same as solved from the overlaps
    series    (K,) the same with the times of the true shutter series, which tags are rounded from
    noise     (K, 2) gain and read of each exposure: variance of a sample = gain * signal + read^2
    clipped   (K,) share of samples that saturated, per exposure
    alike     (K,) for each exposure the first that is the same photograph; itself as a rule
    prnu      the pixels' unequal response, as a share of the signal: its variance is prnu^2
              mosaic^2, alike in all exposures; 0 where it is not known
    transfer  (n, 4) what the noise was measured by, see `stages.noise.Model`
    """

    mosaic: Float
    variance: Float
    valid: NDArray[np.bool_]
    lost: NDArray[np.bool_]
    defective: NDArray[np.bool_]
    moved: NDArray[np.bool_]
    at_least: NDArray[np.float64]
    cfa: NDArray[np.int_]
    tagged: tuple[float, ...]
    solved: tuple[float, ...]
    noise: NDArray[np.float64]
    clipped: tuple[float, ...]
    alike: tuple[int, ...] = ()
    series: tuple[float, ...] = ()
    prnu: float = 0.0
    transfer: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 4)))

    def with_defects(self, found: NDArray[np.bool_]) -> Radiance:
        """The same with further pixels (H, W) marked as defective; their values stay."""
        return replace(
            self,
            valid=self.valid & ~found,
            defective=self.defective | found,
            moved=self.moved & ~found,
        )


@dataclass(frozen=True)
class Saturated:
    """What is kept of a merged bracket about its lost samples.

    lost      (H, W) bool, saturated in every exposure
    at_least  (2, 2) per CFA position, what light must exceed for that
    cfa       (2, 2) int, colour 0 red, 1 green, 2 blue
    """

    lost: NDArray[np.bool_]
    at_least: NDArray[np.float64]
    cfa: NDArray[np.int_]


@dataclass(frozen=True)
class Lights:
    """Light (K,) of a bracket's exposures: as tagged, of the true shutter series, as solved.

    What is solved are ratios. The scale, which no ratio knows, is that of the tags or of the
    series, whichever fits this bracket better.
    """

    tagged: tuple[float, ...]
    series: tuple[float, ...]
    solved: tuple[float, ...]
    alike: tuple[int, ...]

    @classmethod
    def of(cls, radiance: Radiance) -> Lights:
        return cls(radiance.tagged, radiance.series, radiance.solved, radiance.alike)
