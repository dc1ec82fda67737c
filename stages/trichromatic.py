"""The comparators: the same scene in three channels, as a careful trichromatic renderer has it.

Light is given in three channels linear in XYZ, a surface is what it makes of daylight there:
C. Borges, "Trichromatic Approximation for Computer Graphics Illumination Models" (1991), for XYZ
itself; Ward and Eydelberg-Vileshin, "Picture Perfect RGB Rendering Using Spectral Prefiltering and
Sharp Color Primaries" (2002), for sharpened RGB, which is better.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration import sets
from calibration.channels import SHARP_FROM_XYZ
from calibration.primaries import Primaries
from stages.scene import Material, Scene

SPACES = {"sharp": SHARP_FROM_XYZ, "xyz": np.eye(3)}


class Trichromatic:
    """Light and surfaces in three channels, ready for `preview` in place of the primaries.

    channels_from_xyz   (3, 3) SHARP_FROM_XYZ, or the identity for XYZ itself
    xyz_from_primaries  (3, P)
    daylight            (P,) D65 in the primaries, on any scale
    """

    def __init__(self, xyz_from_primaries, daylight, channels_from_xyz=SHARP_FROM_XYZ):
        channels_from_xyz = np.asarray(channels_from_xyz, np.float64)
        self._from_primaries = channels_from_xyz @ np.asarray(xyz_from_primaries, np.float64)
        self._daylight = np.asarray(daylight, np.float64)
        self.xyz_from_channels = np.linalg.inv(channels_from_xyz)

    @classmethod
    def named(cls, name: str, primaries: Primaries) -> Trichromatic:
        """One of SPACES, in place of some primaries."""
        daylight = primaries.project(sets.lights("darling2011")["D65"])
        return cls(primaries.xyz_from_primaries, daylight, SPACES[name])

    def light(self, cube):
        """Light (..., 3) of light in the primaries (..., P)."""
        return (np.asarray(cube) @ self._from_primaries.T).astype(np.float32)

    def scene(self, scene: Scene) -> Scene:
        """The scene, its materials brought from the primaries to the three channels."""
        return replace(scene, things=tuple((mesh, self._material(m)) for mesh, m in scene.things))

    def _material(self, material: Material) -> Material:
        image = material.image
        return replace(
            material,
            diffuse=self.surface(material.diffuse),
            specular=self.surface(material.specular),
            image=None if image is None else self.surface(image).astype(np.float32),
        )

    def surface(self, reflectance):
        """Reflectance (..., 3) of one in the primaries (..., P): daylight from it over daylight."""
        white = self._from_primaries @ self._daylight
        return (np.asarray(reflectance) * self._daylight) @ self._from_primaries.T / white
