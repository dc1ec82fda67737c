"""What running a capture takes, by the size of its photographs: reckoned before it runs."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import BinaryIO

from pipeline.files import tiff
from pipeline.settings import Settings

# What photographers' cameras write; LibRaw, which knows for certain, would take a second to ask.
RAW = (
    *(".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".fff", ".iiq", ".kdc"),
    *(".mef", ".mos", ".mrw", ".nef", ".nrw", ".orf", ".pef", ".ptx", ".raf", ".raw", ".rw2"),
    *(".rwl", ".sr2", ".srf", ".srw", ".x3f"),
)
HEADER_BYTES = 64 << 10  # of a raw file, that hold its directories

# Peak of a whole run, measured (benchmarks/batch.py): Python, the libraries, OpenGL and two
# processes that decode; what a pixel of the photographs adds where the sphere fills them; and what
# a texel of the cube adds.
_BASE_BYTES = 690e6
_BYTES_A_PIXEL = 150.0
_BYTES_A_TEXEL = 450.0

# On disk, measured on the bundled capture: 80 bytes a pixel for merged and developed images of two
# filters, 250 a texel for maps in all their forms; a fifth more, and what the pictures take.
_DISK_BASE_BYTES = 50e6
_DISK_A_PIXEL = 100.0
_DISK_A_TEXEL = 300.0


@dataclass(frozen=True)
class Needs:
    """What a capture's run takes at most.

    memory_bytes  of the process
    disk_bytes    that it writes, results and what its steps leave each other
    """

    memory_bytes: float
    disk_bytes: float


def is_raw(name: str | PurePath) -> bool:
    path = PurePath(name)
    return path.suffix.lower() in RAW and not path.name.startswith(".")


def of_pixels(pixels: float, settings: Settings) -> Needs:
    """Of a capture whose photographs have so many pixels."""
    texels = 6 * (settings.face_size or _largest_face(pixels)) ** 2
    return Needs(
        _BASE_BYTES + _BYTES_A_PIXEL * pixels + _BYTES_A_TEXEL * texels,
        _DISK_BASE_BYTES + _DISK_A_PIXEL * pixels + _DISK_A_TEXEL * texels,
    )


def of_folder(raws: Iterable[Path], settings: Settings) -> Needs:
    """Of a capture on this machine, by its raw files."""
    largest = max(raws, key=lambda path: path.stat().st_size, default=None)
    if largest is None:
        return of_pixels(0.0, settings)
    with largest.open("rb") as file:
        return of_pixels(_pixels(file) or largest.stat().st_size, settings)


def largest_raw(sizes: Mapping[str, int]) -> str | None:
    """The name of the largest raw file; None where there is none."""
    return max(filter(is_raw, sizes), key=lambda name: sizes[name], default=None)


def of_header(size: int, header: bytes, settings: Settings) -> Needs:
    """Of a capture that is elsewhere, by the first HEADER_BYTES of its largest raw file."""
    return of_pixels(_pixels(io.BytesIO(header)) or size, settings)


def _pixels(file: BinaryIO) -> int | None:
    """As the headers of files made like TIFF claim; of others it is for the caller to take that a
    pixel takes a byte."""
    return tiff.largest(tiff.directories(file))


def _largest_face(pixels: float) -> float:
    """Of a sphere that fills the photograph, as `stages.unwrap.default_face_size` has it."""
    return max(64.0, 2.0 ** round(math.log2(max(pixels, 1.0) ** 0.5 / 3.0)))
