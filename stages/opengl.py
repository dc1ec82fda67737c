"""OpenGL without a window: contexts on a chosen device, float textures, errors in one line."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

import shaders
from calibration.errors import InputError, fault

BACKENDS = ("egl", "native")  # native: the window system's own, GLX, WGL or CGL

# By the names in the packages: without their development files there is no "libGL.so".
_LIBGL, _LIBEGL = "libGL.so.1", "libEGL.so.1"

_SEAMLESS = 0x884F  # GL_TEXTURE_CUBE_MAP_SEAMLESS
_FACE_PX = 0x8515  # GL_TEXTURE_CUBE_MAP_POSITIVE_X; the five others follow
_RGB32F, _RGB, _FLOAT = 0x8815, 0x1907, 0x1406
_MOST_DEVICES = 16
_UNIFORMS = 320  # fragment vectors that nine channels with all their lamps and angles take
_TARGETS = 7  # images that surface.frag writes for nine shadowed channels


@dataclass(frozen=True)
class Device:
    """What renders.

    number    what `device=` takes to choose it
    vendor, renderer, version  as its driver calls itself
    """

    number: int
    vendor: str
    renderer: str
    version: str


def devices(backend: str = "egl") -> list[Device]:
    """The devices there are, each with what its driver calls itself; none where there is no EGL.

    Only EGL numbers devices: the native backend has one, number 0.
    """
    found = []
    for number in range(_MOST_DEVICES if backend == "egl" else 1):
        try:
            with opengl(number, backend) as context:
                info = context.info
                found.append(
                    Device(number, info["GL_VENDOR"], info["GL_RENDERER"], info["GL_VERSION"])
                )
        except InputError:
            break
    return found


@contextmanager
def opengl(device: int | None = None, backend: str = "egl") -> Iterator:
    """A moderngl context without a window, for as long as it is needed.

    device   a number of `devices`; None: the first
    backend  one of BACKENDS
    Raises InputError where there is no such device, or it cannot do what is needed.
    """
    import moderngl

    if backend not in BACKENDS:
        raise fault(f"no OpenGL backend is called {backend!r}", " or ".join(BACKENDS), "choose one")
    # Typed by moderngl as dicts, which none of them is.
    settings: Any = {"standalone": True}
    if backend == "egl":
        settings |= {"backend": "egl", "libgl": _LIBGL, "libegl": _LIBEGL}
        settings["device_index"] = device or 0
    try:
        context = moderngl.create_context(require=330, **settings)
    except Exception as error:  # glcontext raises nothing more particular
        if device and "device" in str(error).lower():
            raise fault(
                f"there is no OpenGL device {device}", "a number that exists", "leave it out"
            ) from error
        raise fault(
            f"OpenGL is not available: {error}",
            "EGL with Mesa or a GPU's driver"
            if backend == "egl"
            else "a display, or --backend egl",
            "install it with: apt-get install libegl1 libgl1 libgl1-mesa-dri",
        ) from error
    try:
        _check(context)
        context.gc_mode = "context_gc"
        context.enable_direct(_SEAMLESS)
        yield context
    finally:
        with context:
            context.gc()
        context.release()


def _check(context) -> None:
    """Refuse a device that has too little of anything."""
    info = context.info
    found = {
        "vectors of uniforms": (info["GL_MAX_FRAGMENT_UNIFORM_VECTORS"], _UNIFORMS),
        "images written at once": (info["GL_MAX_DRAW_BUFFERS"], _TARGETS),
        "texture units": (info["GL_MAX_TEXTURE_IMAGE_UNITS"], 16),
    }
    for what, (has, needs) in found.items():
        if 0 < has < needs:
            raise fault(
                f"{info['GL_RENDERER']} has {has} {what}",
                f"at least {needs}",
                "choose another device",
            )


def program(context, vertex: str, fragment: str, **defines: int):
    """Two shader files compiled and linked, with defines put in.

    Raises InputError naming file, line and driver where the driver refuses them.
    """
    try:
        return shaders.program(context, vertex, fragment, defines=defines)
    except shaders.ShaderError as error:
        info = context.info
        raise fault(
            f"the shaders do not compile on {info['GL_RENDERER']}, {info['GL_VERSION']}: {error}",
            "",
            "please report this line; until then choose another device",
        ) from error


def set_uniforms(compiled, **values) -> None:
    """Set uniforms by name; those a program has no use for are passed over.

    A value is a number, or an array shaped as GLSL declares the uniform: (count, columns, rows) for
    an array of matrices, with what one column holds last. It may be shorter than the shader's
    array: the rest of it is 0.
    """
    for name, value in values.items():
        if name not in compiled:
            continue
        uniform = compiled[name]
        if np.ndim(value) == 0:
            uniform.value = value
        else:
            flat = np.zeros(uniform.array_length * uniform.dimension, np.float32)
            given = np.asarray(value, np.float32).ravel()
            flat[: given.size] = given
            uniform.write(flat.tobytes())


def cube_texture(context, mips: Sequence):
    """A cube texture of the given mips, each (6, N >> k, N >> k, 3).

    In 32 bit floats: a lamp may be more than half floats hold. moderngl writes only level 0 of a
    cube texture, hence the call of OpenGL's own for the others.
    """
    most = context.info["GL_MAX_CUBE_MAP_TEXTURE_SIZE"]
    if mips[0].shape[1] > most:
        raise fault(
            f"a cubemap has faces of {mips[0].shape[1]} px",
            f"at most {most} on {context.info['GL_RENDERER']}",
            "make it smaller, or choose another device",
        )
    with enough_memory(context, "a cubemap"):
        texture = context.texture_cube(mips[0].shape[1:3], 3, dtype="f4")
        texture.use(location=0)
        image = _function("glTexImage2D", "uiiiiiuup")
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


def image_texture(context, image):
    """A texture of (H, W, 3) floats, row 0 the upper edge, with mips, repeated past its edges."""
    most = context.info["GL_MAX_TEXTURE_SIZE"]
    height, width = image.shape[:2]
    if max(height, width) > most:
        raise fault(
            f"an image of reflectances is {width} x {height} px",
            f"at most {most} on {context.info['GL_RENDERER']}",
            "make it smaller",
        )
    with enough_memory(context, "an image of reflectances"):
        rows = np.ascontiguousarray(image[::-1], np.float32)
        texture = context.texture((width, height), 3, rows.tobytes(), dtype="f4")
        texture.build_mipmaps()
        texture.filter = (context.LINEAR_MIPMAP_LINEAR, context.LINEAR)
    return texture


@contextmanager
def enough_memory(context, what: str) -> Iterator[None]:
    """Say in one line that the device has no memory left for something made in here."""
    import moderngl

    problem = None
    try:
        yield
        if context.error == "GL_OUT_OF_MEMORY":
            problem = "GL_OUT_OF_MEMORY"
    except (moderngl.Error, MemoryError) as error:
        problem = str(error)
    if problem:
        raise fault(
            f"{context.info['GL_RENDERER']} has no memory for {what} ({problem})",
            "",
            "make the map or the picture smaller, or choose another device",
        )


def _function(name: str, arguments: str):
    """A function of OpenGL's own: arguments i int, u unsigned int, p pointer; without a result."""
    kinds = {"i": ctypes.c_int, "u": ctypes.c_uint, "p": ctypes.c_void_p}
    function = getattr(ctypes.CDLL(_LIBGL), name)
    function.argtypes = [kinds[letter] for letter in arguments]
    function.restype = None
    return function
