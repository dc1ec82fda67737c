"""The light on a room's surfaces: radiosity with Mitsuba's rays, all wavelengths at once.

Surfaces are matte, so the light that leaves a point is its reflectance times one number a
wavelength. Those numbers are sought at points a few centimetres apart: directly from the lamps and
the window by rays toward them, and from everything else by

    light = direct + gather @ (reflectance * light)

where row p of the sparse matrix `gather` averages, over cosine-distributed rays from point p, what
they meet (Goral et al. 1984; here by Monte Carlo). Which way rays go does not depend on
wavelength, so the rays are traced once and all 36 wavelengths share them, and their noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import csr_array

from calibration.spectra import WAVELENGTHS
from pipeline.simulate.render import (
    Progress,
    Scene,
    Surface,
    at_wavelengths,
    blocked,
    cells,
    flat_normals,
    look,
    mitsuba,
)  # fmt: skip

BOUNCES = 12  # at reflectances about a half the next would add a ten-thousandth
AT_ONCE = 4_000_000  # rays: bounds the memory
SMOOTHING = 0.9  # points, standard deviation of the Gaussian that takes noise out
LIFT = 1e-3  # m above a surface that rays start


def bake(scene: Scene, *, spacing: float, samples: int, seed: int, progress: Progress) -> Scene:
    """The scene with the light on its surfaces found, ready to be looked at.

    spacing  metres between the points where light is found; flat surfaces are divided so finely
    samples  rays a point, for what surfaces send each other, and as many toward the lights
    """
    surfaces = [_divided(s, spacing) for s in scene["surfaces"]]
    whole = scene | {"surfaces": surfaces}
    points = _Points.over(surfaces, spacing)
    mi = mitsuba()
    loaded = mi.load_dict(at_wavelengths(whole, 0))
    rng = np.random.default_rng(seed)
    light = np.zeros((len(points), len(WAVELENGTHS)), np.float32)
    for name, item in scene.items():
        if isinstance(item, dict) and "emitter" in item:
            light += _direct(loaded, points, item, samples, rng)
            progress(f"light: from {name}")
    gather = _gather(mi, loaded, points, samples, rng)
    progress("light: what surfaces see")
    direct = light
    for _ in range(BOUNCES):
        light = direct + gather @ (points.reflectance * light)
    progress("light: between surfaces")
    return whole | {"surfaces": points.onto(surfaces, light), "integrator": look()}


@dataclass(frozen=True)
class _Points:
    """The points light is found at: a coarse grid over each surface's own.

    For each point: `row`, `column` in its coarse grid, `surface` the number of its surface,
    `reflectance` (n, 36) of its surroundings. For each surface: `grids` (S, 2) size of the coarse
    grid, `shapes` (S, 2) cells of its own grid, `first_point`, `first_cell` (S,). For each cell,
    all surfaces' in turn: `corners` (C, 4, 3) and `normals` (C, 3).
    """

    row: NDArray[np.intp]
    column: NDArray[np.intp]
    surface: NDArray[np.intp]
    reflectance: NDArray[np.float32]
    grids: NDArray[np.intp]
    shapes: NDArray[np.intp]
    first_point: NDArray[np.intp]
    first_cell: NDArray[np.intp]
    corners: NDArray[np.float64]
    normals: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.row)

    @classmethod
    def over(cls, surfaces: Sequence[Surface], spacing: float) -> _Points:
        grids = np.array([_coarse(s.points, spacing) for s in surfaces])
        shapes = np.array([np.subtract(s.points.shape[:2], 1) for s in surfaces])
        counts, cell_counts = grids.prod(axis=1), shapes.prod(axis=1)
        within = [np.indices(grid).reshape(2, -1) for grid in grids]
        corners = np.concatenate([cells(s.points).reshape(-1, 4, 3) for s in surfaces])
        return cls(
            row=np.concatenate([w[0] for w in within]),
            column=np.concatenate([w[1] for w in within]),
            surface=np.repeat(np.arange(len(surfaces)), counts),
            reflectance=np.concatenate(
                [_surroundings(s, grid) for s, grid in zip(surfaces, grids, strict=True)]
            ),
            grids=grids,
            shapes=shapes,
            first_point=np.cumsum(counts) - counts,
            first_cell=np.cumsum(cell_counts) - cell_counts,
            corners=corners,
            normals=flat_normals(corners),
        )

    def scattered(self, count: int, rng) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Places and normals (n * count, 3): `count` about each point, halfway to the next."""
        index = np.repeat(np.arange(len(self)), count)
        surface = self.surface[index]
        t = np.stack([self.row[index], self.column[index]], axis=1) + rng.uniform(
            -0.5, 0.5, (len(index), 2)
        )
        t = np.abs(t / (self.grids[surface] - 1))
        t = (1.0 - np.abs(1.0 - t)) * self.shapes[surface]  # folded back at the rims
        cell = np.minimum(t.astype(np.intp), self.shapes[surface] - 1)
        v, u = (t - cell).T[..., None]
        cell = self.first_cell[surface] + cell[:, 0] * self.shapes[surface, 1] + cell[:, 1]
        a, b, c, d = np.moveaxis(self.corners[cell], 1, 0)
        # on the triangles 0 1 2 and 0 2 3 that a cell consists of
        place = a + np.where(v < u, u * (b - a) + v * (c - b), v * (d - a) + u * (c - d))
        normal = self.normals[cell]
        return place + LIFT * normal, normal

    def at(self, triangle, barycentric, rng) -> NDArray[np.intp]:
        """The point (n,) near a place on a triangle, drawn so that the average interpolates."""
        cell, second = triangle // 2, triangle % 2
        surface = np.searchsorted(self.first_cell, cell, side="right") - 1
        b1, b2 = barycentric
        v = np.where(second, b1 + b2, b2)  # triangles 0 1 2 and 0 2 3 of corners 00 01 11 10
        u = np.where(second, b1, b1 + b2)
        columns = self.shapes[surface, 1]
        i, j = np.divmod(cell - self.first_cell[surface], columns)
        r, c = self.grids[surface].T
        row = (i + v) * (r - 1) / self.shapes[surface, 0] + rng.random(len(cell))
        column = (j + u) * (c - 1) / columns + rng.random(len(cell))
        row, column = (
            np.minimum(row.astype(np.intp), r - 1),
            np.minimum(column.astype(np.intp), c - 1),
        )
        return self.first_point[surface] + row * c + column

    def onto(self, surfaces: Sequence[Surface], light) -> list[Surface]:
        """The surfaces with the light (n, 36) at the points interpolated to their own grids."""
        parts = np.split(light, self.first_point[1:])
        return [
            replace(s, light=_interpolated(part.reshape(*grid, -1), s.points.shape[:2]))
            for s, part, grid in zip(surfaces, parts, self.grids, strict=True)
        ]


def _sizes(points) -> tuple[float, float]:
    """How long a grid's columns and rows are at most, metres."""
    down = np.linalg.norm(np.diff(points, axis=0), axis=-1).sum(axis=0).max()
    across = np.linalg.norm(np.diff(points, axis=1), axis=-1).sum(axis=1).max()
    return float(down), float(across)


def _divided(surface: Surface, spacing: float) -> Surface:
    """A single flat cell divided into ones no larger than `spacing`; others as they are."""
    if surface.points.shape[:2] != (2, 2):
        return surface
    rows, columns = (int(np.ceil(size / spacing)) for size in _sizes(surface.points))
    v = np.linspace(0, 1, rows + 1)[:, None, None]
    u = np.linspace(0, 1, columns + 1)[None, :, None]
    p = surface.points
    points = (1 - v) * ((1 - u) * p[0, 0] + u * p[0, 1]) + v * ((1 - u) * p[1, 0] + u * p[1, 1])
    return replace(surface, points=points, reflectance=surface.reflectance.reshape(-1))


def _coarse(points, spacing: float) -> tuple[int, int]:
    """Size of the grid of points light is found at, no finer than the surface's own."""
    rows, columns = (int(np.ceil(size / spacing)) + 1 for size in _sizes(points))
    return min(rows, points.shape[0]), min(columns, points.shape[1])


def _surroundings(surface: Surface, grid) -> NDArray[np.float32]:
    """The mean reflectance (r * c, 36) of the cells nearest each point of the coarse grid."""
    r, c = grid
    if surface.reflectance.ndim == 1:
        return np.tile(surface.reflectance.astype(np.float32), (r * c, 1))
    rows, columns = surface.reflectance.shape[:2]
    down, across = (
        np.clip(1 - np.abs((np.arange(n) + 0.5) * (m - 1) / n - np.arange(m)[:, None]), 0, None)
        for m, n in ((r, rows), (c, columns))
    )
    down, across = (w / w.sum(axis=1, keepdims=True) for w in (down, across))
    mean = np.einsum("ri,cj,ijk->rck", down, across, surface.reflectance, optimize=True)
    return mean.reshape(r * c, -1).astype(np.float32)


def _interpolated(light, shape) -> NDArray[np.float32]:
    """Light (r, c, 36), its noise smoothed a little, linear between, at a grid of `shape`."""
    for axis in (0, 1):
        if light.shape[axis] >= 5:
            light = gaussian_filter1d(light, SMOOTHING, axis=axis, mode="nearest")
        if light.shape[axis] != shape[axis]:
            at = np.linspace(0, light.shape[axis] - 1, shape[axis])
            low = np.minimum(at.astype(int), light.shape[axis] - 2)
            share = (at - low).reshape((-1, 1, 1) if axis == 0 else (1, -1, 1))
            near, far = np.take(light, low, axis), np.take(light, low + 1, axis)
            light = near + share * (far - near)
    return light.astype(np.float32)


def _direct(loaded, points: _Points, light: Scene, samples: int, rng) -> NDArray[np.float32]:
    """What one light sends to the points (n, 36), as radiance of a perfect white."""
    radiance = light["emitter"]["radiance"]
    patch = radiance.reshape(-1, radiance.shape[-1])
    result = np.zeros((len(points), len(WAVELENGTHS)), np.float32)
    count = min(samples, 64) if len(patch) == 1 else samples
    at_once = max(1, AT_ONCE // len(points))
    start = rng.random((len(points), 2))
    for begin in range(0, count, at_once):
        k = min(at_once, count - begin)
        place, normal = points.scattered(k, rng)
        target, facing, area, index = _on_light(light, place, _even(start, begin, k))
        toward = target - place
        distance = np.linalg.norm(toward, axis=1)
        toward /= distance[:, None]
        cosines = np.clip((toward * normal).sum(1), 0, None)
        cosines *= np.clip(-(toward * facing).sum(1), 0, None)
        weight = cosines * area / (np.pi * distance**2)
        able = weight > 0
        # Just short of the light itself; a bulb's disk lies inside the bulb, a radius deep.
        weight[able] *= ~blocked(loaded, place[able], toward[able], distance[able] - 0.02)
        columns = csr_array(
            (weight.astype(np.float32), index, np.arange(0, len(place) + 1, k)),
            shape=(len(points), len(patch)),
        )
        result += (columns @ patch.astype(np.float32)) / count
    return result


def _even(start, begin: int, count: int) -> NDArray[np.float64]:
    """Numbers (2, n * count) that fill the unit square evenly, `count` from each `start` (n, 2).

    Terms begin, begin + 1, ... of the additive recurrence of Roberts 2018 ("R2").
    """
    step = np.array([0.7548776662466927, 0.5698402909980532])
    terms = np.arange(begin, begin + count)[None, :, None] * step
    return ((start[:, None, :] + terms) % 1.0).reshape(-1, 2).T


def _on_light(light: Scene, place, even):
    """Points on a light for places (n, 3), spread as `even` (2, n) is over the unit square.

    Returns points and normals (n, 3), the light's area, and which of its patches of radiance the
    points lie in (n,).
    """
    n = len(place)
    u, v = even
    radiance = light["emitter"]["radiance"]
    if light["type"] == "rectangle":
        matrix = light["to_world"]
        target = (
            matrix[:3, 3]
            + (2 * u - 1)[:, None] * matrix[:3, 0]
            + (2 * v - 1)[:, None] * matrix[:3, 1]
        )
        normal = np.cross(matrix[:3, 0], matrix[:3, 1])
        area = 4 * np.linalg.norm(normal)
        index = np.zeros(n, np.intp)
        if radiance.ndim == 3:
            rows, columns = radiance.shape[:2]
            index = (v * rows).astype(np.intp) * columns + (u * columns).astype(np.intp)
        return target, np.broadcast_to(normal / np.linalg.norm(normal), (n, 3)), area, index
    if light["type"] == "sphere":
        # A far small sphere is the disk that faces the place.
        centre, radius = np.asarray(light["center"], float), light["radius"]
        facing = place - centre
        facing /= np.linalg.norm(facing, axis=1, keepdims=True)
        side = np.cross(facing, np.where(np.abs(facing[:, :1]) < 0.9, (1.0, 0, 0), (0, 1.0, 0)))
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        a, s = 2 * np.pi * u, radius * np.sqrt(v)
        across = np.cos(a)[:, None] * side + np.sin(a)[:, None] * np.cross(facing, side)
        return centre + s[:, None] * across, facing, np.pi * radius**2, np.zeros(n, np.intp)
    corners = cells(light["surface"].points).reshape(-1, 4, 3)
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]) / 2
    areas = np.linalg.norm(normal, axis=1)
    upto = np.cumsum(areas) / areas.sum()
    chosen = np.minimum(np.searchsorted(upto, u), len(areas) - 1)
    u = (u - (upto - areas / areas.sum())[chosen]) / (areas / areas.sum())[chosen]
    a, b, c, d = np.moveaxis(corners[chosen], 1, 0)
    u, v = u[:, None], v[:, None]
    target = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c)
    facing = normal[chosen] / areas[chosen, None]
    return target + LIFT * facing, facing, areas.sum(), np.zeros(n, np.intp)


def _gather(mi, loaded, points: _Points, samples: int, rng) -> csr_array:
    """The sparse matrix (n, n) whose row averages over rays what they meet; see the module."""
    n = len(points)
    at_once = max(1, AT_ONCE // n)
    met, weight = [], []
    start = rng.random((n, 2))
    number = [shape.id() for shape in loaded.shapes()].index("surfaces")
    for begin in range(0, samples, at_once):
        k = min(at_once, samples - begin)
        place, normal = points.scattered(k, rng)
        # Cosine-distributed: a point on the unit sphere that touches the surface.
        z, a = _even(start, begin, k)
        z, a = 2 * z - 1, 2 * np.pi * a
        ring = np.sqrt(1 - z * z)
        direction = normal + np.stack([ring * np.cos(a), ring * np.sin(a), z], axis=1)
        direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)
        ray = mi.Ray3f(
            mi.Point3f(place.T.astype(np.float32)), mi.Vector3f(direction.T.astype(np.float32))
        )
        hit = loaded.ray_intersect_preliminary(ray)
        ours = np.array(hit.is_valid() & (hit.shape == loaded.shapes()[number]))
        triangle = np.where(ours, np.array(hit.prim_index), 0).astype(np.intp)
        seen_from_front = (points.normals[triangle // 2] * direction).sum(1) < 0
        met.append(
            points.at(triangle, np.where(ours, np.array(hit.prim_uv), 0.0), rng)
            .reshape(n, k)
            .astype(np.int32)
        )
        weight.append((ours & seen_from_front).reshape(n, k).astype(np.float32) / samples)
    rows = np.arange(0, n * samples + 1, samples)
    return csr_array(
        (np.concatenate(weight, axis=1).ravel(), np.concatenate(met, axis=1).ravel(), rows),
        shape=(n, n),
    )
