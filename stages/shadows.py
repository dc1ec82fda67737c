"""What the things of a scene hide from one another: how much light each vertex loses by it.

Geometry comes first and once (`sight`), light afterwards and by one product (`shade`), so that a
turntable under one map, or one scene under many maps, costs little more than its first picture.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stages import cube as cubes
from stages.lamps import lights, parted
from stages.light import Light, light
from stages.opengl import opengl, program, set_uniforms
from stages.prefilter import area_average, mean
from stages.scene import Mesh, Scene
from stages.types import Float

_MAP = 256  # cells across a shadow map ...
_MARGIN = 4  # ... and those outside the scene
_CLUSTER = 3  # cells within which vertices become one, for what casts shadows
_CELLS = 6  # along a face of the cube of directions
_PARTS = 6  # each cell of directions is the mean of so many by so many places of the map
_STANDS_OUT = 3.0  # light over so many times the mean has shadow maps of its own ...
_LIGHTS = 96  # ... as so many directional lights
_SOURCE = 64  # texels along a face of the map that is broken up into these
_ROWS = 4096  # vertices taken at once


@dataclass(frozen=True)
class Shade:
    """What a thing loses of its environment, vertex by vertex; exactly 0 where nothing is hidden.

    light  (V, C) irradiance over pi that is hidden, less what comes from the things that hide it
    sky    (V, 9) which share of each direction d is hidden, as coefficients of x y z xx yy zz xy yz
           zx of d: good above the vertex's horizon
    """

    light: Float
    sky: Float


@dataclass(frozen=True)
class Sight:
    """What each vertex of a scene sees of the environment, of whatever light.

    hidden      (V, D) uint8: 255 where the way to a direction is hidden, less where half so; the
                directions are a coarse cube's, in the frame the scene was in
    sky         (V, 9) as in Shade, in that frame
    rotation    (3, 3) from that frame to the world
    """

    hidden: NDArray[np.uint8]
    sky: Float
    rotation: NDArray[np.float64]

    def turned(self, degrees: float) -> Sight:
        """The same for the scene turned about +Y, as `stages.scene.turned` does."""
        angle = np.radians(degrees)
        cos, sin = np.cos(angle), np.sin(angle)
        about_y = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
        return replace(self, rotation=about_y @ self.rotation)


def sight(scene: Scene, *, device: int | None = None, backend="egl") -> Sight:
    """What each vertex sees of the sky past all things of the scene: a shadow map for each of two
    hundred directions, looked up from every vertex.

    That is enough for what is even in an environment; what stands out of it has shadow maps of its
    own in `shade`.
    """
    meshes = [mesh for mesh, _ in scene.things]
    directions = cubes.directions(_CELLS).reshape(-1, 3)
    hidden = _hidden(meshes, directions, device, backend)
    normals = np.concatenate([np.zeros((0, 3), np.float32), *(mesh.normals for mesh in meshes)])
    solid_angles = np.tile(cubes.solid_angles(_CELLS).ravel(), 6)
    return Sight(hidden, _fitted(hidden, normals, directions, solid_angles), np.eye(3))


def shade(
    scene: Scene, cube, *, sight: Sight | None = None, device: int | None = None, backend="egl"
) -> tuple[Shade, ...]:
    """What each thing of a scene loses of its light to the others and to itself.

    scene    things that shadow themselves and one another
    cube     (6, N, N, C) linear, without NaN; or what `stages.light.light` made of it
    sight    of the same scene, turned as it is; None: found here
    returns  one for each thing

    What hides the sky is taken to be lit as what it hides it from, and to be of the things' mean
    colour: A. Jimenez and others, "Practical Realtime Strategies for Accurate Indirect Occlusion"
    (2016), section 4, with the series summed up.
    """
    if not scene.things:
        return ()
    prepared = cube if isinstance(cube, Light) else light(cube)
    seen = _sight(scene, device=device, backend=backend) if sight is None else sight
    meshes = [mesh for mesh, _ in scene.things]
    normals = np.concatenate([mesh.normals for mesh in meshes]).astype(np.float32)
    assert len(seen.hidden) == len(normals), "a sight of another scene"
    coarse = prepared.whole.mips[0]
    if coarse.shape[1] > _SOURCE:
        coarse = area_average(coarse, _SOURCE)
    even, standing = parted(coarse, _STANDS_OUT * float(mean(coarse).sum()))
    lamps, flux = lights(standing, _LIGHTS)
    behind = _hidden(meshes, lamps, device, backend)
    directions, radiance = _cells(even, seen.rotation)
    weight = np.tile(cubes.solid_angles(_CELLS).ravel(), 6).astype(np.float32)
    albedo = np.mean([_diffuse(material) for _, material in scene.things], axis=0)

    lost = np.empty((len(normals), radiance.shape[-1]), np.float32)
    for first in range(0, len(normals), _ROWS):
        rows = slice(first, first + _ROWS)
        cosine = np.maximum(normals[rows] @ directions.T, 0) * weight
        cosine /= cosine.sum(axis=1, keepdims=True)  # over pi, and exactly so
        share = cosine * (seen.hidden[rows] * np.float32(1 / 255))
        gone = share @ radiance
        whole = cosine @ radiance
        if len(lamps):
            cosine = np.maximum(normals[rows] @ lamps.T, 0) / np.float32(np.pi)
            gone += (cosine * (behind[rows] * np.float32(1 / 255))) @ flux
            whole += cosine @ flux
        back = 1 - np.minimum(albedo, 1 - 1e-5) * share.sum(axis=1, keepdims=True)
        # irradiance E = (whole - gone) + share albedo E; lost is whole - E
        lost[rows] = (gone - whole * (1 - back)) / back
    sky = _turned(seen.sky, seen.rotation)
    ends = np.cumsum([len(mesh.positions) for mesh in meshes])[:-1]
    pairs = zip(np.split(lost, ends), np.split(sky, ends), strict=True)
    return tuple(Shade(*pair) for pair in pairs)


_sight = sight  # `shade` has an argument of that name


def _diffuse(material):
    return material.diffuse if material.image is None else np.mean(material.image, axis=(0, 1))


def _cells(even, rotation):
    """World directions (D, 3) of a sight's cells, and a map's mean in each of them (D, C)."""
    fine = cubes.directions(_CELLS * _PARTS) @ rotation.T
    values = cubes.sample(even, fine).reshape(6, _CELLS, _PARTS, _CELLS, _PARTS, -1)
    directions = cubes.directions(_CELLS).reshape(-1, 3) @ rotation.T
    radiance = values.mean(axis=(2, 4)).reshape(len(directions), -1)
    return directions.astype(np.float32), radiance


def _fitted(hidden, normals, directions, solid_angles):
    """Coefficients (V, 9) of what is hidden, by least squares over each vertex's hemisphere.

    Weighted by solid angle and, a little, by cosine: what is below the horizon is nobody's concern.
    """
    terms = _terms(directions)
    pairs = (terms[:, :, None] * terms[:, None, :]).reshape(len(terms), -1).astype(np.float32)
    result = np.zeros((len(normals), 9), np.float32)
    some = np.flatnonzero(hidden.any(axis=1))
    damping = 1e-3 * np.eye(9)
    for rows in np.array_split(some, max(1, -(-len(some) // _ROWS))):
        cosine = np.clip(normals[rows] @ directions.T.astype(np.float32), 0, 1)
        weight = (np.sqrt(cosine) * solid_angles).astype(np.float32)
        normal = (weight @ pairs).reshape(-1, 9, 9) + damping
        right = (weight * (hidden[rows] * np.float32(1 / 255))) @ terms.astype(np.float32)
        result[rows] = np.linalg.solve(normal, right[..., None])[..., 0]
    return result


def _terms(d):
    """x y z xx yy zz xy yz zx of directions (D, 3): (D, 9)."""
    return np.concatenate([d, d * d, d * np.roll(d, -1, axis=1)], axis=1)


def _turned(sky, rotation):
    """Coefficients (V, 9) in a frame turned by a rotation (3, 3)."""
    if np.array_equal(rotation, np.eye(3)):
        return sky
    linear = sky[:, :3] @ rotation.T
    quadratic = np.zeros((len(sky), 3, 3))
    for k in range(3):
        quadratic[:, k, k] = sky[:, 3 + k]
        other = (k + 1) % 3
        quadratic[:, k, other] = quadratic[:, other, k] = sky[:, 6 + k] / 2
    quadratic = rotation @ quadratic @ rotation.T
    diagonal = np.stack([quadratic[:, k, k] for k in range(3)], axis=1)
    mixed = np.stack([2 * quadratic[:, k, (k + 1) % 3] for k in range(3)], axis=1)
    return np.concatenate([linear, diagonal, mixed], axis=1).astype(np.float32)


def _hidden(meshes: list[Mesh], directions, device, backend):
    """Share (V, D) uint8 of the way from every vertex in each direction that is hidden; 255 all."""
    count = sum(len(mesh.positions) for mesh in meshes)
    result = np.zeros((count, len(directions)), np.uint8)
    if not count or not len(directions):
        return result
    vertices = np.concatenate([mesh.positions for mesh in meshes]).astype(np.float32)
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    radius = float(np.linalg.norm(vertices - middle, axis=1).max())
    cell = 2 * radius / (_MAP - 2 * _MARGIN)
    starts = np.cumsum([0, *(len(mesh.positions) for mesh in meshes)])
    triangles = np.concatenate(
        [mesh.triangles + start for mesh, start in zip(meshes, starts[:-1], strict=True)]
    )
    casting, corners = _clustered((vertices - middle) / cell, triangles)
    places = _rows((vertices - middle) / cell)
    normals = _rows(np.concatenate([mesh.normals for mesh in meshes]))
    with opengl(device, backend) as context:
        # Depth once more as a colour: Mesa takes ten times as long to read a depth buffer.
        stored = context.renderbuffer((_MAP, _MAP), 1, dtype="f4")
        target = context.framebuffer([stored], context.depth_renderbuffer((_MAP, _MAP)))
        compiled = program(context, "shadow.vert", "shadow.frag")
        array = context.vertex_array(
            compiled,
            [(context.buffer(casting.tobytes()), "3f", "position")],
            index_buffer=context.buffer(corners.tobytes()),
        )
        target.use()
        context.enable_only(context.DEPTH_TEST)
        for k, direction in enumerate(np.asarray(directions, np.float64)):
            axes = _axes(direction)
            cosine = _dot(direction, normals)
            lit = cosine > 0
            clip_from_cells = np.eye(4)
            clip_from_cells[:3, :3] = axes * (2 / _MAP)
            clip_from_cells[2] *= -1  # the nearest to the light has the least depth
            target.clear(1.0, depth=1.0)
            set_uniforms(compiled, clip_from_world=clip_from_cells.T)
            array.render()
            depth = np.frombuffer(target.read(components=1, dtype="f4"), np.float32)
            nearest = (0.5 - depth) * _MAP  # cells towards the light
            share = _share_hidden(nearest, places[:, lit], normals[:, lit], cosine[lit], axes)
            result[lit, k] = np.round(255 * share)
    return result


def _clustered(vertices, triangles):
    """A mesh of fewer triangles: vertices within the same few cells are one, at their mean.

    A shadow map has no use for triangles smaller than its cells, and they cost as much as large
    ones. Rossignac and Borrel, "Multi-resolution 3D approximations for rendering complex scenes"
    (1993).
    """
    grid = np.floor(vertices / _CLUSTER).astype(np.int64) + 1024
    key = (grid[:, 0] * 2048 + grid[:, 1]) * 2048 + grid[:, 2]
    _, cluster = np.unique(key, return_inverse=True)
    number = np.bincount(cluster)
    places = np.stack([np.bincount(cluster, axis) / number for axis in vertices.T], axis=1)
    corners = np.sort(cluster[triangles], axis=1)  # which way they face does not matter
    whole = (corners[:, 0] < corners[:, 1]) & (corners[:, 1] < corners[:, 2])
    return places.astype(np.float32), np.unique(corners[whole], axis=0).astype(np.int32)


def _axes(direction):
    """Rows: two directions across a light's, and its own."""
    right = np.cross(np.eye(3)[np.argmin(np.abs(direction))], direction)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(direction, right), direction])


def _share_hidden(nearest, places, normals, cosine, axes):
    """How much of each place a light does not reach: of four cells of a shadow map about it, those
    it is behind.

    nearest  (_MAP * _MAP,) towards the light, in cells from the middle of the scene
    places   (3, V) in cells from there; with their normals, and their cosines with the light
    """
    # Off the surface by more than a cell, or what is rounded would shadow itself; then toward the
    # light by what a slanted plane rises over the cells that the four look-ups span.
    places = places + np.float32(1.5) * normals
    x, y, depth = (_dot(axis, places) for axis in axes)
    slope = np.sqrt(np.maximum(1 - cosine**2, 0)) / np.maximum(cosine, 0.01)
    depth += np.minimum(0.75 * slope, 4.0) + 0.5
    x, y = x + (_MAP / 2 - 0.5), y + (_MAP / 2 - 0.5)
    column, row = x.astype(np.int32), y.astype(np.int32)
    fx, fy = x - column, y - row
    corner = row * _MAP + column
    return (
        (nearest[corner] > depth) * (1 - fx) * (1 - fy)
        + (nearest[corner + 1] > depth) * fx * (1 - fy)
        + (nearest[corner + _MAP] > depth) * (1 - fx) * fy
        + (nearest[corner + _MAP + 1] > depth) * fx * fy
    )


def _rows(points):
    """Points (K, 3) as (3, K) float32: one row a coordinate, each in one piece of memory."""
    return np.ascontiguousarray(np.transpose(points), np.float32)


def _dot(direction, rows):
    """Dot products (K,); written out, for BLAS is slow at so flat a product."""
    x, y, z = np.asarray(direction, np.float32)
    return x * rows[0] + y * rows[1] + z * rows[2]
