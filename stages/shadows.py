"""How much of the sky each point of a scene sees, as light in each channel."""

from __future__ import annotations

import numpy as np

from stages.lamps import lights
from stages.prefilter import area_average
from stages.scene import Mesh, Scene

_LIGHTS = 160
_GRID = 128  # cells across a shadow map ...
_MARGIN = 4  # ... and those outside the scene
_SOURCE = 64  # texels along a face of the map that is broken up into lights


def sky(scene: Scene, cube):
    """Shadowed over unshadowed irradiance at every vertex, for each channel.

    scene    things that shadow themselves and one another
    cube     (6, N, N, C) linear, without NaN
    returns  a list of (V, C) float32 in [0, 1], one for each thing

    The environment is broken up into directional lights (`lamps.lights`), each with a shadow map.
    Being a quotient of two sums over the same lights it is exactly 1 where nothing is hidden,
    however few they are: the irradiance itself comes from the whole map (`prefilter.irradiance`).
    What hides the sky is taken to be lit as what it hides it from, and to be of the things' mean
    colour: A. Jimenez and others, "Practical Realtime Strategies for Accurate Indirect Occlusion"
    (2016), section 4, with the series summed up.
    """
    if not scene.things:
        return []
    if cube.shape[1] > _SOURCE:
        cube = area_average(cube, _SOURCE)
    directions, flux = lights(cube, _LIGHTS)
    meshes = [mesh for mesh, _ in scene.things]
    vertices = np.concatenate([mesh.positions for mesh in meshes])
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    radius = np.linalg.norm(vertices - middle, axis=1).max()
    cell = 2 * radius / (_GRID - 2 * _MARGIN)
    surface = np.concatenate([_points(mesh, cell) for mesh in meshes])
    occluders = _rows((surface - middle) / cell)
    places = _rows((vertices - middle) / cell)
    normals = _rows(np.concatenate([mesh.normals for mesh in meshes]))
    cosine = np.empty((len(directions), len(vertices)), np.float32)
    lit = np.empty_like(cosine)
    for k, direction in enumerate(directions):
        cosine[k] = np.maximum(_dot(direction, normals), 0)
        lit[k] = _share_lit(occluders, places, cosine[k], direction)
    whole = cosine.T @ flux
    some = (cosine * lit).T @ flux
    seen = np.divide(some, whole, out=np.ones_like(some), where=whole > 0)
    seen = np.clip(seen, 0, 1)
    albedo = np.mean([material.diffuse for _, material in scene.things], axis=0, dtype=np.float32)
    seen = seen / (1 - np.minimum(albedo, 1 - 1e-5) * (1 - seen))
    ends = np.cumsum([len(mesh.positions) for mesh in meshes])
    return np.split(seen, ends[:-1])


def _points(mesh: Mesh, spacing: float):
    """Points (K, 3) over a mesh, none further than `spacing` from the next."""
    corners = mesh.positions[mesh.triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).max(axis=1)
    parts = np.ceil(longest / spacing).astype(int)
    points = [mesh.positions]
    for n in np.unique(parts[parts > 1]):
        i, j = (k.ravel() for k in np.meshgrid(np.arange(n), np.arange(n)))
        within = i + j < n
        a, b = (i[within] + 1 / 3) / n, (j[within] + 1 / 3) / n
        barycentric = np.stack([1 - a - b, a, b], axis=1).astype(np.float32)
        points.append(np.einsum("ki,tic->tkc", barycentric, corners[parts == n]).reshape(-1, 3))
    return np.concatenate(points)


def _share_lit(occluders, places, cosine, direction):
    """How much of each place a light from a direction reaches, past the occluders.

    occluders  (3, K) points on all surfaces, in cells from the middle of the scene
    places     (3, V) likewise; on those surfaces
    cosine     (V,) of the surface there and the direction
    returns    (V,) in [0, 1]: of four cells of a shadow map about the place, those it is not behind
    """
    right = np.cross(np.eye(3)[np.argmin(np.abs(direction))], direction)
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(direction, right), direction], np.float32)

    x, y, depth = (_dot(axis, occluders) for axis in axes)
    cell = (y + _GRID / 2).astype(np.int32) * _GRID + (x + _GRID / 2).astype(np.int32)
    nearest = np.full(_GRID * _GRID, -np.inf, np.float32)
    np.maximum.at(nearest, cell, depth)

    x, y, depth = (_dot(axis, places) for axis in axes)
    # Toward the light by what a slanted plane rises over the corner to corner of a cell that the
    # four look-ups span, or it would shadow itself.
    depth += np.minimum(np.sqrt(2 - 2 * cosine**2) / np.maximum(cosine, 0.01), 6.0) + 0.5
    x, y = x + (_GRID / 2 - 0.5), y + (_GRID / 2 - 0.5)
    column, row = x.astype(np.int32), y.astype(np.int32)
    fx, fy = x - column, y - row
    corner = row * _GRID + column
    return (
        (nearest[corner] <= depth) * (1 - fx) * (1 - fy)
        + (nearest[corner + 1] <= depth) * fx * (1 - fy)
        + (nearest[corner + _GRID] <= depth) * (1 - fx) * fy
        + (nearest[corner + _GRID + 1] <= depth) * fx * fy
    )


def _rows(points):
    """Points (K, 3) as (3, K) float32: one row a coordinate, each in one piece of memory."""
    return np.ascontiguousarray(np.transpose(points), np.float32)


def _dot(direction, rows):
    """Dot products (K,); written out, for BLAS is slow at so flat a product."""
    x, y, z = np.asarray(direction, np.float32)
    return x * rows[0] + y * rows[1] + z * rows[2]
