"""An environment in the forms that shading wants: made once, used for every picture under it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.errors import fault
from stages.lamps import MOST, lights, parted, take_out
from stages.prefilter import area_average, irradiance, mean, prefilter
from stages.types import Float

# Surfaces smoother than this mirror a lamp's shape: they are shown the whole map, which is sharp
# there, and not the lamps' stand-ins.
_SHARP = 0.04
# Rougher than this, lobes are broader than the steps between the few lights that a window becomes.
_BROAD = 0.1
_BROAD_SIZE = 64  # texels along a face of the map that they see; 1.4 degrees
_MATT_SIZE = 40  # texels along a face of the irradiance; 32 shows where a window ends
_MATT_LAMPS = 8  # as in shade.glsl
_STANDS_OUT = 3.0  # what is so many times the mean is lights to them


@dataclass(frozen=True)
class Parts:
    """An environment as a map and directional lights; it is both together.

    mips        Gaussian, each (6, N >> k, N >> k, C)
    directions  (K, 3) unit, towards each light
    flux        (K, C) radiance times solid angle
    """

    mips: Sequence[Float]
    directions: Float
    flux: Float


@dataclass(frozen=True)
class Matt:
    """An environment as a matt surface sees it: a smooth map, and lamps, which end at a line.

    irradiance  over pi, of all but the lamps, facing each direction (6, n, n, C)
    directions  (K, 3) unit, towards each lamp
    flux        (K, C) radiance times solid angle
    """

    irradiance: Float
    directions: Float
    flux: Float


@dataclass(frozen=True)
class Light:
    """An environment in the forms that surfaces of different roughness see.

    Samples of a blurred map are the worse the more it varies. So the rougher a surface is, the more
    of the map is taken out of it and given as directional lights, which are summed up exactly.

    whole   for mirrors: no lights
    narrow  lamps are lights
    broad   all that stands out is, windows too
    matt    for what does not mirror
    """

    whole: Parts
    narrow: Parts
    broad: Parts
    matt: Matt

    @property
    def channels(self) -> int:
        return self.matt.irradiance.shape[-1]


def form(roughness) -> str:
    """Which of a Light's Parts a surface sees: "whole", "narrow" or "broad"."""
    if np.max(roughness) < _SHARP:
        return "whole"
    return "broad" if np.min(roughness) >= _BROAD else "narrow"


def light(cube) -> Light:
    """What shading needs of a cubemap.

    cube  (6, N, N, C) linear; negative values are welcome, NaN and infinity are not
    Raises InputError for what is not such a cube.
    """
    cube = np.asarray(cube, np.float32)
    if cube.ndim != 4 or cube.shape[0] != 6 or cube.shape[1] != cube.shape[2] or 0 in cube.shape:
        raise fault(f"a map of shape {cube.shape}", "(6, N, N, channels)", "give a cubemap")
    if not np.isfinite(cube).all():
        count = int((~np.isfinite(cube)).any(axis=-1).sum())
        raise fault(
            f"{count} texels of the map are not numbers",
            "a map without holes",
            "close them first, with stages.fill",
        )
    none = np.zeros((0, 3), np.float32), np.zeros((0, cube.shape[-1]), np.float32)
    whole = Parts(prefilter(cube), *none)
    rest, directions, flux = take_out(cube)
    narrow = Parts(prefilter(rest), directions, flux) if len(flux) else whole
    coarse = area_average(cube, _BROAD_SIZE) if cube.shape[1] > _BROAD_SIZE else cube
    even, standing = parted(coarse, _STANDS_OUT * float(mean(coarse).sum()))
    broad = Parts(prefilter(even), *lights(standing, MOST))
    matt = Matt(irradiance(rest, size=_MATT_SIZE), *lights(cube - rest, _MATT_LAMPS))
    return Light(whole, narrow, broad, matt)
