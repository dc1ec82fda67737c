"""Scenes there are names for.

Lengths in metres, the world's axes as in `stages/cube.py`: +Y up, the camera on the +Z side.
"""

from __future__ import annotations

import numpy as np

from stages.meshes import revolved, teapot_mesh
from stages.scene import Camera, Material, Scene


def teapot(body: Material, stand: Material) -> Scene:
    """A teapot on a round stand, handle and left side to -X, spout and right side to +X.

    body   of the teapot
    stand  of what it stands on
    """
    return Scene(
        things=(
            (teapot_mesh(), body),
            (revolved(_stand_profile(radius=0.215, height=0.03, edge=0.008), 192), stand),
        ),
        camera=Camera(eye=(0.0, 0.33, 0.95), target=(0.0, 0.052, 0.0), vertical_view_deg=27.0),
        background_level=1.5,
    )


def _stand_profile(*, radius, height, edge):
    """Top at y = 0, a rounded edge, a side: positions and normals for `revolved`."""
    top = np.linspace(0.0, radius - edge, 72)
    turn = np.linspace(0.0, np.pi / 2, 13)
    side = np.linspace(-edge, -height, 4)
    bend = np.stack([np.sin(turn), np.cos(turn)], axis=1)
    positions = np.concatenate(
        [
            np.stack([top, np.zeros_like(top)], axis=1),
            [radius - edge, -edge] + edge * bend[1:],
            np.stack([np.full_like(side, radius), side], axis=1)[1:],
        ]
    )
    normals = np.concatenate(
        [np.tile([0.0, 1.0], (len(top), 1)), bend[1:], np.tile([1.0, 0.0], (len(side) - 1, 1))]
    )
    return positions, normals
