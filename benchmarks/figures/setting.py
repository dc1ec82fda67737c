"""What the figures are made from: the finished map, and the light as it truly is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import worlds
from benchmarks.render import difference
from calibration import look as looks
from calibration import sets
from calibration.look import Look
from calibration.primaries import Primaries
from pipeline import previews
from stages import cube as cubes
from stages.light import Light
from stages.light import light as prepare
from stages.prefilter import irradiance, mean
from stages.preview import Drawing, sequence
from stages.scene import Scene
from stages.shadows import Sight, shade
from stages.trichromatic import Trichromatic

WAYS = {"xyz": "Three channels, XYZ", "sharp": "Three channels, sharpened RGB",
        "six": "Six channels"}  # fmt: skip
"""Of rendering, as in `pipeline.previews`, from the least true to the truest."""


@dataclass(frozen=True)
class Setting:
    """A captured map and the spectral light it was captured from.

    result   the folder `sixlight envmap` wrote
    light    (6, N, N, P) the captured map, without holes
    world    (6, n, n, 36) the true light, W/(sr m2 nm)
    """

    result: Path
    light: Any
    primaries: Primaries
    world: Any

    @classmethod
    def read(cls, result: Path) -> Setting:
        """InputError where there is no finished map."""
        environment = previews.read(result)
        return cls(result, environment.light, environment.primaries, worlds.room())

    @cached_property
    def white(self):
        """XYZ (3,) of what a small white sphere scatters, as captured."""
        return self.primaries.xyz_from_primaries @ mean(self.light)

    @cached_property
    def true_white(self):
        """The same in full spectra."""
        return sets.xyz(mean(np.asarray(self.world, np.float64)))

    @cached_property
    def _irradiances(self):
        return irradiance(self.light), irradiance(self.world)

    def falling(self, directions):
        """On surfaces facing directions (..., 3): captured (..., P), and in full spectra (..., 36).

        Over pi: what a white surface returns.
        """
        captured, true = (cubes.sample(e, directions) for e in self._irradiances)
        return np.asarray(captured, np.float64), np.asarray(true, np.float64)

    def in_channels(self, way: str) -> Trichromatic | None:
        """The three channels of a way; None for the primaries."""
        return None if way == "six" else Trichromatic.named(way, self.primaries)

    def matt(self, way: str, falling, reflectance):
        """XYZ (..., 3) of a matt surface as a way of rendering has it.

        falling      (..., P) on it, as captured
        reflectance  (36,)
        """
        three, body = self.in_channels(way), self.primaries.project(reflectance)
        if three is None:
            return (falling * body) @ self.primaries.xyz_from_primaries.T
        return (three.light(falling) * three.surface(body)) @ three.xyz_from_channels.T

    def rendered(
        self, way: str, several: Sequence[Scene], width: int, height: int, *,
        sights: Sequence[Sight] | None = None,
    ) -> list[Any]:  # fmt: skip
        """XYZ (height, width, 3) of scenes, materials in the primaries, under the captured map.

        sights  what each scene's things hide of the light; None: nothing
        """
        three = self.in_channels(way)
        matrix, light = self.primaries.xyz_from_primaries, self._prepared(way, three)
        if three is not None:
            matrix, several = three.xyz_from_channels, [three.scene(scene) for scene in several]
        shades = None
        if sights is not None:
            shades = [shade(s, light, sight=seen) for s, seen in zip(several, sights, strict=True)]
        return list(sequence(light, matrix, several, Drawing(width, height), shades=shades))

    def _prepared(self, way: str, three: Trichromatic | None) -> Light:
        if way not in self._lights:
            self._lights[way] = prepare(self.light if three is None else three.light(self.light))
        return self._lights[way]

    @cached_property
    def _lights(self) -> dict[str, Light]:
        return {}

    def shown(self, xyz, exposure_of, white=None):
        """Signal (..., 3) for sRGB, adapted from a white; exposed as another picture is."""
        white = self.white if white is None else white
        return looks.shown(xyz, Look(), white, exposure_of=exposure_of).signal

    def apart(self, xyz, true, white=None):
        """CIEDE2000 (...) from colours in full spectra, adapted from the true white."""
        return difference(xyz, true, self.true_white if white is None else white)


def upright(azimuth_deg, tilt_deg: float = 0.0):
    """Directions (..., 3) from azimuths, degrees from +Z towards +X, a little up."""
    a, tilt = np.radians(np.asarray(azimuth_deg, float)), np.radians(tilt_deg)
    level = np.cos(tilt)
    return np.stack([level * np.sin(a), np.sin(tilt) + 0 * a, level * np.cos(a)], axis=-1)
