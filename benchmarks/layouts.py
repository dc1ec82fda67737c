"""Conversions between layouts: there and back, energy over the sphere, and of a lamp of one pixel.

Rows of `python -m benchmarks unwrap`.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.figure import Figure
from stages.layouts import CUBE, PROJECTIONS, Projection
from stages.resample import matrix_between

FACE = 48  # texels along a cube's face, and as much detail in the other layouts
SLIVER = 0.01  # of a mean pixel's solid angle: smaller ones, on a disc's rim, are not counted
_PARTS = 8  # along a pixel's side, over which the world is averaged
_TURN = 1.2 * np.array([0.36, 0.48, 0.8])  # rad, of that length about that axis, between two


def measure() -> Iterator[Figure]:
    """All 25 pairs, turned; a world of degree three with mean 2 and range about 3."""
    errors: dict[str, list[float]] = {"cube, latlong, angular, octahedral": [], "mirror ball": []}
    world_energy, lamp_energy, mean_kept = [], [], []
    turn = Rotation.from_rotvec(_TURN).as_matrix()
    for source, target in itertools.product(PROJECTIONS.values(), repeat=2):
        rows, target_rows = _rows(source), _rows(target)
        there = matrix_between(source, rows, target, target_rows, rotation=turn)
        back = matrix_between(target, target_rows, source, rows, rotation=turn.T)
        has, takes = _solid_angles(source, rows), _solid_angles(target, target_rows)
        before = _world(source, rows)
        after = there @ before
        apart = np.sqrt(((back @ after - before) ** 2 @ np.ones(3) / 3 * has).sum() / has.sum())
        ball = "mirrorball" in (source.name, target.name)
        errors["mirror ball" if ball else "cube, latlong, angular, octahedral"].append(apart / 2)
        world_energy.append(np.abs((takes @ after) / (has @ before) - 1).max())
        counts = has > SLIVER * has[has > 0].mean()
        lamp_energy.append(np.abs((there.T @ takes)[counts] / has[counts] - 1).max())
        mean_kept.append(np.abs(there.sum(axis=1)[takes > 0] - 1).max())
    for names, found in errors.items():
        name = f"there and back, rms over the mean, worst pair: {names}"
        yield Figure(name, 100.0 * max(found), "%", high=0.5)
    yield Figure(
        "energy of that world, worst of 25 pairs of layouts", 100 * max(world_energy), "%", high=0.1
    )
    yield Figure(
        "energy of one lit pixel, worst pixel of 25 pairs", 100 * max(lamp_energy), "%", high=0.1
    )
    yield Figure("a constant map, worst pixel of 25 pairs", 100 * max(mean_kept), "%", high=0.001)
    began = time.process_time()
    matrix_between(CUBE, 512, PROJECTIONS["latlong"], 1024)
    spent = time.process_time() - began
    yield Figure("6 x 512 x 512 to latlong 2048 x 1024, any channels, CPU", spent, "s")


def _rows(projection: Projection) -> int:
    return 2 * round(FACE * projection.rows_per_radian / CUBE.rows_per_radian / 2)


def _solid_angles(projection: Projection, rows: int):
    return np.tile(projection.solid_angles(rows).reshape(-1), projection.sheets)


def _world(projection: Projection, rows: int):
    """Means over pixels (n, 3) of a world of degree three; 0 where a layout looks nowhere."""
    sheets, height, width = projection.shape(rows)
    u = (np.arange(width * _PARTS) + 0.5) / (width * _PARTS)
    v = (np.arange(height * _PARTS) + 0.5)[:, None] / (height * _PARTS)
    faces = []
    for sheet in range(sheets):
        weight = np.broadcast_to(projection.density(u[None, :], v), (len(v), len(u)))
        d = projection.direction(sheet, u[None, :], v)
        x, y, z = np.moveaxis(np.where(weight[..., None] > 0, d, 0.0), -1, 0)
        value = np.stack([2 + x, 2 + x * y - z, 2 + x * y * z + y * y * z], axis=-1)
        sums = _pooled(value * weight[..., None])
        total = _pooled(weight[..., None])
        faces.append((sums / np.where(total > 0, total, 1.0)).reshape(-1, 3))
    return np.concatenate(faces)


def _pooled(a):
    height, width, channels = a.shape
    return a.reshape(height // _PARTS, _PARTS, width // _PARTS, _PARTS, channels).sum(axis=(1, 3))
