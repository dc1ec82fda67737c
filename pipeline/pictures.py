"""Pictures as files: XYZ through a look to a format that says what its numbers mean."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calibration import look as looks
from calibration.look import Look
from pipeline import io
from pipeline.errors import InputError, Problem, fault, storing
from pipeline.files import header as headers
from stages.cube import solid_angles

WHITE = "white_xyz"  # in the header of an XYZ EXR: the scene's white, as `about_white` writes it


def about_white(white) -> dict[str, str]:
    """The scene's white, XYZ (3,), for the header of an XYZ EXR: what `white_of` reads."""
    return {WHITE: " ".join(f"{v:.9g}" for v in np.asarray(white, float))}


def white_of(header: Mapping[str, str]):
    """The scene's white, XYZ (3,), that a header tells; None where it tells none."""
    try:
        white = np.array(header.get(WHITE, "").split(), float)
    except ValueError:
        return None
    return white if white.shape == (3,) and np.isfinite(white).all() else None


def depth(look: Look, bits: int | None = None) -> int:
    """Bits a channel: as asked for, or 8, for PQ 16, whose steps would show."""
    return bits or (16 if look.display.absolute else 8)


def check(path: Path, look: Look, bits: int | None = None, *, force: bool = False) -> None:
    """Before any work: InputError with all that keeps a picture from being written there.

    bits   a channel, 8 or 16; None: as `depth` has it
    force  a file that exists may be replaced
    """
    problems = []
    suffix, absolute = path.suffix.lower(), look.display.absolute
    if suffix not in io.PICTURES:
        problems.append(
            Problem(f"a picture {suffix or 'without suffix'}", ", ".join(io.PICTURES), "rename it")
        )
    elif absolute and suffix.startswith(".tif"):
        problems.append(
            Problem(
                f"{look.display.name} in TIFF, which has no word for it",
                ".png or .jxl",
                "choose another -o",
            )
        )
    if bits not in (None, 8, 16):
        problems.append(Problem(f"{bits} bits a channel", "8 or 16", "choose one"))
    elif absolute and bits == 8:
        problems.append(
            Problem(f"{look.display.name} in 8 bits, whose steps show", "16", "leave --bits out")
        )
    if path.exists() and not force:
        problems.append(Problem("exists", "a new file", "choose another -o, or --force"))
    if problems:
        raise InputError(problems).at(path)


def write(path: Path, signal, look: Look, *, bits: int | None = None, caption: str = "") -> None:
    """A picture that `calibration.look.shown` made, as PNG, JPEG XL or TIFF by its suffix.

    path     as `check` lets it pass; written at once, moving it into place is the caller's
    signal   (H, W, 3) in 0..1, for the look's display
    bits     a channel; None: as `depth` has it
    caption  what is seen, for the file's description; the look is added
    """
    description = "; ".join(filter(None, [caption, looks.in_words(look)]))
    io.write_picture(path, signal, look.display, bits=depth(look, bits), description=description)


def show(
    source: Path, out: Path, look: Look, *, bits: int | None = None, force: bool = False
) -> list[str]:
    """An XYZ EXR, or a map, as a picture; returns what there is to say about it.

    source  channels X, Y, Z, linear, any unit; or light in primaries, whose white is then its mean
    out     the picture; its suffix chooses the format
    raises  InputError where the file, the look or the place is wrong
    """
    check(out, look, bits, force=force)
    xyz, white = _read(source)
    try:
        made = looks.shown(xyz, look, white)
    except InputError as error:
        if white is None and look.adaptation is not None and look.white is None:
            raise fault(
                "the file does not say what is white in it",
                f"{WHITE} in its header, as sixlight's own files have",
                "give --white D65 or another, or --adapt none",
                source,
            ) from None
        raise error.at(source) from None
    with storing(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".unfinished-", dir=out.parent) as folder:
            beside = Path(folder) / out.name
            write(beside, made.signal, look, bits=bits, caption=source.name)
            os.replace(beside, out)
    how = "automatic" if look.exposure_ev is None else "as given"
    notes = [f"{looks.in_words(look)}; exposure {made.exposure_ev:.2f} EV, {how}"]
    if made.unknown:
        share = made.unknown / made.signal[..., 0].size
        notes.append(f"{share:.2%} of the pixels have no value; they are black")
    return notes


def _read(source: Path):
    """XYZ (H, W, 3) of a file, and the white (3,) its header or its light tells, or None."""
    pixels, channels, header = io.read_exr(source)

    def pick(names):
        return pixels[..., [channels.index(name) for name in names]]

    if set("XYZ") <= set(channels):
        return pick("XYZ"), white_of(header)
    names = [c for c in channels if re.fullmatch(r"P\d+", c)]
    if names and header.get("quantity") == "light":
        xyz = pick(names) @ headers.primaries_of(source, names, header).xyz_from_primaries.T
        return xyz, _mean(xyz)
    raise fault(
        f"channels {', '.join(channels)}"[:200],
        "X, Y, Z, or the P1..P6 of a map",
        "give preview_teapot.exr, or latlong.exr",
        source,
    )


def _mean(xyz):
    """Mean (3,) of a map over all directions that are known; None where it is no map.

    xyz  (6 N, N, 3), faces stacked, or (N, 2 N, 3), latitude and longitude
    """
    height, width = xyz.shape[:2]
    if height == 6 * width:
        area = np.tile(solid_angles(width), (6, 1))
    elif width == 2 * height:
        polar = (np.arange(height) + 0.5) * (np.pi / height)
        area = np.repeat(np.sin(polar)[:, None], width, axis=1)
    else:
        return None
    known = np.isfinite(xyz).all(axis=-1)
    return np.average(xyz[known], axis=0, weights=area[known]) if known.any() else None
