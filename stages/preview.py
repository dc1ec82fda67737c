"""Render a scene in an environment of any number of channels, as fast as three render."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from itertools import repeat

import numpy as np
from numpy.typing import NDArray

from calibration.errors import fault
from stages.light import Light, light
from stages.opengl import opengl
from stages.renderer import Renderer
from stages.scene import Scene
from stages.shadows import Shade
from stages.types import Float


@dataclass(frozen=True)
class Drawing:
    """How pictures are drawn.

    width, height    px
    samples          of the gloss, per pixel; None: by each material's roughness
    quality          factor on the samples so chosen: .5 for a draft, 4 for the best
    supersampling    shaded points along a pixel's side. They share the pixel's samples
    device, backend  as `stages.opengl.opengl` has them
    """

    width: int = 640
    height: int = 640
    samples: int | None = None
    quality: float = 1.0
    supersampling: int = 2
    device: int | None = None
    backend: str = "egl"


def preview(
    cube, xyz_from_channels, scene: Scene, how: Drawing, *, shade: tuple[Shade, ...] | None = None
) -> Float:
    """A picture of the scene in the environment, before the environment itself.

    cube               (6, N, N, C) linear, without NaN; or what `stages.light.light` made of it
    xyz_from_channels  (3, C) the matrix to XYZ of light in these channels
    scene              its materials are given in the same channels
    shade              what its things hide from one another, `shadows.shade`; None: nothing
    returns            (height, width, 3) float32 XYZ, in the unit of xyz_from_channels @ cube
    Raises InputError where there is no OpenGL 3.3, or memory, or a material does not suit its mesh
    or the map.
    """
    shades = None if shade is None else [shade]
    with closing(sequence(cube, xyz_from_channels, [scene], how, shades=shades)) as pictures:
        return next(pictures)


def sequence(
    cube,
    xyz_from_channels,
    scenes: Iterable[Scene],
    how: Drawing,
    *,
    shades: Iterable[tuple[Shade, ...]] | None = None,
) -> Generator[Float, None, None]:
    """Pictures of many scenes in one environment, such as the frames of a turntable.

    scenes  drawn one at a time, as their pictures are asked for
    shades  what `preview` takes as `shade`, one for each scene
    The rest is as for `preview`. The environment is uploaded once.
    """
    prepared, matrix = _checked(cube, xyz_from_channels)

    def pictures():
        with _renderer(prepared, matrix, how) as renderer:
            beside = repeat(None) if shades is None else shades
            for scene, shade in zip(scenes, beside, strict=shades is not None):
                picture = renderer.draw(scene, shade, how.samples, how.quality)
                rows = _reduced(picture, how.supersampling, axis=0)
                yield _reduced(rows, how.supersampling, axis=1)

    return pictures()


def draw_times(
    cube,
    xyz_from_channels,
    scene: Scene,
    count: int,
    how: Drawing,
    *,
    shade: tuple[Shade, ...] | None = None,
) -> list[float]:
    """Seconds the device itself takes for each of `count` pictures, by its own clock.

    The arguments are those of `preview`. Light and programs are there already, and reading back is
    not counted.
    """
    seconds = []
    with _renderer(*_checked(cube, xyz_from_channels), how) as renderer:
        for _ in range(count + 1):
            renderer.draw(scene, shade, how.samples, how.quality)
            seconds.append(renderer.seconds)
    return seconds[1:]  # the first one compiles


def _checked(cube, xyz_from_channels) -> tuple[Light, NDArray[np.float64]]:
    prepared = cube if isinstance(cube, Light) else light(cube)
    matrix = np.asarray(xyz_from_channels, np.float64)
    if matrix.shape != (3, prepared.channels):
        raise fault(
            f"a matrix to XYZ of shape {matrix.shape} for {prepared.channels} channels",
            f"(3, {prepared.channels})",
            "give the matrix of the map's own channels",
        )
    return prepared, matrix


@contextmanager
def _renderer(prepared: Light, matrix, how: Drawing) -> Iterator[Renderer]:
    size = (how.width * how.supersampling, how.height * how.supersampling)
    with opengl(how.device, how.backend) as context:
        yield Renderer(context, prepared, matrix, size, how.supersampling)


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
        # A shadow about the letters, or they would be lost before a bright wall.
        around = cv2.dilate(letters, np.ones((2 * thickness + 1, 2 * thickness + 1), np.uint8))
        shadow = cv2.GaussianBlur(around, (0, 0), 1.5 * thickness)[..., None] / np.float32(255)
        ink = letters[..., None] / np.float32(255)
        shaded = picture * (1 - np.float32(0.75) * shadow)
        captioned.append(shaded * (1 - ink) + np.float32(0.92) * ink)
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
