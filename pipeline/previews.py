"""Pictures of finished maps: what a step and `sixlight preview` both do."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np

from calibration import sets
from calibration.adaptation import D65, cat02
from calibration.display import auto_exposure, srgb
from calibration.primaries import Primaries
from pipeline import header as headers
from pipeline import io
from pipeline.errors import fault, storing
from stages import scenes, shadows
from stages.fill import fill
from stages.prefilter import mean
from stages.preview import preview as render
from stages.preview import side_by_side
from stages.scene import Material
from stages.sharpen import sharpen
from stages.types import Float, Measured

SCENES = ("teapot",)


def teapot(
    light: Measured, primaries: Primaries, *, width: int, samples: int
) -> tuple[Float, Float]:
    """The teapot under a map, six channels beside three.

    light    (6, N, N, P) cubemap in the primaries
    width    px of the picture; it is half as high
    samples  of the gloss, per pixel and triple of channels
    returns  (width / 2, width, 3) encoded sRGB 0..1, and the six-channel half's XYZ in the unit
             of the map

    White is what a small white sphere in the middle of the room would scatter on the whole: CAT02
    takes it to the display's. Both halves share white and exposure.
    """
    filled = fill(light)
    matrix = primaries.xyz_from_primaries
    chart = sets.surfaces("colorchecker24")
    # Patch 15, red: what a trichromatic renderer shows too orange under tungsten light.
    scene = scenes.teapot(
        body=Material(primaries.project(chart["15"]), _gloss(primaries, 0.045), 0.05),
        stand=Material(primaries.project(chart["21"]), _gloss(primaries, 0.03), 0.12),
    )
    daylight = primaries.project(sets.lights("darling2011")["D65"])
    three_light, three_scene, xyz_from_sharp = sharpen(filled, scene, matrix, daylight)
    size = {"width": width // 2, "height": width // 2, "samples": samples}
    six = render(filled, matrix, scene, sky=shadows.sky(scene, filled), **size)
    three = render(
        three_light,
        xyz_from_sharp,
        three_scene,
        sky=shadows.sky(three_scene, three_light),
        **size,
    )
    to_display = cat02(matrix @ mean(filled), D65)
    exposure = auto_exposure(six @ to_display.T)
    pictures = [srgb(xyz @ to_display.T, exposure=exposure) for xyz in (six, three)]
    return side_by_side(pictures, ["six channels", "three channels (sharpened RGB)"]), six


def _gloss(primaries: Primaries, reflectance: float):
    """A colourless gloss, as of varnish."""
    return np.full(len(primaries.channels), reflectance)


def preview(
    envmap: Path, scene: str, out: Path | None, *, width: int, samples: int, force: bool
) -> list[Path]:
    """Renders a finished map into preview_SCENE.png and .exr; returns their paths.

    envmap  a folder `sixlight envmap` wrote, or a cubemap.exr
    out     folder for the pictures; None: where the map is

    InputError where the map, the scene or the place is wrong; pictures of ours are replaced.
    """
    if scene not in SCENES:
        raise fault(f"no scene is called {scene!r}", ", ".join(SCENES), "choose one of these")
    file = envmap / "cubemap.exr" if envmap.is_dir() else envmap
    light, names = io.read_measured(file, cube=True)
    header = io.read_exr(file)[2]
    primaries = headers.primaries_of(file, names, header)
    out = out or file.parent
    pictures = [out / f"preview_{scene}.{suffix}" for suffix in ("png", "exr")]
    for path in pictures:
        if path.exists() and not force and not (out / "work" / "capture.json").is_file():
            raise fault("exists", "a new file", "choose another -o, or --force", path)
    rgb, xyz = teapot(light, primaries, width=width, samples=samples)
    with storing(out):
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".unfinished-", dir=out) as folder:
            beside = [Path(folder) / path.name for path in pictures]
            write(beside, rgb, xyz, header)
            for made, path in zip(beside, pictures, strict=True):
                os.replace(made, path)
    return pictures


def write(paths: list[Path], rgb, xyz, header) -> None:
    """The picture as PNG and its XYZ as EXR."""
    picture, values = paths
    io.write_png(picture, rgb, "left: six channels; right: three channels, sharpened RGB")
    about = {**header, "step": "preview", "channels": "X Y Z of the six-channel half"}
    io.write_exr(values, xyz, "XYZ", about)
