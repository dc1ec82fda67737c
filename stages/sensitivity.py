"""How far directions move when what is known of the sphere is a little wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stages.mirror import Sphere

_RINGS = (90.0, 135.0, 160.0)  # degrees from +Z, where it is told


def sensitivity(sphere: Sphere, *, distance_known: bool) -> dict[str, dict[str, float]]:
    """The median change of directions, in degrees, at rings about +Z, for each uncertain number.

    sphere          as found
    distance_known  whether the tape decided, or the lens (`Sphere.from_rim`)
    returns         by what is wrong, then by the ring: {"rim +1 px": {"90 degrees": .14, ...}, ...}
    """
    t = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
    x, y = sphere.centre_px
    distant = replace(sphere, room=None)

    def made(dx=0.0, dr=0.0, radius=1.0, distance=1.0, focal=1.0, bend=1.0) -> Sphere:
        by_tape = {"distance_mm": sphere.distance_mm * distance}
        by_lens = {"focal_px": sphere.focal_px * focal}
        return Sphere.from_rim(
            x + dx,
            y,
            sphere.rim_px + dr,
            radius_mm=sphere.radius_mm * radius,
            principal_px=sphere.principal_px,
            yaw_deg=sphere.yaw_deg,
            distortion=[bend * k for k in sphere.distortion],
            **(by_tape if distance_known else by_lens),
        )

    others = {"centre +1 px": made(dx=1.0), "rim +1 px": made(dr=1.0)}
    if distance_known:
        others |= {"distance_mm +1 %": made(distance=1.01), "radius_mm +1 %": made(radius=1.01)}
    else:
        others["focal length +1 %"] = made(focal=1.01)
    if any(sphere.distortion):
        others["distortion +10 %"] = made(bend=1.1)
    towards = distant.direction_of(distant.centre_px)
    across = np.cross(towards, (0.0, 1.0, 0.0))
    across /= np.linalg.norm(across)
    down = np.cross(towards, across)
    moved: dict[str, dict[str, float]] = {name: {} for name in others}
    for ring in _RINGS:
        angle = np.radians(ring)
        around = np.cos(t)[:, None] * across + np.sin(t)[:, None] * down
        directions = np.cos(angle) * towards + np.sin(angle) * around
        pixels, _ = distant.pixel_of(directions)
        for name, other in others.items():
            cosine = np.sum(other.direction_of(pixels) * directions, axis=-1)
            change = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
            moved[name][f"{ring:g} degrees"] = round(float(np.median(change)), 3)
    return moved
