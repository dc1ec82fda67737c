"""`sixlight convert`: environment maps from one layout to another, and to what engines read."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline import io
from pipeline.errors import InputError, Problem, fault, storing
from pipeline.files import dds, ktx2
from stages import cube
from stages.export import half_float_scale
from stages.fill import fill
from stages.layouts import (
    CUBE,
    PACKINGS,
    PROJECTIONS,
    BallPhotograph,
    Projection,
    packed,
    unpacked,
)
from stages.locate import locate
from stages.prefilter import prefilter
from stages.resample import resample
from stages.types import Measured

FACES = "faces"  # six files, one a face
LAYOUTS = (*PACKINGS, FACES, *(name for name in PROJECTIONS if name not in PACKINGS))
SUFFIXES = (".exr", ".hdr", ".tif", ".ktx2", ".dds")
_TEXTURES = (".ktx2", ".dds")
_DISTANT = 1e5  # radii: a camera so far away counts as infinitely far
_FILLED_FROM = 256  # texels along a face of the cube that holes are filled from, at most

_ORIENTATION = {
    "cube": "faces px nx py ny pz nz stacked top to bottom, each as OpenGL's cube map table has it",
    "hcross": "faces as OpenGL's cube map table has them: py over pz, nx pz px nz in a row, ny",
    "vcross": "faces as OpenGL's cube map table has them: py, then nx pz px, ny, nz upside down",
    "faces": "one face a file, as OpenGL's cube map table has it",
    "latlong": "2:1, row 0 at +Y, centre column at -Z, +X right of the centre",
    "mirrorball": "a mirror ball seen from far away on +Z: centre +Z, rim -Z, +X right, +Y up",
    "angular": "distance from the centre is the angle from -Z, rim +Z; +X right, +Y up",
    "octahedral": "centre +Y, corners -Y, +X right, +Z down",
}


@dataclass(frozen=True)
class Preset:
    """What an engine reads, so that it shows a map where it shows a glTF model's surroundings.

    suffixes  of files it takes
    centre    the direction of the glTF world, right-handed with +Y up, that lies in the middle of
              the latlong image
    yaw_deg   the turn that brings it there
    """

    suffixes: tuple[str, ...]
    centre: str
    yaw_deg: float


# docs/layouts.md says from where each is known, and which are proven by a picture.
PRESETS = {
    "blender": Preset((".exr", ".hdr"), "+X, which is Blender's +X", 90.0),
    "mitsuba": Preset((".exr", ".hdr"), "+Z", 180.0),
    "threejs": Preset((".exr", ".hdr"), "+X", 90.0),
    "unreal": Preset((".hdr",), "-Z, which is Unreal's -Y", 0.0),
    "unity": Preset((".exr", ".hdr"), "+Z", 180.0),
    "filament": Preset((".exr", ".hdr"), "+Z", 180.0),
}


def convert(
    source: Path,
    out: Path,
    *,
    layout: str | None = None,
    source_layout: str | None = None,
    size: int | None = None,
    turn: str | None = None,
    preset: str | None = None,
    channels: str | None = None,
    outline: str | None = None,
    distance: float | None = None,
    filled: bool = False,
    force: bool = False,
) -> dict[str, Any]:
    """An environment map in another layout, as files; and figures of what was done.

    source         an image OpenImageIO reads; with {face} in its name, six
    out            likewise: .exr, .hdr, .tif; or .ktx2, .dds, cubes with prefiltered mips
    layout         one of LAYOUTS; may be left out with a preset, .ktx2 or .dds
    source_layout  of the source; left out, its header's, or what its shape tells
    size           rows of the image; of cubes, texels along a face. Left out: the source's detail
    turn           see `rotation`
    preset         one of PRESETS
    channels       names, comma between, in the order they are to have
    outline        of a ball in a photograph: "x,y,radius" in px; else it is searched for
    distance       of its camera from the ball's centre, in the ball's radii; else far away
    filled         close holes, and leave out what is known of errors
    raises         InputError where something of it is wrong
    """
    target = _target(out, layout, preset, size, force)
    rotated = _preset_rotation(preset) @ rotation(turn)
    image = _read(source, source_layout, channels)
    engine = preset is not None or out.suffix.lower() != ".exr"
    if engine:
        image = _three(image, source)
    measured, projection, found = _measured(image, source, outline, distance)
    rows = size or _matching_rows(projection, measured, target.projection)
    if target.suffix in _TEXTURES and rows & (rows - 1):
        raise fault(f"{rows} texels along a face", "a power of two for mips", "give --size", out)
    made = _resampled(measured, projection, target.projection, rows, rotated)
    notes = list(image.notes)
    closed = None
    if filled or engine:
        closed = _holes(made, target.projection, rows)
        made = _filled(made, measured, projection, target.projection, rows, rotated)
        if closed > 0:
            notes.append(f"{closed:.2%} of all directions were not known; they are filled smoothly")
    header = _header(image, source, target, rotated, preset, closed)
    with_errors = not (filled or engine) and (image.errors or not made.valid.all())
    # Engines look for R, G and B; which channels those are, the header says.
    names = tuple("RGB") if engine else image.names
    files, scale = _write(target, made, names, header, with_errors=with_errors)
    return {
        "files": [str(path) for path in files],
        "layout": target.layout,
        "size": rows,
        "from": projection.name,
        "channels": list(image.names),
        "scale": scale,
        **found,
        "notes": notes,
    }


def rotation(turn: str | None):
    """The rotation (3, 3) a user means: nothing, "yaw", "yaw,pitch", "yaw,pitch,roll", or nine.

    Degrees, right-handed: roll about +Z first, then pitch about +X, then yaw about +Y, as the world
    has them; so at yaw 90 what was in +Z comes to +X. Nine numbers are a matrix, row by row.
    """
    if turn is None:
        return np.eye(3)
    numbers = _numbers(turn, "--turn")
    if len(numbers) == 9:
        matrix = np.array(numbers).reshape(3, 3)
        if abs(matrix @ matrix.T - np.eye(3)).max() > 1e-3 or np.linalg.det(matrix) < 0:
            raise fault("--turn with nine numbers that are no rotation", "a rotation", "correct it")
        u, _, vt = np.linalg.svd(matrix)
        return u @ vt
    if len(numbers) > 3:
        raise fault(
            f"--turn with {len(numbers)} numbers", "yaw[,pitch[,roll]] or nine", "correct it"
        )
    return Rotation.from_euler("YXZ", [*numbers, 0.0, 0.0][:3], degrees=True).as_matrix()


def _preset_rotation(preset: str | None):
    return rotation(None if preset is None else str(PRESETS[preset].yaw_deg))


def _numbers(text: str, option: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if not numbers or not np.isfinite(numbers).all():
        raise fault(f"{option} {text!r}", "numbers, comma between", "correct it")
    return numbers


# ------------------------------------------------------------------------------- where it goes


@dataclass(frozen=True)
class _Target:
    """What is written where; `layout` is one of LAYOUTS."""

    out: Path
    layout: str
    suffix: str

    @property
    def projection(self) -> Projection:
        return PROJECTIONS.get(self.layout, CUBE)

    @property
    def files(self) -> list[Path]:
        return _face_files(self.out) if self.layout == FACES else [self.out]


def _target(
    out: Path, layout: str | None, preset: str | None, size: int | None, force: bool
) -> _Target:
    problems = []
    suffix = out.suffix.lower()
    if suffix == ".tiff":
        suffix = ".tif"
    if preset is not None and preset not in PRESETS:
        raise fault(f"preset {preset!r}", ", ".join(PRESETS), "name one")
    if layout is None:
        layout = "latlong" if preset else "cube" if suffix in _TEXTURES else None
    if layout is None:
        raise fault("no --layout", ", ".join(LAYOUTS), "name one, or a --preset", out)
    if layout not in LAYOUTS:
        raise fault(f"layout {layout!r}", ", ".join(LAYOUTS), "name one")
    if suffix not in SUFFIXES:
        problems.append(
            Problem(f"a file {suffix or 'without suffix'}", ", ".join(SUFFIXES), "rename it")
        )
    elif suffix in _TEXTURES and layout != "cube":
        problems.append(Problem(f"layout {layout} in {suffix}", "cube", "choose another suffix"))
    if preset is not None:
        if layout != "latlong":
            problems.append(Problem(f"layout {layout} with a preset", "latlong", "leave one out"))
        if suffix not in PRESETS[preset].suffixes:
            takes = " or ".join(PRESETS[preset].suffixes)
            problems.append(Problem(f"{suffix or 'no suffix'} for {preset}", takes, "rename it"))
    if layout == FACES and "{face}" not in out.name:
        problems.append(
            Problem("one file for six faces", "{face} in its name", "call it NAME_{face}.exr")
        )
    if size is not None and not 1 <= size <= 16384:
        problems.append(Problem(f"--size {size}", "1 to 16384", "correct it"))
    if problems:
        raise InputError(problems).at(out)
    target = _Target(out, layout, suffix)
    there = [path for path in target.files if path.exists()]
    if there and not force:
        raise fault("exists", "a new file", "choose another, or --force", there[0])
    return target


def _face_files(path: Path) -> list[Path]:
    return [path.with_name(path.name.replace("{face}", face)) for face in cube.FACES]


# --------------------------------------------------------------------------------- what is read


@dataclass(frozen=True)
class _Image:
    """What was read: values (H, W, C), or faces (6, N, N, C); valid and variance beside them.

    layout  as the user, the header or the shape says; "photograph" for a ball as it was framed
    errors  whether the file says how well each pixel is known
    """

    values: np.ndarray
    valid: np.ndarray
    variance: np.ndarray
    names: tuple[str, ...]
    layout: str
    header: Mapping[str, str]
    errors: bool
    notes: tuple[str, ...]


def _read(source: Path, layout: str | None, channels: str | None) -> _Image:
    if layout is not None and layout not in LAYOUTS:
        raise fault(f"layout {layout!r}", ", ".join(LAYOUTS), "name one")
    if (layout == FACES) != ("{face}" in source.name):
        found = f"{source.name!r} with --from {layout}" if layout else "six files"
        raise fault(found, "NAME_{face}.exr with --from faces", "give both or neither", source)
    notes: list[str] = []
    if layout == FACES:
        read = [io.read_image(path) for path in _face_files(source)]
        for path, (pixels, names, _, _) in zip(_face_files(source), read, strict=True):
            if pixels.shape != read[0][0].shape or names != read[0][1]:
                raise fault(
                    f"{pixels.shape[1]} x {pixels.shape[0]} px, channels {', '.join(names)}",
                    "six faces alike",
                    "make them alike",
                    path,
                )
        pixels = np.stack([each[0] for each in read])
        _, names, header, decoded = read[0]
        if pixels.shape[1] != pixels.shape[2]:
            raise fault(_size_of(pixels[0]), "square faces", "check the files", source)
        found = FACES
    else:
        pixels, names, header, decoded = io.read_image(source)
        found = layout or header.get("layout", "") or _by_shape(pixels, source)
        if found in PACKINGS:
            faces = unpacked(pixels, found)
            if faces is None:
                raise fault(_size_of(pixels), _EXPECTED[found], "check --from", source)
            pixels = faces
        elif found == "latlong" and pixels.shape[1] != 2 * pixels.shape[0]:
            raise fault(_size_of(pixels), "twice as wide as high", "check --from", source)
        elif found in ("angular", "octahedral") and pixels.shape[0] != pixels.shape[1]:
            raise fault(_size_of(pixels), "as wide as high", "check --from", source)
        elif found == "mirrorball" and header.get("layout") != "mirrorball":
            found = "photograph"
        elif found not in LAYOUTS:
            raise fault(
                f"layout {found!r} in its header", ", ".join(LAYOUTS), "give --from", source
            )
    if decoded:
        notes.append("integers, decoded as sRGB: light above white is cut off in such a file")
    return _split_channels(pixels, names, channels, found, header, tuple(notes), source)


_EXPECTED = {
    "cube": "six square faces stacked, six times as high as wide",
    "hcross": "4 by 3 square faces",
    "vcross": "3 by 4 square faces",
}


def _size_of(pixels) -> str:
    return f"{pixels.shape[1]} x {pixels.shape[0]} px"


def _by_shape(pixels, source: Path) -> str:
    height, width = pixels.shape[:2]
    for name in PACKINGS:
        if unpacked(pixels[..., :1], name) is not None:
            return name
    if width == 2 * height:
        return "latlong"
    raise fault(
        f"{_size_of(pixels)}, which could be several layouts",
        "--from, one of " + ", ".join(LAYOUTS),
        "say what it is",
        source,
    )


def _split_channels(
    pixels, all_names: Sequence[str], wanted: str | None, layout: str, header, notes, source: Path
) -> _Image:
    names = tuple(n for n in all_names if n != "valid" and not n.startswith("sigma."))
    if wanted is not None:
        chosen = tuple(name.strip() for name in wanted.split(","))
        missing = [name for name in chosen if name not in names]
        if missing or len(set(chosen)) < len(chosen):
            raise fault(
                f"--channels {wanted}; the file has {', '.join(names)}"[:300],
                "channels of the file, each once",
                "name those to keep",
                source,
            )
        names = chosen
    if not names:
        raise fault(f"channels {', '.join(all_names)}", "values besides", "check it", source)

    def pick(which):
        return pixels[..., [all_names.index(name) for name in which]]

    values = pick(names)
    known = np.isfinite(values).all(axis=-1)
    valid = known.astype(np.float32)
    if "valid" in all_names:
        given = pick(["valid"])[..., 0]
        valid = np.where(known & np.isfinite(given), np.clip(given, 0.0, 1.0), 0.0)
    if not (valid > 0).any():
        raise fault("not one pixel is known", "finite values", "check the file", source)
    sigmas = [f"sigma.{name}" for name in names]
    has_sigma = set(sigmas) <= set(all_names)
    variance = pick(sigmas) ** 2 if has_sigma else np.full_like(values, np.nan)
    return _Image(
        values,
        np.asarray(valid, np.float32),
        variance,
        names,
        layout,
        header,
        has_sigma or "valid" in all_names,
        notes,
    )


def _three(image: _Image, source: Path) -> _Image:
    """The same with the three channels that files for engines hold."""
    keep = [i for i, name in enumerate(image.names) if name != "A" or len(image.names) != 4]
    if len(keep) != 3:
        raise fault(
            f"{len(image.names)} channels {', '.join(image.names)}"[:200],
            "three, in a file for an engine",
            "name them, as in --channels P1,P2,P3, or give cubemap_123.exr",
            source,
        )
    return replace(
        image,
        values=image.values[..., keep],
        variance=image.variance[..., keep],
        names=tuple(image.names[i] for i in keep),
    )


def _measured(
    image: _Image, source: Path, outline: str | None, distance: float | None
) -> tuple[Measured, Projection, dict[str, Any]]:
    """The map as stages have it, its projection, and what was found of a ball."""
    measured = Measured(image.values, image.variance, image.valid)
    if image.layout != "photograph":
        name = "cube" if image.layout == FACES or image.layout in PACKINGS else image.layout
        if outline is not None or distance is not None:
            raise fault(
                f"--outline or --distance with layout {image.layout}",
                "--from mirrorball",
                "leave them out",
                source,
            )
        return measured, PROJECTIONS[name], {}
    if distance is not None and not distance > 1.0:
        raise fault(f"--distance {distance:g}", "more than 1 radius", "correct it")
    rim = None if outline is None else _numbers(outline, "--outline")
    if rim is not None and len(rim) != 3:
        raise fault(f"--outline {outline!r}", "x,y,radius in px", "correct it")
    height, width = image.valid.shape
    # The search weighs pixels by their noise; of a finished picture it is not known, and 1 % of
    # each pixel serves.
    known = image.valid > 0
    scale = np.abs(image.values[known]).mean()
    noise = (0.01 * (np.abs(image.values) + 0.01 * scale)) ** 2
    searched = Measured(image.values, noise.astype(np.float32), image.valid)
    try:
        sphere = locate([searched], radius_mm=1.0, distance_mm=distance or _DISTANT, outline=rim)
    except InputError as error:
        raise InputError(
            Problem(p.found, p.expected, "give --outline x,y,radius in px") for p in error.problems
        ).at(source) from None
    x, y = sphere.centre_px
    found = {"ball_px": [round(float(v), 2) for v in (x, y, sphere.rim_px)]}
    return measured, BallPhotograph(sphere, height, width), found


def _matching_rows(source: Projection, measured: Measured, target: Projection) -> int:
    """Rows that keep the source's detail: of cubes the nearest power of two, otherwise even."""
    rows = measured.values.shape[-3]
    if source is target:
        return rows
    matching = rows / source.rows_per_radian * target.rows_per_radian
    if target is CUBE:
        return max(1, int(2 ** np.round(np.log2(matching))))
    return max(2, 2 * round(matching / 2))


# --------------------------------------------------------------------------------- what is made


def _resampled(
    measured: Measured, source: Projection, target: Projection, rows: int, turn
) -> Measured:
    if source is target and rows == measured.values.shape[-3] and np.allclose(turn, np.eye(3)):
        return measured
    return resample(measured, source, target, rows, rotation=turn)


def _holes(made: Measured, projection: Projection, rows: int) -> float:
    """The share of all directions of which nothing is known."""
    angles = np.broadcast_to(projection.solid_angles(rows), made.valid.shape)
    share = float((angles * (1.0 - made.valid)).sum() / angles.sum())
    return share if share > 1e-6 else 0.0


def _filled(
    made: Measured, measured: Measured, source: Projection, target: Projection, rows: int, turn
) -> Measured:
    """The same without holes: unknown directions take a smooth continuation of what is around.

    Pixels that look nowhere, as a probe's corners, are 0.
    """
    values = made.values
    if (made.valid < 1).any():
        size = 2 ** int(np.log2(min(_FILLED_FROM, max(1, rows))))
        coarse = resample(measured, source, CUBE, size)
        whole = fill(Measured(coarse.values, coarse.variance, coarse.valid))
        known = Measured(whole, np.full_like(whole, np.nan), np.ones(whole.shape[:-1], np.float32))
        smooth = resample(known, CUBE, target, rows, rotation=turn)
        share = made.valid[..., None]
        values = np.where(share > 0, values, 0.0) * share + smooth.values * (1.0 - share)
        values = np.where(smooth.valid[..., None] > 0, values, 0.0).astype(np.float32)
    return Measured(values, np.full_like(values, np.nan), np.ones(values.shape[:-1], np.float32))


def _header(
    image: _Image, source: Path, target: _Target, turn, preset: str | None, closed: float | None
):
    """What the file says of itself; `closed` is the share of directions that was filled."""
    orientation = _ORIENTATION[target.layout]
    if preset is not None:
        orientation += f"; turned for {preset}: the centre is {PRESETS[preset].centre}"
    before = image.header.get("turned", "").split()
    earlier = np.array(before, float).reshape(3, 3) if len(before) == 9 else np.eye(3)
    about = {
        **image.header,
        "step": "convert",
        "version": version("sixlight"),
        "source": source.name,
        "layout": target.layout,
        "orientation": orientation,
        "channels": " ".join(image.names),
    }
    # A map that came filled stays so. One with holes says nothing of it until they are closed.
    if closed:
        about["filled"] = f"holes are filled smoothly, {closed:.2%} of all directions"
    whole = turn @ earlier
    if not np.allclose(whole, np.eye(3)):
        about["turned"] = " ".join(f"{v:.9g}" for v in whole.ravel())
    return about


def _write(
    target: _Target, made: Measured, names: Sequence[str], header: Mapping[str, str], *, with_errors
) -> tuple[list[Path], float]:
    """Writes beside the final names and moves into place; returns them, and the scale."""
    scale = 1.0
    folder = target.out.parent
    with storing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".unfinished-", dir=folder) as place:
            beside = [Path(place) / path.name for path in target.files]
            if target.suffix in _TEXTURES:
                scale = _write_texture(beside[0], made.values, header)
            else:
                for k, path in enumerate(beside):
                    part = _part(made, target.layout, k)
                    if target.suffix == ".exr":
                        _write_exr(path, part, names, header, with_errors=with_errors)
                    else:
                        _write_rgb(path, part, header)
            for path, final in zip(beside, target.files, strict=True):
                os.replace(path, final)
    return target.files, scale


def _write_texture(path: Path, faces, header: Mapping[str, str]) -> float:
    """A cube (6, N, N, 3) without holes as .ktx2 or .dds with Gaussian mips; returns its scale.

    The values are radiance / scale, a power of two, where half floats could not hold them; a scale
    the header tells of is multiplied in. DDS has no place for a header.
    """
    scale = half_float_scale(faces)
    levels = prefilter(faces / np.float32(scale))
    if path.suffix.lower() == ".dds":
        dds.write(path, levels)
    else:
        told = dict(header)
        if scale != 1.0 or "scale" in told:
            told["scale"] = f"{scale * float(told.get('scale', 1.0)):g}"
        ktx2.write(path, levels, told)
    return scale


def _part(made: Measured, layout: str, k: int) -> Measured:
    """The image that one file holds."""
    if layout in PACKINGS:
        return Measured(
            packed(made.values, layout, np.nan),
            packed(made.variance, layout, np.nan),
            packed(made.valid[..., None], layout)[..., 0],
        )
    if layout == FACES:
        return Measured(made.values[k], made.variance[k], made.valid[k])
    return made


def _write_exr(path: Path, part: Measured, names, header, *, with_errors: bool) -> None:
    if with_errors:
        io.write_measured(path, part, names, header)
    else:
        io.write_exr(path, np.nan_to_num(part.values, nan=0.0), names, header)


def _write_rgb(path: Path, part: Measured, header: Mapping[str, str]) -> None:
    told = [k for k in ("layout", "orientation", "channels", "filled") if k in header]
    about = "; ".join(f"{k}: {header[k]}" for k in told)
    io.write_rgb(path, np.nan_to_num(part.values, nan=0.0), about)
