"""The room about the sphere as a box: where walls are near, direction depends on where one stands.

A texel of the cubemap is a direction from the sphere's centre, but the mirror sees the world from
its surface. At the distance L of a wall the two differ by up to radius / L: .8 degrees in a room,
for a sphere of 100 mm. A box, measured with a tape, says where the walls are, and so takes most of
that away; furniture stands nearer than its wall and keeps a part of it.

The room's axes are the photographer's: x to the right as the camera sees it, y up from the floor,
z from the wall behind the sphere towards the camera's wall; the origin is the corner where the
left wall, the floor and the wall behind the sphere meet.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Room:
    """A box, and where sphere and camera stand in it, all (3,) in metres in the room's axes.

    size_m    of the box
    sphere_m  the sphere's centre, inside the box
    camera_m  a place on the line from the sphere to the camera's entrance pupil, as that itself;
              left out, the camera is taken to look along the room's z, level
    """

    size_m: tuple[float, float, float]
    sphere_m: tuple[float, float, float]
    camera_m: tuple[float, float, float] | None = None

    @property
    def room_from_world(self) -> Array:
        """Rotation (3, 3) of directions from the result's world (no yaw) to the room's axes."""
        if self.camera_m is None:
            return np.eye(3)
        z = np.subtract(self.camera_m, self.sphere_m)
        z = z / np.linalg.norm(z)
        y = np.array([0.0, 1.0, 0.0]) - z[1] * z
        y /= np.linalg.norm(y)
        return np.stack([np.cross(y, z), y, z], axis=-1)

    def wall(self, start, directions) -> Array:
        """Where rays from inside the box meet it.

        start       (..., 3) m from the sphere's centre, in the result's world (no yaw)
        directions  (..., 3) of any length, likewise
        returns     (..., 3) likewise
        """
        turn = self.room_from_world
        start, along = np.asarray(start) @ turn.T, np.asarray(directions) @ turn.T
        sphere = np.asarray(self.sphere_m)
        far = np.where(along > 0, np.asarray(self.size_m) - sphere, -sphere)
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = np.where(along != 0, (far - start) / along, np.inf)
        place = start + np.min(steps, axis=-1, keepdims=True) * along
        return np.asarray(place @ turn)
