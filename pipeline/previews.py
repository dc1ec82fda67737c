"""Pictures of finished maps: what a step and `sixlight preview` both do."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from calibration import look as looks
from calibration.look import Look
from calibration.primaries import Primaries
from calibration.spectra import write_spectra
from pipeline import io, pictures
from pipeline.compositions import LIGHTS, Composition, compose
from pipeline.errors import fault, storing
from pipeline.files import header as headers
from pipeline.files import video
from stages import cube, shadows
from stages.fill import fill
from stages.light import light as prepare
from stages.prefilter import mean
from stages.preview import Drawing, sequence, side_by_side
from stages.scene import BRDFS, Scene, turned
from stages.trichromatic import SPACES, Trichromatic
from stages.types import Float, Measured

CHANNELS = ("compare", "six", *SPACES)
"""Six beside sharpened RGB, or one of: the primaries, sharpened RGB, XYZ."""
QUALITIES = {"draft": 0.5, "good": 1.0, "best": 4.0}

_COUNTED = {5: "five", 6: "six", 7: "seven", 8: "eight"}
_SPACE_NAMES = {"sharp": "sharpened RGB", "xyz": "XYZ"}
# A picture wider than this is shown above the other it is compared with, not beside it.
_WIDE = 1.7
# Where a picture is exposed for a white: it comes to lie where the tone curve has bent a little.
OF_WHITE = 0.65


@dataclass(frozen=True)
class Rendering:
    """How a composition is rendered and shown.

    width       px of the whole picture
    samples     of the gloss, per pixel; None: by each material's roughness and the quality
    quality     one of QUALITIES
    channels    one of CHANNELS
    brdf        in place of the materials' own; None: theirs
    facing_deg  where the viewer stands, seen from the scene: from +Z towards +X
    turn_deg    of the environment about +Y, from +Z towards +X
    device      the GPU's number; None: the system's choice
    backend     of OpenGL
    look        how XYZ is shown
    """

    width: int = 1280
    samples: int | None = None
    quality: str = "good"
    channels: str = "compare"
    brdf: str | None = None
    facing_deg: float = 0.0
    turn_deg: float = 0.0
    device: int | None = None
    backend: str = "egl"
    look: Look = field(default_factory=Look)

    @property
    def ways(self) -> tuple[str, ...]:
        """Of rendering, in the order shown."""
        return ("six", "sharp") if self.channels == "compare" else (self.channels,)


@dataclass(frozen=True)
class Rendered:
    """A composition's pictures.

    signal   (H, W, 3) in 0..1 for the look's display: all pictures, with their captions
    xyz      (h, W, 3) of the first way's pictures beside each other, in the unit of the map
    whites   XYZ (3,) of each column's white
    figures  for --json
    """

    signal: Float
    xyz: Float
    whites: tuple[Any, ...]
    figures: dict[str, Any]


def draw(
    light: Float, primaries: Primaries, composition: Composition, rendering: Rendering
) -> Rendered:
    """A composition under a map.

    light  (6, N, N, P) in the primaries, without holes
    """
    scenes = [_oriented(composition, rendering, facing) for facing in composition.facing]
    angles = [facing - composition.facing[0] for facing in composition.facing]
    frames = _frames(light, primaries, composition, rendering, scenes, angles)
    by_way = {way: list(drawn) for way, drawn in frames.items()}
    whites = _whites(light, primaries, composition)
    rows, exposures = [], []
    for k, white in enumerate(whites):
        drawn = [by_way[way][k] for way in rendering.ways]
        judged = drawn[0] if composition.whites[k] is None else OF_WHITE * white[None]
        column = [looks.shown(xyz, rendering.look, white, exposure_of=judged) for xyz in drawn]
        exposures.append(column[0].exposure_ev)
        rows.append([made.signal for made in column])
    rows = [list(row) for row in zip(*rows, strict=True)]  # a row each way, a column each side
    captions = [_captions(way, primaries, composition) for way in rendering.ways]
    if len(whites) == 1 and len(rows) > 1 and composition.aspect <= _WIDE:
        rows, captions = [[r[0] for r in rows]], [[c[0] for c in captions]]
    signal = np.concatenate(
        [side_by_side(row, said) for row, said in zip(rows, captions, strict=True)], axis=0
    )
    figures = {
        "scene": composition.name,
        "channels": list(rendering.ways),
        "primaries": primaries.name,
        "look": looks.in_words(rendering.look),
        "exposure_ev": exposures,
        "white_xyz": [np.asarray(white).tolist() for white in whites],
        **composition.figures,
    }
    first = np.concatenate(by_way[rendering.ways[0]], axis=1)
    return Rendered(signal, first, whites, figures)


def turntable(
    light: Float,
    primaries: Primaries,
    composition: Composition,
    rendering: Rendering,
    count: int,
) -> Iterator[Float]:
    """Signals (H, W, 3) of a scene that turns once before the camera, in `count` pictures.

    The camera and the light stay. White and exposure are those of the first picture.
    """
    still = _oriented(composition, rendering, composition.facing[0])
    angles = [360.0 * k / count for k in range(count)]
    scenes = [replace(turned(still, angle), camera=still.camera) for angle in angles]
    white = _whites(light, primaries, composition)[0]
    ways = _frames(light, primaries, composition, rendering, scenes, angles).values()
    captions = [_captions(way, primaries, composition)[0] for way in rendering.ways]
    look = rendering.look
    beside = composition.aspect <= _WIDE
    for drawn in zip(*ways, strict=True):
        shown = [looks.shown(xyz, look, white, exposure_of=drawn[0]) for xyz in drawn]
        look = replace(look, exposure_ev=shown[0].exposure_ev)
        signals = [s.signal for s in shown]
        if beside:
            yield side_by_side(signals, captions)
        else:
            rows = [side_by_side([s], [c]) for s, c in zip(signals, captions, strict=True)]
            yield np.concatenate(rows, axis=0)


def _oriented(composition: Composition, rendering: Rendering, facing_deg: float) -> Scene:
    """The scene turned to where the viewer stands, against the way the environment turns."""
    facing_deg += rendering.facing_deg - rendering.turn_deg - composition.turn_deg
    scene = turned(composition.scene, facing_deg)
    if rendering.brdf is None:
        return scene
    things = tuple((mesh, replace(m, brdf=rendering.brdf)) for mesh, m in scene.things)
    return replace(scene, things=things)


def _frames(
    light: Float,
    primaries: Primaries,
    composition: Composition,
    rendering: Rendering,
    scenes: Sequence[Scene],
    angles: Sequence[float],
) -> dict[str, Iterator[Float]]:
    """Each scene's XYZ (h, w, 3), by way: light and surfaces in that way's channels.

    scenes, angles  the first scene turned by each angle, cameras wherever
    """
    where: dict[str, Any] = {"device": rendering.device, "backend": rendering.backend}
    quality = QUALITIES[rendering.quality]
    how = Drawing(
        *_size(composition, rendering), samples=rendering.samples, quality=quality, **where
    )
    seen = None if composition.alone else shadows.sight(scenes[0], **where)

    def shaded(scenes, prepared, seen: shadows.Sight):
        """How each is shadowed; one at a time, as they are drawn."""
        for scene, angle in zip(scenes, angles, strict=True):
            yield shadows.shade(scene, prepared, sight=seen.turned(angle), **where)

    drawn: dict[str, Iterator[Float]] = {}
    for way in rendering.ways:
        environment, matrix, theirs = light, primaries.xyz_from_primaries, scenes
        if way != "six":
            three = Trichromatic.named(way, primaries)
            environment, matrix = three.light(light), three.xyz_from_channels
            theirs = [three.scene(scene) for scene in scenes]
        prepared = prepare(environment)
        drawn[way] = sequence(
            prepared,
            matrix,
            theirs,
            how,
            shades=None if seen is None else shaded(theirs, prepared, seen),
        )
    return drawn


def _size(composition: Composition, rendering: Rendering) -> tuple[int, int]:
    """Width and height of one picture, px; even, as video wants them."""
    beside = len(composition.facing)
    if len(rendering.ways) > 1 and beside == 1 and composition.aspect <= _WIDE:
        beside = 2
    width = max(2, rendering.width // beside // 2 * 2)
    return width, max(2, round(width / composition.aspect / 2) * 2)


def _whites(light: Float, primaries: Primaries, composition: Composition) -> tuple[Any, ...]:
    """XYZ of white in each column: the composition's, or what a small white sphere scatters."""
    whole = primaries.xyz_from_primaries @ mean(light)
    return tuple(whole if white is None else white for white in composition.whites)


def _captions(way: str, primaries: Primaries, composition: Composition) -> list[str]:
    if way == "six":
        count = len(primaries.channels)
        name = f"{_COUNTED.get(count, count)} channels"
    else:
        name = f"three channels ({_SPACE_NAMES[way]})"
    said = composition.said.get(way, ("",) * len(composition.headings))
    return [
        ", ".join(filter(None, [name, heading, also]))
        for heading, also in zip(composition.headings, said, strict=True)
    ]


# ------------------------------------------------------------------------------- maps and files


@dataclass(frozen=True)
class Environment:
    """A finished map, ready to light.

    file    it was read from
    light   (6, N, N, P) without holes
    header  of the file
    notes   what was done to it
    """

    file: Path
    light: Float
    primaries: Primaries
    header: dict[str, str]
    notes: tuple[str, ...]


def read(envmap: Path) -> Environment:
    """The map in a folder `sixlight envmap` wrote, or a cubemap.exr; InputError for another."""
    file = envmap / "cubemap.exr" if envmap.is_dir() else envmap
    measured, names = io.read_measured(file, cube=True)
    size = measured.values.shape[1]
    if size & (size - 1):
        raise fault(f"faces of {size} texels", "a power of two", "resample the map", file)
    header = io.read_exr(file)[2]
    primaries = headers.primaries_of(file, names, header)
    if header.get("quantity", "light") != "light":
        raise fault(f"{header['quantity']} in its header", "light", "give a map of light", file)
    known = np.isfinite(measured.values).all(axis=-1) & (measured.valid > 0)
    share = float((known * cube.solid_angles(size)).sum() / (4 * np.pi))
    if share == 0.0:
        raise fault("nothing in it is known", "a map with light in it", "make it again", file)
    # A texel that says it is known and is not, is not.
    valid = np.where(known, measured.valid, 0).astype(np.float32)
    light = fill(Measured(measured.values, measured.variance, valid))
    if not (primaries.xyz_from_primaries[1] @ mean(light)) > 0.0:
        raise fault("no light in it", "a map with light in it", "make it again", file)
    notes = (
        (f"{1 - share:.1%} of all directions are not known in the map: filled smoothly",)
        if share < 0.9995
        else ()
    )
    return Environment(file, light, primaries, header, notes)


@dataclass(frozen=True)
class Made:
    """What `preview` wrote, and what there is to say about it."""

    files: tuple[Path, ...]
    figures: dict[str, Any]
    notes: tuple[str, ...]


def preview(
    envmap: Path,
    scene: str,
    out: Path | None,
    rendering: Rendering,
    *,
    bits: int | None = None,
    frames: int = 0,
    lights: str = LIGHTS,
    seed: int = 1,
    force: bool = False,
) -> Made:
    """Renders a finished map into preview_SCENE.png and .exr, or a turntable.

    envmap  a folder `sixlight envmap` wrote, or a cubemap.exr
    scene   as `compositions.compose` knows it
    out     folder for the pictures, or for a turntable's; a video where it ends in .mp4;
            None: where the map is
    bits    a channel of the PNG, 8 or 16
    frames  of a turntable; 0: one still picture
    raises  InputError where the map, the scene or the place is wrong; pictures of ours are replaced
    """
    _check(rendering)
    environment = read(envmap)
    composition = compose(scene, environment.light, environment.primaries, lights=lights, seed=seed)
    if frames:
        return _turntable(environment, composition, out, rendering, frames, bits, force)
    folder = out or environment.file.parent
    stem = f"preview_{composition.name}"
    picture, values = folder / f"{stem}.png", folder / f"{stem}.exr"
    spectra = {folder / f"{stem}_{name}.csv": s for name, s in composition.spectra.items()}
    ours = (folder / "work" / "capture.json").is_file()
    for path in (values, *spectra):
        check_place(path, force or ours)
    pictures.check(picture, rendering.look, bits, force=force or ours)
    drawn = draw(environment.light, environment.primaries, composition, rendering)
    with moving_into(folder) as beside:
        write(
            (beside / picture.name, beside / values.name),
            drawn,
            environment.header,
            rendering,
            bits=bits,
        )
        for path, found in spectra.items():
            write_spectra(beside / path.name, found)
    return Made(
        (picture, values, *spectra), drawn.figures, (*environment.notes, *composition.notes)
    )


def write(
    paths: Sequence[Path],
    drawn: Rendered,
    header,
    rendering: Rendering,
    *,
    bits: int | None = None,
) -> None:
    """The picture as PNG and its XYZ as EXR."""
    picture, values = paths
    caption = f"{drawn.figures['scene']}: {', '.join(drawn.figures['channels'])} channels"
    pictures.write(picture, drawn.signal, rendering.look, bits=bits, caption=caption)
    about = {
        **header,
        **pictures.about_white(drawn.whites[0]),
        "step": "preview",
        "channels": f"X Y Z, rendered in {rendering.ways[0]} channels",
    }
    io.write_exr(values, drawn.xyz, "XYZ", about)


def _turntable(
    environment: Environment,
    composition: Composition,
    out: Path | None,
    rendering: Rendering,
    count: int,
    bits: int | None,
    force: bool,
) -> Made:
    if len(composition.facing) > 1:
        raise fault(
            f"a turntable of {composition.name}, which looks two ways",
            "a scene that is seen from one side",
            "leave --turntable out",
        )
    out = out or environment.file.parent / f"turntable_{composition.name}"
    frames = turntable(environment.light, environment.primaries, composition, rendering, count)
    notes = (*environment.notes, *composition.notes)
    figures = {"scene": composition.name, "frames": count, "channels": list(rendering.ways)}
    if out.suffix.lower() in video.FORMATS:
        check_place(out, force)
        with moving_into(out.parent) as beside:
            video.write(beside / out.name, frames)
        return Made((out,), figures, notes)
    digits = max(3, len(str(count - 1)))
    paths = [out / f"frame_{k:0{digits}d}.png" for k in range(count)]
    for path in paths:
        check_place(path, force)
    pictures.check(paths[0], rendering.look, bits, force=force)
    with moving_into(out) as beside:
        for path, signal in zip(paths, frames, strict=True):
            pictures.write(beside / path.name, signal, rendering.look, bits=bits)
    return Made(tuple(paths), figures, notes)


def _check(rendering: Rendering) -> None:
    for what, word, known in (
        ("quality", rendering.quality, tuple(QUALITIES)),
        ("channels", rendering.channels, CHANNELS),
        ("BRDF", rendering.brdf, (None, *BRDFS)),
    ):
        if word not in known:
            choices = ", ".join(k for k in known if k is not None)
            raise fault(f"no {what} called {word!r}", choices, "choose one of these")


@contextmanager
def moving_into(folder: Path) -> Iterator[Path]:
    """A folder to write in, whose files are moved into `folder` when all are written."""
    with storing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".unfinished-", dir=folder) as beside:
            yield Path(beside)
            for path in sorted(Path(beside).iterdir()):
                os.replace(path, folder / path.name)


def check_place(path: Path, replaceable: bool) -> None:
    """InputError where something is that may not be replaced."""
    if path.exists() and not replaceable:
        raise fault("exists", "a new file", "choose another -o, or --force", path)
