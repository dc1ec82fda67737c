"""One environment on a device, and scenes drawn in it.

Light and surfaces are multiplied channel by channel and brought to XYZ by a matrix at the end
(Darling, Ferwerda, Berns and Chen, "Real-Time Multispectral Rendering with Complex Illumination",
2011, eqs. 2 to 4). Where light is sampled, how blurred, and with what weight is the same for every
channel and found once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.errors import fault
from stages.light import Light, form
from stages.opengl import cube_texture, enough_memory, image_texture, program, set_uniforms
from stages.scene import BRDFS, Camera, Material, Mesh, Scene
from stages.shadows import Shade
from stages.types import Float

_TRIPLES = 3  # most that the shaders take at once; more channels are more passes
_TILE = 1024  # points along a side of what is drawn at once
_STEPS = 24  # of specular reflectance by angle, as in shade.glsl


def samples_of(material: Material, quality=1.0) -> int:
    """Samples of the gloss a pixel that show this material steadily.

    A mirror needs few, as it sees little of the map; a strong gloss shows its errors more.
    """
    strength = float(np.clip(np.mean(np.asarray(material.specular)), 0, 0.5))
    count = 16 if form(material.roughness) == "whole" else 32 + 64 * strength
    return max(4, round(count * quality))


@dataclass(frozen=True)
class _Group:
    """What the shaders take at once: some of the channels, as triples, on the device.

    channels  a slice of them
    triples   how many
    maps      by form of the Light, "matt" for its irradiance: a cube texture for each triple
    lights    flux of the lights (K, triples, 3) by form, and "matt"
    """

    channels: slice
    triples: int
    maps: dict[str, list[Any]]
    lights: dict[str, Float]
    xyz_from_triple: Float


class Renderer:
    """One environment on a device, and what it takes to draw scenes in it.

    seconds  that the device took for the last picture, by its own clock
    """

    def __init__(self, context, prepared: Light, matrix, size: tuple[int, int], supersampling: int):
        """matrix (3, C) to XYZ; size: shaded points across and up, several along a pixel's side."""
        self._context, self._light, self._size = context, prepared, size
        self._supersampling = supersampling
        step = _TILE // supersampling * supersampling
        self._tile = (min(step, size[0]), min(step, size[1]))
        self._programs: dict[tuple, Any] = {}
        self._images: dict[tuple[int, int], tuple[Any, list[Any]]] = {}
        self._targets: list[Any] = []  # what surface.frag writes, as far as needed up to now
        self._framebuffers: dict[int, Any] = {}
        self._groups = []
        for first in range(0, prepared.channels, 3 * _TRIPLES):
            taken = slice(first, min(first + 3 * _TRIPLES, prepared.channels))
            self._groups.append(self._group(taken, matrix))
        with enough_memory(context, f"a picture of {size[0]} x {size[1]} points"):
            self._colour = context.renderbuffer(self._tile, 4, dtype="f4")
            self._depth = context.depth_renderbuffer(self._tile)
            self._picture = context.framebuffer([self._colour])
        self.seconds = 0.0

    def draw(self, scene: Scene, shade: tuple[Shade, ...] | None, samples, quality) -> Float:
        """(H, W, 3) XYZ of every point, row 0 at the top.

        Other renderers may draw between two pictures: the context is made current for this one.
        """
        with self._context:
            picture = self._drawn(scene, shade, samples, quality)
            self._context.gc()
        return picture

    def _drawn(self, scene: Scene, shade, samples, quality) -> Float:
        width, height = self._size
        things = [
            _Thing(mesh, material, shade[k] if shade is not None else None)
            for k, (mesh, material) in enumerate(scene.things)
        ]
        for thing in things:
            _check(thing, self._light.channels)
        picture = np.zeros((height, width, 3), np.float32)
        self.seconds = 0.0
        for group in self._groups:
            buffers = [self._vertices(group, thing) for thing in things]
            for y in range(0, height, self._tile[1]):
                for x in range(0, width, self._tile[0]):
                    w, h = min(self._tile[0], width - x), min(self._tile[1], height - y)
                    clip_from_world, world_from_clip = _camera_matrices(
                        scene.camera, self._size, (x, y, w, h)
                    )
                    query = self._context.query(time=True)
                    with query:
                        self._write_down(group, things, buffers, clip_from_world, (w, h))
                        self._shade(
                            group, scene, things, world_from_clip, clip_from_world, (w, h),
                            samples, quality,
                        )  # fmt: skip
                    self.seconds += query.elapsed * 1e-9
                    pixels = self._picture.read((0, 0, w, h), 3, dtype="f4")
                    part = np.frombuffer(pixels, np.float32).reshape(h, w, 3)
                    picture[y : y + h, x : x + w] += part
        return picture[::-1]

    def _group(self, taken: slice, matrix) -> _Group:
        triples = -(-(taken.stop - taken.start) // 3)
        maps: dict[str, list[Any]] = {}
        prepared = self._light
        parts = {"whole": prepared.whole, "narrow": prepared.narrow, "broad": prepared.broad}
        for name, mips in [
            *((name, part.mips) for name, part in parts.items()),
            ("matt", [prepared.matt.irradiance]),
        ]:
            if name == "narrow" and mips is prepared.whole.mips:
                maps[name] = maps["whole"]
                continue
            levels = [_triples(level, taken) for level in mips]
            maps[name] = [
                cube_texture(self._context, [level[..., k, :] for level in levels])
                for k in range(triples)
            ]
        fluxes = {name: _triples(part.flux, taken) for name, part in parts.items()}
        fluxes["matt"] = _triples(prepared.matt.flux, taken)
        columns = np.swapaxes(_triples(matrix, taken), 0, 1)  # (triples, 3, 3), rows first
        return _Group(
            taken,
            triples,
            maps,
            fluxes,
            np.swapaxes(columns, 1, 2),
        )

    def _program(self, vertex, fragment, **defines):
        key = (vertex, fragment, *sorted(defines.items()))
        if key not in self._programs:
            self._programs[key] = program(self._context, vertex, fragment, **defines)
        return self._programs[key]

    def _vertices(self, group: _Group, thing: _Thing):
        """A thing's vertices on the device, ready to be written down."""
        mesh, count = thing.mesh, len(thing.mesh.positions)
        tangents = _tangents(mesh) if thing.anisotropic else np.zeros((count, 3))
        uv = np.zeros((count, 2)) if mesh.uv is None else mesh.uv
        columns = [mesh.positions, mesh.normals, tangents, uv]
        names, layout = ["position", "normal", "tangent", "uv"], ["3f", "3f", "3f", "2f"]
        if thing.shade is not None:
            lost = _triples(thing.shade.light, group.channels).reshape(count, -1)
            columns += [lost, thing.shade.sky]
            names += ["hidden_light", "hidden_sky"]
            layout += [f"{3 * group.triples}f", "9f"]
        surface = self._program(
            "surface.vert",
            "surface.frag",
            TRIPLES=group.triples,
            SHADED=int(thing.shade is not None),
        )
        used = [k for k, name in enumerate(names) if name in surface]
        data = np.concatenate([columns[k] for k in used], axis=1, dtype=np.float32)
        with enough_memory(self._context, f"a mesh of {count} vertices"):
            return surface, self._context.vertex_array(
                surface,
                [
                    (
                        self._context.buffer(data.tobytes()),
                        " ".join(layout[k] for k in used),
                        *(names[k] for k in used),
                    )
                ],
                index_buffer=self._context.buffer(mesh.triangles.astype(np.int32).tobytes()),
            )

    def _written(self, count: int):
        """A framebuffer of the first `count` of the targets."""
        while len(self._targets) < count:
            with enough_memory(self._context, "the surfaces of a picture"):
                texture = self._context.texture(self._tile, 4, dtype="f4")
                texture.filter = (self._context.NEAREST, self._context.NEAREST)
                self._targets.append(texture)
        if count not in self._framebuffers:
            self._framebuffers[count] = self._context.framebuffer(
                self._targets[:count], self._depth
            )
        return self._framebuffers[count]

    def _write_down(self, group, things, buffers, clip_from_world, size):
        shaded = any(thing.shade is not None for thing in things)
        target = self._written(4 + group.triples if shaded else 2)
        target.use()
        target.viewport = (0, 0, *size)
        target.clear(depth=1.0)
        self._context.enable_only(self._context.DEPTH_TEST)
        for number, (surface, vertices) in enumerate(buffers, start=1):
            set_uniforms(surface, clip_from_world=clip_from_world.T, thing=float(number))
            vertices.render()

    def _shade(
        self, group, scene, things, world_from_clip, clip_from_world, size, samples, quality
    ):
        context, prepared = self._context, self._light
        self._picture.use()
        self._picture.viewport = (0, 0, *size)
        context.enable_only(0)
        common = {
            "world_from_clip": world_from_clip.T,
            "xyz_from_triple": group.xyz_from_triple,
        }
        background = self._program("screen.vert", "environment.frag", TRIPLES=group.triples)
        set_uniforms(background, level=float(scene.background_level), **common)
        bind(background, {"radiance": group.maps["whole"]})
        context.vertex_array(background, []).render(vertices=3)

        mean = np.mean([np.asarray(_diffuse(t.material)) for t in things], axis=0) if things else 0
        points = self._supersampling**2
        for number, thing in enumerate(things, start=1):
            box = _bounds(thing.mesh, clip_from_world, size)
            if box is None:
                continue
            material = thing.material
            angular = np.ndim(material.specular) == 2
            shade = self._program(
                "screen.vert",
                f"{material.brdf}.frag",
                TRIPLES=group.triples,
                SHADED=int(thing.shade is not None),
                ANGULAR=int(angular),
                TEXTURED=int(material.image is not None),
            )
            seen = form(material.roughness)
            parts = getattr(prepared, seen)
            wanted = samples_of(material, quality) if samples is None else samples
            specular = by_root(material.specular) if angular else material.specular
            set_uniforms(
                shade,
                thing=float(number),
                face_size=float(parts.mips[0].shape[1]),
                samples=max(1, -(-wanted // points)),
                supersampling=self._supersampling,
                lamps=len(parts.flux),
                lamp_direction=parts.directions,
                lamp_flux=group.lights[seen],
                matt_lamps=len(prepared.matt.flux),
                matt_direction=prepared.matt.directions,
                matt_flux=group.lights["matt"],
                roughness=np.broadcast_to(material.roughness, 2),
                rho_d=_triples(material.diffuse, group.channels),
                rho_s=_triples(specular, group.channels),
                surroundings=_triples(mean, group.channels),
                **common,
            )
            targets = self._targets
            textures = {
                "radiance": group.maps[seen],
                "irradiance": group.maps["matt"],
                "facing": [targets[0]],
                "what": [targets[1]],
            }
            if thing.shade is not None:
                textures |= {"sky_a": [targets[2]], "sky_b": [targets[3]]}
                textures["lost"] = targets[4 : 4 + group.triples]
            if material.image is not None:
                textures["image"] = self._image(material.image, group)
            bind(shade, textures)
            self._picture.scissor = box
            context.vertex_array(shade, []).render(vertices=3)
            self._picture.scissor = None

    def _image(self, image, group: _Group):
        """An image of reflectances on the device, a texture for each triple."""
        key = (id(image), group.channels.start)
        if key not in self._images:
            parts = _triples(image, group.channels)
            textures = [
                image_texture(self._context, parts[..., k, :]) for k in range(group.triples)
            ]
            self._images[key] = (image, textures)  # the image too, or its id could come again
        return self._images[key][1]


@dataclass(frozen=True)
class _Thing:
    mesh: Mesh
    material: Material
    shade: Shade | None

    @property
    def anisotropic(self) -> bool:
        return np.size(self.material.roughness) == 2


def _check(thing: _Thing, channels: int) -> None:
    """Refuse a material that does not suit its mesh or the map."""
    material, mesh = thing.material, thing.mesh
    for name, value in (("diffuse", _diffuse(material)), ("specular", material.specular)):
        if np.shape(value)[-1:] != (channels,):
            raise fault(
                f"a material's {name} reflectance has {np.shape(value)[-1:]} channels",
                f"the map's {channels}",
                "give both in the same primaries",
            )
    alpha = np.ravel(material.roughness)
    if alpha.size not in (1, 2) or not ((alpha > 0) & (alpha <= 1)).all():
        raise fault(
            f"a material's roughness is {material.roughness}",
            "one or two numbers over 0, at most 1",
            "give another",
        )
    if material.brdf not in BRDFS:
        raise fault(f"no BRDF is called {material.brdf!r}", ", ".join(BRDFS), "choose one of these")
    if material.image is not None and mesh.uv is None:
        raise fault("an image is laid on a mesh", "a mesh with uv", "unwrap the mesh first")
    if thing.anisotropic and mesh.tangents is None and mesh.uv is None:
        raise fault(
            "a roughness of two numbers on a mesh that does not say along what",
            "a mesh with tangents or uv",
            "unwrap the mesh first, or give one number",
        )


def _diffuse(material: Material):
    """Its diffuse reflectance (C,), the mean where an image has it."""
    return material.diffuse if material.image is None else np.mean(material.image, axis=(0, 1))


def _triples(values, taken: slice):
    """Channels (..., C) as triples: (..., triples, 3) float32; 0 where some are missing."""
    part = np.asarray(values, np.float32)[..., taken]
    missing = -part.shape[-1] % 3
    if missing:
        part = np.pad(part, [(0, 0)] * (part.ndim - 1) + [(0, missing)])
    return part.reshape(*part.shape[:-1], part.shape[-1] // 3, 3)


def by_root(table):
    """A table (K, C) at equal steps of the cosine, 1 first, brought to the shader's: (_STEPS, C) at
    equal steps of its root, 0 first. Reflectances rise most where the cosine nears 0."""
    table = np.asarray(table, np.float64)[::-1]
    cosine = np.linspace(0, 1, len(table))
    wanted = np.linspace(0, 1, _STEPS) ** 2
    return np.stack([np.interp(wanted, cosine, channel) for channel in table.T], axis=1)


def _tangents(mesh: Mesh):
    """Unit vectors (V, 3) along which roughness is measured: the mesh's, or up the image's u.

    Where an image's u has no direction they are 0, and the roughness follows the viewer.
    """
    if mesh.tangents is not None:
        return mesh.tangents
    corners, uv = mesh.positions[mesh.triangles], np.asarray(mesh.uv)[mesh.triangles]
    (a, b), (s, t) = (
        (x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) for x in (corners.astype(float), uv.astype(float))
    )
    area = s[:, 0] * t[:, 1] - t[:, 0] * s[:, 1]
    along = (a * t[:, 1:] - b * s[:, 1:]) * np.sign(area)[:, None]
    total = np.zeros((len(mesh.positions), 3))
    for corner in range(3):
        np.add.at(total, mesh.triangles[:, corner], along)
    total -= mesh.normals * np.einsum("vi,vi->v", total, mesh.normals)[:, None]
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.zeros_like(total), where=length > 0)


def bind(compiled, textures: dict[str, list[Any]]) -> None:
    """Give a program its textures, a list for each name it knows."""
    unit = 0
    for name, several in textures.items():
        if name not in compiled:
            continue
        units = list(range(unit, unit + len(several)))
        for texture, place in zip(several, units, strict=True):
            texture.use(location=place)
        compiled[name].value = units if compiled[name].array_length > 1 else units[0]
        unit += len(several)


def _bounds(mesh: Mesh, clip_from_world, size):
    """x, y, width, height in pixels of what a mesh may cover; None: nothing."""
    clip = mesh.positions @ clip_from_world[:, :3].T + clip_from_world[:, 3]
    if (clip[:, 3] <= 0).any():
        return (0, 0, *size)  # part of it is behind the eye
    place = clip[:, :2] / clip[:, 3:]
    low, high = place.min(axis=0), place.max(axis=0)
    low = np.floor((np.clip(low, -1, 1) + 1) / 2 * size).astype(int)
    high = np.ceil((np.clip(high, -1, 1) + 1) / 2 * size).astype(int)
    x, y = low.tolist()
    w, h = (high - low).tolist()
    return (x, y, w, h) if w > 0 and h > 0 else None


def _camera_matrices(camera: Camera, size, tile):
    """clip from world (4, 4), and world directions from clip positions on the far plane (4, 4).

    size  points of the picture, across and up
    tile  x, y, width, height of the part of it that is to fill the clip space
    """
    eye, target = np.asarray(camera.eye, float), np.asarray(camera.target, float)
    distance = np.linalg.norm(target - eye)
    forward = (target - eye) / distance
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    view = np.eye(4)
    view[:3, :3] = [right, np.cross(right, forward), -forward]
    rotation = view.copy()
    view[:3, 3] = -view[:3, :3] @ eye
    f = 1 / np.tan(np.radians(camera.vertical_view_deg) / 2)
    near, far = distance / 20, distance * 20
    projection = np.zeros((4, 4))
    projection[0, 0], projection[1, 1] = f * size[1] / size[0], f
    projection[2, 2:] = (near + far) / (near - far), 2 * near * far / (near - far)
    projection[3, 2] = -1
    part = np.eye(4)
    for axis in range(2):
        part[axis, axis] = size[axis] / tile[2 + axis]
        middle = 2 * tile[axis] + tile[2 + axis] - size[axis]  # in half points from the centre
        part[axis, 3] = -middle / tile[2 + axis]
    return part @ projection @ view, np.linalg.inv(part @ projection @ rotation)
