"""A small map of a made-up room, quickly: daylight one way, tungsten the other, a lamp, a hole."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calibration import primaries as primary_sets
from calibration import sets
from pipeline import io
from pipeline.files import header as headers
from stages import cube
from stages.types import Measured

SIZE = 64  # texels along a face
UNIT = "W/(sr m2 nm)"
LEVEL = 4e-4  # of a white wall, in that unit
HOLE = (0.0, 0.0, -1.0)  # 20 degrees about it nothing was measured


def measured(
    size: int = SIZE, noise: float = 0.01, name: str = primary_sets.DEFAULT
) -> tuple[Measured, primary_sets.Primaries]:
    """The map, and the primaries of that name it is in."""
    rng = np.random.default_rng(7)
    primaries = primary_sets.load(name)
    d = cube.directions(size)
    lights = sets.lights("darling2011")
    day, warm = (primaries.project(lights[name] / lights[name].mean()) for name in ("D65", "A"))
    wall = 1.0 + 0.4 * np.sin(7 * d[..., 0]) * np.cos(5 * d[..., 1] + 3 * d[..., 2])
    to_window = np.clip(0.5 - 0.8 * d[..., 0] + 0.4 * d[..., 2], 0.05, None)
    window = (
        8.0 * (np.maximum(np.abs(d[..., 1]), np.abs(d[..., 2] - 0.4)) < 0.25) * (d[..., 0] < -0.8)
    )
    lamp = 400.0 * (d @ np.array([0.74, 0.42, 0.52]) > np.cos(np.radians(2.5)))
    light = (wall * to_window + window)[..., None] * day
    light = light + (wall * np.clip(0.4 + 0.5 * d[..., 0], 0.05, None) + lamp)[..., None] * warm
    light *= LEVEL
    sigma = noise * light + 0.002 * LEVEL
    values = light + sigma * rng.standard_normal(light.shape)
    valid = np.clip((np.degrees(np.arccos(d @ np.array(HOLE))) - 20.0) / 2.0, 0.0, 1.0)
    known = (valid > 0)[..., None]
    return (
        Measured(
            np.where(known, values, np.nan).astype(np.float32),
            np.where(known, sigma**2, np.nan).astype(np.float32),
            valid.astype(np.float32),
        ),
        primaries,
    )


def write(folder: Path, name: str, primaries: str = primary_sets.DEFAULT) -> Path:
    """cubemap.exr in a folder, as `sixlight envmap` writes it; returns the file."""
    light, known = measured(name=primaries)
    header = headers.of_primaries(known, unit=UNIT, quantity="light") | {"name": name}
    file = folder / "cubemap.exr"
    io.write_measured(file, light, known.channels, header)
    return file
