"""The comparator: the same scene in three channels, as a careful trichromatic renderer has it.

Ward and Eydelberg-Vileshin, "Picture Perfect RGB Rendering Using Spectral Prefiltering and Sharp
Color Primaries" (2002): light is given in sharpened RGB, a surface is what it makes of daylight
there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.channels import SHARP_FROM_XYZ
from stages.scene import Material, Scene


def sharpen(cube, scene: Scene, xyz_from_primaries, daylight):
    """Light and surfaces in sharpened RGB, ready for `preview` in place of the primaries.

    cube                (6, N, N, P) light in the primaries
    scene               its materials in the primaries
    xyz_from_primaries  (3, P)
    daylight            (P,) D65 in the primaries, on any scale
    returns             cube (6, N, N, 3), scene, xyz_from_sharp (3, 3)
    """
    sharp_from_primaries = SHARP_FROM_XYZ @ np.asarray(xyz_from_primaries, float)
    white = sharp_from_primaries @ daylight

    def surface(reflectance):
        return sharp_from_primaries @ (np.asarray(reflectance) * daylight) / white

    things = tuple(
        (mesh, Material(surface(m.diffuse), surface(m.specular), m.roughness))
        for mesh, m in scene.things
    )
    light = (np.asarray(cube) @ sharp_from_primaries.T).astype(np.float32)
    return light, replace(scene, things=things), np.linalg.inv(SHARP_FROM_XYZ)
