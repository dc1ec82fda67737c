"""Several views made one: three photographs of a sphere, 120 degrees apart, whoever took them in.

The photographs are traced ray by ray by the tests' own tracer, in worlds with edges and lamps; how
the views lie is told to nobody.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.figure import Figure
from stages import cube
from stages.align import Alignment
from stages.join import join
from stages.mirror import Sphere
from stages.normalise import normalise, reflectance_at
from stages.orient import orient
from stages.types import Measured
from stages.unwrap import unwrap

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from small_views import photographed, someone  # type: ignore[import-not-found]
from sphere_tracer import (  # type: ignore[import-not-found]
    Camera,
    busy_world,
    chromium,
    smooth_world,
)

_RIM, _SIZE = 200.0, 128
_WORLDS = {
    "with edges": busy_world(2, channels=3),
    "smooth": smooth_world(1, degree=8.0, channels=3),
}
_COSINE = np.linspace(1.0, 0.0, 500) ** 2
_REFLECTANCE = np.arccos(_COSINE), chromium(_COSINE)


def measure() -> Iterator[Figure]:
    for name, world in _WORLDS.items():
        yield from _joined(name, world)


def _joined(name: str, world) -> Iterator[Figure]:
    rng = np.random.default_rng(4)
    turns = [np.eye(3)]
    for yaw in (120.0, -120.0):
        angles = [yaw, 0.0, 0.0] + rng.normal(size=3) * (8.0, 8.0, 3.0)
        turns.append(Rotation.from_euler("YXZ", angles, degrees=True).as_matrix())
    images, spheres = zip(*(_taken(world, t, k) for k, t in enumerate(turns)), strict=True)
    names = ("first", "second", "third")
    found = orient(images, spheres, names=names, places=[None] * 3, reflectance=_REFLECTANCE).views
    off = [
        float(np.degrees(Rotation.from_matrix(np.asarray(view.turn) @ turn.T).magnitude()))
        for view, turn in zip(found[1:], turns[1:], strict=True)
    ]
    yield Figure(f"three views, {name}: rotation, worst error", max(off), "degrees", high=0.05)

    turned = [replace(s, turn=v.turn) for s, v in zip(spheres, found, strict=True)]
    d = cube.directions(_SIZE)
    still = Alignment(np.zeros((1, 2)), np.ones(1), np.zeros(1))
    angles, factors = _REFLECTANCE
    views = [
        normalise(
            unwrap([image], sphere, still, face_size=_SIZE),
            reflectance_at(sphere.incidence_angle(d), angles, factors[:, None]),
        )
        for image, sphere in zip(images, turned, strict=True)
    ]
    light = join(views, turned).light
    yield Figure(f"three views, {name}: directions not seen", _share(light.valid == 0), "%", high=0)
    truth = _truth(world)
    before = [someone((d @ turn).reshape(-1, 3)).reshape(d.shape[:-1]) for turn in turns]
    there = np.logical_or.reduce(before)
    ratio = np.abs(light.values / truth - 1.0).max(axis=-1)
    alone = np.abs(views[0].values / truth - 1.0).max(axis=-1)
    yield Figure(
        f"three views, {name}: median error where the first sees its photographer, alone",
        100.0 * float(np.nanmedian(alone[before[0]])),
        "%",
    )
    yield Figure(
        f"three views, {name}: median error where any sees one, joined",
        100.0 * float(np.median(ratio[there])),
        "%",
        high=2.0,
    )
    for what, values in (("the first alone", views[0].values), ("joined", light.values)):
        yield Figure(
            f"three views, {name}: dE2000 of a diffuse white, worst way it faces, {what}",
            _white(values, truth),
            high=0.5 if what == "joined" else None,
        )


def _taken(world, turn, seed: int) -> tuple[Measured, Sphere]:
    """A photograph with its photographer, and where the sphere is in it."""
    height, width = int(2.3 * _RIM), int(2.5 * _RIM)
    camera = Camera.seeing(width / 2 + 6.3, height / 2 - 4.1, _RIM, height, width)
    return photographed(camera, world, turn, seed=seed, rim_samples=5)


def _truth(world, parts: int = 4):
    """The mean of the world over each texel (6, N, N, 3)."""
    total = np.zeros((6, _SIZE, _SIZE, 3))
    for a in (np.arange(parts) + 0.5) / parts:
        for b in (np.arange(parts) + 0.5) / parts:
            u, v = (2.0 * (np.arange(_SIZE) + p) / _SIZE - 1.0 for p in (a, b))
            d = cube.face_directions(u[None, :], v[:, None])
            total += world(d.reshape(-1, 3)).reshape(total.shape)
    return total / parts**2


def _white(values, truth) -> float:
    """CIEDE2000 of a diffuse white under a map, the worst of 200 ways to face, channels as sRGB.

    The eye is adapted to the true light there; what is not known is black.
    """
    from colour import RGB_COLOURSPACES, XYZ_to_Lab, XYZ_to_xy
    from colour.difference import delta_E_CIE2000

    facing = np.random.default_rng(0).normal(size=(200, 3))
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    d, omega = cube.directions(_SIZE).reshape(-1, 3), np.tile(cube.solid_angles(_SIZE).ravel(), 6)
    gather = np.maximum(facing @ d.T, 0.0) * omega
    to_xyz = RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ
    seen, true = (gather @ np.nan_to_num(v.reshape(-1, 3)) @ to_xyz.T for v in (values, truth))
    worst = 0.0
    for a, b in zip(seen, true, strict=True):
        white = XYZ_to_xy(b)
        one, other = (XYZ_to_Lab(x / b[1], white) for x in (a, b))
        worst = max(worst, float(delta_E_CIE2000(one, other)))
    return worst


def _share(mask) -> float:
    omega = cube.solid_angles(_SIZE)
    return 100.0 * float(np.sum(mask * omega) / (4.0 * np.pi))
