"""A plain DNG: uncompressed Bayer samples and the tags a camera writes, by tifffile."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tifffile

_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _SRATIONAL = 1, 2, 3, 4, 5, 10
_CAMERA_FROM_XYZ = (3.24, -1.54, -0.5, -0.97, 1.88, 0.04, 0.06, -0.2, 1.06)  # sRGB's will do


def write(
    path: Path,
    samples,
    *,
    black_level: int | tuple[int, int, int, int],
    saturation_level: int,
    time_s: tuple[int, int] | None,
    f_number: tuple[int, int] = (8, 1),
    iso: int = 100,
    model: str = "Plain",
    focus_m: tuple[int, int] | None = None,
    cfa: str = "RGGB",
    active_area: tuple[int, int, int, int] | None = None,
) -> None:
    """Writes raw samples (H, W) uint16; a time_s or focus_m of None leaves the tag out.

    black_level  one, or one for each of the CFA's positions, row by row
    cfa, black_level  from the first pixel of the active area on
    active_area  top, left, bottom, right; None: all of it
    """
    blacks = (black_level,) if isinstance(black_level, int) else black_level
    matrix = tuple(n for v in _CAMERA_FROM_XYZ for n in (round(v * 100), 100))
    tags = [
        (271, _ASCII, 0, "Tests", True),
        (272, _ASCII, 0, model, True),
        (274, _SHORT, 1, 1, True),
        (33421, _SHORT, 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, _BYTE, 4, bytes("RGB".index(c) for c in cfa), True),  # CFAPattern
        (33437, _RATIONAL, 1, f_number, True),
        (34855, _SHORT, 1, iso, True),
        (50706, _BYTE, 4, bytes([1, 4, 0, 0]), True),  # DNGVersion
        (50707, _BYTE, 4, bytes([1, 1, 0, 0]), True),
        (50708, _ASCII, 0, f"Tests {model}", True),
        (50710, _BYTE, 3, bytes([0, 1, 2]), True),  # CFAPlaneColor
        (50713, _SHORT, 2, (1, 1) if len(blacks) == 1 else (2, 2), True),  # BlackLevelRepeatDim
        (50714, _RATIONAL, len(blacks), tuple(n for b in blacks for n in (b, 1)), True),
        (50717, _LONG, 1, saturation_level, True),
        (50721, _SRATIONAL, 9, matrix, True),  # ColorMatrix1
        (50728, _RATIONAL, 3, (1, 2, 1, 1, 2, 3), True),  # AsShotNeutral
        (50778, _SHORT, 1, 21, True),  # CalibrationIlluminant1: D65
    ]
    if time_s is not None:
        tags.append((33434, _RATIONAL, 1, time_s, True))
    if active_area is not None:
        tags.append((50829, _LONG, 4, active_area, True))
    if focus_m is not None:
        tags.append((37382, _RATIONAL, 1, focus_m, True))  # SubjectDistance
    with tifffile.TiffWriter(path) as tif:
        tif.write(
            np.ascontiguousarray(samples, np.uint16),
            photometric=32803,
            planarconfig=1,
            extratags=tags,
            metadata=None,
        )
