"""Meshes made here, the teapot and spheres and planes; and what meshes from elsewhere lack.

Lengths in metres, +Y up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from stages.scene import Mesh


def teapot_mesh(*, segments=20, height=0.15) -> Mesh:
    """The Utah teapot standing on y = 0 about the Y axis, spout to +X.

    segments  quads along each side of a patch
    height    from table to knob, metres

    Martin Newell's 28 bicubic Bezier patches of 1975, with the four of the bottom that were added
    later: a data set in the public domain. It has z up, and its patches are seen from inside.
    """
    control = _control_points()
    t = np.linspace(0.0, 1.0, segments + 1)
    positions = _bezier(control, t, t)
    normals = _bezier_normals(control, t)
    row, column = np.meshgrid(np.arange(segments), np.arange(segments), indexing="ij")
    corner = (row * (segments + 1) + column).ravel()
    below, right = corner + segments + 1, corner + 1
    quads = np.stack([corner, right, below, right, below + 1, below], axis=1).reshape(-1, 3)
    per_patch = (segments + 1) ** 2
    triangles = (np.arange(len(control))[:, None, None] * per_patch + quads).reshape(-1, 3)
    scale = height / control[..., 2].max()
    y_up = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    return Mesh(
        (positions.reshape(-1, 3) @ y_up.T * scale).astype(np.float32),
        (normals.reshape(-1, 3) @ y_up.T).astype(np.float32),
        triangles.astype(np.int32),
    )


def sphere(*, radius=1.0, segments=64) -> Mesh:
    """A sphere about the origin, `segments` quads from pole to pole."""
    angle = np.linspace(0.0, np.pi, segments + 1)
    outline = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    outline[[0, -1], 0] = 0.0
    return revolved((radius * outline, outline), 2 * segments)


def plane(*, size=1.0, segments=32) -> Mesh:
    """A square on y = 0 about the origin, facing up; an image lies on it with its foot to +Z."""
    t = np.linspace(0.0, 1.0, segments + 1)
    u, v = np.meshgrid(t, t)
    positions = np.stack([u - 0.5, np.zeros_like(u), 0.5 - v], axis=-1).reshape(-1, 3) * size
    row, column = np.meshgrid(np.arange(segments), np.arange(segments), indexing="ij")
    corner = (row * (segments + 1) + column).ravel()
    right, above = corner + 1, corner + segments + 1
    triangles = np.stack([corner, right, above, right, above + 1, above], axis=1).reshape(-1, 3)
    return Mesh(
        positions.astype(np.float32),
        np.tile(np.array([0, 1, 0], np.float32), (len(positions), 1)),
        triangles.astype(np.int32),
        uv=np.stack([u, v], axis=-1).reshape(-1, 2).astype(np.float32),
        tangents=np.tile(np.array([1, 0, 0], np.float32), (len(positions), 1)),
    )


def placed(mesh: Mesh, *, at=(0.0, 0.0, 0.0), scale=1.0, turn_deg=0.0) -> Mesh:
    """The mesh scaled about the origin, turned about +Y from +Z towards +X, then moved."""
    angle = np.radians(turn_deg)
    cos, sin = np.cos(angle), np.sin(angle)
    rotation = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])

    def about(vectors):
        return np.asarray(vectors, np.float64) @ rotation.T

    return replace(
        mesh,
        positions=(scale * about(mesh.positions) + np.asarray(at)).astype(np.float32),
        normals=about(mesh.normals).astype(np.float32),
        tangents=None if mesh.tangents is None else about(mesh.tangents).astype(np.float32),
    )


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Several meshes as one; images and tangents are kept where all have a place for them."""
    starts = np.cumsum([0, *(len(mesh.positions) for mesh in meshes)])[:-1]

    def all_of(name):
        parts = [getattr(mesh, name) for mesh in meshes]
        return None if any(part is None for part in parts) else np.concatenate(parts)

    return Mesh(
        np.concatenate([mesh.positions for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate(
            [mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)]
        ).astype(np.int32),
        uv=all_of("uv"),
        tangents=all_of("tangents"),
    )


def extent(meshes: Sequence[Mesh]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The lowest and the highest corner (3,) of the box about some meshes."""
    used = [mesh.positions[np.unique(mesh.triangles)] for mesh in meshes]
    low, high = (np.array([pick(p, axis=0) for p in used], np.float64) for pick in (np.min, np.max))
    return low.min(axis=0), high.max(axis=0)


def standing(mesh: Mesh, *, reach: float, height: float) -> tuple[Mesh, float]:
    """A mesh of any size as large as fits, standing on y = 0 about the Y axis.

    reach    furthest from the axis, metres
    height   of the whole, metres
    returns  the mesh, and the factor it was scaled by
    """
    low, high = extent([mesh])
    centre = np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
    about = np.asarray(mesh.positions, np.float64) - centre
    furthest = np.hypot(about[:, 0], about[:, 2])[np.unique(mesh.triangles)].max()
    scale = min(
        reach / furthest if furthest > 0 else np.inf,
        height / (high[1] - low[1]) if high[1] > low[1] else np.inf,
    )
    return replace(mesh, positions=(scale * about).astype(np.float32)), float(scale)


CREASE_DEG = 40.0
"""Where two triangles meet at more than this, an edge is meant: a cube stays a cube."""


def with_normals(positions, triangles, uv=None, *, crease_deg=CREASE_DEG) -> Mesh:
    """A mesh with the normals a file left out: smooth, but for creases.

    positions   (V, 3); vertices in the same place are taken for one
    triangles   (T, 3), none of them without area
    uv          (V, 2) or None
    crease_deg  triangles at an angle of more, about their common edge, do not share a normal
    returns     vertices are divided where a crease parts their triangles, and where uv does

    A corner's normal is the sum of the triangles' about it that no crease parts from it, each
    weighted with its angle there, so that it does not matter how a polygon was cut into triangles
    (G. Thürmer and C. Wüthrich, "Computing Vertex Normals from Polygonal Facets", 1998).
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    positions = np.asarray(positions, np.float32)
    triangles = np.asarray(triangles, np.int64)
    count = len(triangles)
    place = places(positions)[triangles]
    a, b, c = (positions[triangles[:, k]].astype(np.float64) for k in range(3))
    area = np.cross(b - a, c - a)
    facing = area / np.linalg.norm(area, axis=1, keepdims=True)

    # Each side of each triangle: its two corners (numbered 3 t + k), the lower place first.
    first = np.arange(3 * count)
    second = 3 * (first // 3) + (first + 1) % 3
    swap = place.ravel()[first] > place.ravel()[second]
    first, second = np.where(swap, second, first), np.where(swap, first, second)
    ends = np.stack([place.ravel()[first], place.ravel()[second]], axis=1)
    order = np.lexsort(ends.T)
    same = (ends[order][1:] == ends[order][:-1]).all(axis=1)
    one, other = order[:-1][same], order[1:][same]
    cosine = np.einsum("ij,ij->i", facing[one // 3], facing[other // 3])
    smooth = cosine >= np.cos(np.radians(crease_deg))
    one, other = one[smooth], other[smooth]
    rows, columns = (np.concatenate([first[k], second[k]]) for k in (one, other))
    links = coo_array((np.ones(len(rows), bool), (rows, columns)), shape=(3 * count, 3 * count))
    group = connected_components(links, directed=False)[1]

    normals = np.zeros((group.max() + 1, 3))
    np.add.at(normals, group, (_corner_angles(a, b, c)[..., None] * facing[:, None]).reshape(-1, 3))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.tile([0.0, 1.0, 0.0], (len(length), 1)),
                        where=length > 0)  # fmt: skip
    # One vertex for each group and, where uv parts them, for each of the file's vertices in it.
    seam = triangles.ravel() if uv is not None else place.ravel()
    _, kept, renumbered = np.unique(
        np.stack([group, seam], axis=1), axis=0, return_index=True, return_inverse=True
    )
    source = triangles.ravel()[kept]
    return Mesh(
        positions[source],
        normals[group[kept]].astype(np.float32),
        renumbered.reshape(-1, 3).astype(np.int32),
        uv=None if uv is None else np.asarray(uv, np.float32)[source],
    )


def places(positions) -> NDArray[np.intp]:
    """A number (V,) for each vertex, the same for those in one place.

    In one place is what a millionth of the whole mesh does not part: seams are seldom exact.
    """
    positions = np.asarray(positions, np.float64)
    low, high = positions.min(axis=0), positions.max(axis=0)
    cell = 1e-6 * max(float((high - low).max()), np.finfo(np.float64).tiny)
    cells = np.rint((positions - low) / cell).astype(np.int64)
    return np.asarray(np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1))


def _corner_angles(a, b, c):
    """The angles (T, 3) of triangles at their corners (T, 3) a, b and c, rad."""
    angles = []
    for here, one, other in ((a, b, c), (b, c, a), (c, a, b)):
        one, other = one - here, other - here
        across = np.linalg.norm(np.cross(one, other), axis=1)
        angles.append(np.arctan2(across, np.einsum("ij,ij->i", one, other)))
    return np.stack(angles, axis=1)


def with_tangents(mesh: Mesh) -> Mesh:
    """The mesh with tangents along its uv's u, at right angles to the normals.

    Each triangle's direction of growing u, weighted with its area, summed about a vertex; where
    uv says nothing, any direction along the surface. Without uv the mesh stays as it is.
    """
    if mesh.uv is None or mesh.tangents is not None:
        return mesh
    corners = mesh.positions[mesh.triangles].astype(np.float64)
    uv = mesh.uv[mesh.triangles].astype(np.float64)
    side_1, side_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    (u_1, v_1), (u_2, v_2) = (uv[:, 1] - uv[:, 0]).T, (uv[:, 2] - uv[:, 0]).T
    turned_over = np.sign(u_1 * v_2 - u_2 * v_1)
    along = turned_over[:, None] * (v_2[:, None] * side_1 - v_1[:, None] * side_2)
    length = np.linalg.norm(along, axis=1, keepdims=True)
    area = np.linalg.norm(np.cross(side_1, side_2), axis=1, keepdims=True)
    along = np.divide(along * area, length, out=np.zeros_like(along), where=length > 0)
    tangents = np.zeros((len(mesh.positions), 3))
    np.add.at(tangents, mesh.triangles, along[:, None].repeat(3, axis=1))
    normals = mesh.normals.astype(np.float64)
    tangents -= np.einsum("ij,ij->i", tangents, normals)[:, None] * normals
    length = np.linalg.norm(tangents, axis=1, keepdims=True)
    across = np.eye(3)[np.abs(normals).argmin(axis=1)]
    other = np.cross(normals, across)
    other /= np.linalg.norm(other, axis=1, keepdims=True)
    known = length > 1e-12 * np.maximum(area.max(), 1e-30)
    tangents = np.divide(tangents, length, out=other, where=known)
    return replace(mesh, tangents=tangents.astype(np.float32))


def revolved(profile, segments: int) -> Mesh:
    """The surface a profile sweeps about the Y axis; u goes around from -Z, v up the profile.

    profile   ((K, 2) positions, (K, 2) normals): distance from the axis and height; going down
              the outside of the surface
    segments  quads around
    """
    positions, normals = profile
    t = np.linspace(0.0, 1.0, segments + 1)
    angle = 2 * np.pi * t - np.pi
    around = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
    along = np.stack([np.cos(angle), np.zeros_like(angle), -np.sin(angle)], axis=1)

    def turn(plane):
        up = plane[:, 1, None, None] * np.array([0.0, 1.0, 0.0])
        return (plane[:, 0, None, None] * around + up).reshape(-1, 3).astype(np.float32)

    row, column = np.meshgrid(np.arange(len(positions) - 1), np.arange(segments), indexing="ij")
    corner = (row * (segments + 1) + column).ravel()
    below, right = corner + segments + 1, corner + 1
    triangles = np.stack([corner, below, right, right, below, below + 1], axis=1).reshape(-1, 3)
    u, v = np.meshgrid(t, np.linspace(1.0, 0.0, len(positions)))
    return Mesh(
        turn(positions),
        turn(normals),
        triangles.astype(np.int32),
        uv=np.stack([u, v], axis=-1).reshape(-1, 2).astype(np.float32),
        tangents=np.tile(along, (len(positions), 1)).astype(np.float32),
    )


def _control_points():
    """(32, 4, 4, 3), z up, as the data set has them."""
    with resources.files(__package__).joinpath("teapot.csv").open(encoding="utf-8") as file:
        rows = np.loadtxt(file, delimiter=",", skiprows=1)
    return rows[:, 3:].reshape(-1, 4, 4, 3)


def _bezier(control, u, v):
    """Points (P, U, V, 3) of bicubic patches (P, 4, 4, 3): u along their rows, v their columns."""
    return np.einsum("ui,vj,pijk->puvk", _bernstein(u), _bernstein(v), control)


def _bezier_normals(control, t):
    """Unit normals (P, T, T, 3).

    Where a row of control points is a single point (knob and bottom) the cross product vanishes;
    the normal there is its limit, taken a hair's breadth inside the patch.
    """
    inside = np.clip(t, 1e-4, 1 - 1e-4)
    along_u = np.einsum("ui,vj,pijk->puvk", _bernstein_slope(inside), _bernstein(inside), control)
    along_v = np.einsum("ui,vj,pijk->puvk", _bernstein(inside), _bernstein_slope(inside), control)
    normal = np.cross(along_v, along_u)
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def _bernstein(t):
    """The cubic Bernstein polynomials (T, 4)."""
    s = 1 - t
    return np.stack([s**3, 3 * t * s**2, 3 * t**2 * s, t**3], axis=1)


def _bernstein_slope(t):
    """Their derivatives (T, 4)."""
    s = 1 - t
    return np.stack([-3 * s**2, 3 * s**2 - 6 * t * s, 6 * t * s - 3 * t**2, 3 * t**2], axis=1)
