"""Render a scene in an environment of any number of channels, as fast as three render.

Light and surfaces are multiplied channel by channel and brought to XYZ by a matrix at the end, so
a trichromatic renderer does: once for each triple of channels, XYZ added up (Darling, Ferwerda,
Berns and Chen, eq. 4: M Phi = M_123 Phi_123 + M_456 Phi_456).
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import shaders
from calibration.errors import fault
from stages.lamps import take_out
from stages.prefilter import irradiance, prefilter
from stages.scene import Camera, Material, Scene
from stages.types import Float

BRDFS = ("ward", "ward1992")  # the fragment shaders of the same names

# By the names in the packages: without their development files there is no "libGL.so".
_LIBGL, _LIBEGL = "libGL.so.1", "libEGL.so.1"

# Surfaces smoother than this mirror a lamp's shape: they are shown the whole map, which is sharp
# there, and not the lamps' stand-ins.
_SHARP = 0.04

_SEAMLESS = 0x884F  # GL_TEXTURE_CUBE_MAP_SEAMLESS
_FACE_PX = 0x8515  # GL_TEXTURE_CUBE_MAP_POSITIVE_X; the five others follow
_RGB32F, _RGB, _FLOAT = 0x8815, 0x1907, 0x1406


def preview(
    cube,
    xyz_from_channels,
    scene: Scene,
    *,
    sky=None,
    width=640,
    height=640,
    samples=64,
    supersampling=2,
    brdf="ward",
):
    """A picture of the scene in the environment, before the environment itself.

    cube               (6, N, N, C) linear, without NaN
    xyz_from_channels  (3, C) the matrix to XYZ of light in these channels
    scene              its materials are given in the same channels
    sky                light in each channel that reaches each vertex over what would if nothing hid
                       the sky, a (V, C) for each thing, as `shadows.sky` gives it; None: all does
    samples            of the gloss, per pixel and triple of channels
    supersampling      shaded points a pixel, in each direction
    brdf               one of BRDFS
    returns            (height, width, 3) float32 XYZ, in the unit of xyz_from_channels @ cube
    Raises InputError where there is no OpenGL 3.3.
    """
    rest, directions, flux = take_out(cube)
    mips = prefilter(cube)
    rest_mips = prefilter(rest) if len(flux) else mips
    light = _Light(mips, rest_mips, directions, flux, irradiance(cube))
    if sky is None:
        sky = [np.ones((len(mesh.positions), cube.shape[-1])) for mesh, _ in scene.things]
    size = (width * supersampling, height * supersampling)
    picture = np.zeros((size[1], size[0], 3), np.float32)
    with _opengl() as context:
        for triple in _triples(cube.shape[-1]):
            picture += _render(
                context,
                light.channels(triple),
                _take(np.asarray(xyz_from_channels), triple),
                [_of_channels(material, triple) for _, material in scene.things],
                [_take(seen, triple) for seen in sky],
                scene,
                samples=samples,
                size=size,
                brdf=brdf,
            )
    return _reduced(_reduced(picture, supersampling, axis=0), supersampling, axis=1)


def side_by_side(pictures, captions):
    """Pictures of one height beside one another, each with a caption in its lower left corner.

    pictures  (H, W, 3) each, encoded for display, 0..1
    returns   (H, sum of W, 3) float32
    """
    import cv2

    captioned = []
    for picture, caption in zip(pictures, captions, strict=True):
        height = picture.shape[0]
        letters = np.zeros(picture.shape[:2], np.uint8)
        place = (round(height * 0.025), round(height * 0.975))
        size, thickness = height / 1100, max(1, round(height / 640))
        font = cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(letters, caption, place, font, size, 255, thickness, cv2.LINE_AA)
        ink = letters[..., None] / np.float32(255)
        captioned.append(picture * (1 - ink) + np.float32(0.92) * ink)
    return np.concatenate(captioned, axis=1)


def _reduced(picture, factor, axis):
    """Fewer pixels along an axis, under a tent two pixels wide: smoother outlines than a mean."""
    tap = np.arange(-factor, 2 * factor)  # shaded points, the pixel's own are 0 .. factor - 1
    weight = np.maximum(0, 1 - np.abs(tap - (factor - 1) / 2) / factor)
    picture = np.moveaxis(picture, axis, 0)
    padded = np.pad(picture, [(factor, factor), (0, 0), (0, 0)], mode="edge")
    count = len(picture)
    total = np.zeros_like(picture[::factor])
    for k, w in zip(tap, weight / weight.sum(), strict=True):
        total += np.float32(w) * padded[factor + k : factor + k + count : factor]
    return np.moveaxis(total, 0, axis)


@dataclass(frozen=True)
class _Light:
    """An environment in the forms the shaders want it.

    mips             of the whole, each (6, N >> k, N >> k, C)
    rest_mips        of the whole without its lamps
    lamp_directions  (K, 3)
    lamp_flux        (K, C)
    irradiance       over pi, (6, n, n, C)
    """

    mips: Sequence[Float]
    rest_mips: Sequence[Float]
    lamp_directions: Float
    lamp_flux: Float
    irradiance: Float

    def channels(self, triple) -> _Light:
        """The same in three of its channels."""
        return _Light(
            [_take(level, triple) for level in self.mips],
            [_take(level, triple) for level in self.rest_mips],
            self.lamp_directions,
            _take(self.lamp_flux, triple),
            _take(self.irradiance, triple),
        )


def _of_channels(material: Material, triple) -> Material:
    return replace(
        material,
        diffuse=_take(material.diffuse, triple),
        specular=_take(material.specular, triple),
    )


def _triples(channels: int) -> list[list[int]]:
    return [list(range(k, min(k + 3, channels))) for k in range(0, channels, 3)]


def _take(values, triple):
    """A triple of an array's channels, its last axis; 0 where fewer than three are left."""
    taken = np.asarray(values, np.float32)[..., triple]
    missing = 3 - taken.shape[-1]
    return np.pad(taken, [(0, 0)] * (taken.ndim - 1) + [(0, missing)]) if missing else taken


@contextmanager
def _opengl() -> Iterator:
    """A moderngl context without a window, for as long as it is needed."""
    import moderngl

    # Typed by moderngl as dicts, which none of them is.
    settings: Any = {"standalone": True, "backend": "egl", "libgl": _LIBGL, "libegl": _LIBEGL}
    try:
        context = moderngl.create_context(require=330, **settings)
    except Exception as error:  # glcontext raises nothing more particular
        raise fault(
            f"OpenGL is not available: {error}",
            "EGL with Mesa or a GPU's driver",
            "install it with: apt-get install libegl1 libgl1 libgl1-mesa-dri",
        ) from error
    try:
        context.gc_mode = "context_gc"
        context.enable_direct(_SEAMLESS)
        yield context
    finally:
        context.gc()
        context.release()


def _render(
    context, light: _Light, xyz_from_triple, materials, sky, scene: Scene, *, samples, size, brdf
):
    """One triple of channels: (H, W, 3) XYZ, row 0 at the top."""
    target = context.framebuffer(
        [context.renderbuffer(size, 4, dtype="f4")], context.depth_renderbuffer(size)
    )
    target.use()
    target.clear(depth=1.0)
    whole, rest, matt = 0, 1, 2  # texture units
    textures = [_upload(context, m) for m in (light.mips, light.rest_mips, [light.irradiance])]
    for unit, texture in zip((whole, rest, matt), textures, strict=True):
        texture.use(location=unit)  # after all uploads, which go through unit 0
    clip_from_world, world_from_clip = _camera_matrices(scene.camera, size[0] / size[1])

    context.enable_only(context.DEPTH_TEST)
    surface = shaders.program(context, "surface.vert", f"{brdf}.frag")
    _set(
        surface,
        clip_from_world=clip_from_world,
        eye=scene.camera.eye,
        irradiance=matt,
        face_size=float(light.mips[0].shape[1]),
        samples=samples,
        xyz_from_triple=xyz_from_triple,
        lamp_direction=light.lamp_directions,
        lamp_flux=light.lamp_flux,
    )
    for (mesh, _), material, seen in zip(scene.things, materials, sky, strict=True):
        mirror = material.roughness < _SHARP
        _set(
            surface,
            rho_d=material.diffuse,
            rho_s=material.specular,
            roughness=float(material.roughness),
            radiance=whole if mirror else rest,
            lamps=0 if mirror else len(light.lamp_flux),
        )
        vertices = np.concatenate([mesh.positions, mesh.normals, seen], axis=1, dtype=np.float32)
        context.vertex_array(
            surface,
            [(context.buffer(vertices.tobytes()), "3f 3f 3f", "position", "normal", "sky")],
            index_buffer=context.buffer(mesh.triangles.astype(np.int32).tobytes()),
        ).render()

    context.depth_func = "<="
    background = shaders.program(context, "environment.vert", "environment.frag")
    _set(
        background,
        world_from_clip=world_from_clip,
        radiance=whole,
        level=float(scene.background_level),
        xyz_from_triple=xyz_from_triple,
    )
    context.vertex_array(background, []).render(vertices=3)
    pixels = np.frombuffer(target.read(components=3, dtype="f4"), np.float32)
    return pixels.reshape(size[1], size[0], 3)[::-1]


def _set(program, **uniforms):
    """Set uniforms by name. A matrix is given as it is written, rows first; an array of vectors
    may be shorter than the shader's, and the rest of it is 0."""
    for name, value in uniforms.items():
        uniform = program[name]
        if np.ndim(value) == 2 and uniform.array_length > 1:
            rows = np.pad(value, [(0, uniform.array_length - len(value)), (0, 0)])
            uniform.write(np.ascontiguousarray(rows, np.float32).tobytes())
        elif np.ndim(value) == 2:
            uniform.write(np.ascontiguousarray(np.transpose(value), np.float32).tobytes())
        else:
            uniform.value = tuple(map(float, value)) if np.ndim(value) else value


def _upload(context, mips):
    """A cube texture of the given mips, each (6, N >> k, N >> k, 3).

    In 32 bit floats: a lamp may be more than half floats hold. moderngl writes only level 0 of a
    cube texture, hence the call of OpenGL's own for the others.
    """
    texture = context.texture_cube(mips[0].shape[1:3], 3, dtype="f4")
    texture.use(location=0)
    image = ctypes.CDLL(_LIBGL).glTexImage2D
    image.argtypes = [ctypes.c_uint, *[ctypes.c_int] * 5, *[ctypes.c_uint] * 2, ctypes.c_void_p]
    image.restype = None
    for level, cube in enumerate(mips):
        n = cube.shape[1]
        for face in range(6):
            texels = np.ascontiguousarray(cube[face], np.float32)
            image(_FACE_PX + face, level, _RGB32F, n, n, 0, _RGB, _FLOAT, texels.ctypes.data)
    several = len(mips) > 1
    texture.filter = (
        context.LINEAR_MIPMAP_LINEAR if several else context.LINEAR,
        context.LINEAR,
    )
    return texture


def _camera_matrices(camera: Camera, aspect: float):
    """clip from world (4, 4), and world directions from clip positions on the far plane (4, 4)."""
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
    projection[0, 0], projection[1, 1] = f / aspect, f
    projection[2, 2:] = (near + far) / (near - far), 2 * near * far / (near - far)
    projection[3, 2] = -1
    return projection @ view, np.linalg.inv(projection @ rotation)
