"""Environments to judge renders under: spectral radiance, a cube of 36 wavelengths each.

Made of `calibration.sets` lights; nothing here is random.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration import sets
from calibration.spectra import WAVELENGTHS
from pipeline.io import read_exr
from stages import cube as cubes

ROOM = Path("sample_captures/room/truth/spectral.exr")

World = NDArray[np.float32]


def room() -> World:
    """What the bundled capture was made from (6, 64, 64, 36): a room, a window and two lamps."""
    pixels, names, _ = read_exr(ROOM)
    assert names == [f"{w:.0f}nm" for w in WAVELENGTHS], names
    n = pixels.shape[1]
    return pixels.reshape(6, n, n, len(WAVELENGTHS))


def sun(n: int = 128) -> World:
    """Out of doors: a sun of half a degree that gives four times what the blue sky gives.

    The sky is bluer above than at the horizon; the ground reflects a fifth of it.
    """
    towards = _unit([0.45, 0.62, 0.64])
    d = cubes.directions(n)
    zenith, horizon = _light("daylight", -1), _light("darling2011", "D65")
    up = np.clip(d[..., 1:2], 0, 1)
    sky = np.where(d[..., 1:2] > 0, 0.7 * zenith * up + horizon * (1 - 0.5 * up), 0.2 * horizon)
    disc = _covered(n, lambda e: e @ towards > np.cos(np.radians(0.25)))
    flux = (disc * cubes.solid_angles(n)).sum()
    level = 4 * np.pi / flux  # the sky's irradiance is about pi
    return (sky + level * disc[..., None] * _light("planckian", -6)).astype(np.float32)


def window(n: int = 64) -> World:
    """A dark room, and daylight through a window from the left."""
    d = cubes.directions(n)
    opening = _covered(n, lambda e: _rectangle(e, [-1, 0.25, 0.45], 0.42, 0.5))
    dark = np.broadcast_to(0.02 * _light("darling2011", "A"), (*d.shape[:-1], 36))
    return (dark + opening[..., None] * 8.0 * _light("darling2011", "D65")).astype(np.float32)


def uniform(n: int = 16) -> World:
    """Equal energy from everywhere: whatever reflects all is 1."""
    return np.ones((6, n, n, len(WAVELENGTHS)), np.float32)


def two_lights(left, right, n: int = 64) -> World:
    """A black world with one light (36,) at -X and another at +X, each a window 40 degrees wide."""
    world = np.zeros((6, n, n, len(WAVELENGTHS)), np.float32)
    for side, spectrum in ((-1.0, left), (1.0, right)):
        opening = _covered(n, lambda e, side=side: _rectangle(e, [side, 0.2, 0.0], 0.36, 0.36))
        world += (opening[..., None] * 6.0 * np.asarray(spectrum)).astype(np.float32)
    return world


def _light(set_: str, which) -> NDArray[np.float64]:
    """A light of a set by name, or by number, Y = 1."""
    lights = sets.lights(set_)
    name = which if isinstance(which, str) else lights.names[which]
    return np.asarray(lights[name])


def _rectangle(direction, middle, half_width: float, half_height: float):
    """Whether directions (..., 3) lie in an upright rectangle; extents as tangents."""
    ahead = _unit(middle)
    right = _unit(np.cross(ahead, [0.0, 1.0, 0.0]))
    depth = direction @ ahead
    inside = np.abs(direction @ right) < half_width * depth
    return inside & (np.abs(direction @ np.cross(right, ahead)) < half_height * depth)


def _covered(n: int, inside, parts: int = 6) -> NDArray[np.float64]:
    """How much of each texel (6, n, n) lies inside, by the texel's parts."""
    covered = np.zeros((6, n, n))
    offset = (np.arange(parts) + 0.5) / parts
    t = np.arange(n)
    for a in offset:
        for b in offset:
            u, v = (2 * (t + x) / n - 1 for x in (a, b))
            covered += inside(cubes.face_directions(u[None, :], v[:, None]))
    return covered / parts**2


def _unit(v) -> NDArray[np.float64]:
    v = np.asarray(v, np.float64)
    return v / np.linalg.norm(v)
