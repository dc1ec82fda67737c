"""Scenes there are names for; what is on them is given as materials.

Lengths in metres, the world's axes as in `stages/cube.py`: +Y up, the camera on the +Z side, what
is shown about the origin.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stages.meshes import extent, placed, revolved, sphere, standing, teapot_mesh
from stages.scene import Camera, Material, Mesh, Scene

REACH, HEIGHT = 0.165, 0.17
"""What stands on the small stand reaches no further from its axis, and no higher."""


def teapot(body: Material, stand: Material) -> Scene:
    """A teapot on a round stand, handle and left side to -X, spout and right side to +X.

    body   of the teapot
    stand  of what it stands on
    """
    return Scene(
        things=((teapot_mesh(), body), (_stand(0.215), stand)),
        camera=Camera(eye=(0.0, 0.33, 0.95), target=(0.0, 0.052, 0.0), vertical_view_deg=27.0),
        background_level=1.5,
    )


def on_stand(mesh: Mesh, body: Material, stand: Material) -> tuple[Scene, float]:
    """A mesh in the teapot's place, made as large as fits there; and what it was scaled by."""
    fitted, scale = standing(mesh, reach=REACH, height=HEIGHT)
    alone = teapot(body, stand)
    return Scene(((fitted, body), alone.things[1]), alone.camera, alone.background_level), scale


def metamers(first: Material, second: Material, stand: Material) -> Scene:
    """Two teapots beside each other, the first on the left, both in the same light."""
    things = tuple(
        (placed(teapot_mesh(), at=(x - 0.011, 0.0, 0.0)), body)
        for x, body in ((-0.175, first), (0.175, second))
    )
    return Scene(
        things=(*things, (_stand(0.38), stand)),
        camera=Camera(eye=(0.0, 0.34, 1.35), target=(0.0, 0.05, 0.0), vertical_view_deg=20.0),
        background_level=2.0,
    )


def grid(rows: Sequence[Sequence[Material]], *, background_level=2.0) -> Scene:
    """Spheres in rows, upright before the camera, the first row on top.

    rows  of materials, all of one length
    """
    height, width = len(rows), len(rows[0])
    ball = sphere(radius=0.43 * _PITCH, segments=48)
    things = tuple(
        (placed(ball, at=(_PITCH * (x - (width - 1) / 2), _PITCH * ((height - 1) / 2 - y), 0)), m)
        for y, row in enumerate(rows)
        for x, m in enumerate(row)
    )
    distance = 3.5 * _PITCH * max(height, width)
    view = 2 * np.degrees(np.arctan((height + _MARGIN) * _PITCH / 2 / distance))
    return Scene(
        things=things,
        camera=Camera((0.0, 0.0, distance), (0.0, 0.0, 0.0), float(view)),
        background_level=background_level,
    )


def grid_aspect(rows: Sequence[Sequence[Material]]) -> float:
    """Width over height of the picture that `grid` fills."""
    return (len(rows[0]) + _MARGIN) / (len(rows) + _MARGIN)


def fitted_camera(meshes: Sequence[Mesh], *, aspect: float, vertical_view_deg=27.0) -> Camera:
    """A camera a little above, on the +Z side, that sees the whole of some meshes."""
    low, high = extent(meshes)
    middle = (low + high) / 2
    radius = float(np.linalg.norm(high - low)) / 2
    half = np.radians(vertical_view_deg) / 2
    narrower = min(half, np.arctan(np.tan(half) * aspect))
    distance = 0.95 * radius / np.sin(narrower)
    up = np.radians(15.0)
    x, y, z = (middle + distance * np.array([0.0, np.sin(up), np.cos(up)])).tolist()
    a, b, c = middle.tolist()
    return Camera((x, y, z), (a, b, c), vertical_view_deg)


_PITCH = 0.1  # from sphere to sphere
_MARGIN = 0.5  # about them, in pitches


def _stand(radius: float) -> Mesh:
    return revolved(_stand_profile(radius=radius, height=0.03, edge=0.008), 192)


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
