"""Writing raw photographs: DNG 1.4 with lossless JPEG, as cameras and converters write them."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.simulate.camera import Camera
from pipeline.simulate.materials import require

MAKE, MODEL = "Sixlight", "Simulated D5100"

_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _SRATIONAL = 1, 2, 3, 4, 5, 10
_FORMAT = {_BYTE: "<B", _SHORT: "<H", _LONG: "<I", _RATIONAL: "<II", _SRATIONAL: "<ii"}

Directory = dict[int, tuple[int, Any]]  # tag -> type, text or list of values


@dataclass(frozen=True)
class Shot:
    """What a camera notes about one exposure.

    time_s      the shutter as tagged: (numerator, denominator)
    taken       date and time
    as_shot     camera signals (3,) of a neutral under the light, the largest 1
    """

    time_s: tuple[int, int]
    taken: datetime
    as_shot: tuple[float, float, float]


def write_dng(path: Path, samples, camera: Camera, shot: Shot, colour_matrix) -> None:
    """Write raw samples (H, W) uint16, H and W even, RGGB from the first pixel on.

    colour_matrix  (3, 3) camera signals from XYZ of daylight; raw converters want one
    """
    codecs = require("imagecodecs")
    height, width = samples.shape
    assert samples.dtype == np.uint16
    assert height % 2 == 0
    assert width % 2 == 0
    bits = int(camera.saturation_level).bit_length()
    # Two rows of the mosaic as one of the JPEG: then a sample and its neighbours above and beside,
    # which predict it, are of alternating colours in step.
    data = codecs.ljpeg_encode(
        np.ascontiguousarray(samples).reshape(height // 2, 2 * width), bitspersample=bits
    )
    per_cm = _fraction(1e4 / camera.pixel_pitch_um, 1000)
    taken = shot.taken.strftime("%Y:%m:%d %H:%M:%S")
    directory = {
        256: (_LONG, [width]),
        257: (_LONG, [height]),
        258: (_SHORT, [16]),  # BitsPerSample once unpacked
        259: (_SHORT, [7]),  # Compression: lossless JPEG
        262: (_SHORT, [32803]),  # PhotometricInterpretation: CFA
        271: (_ASCII, MAKE),
        272: (_ASCII, MODEL),
        273: (_LONG, [0]),  # StripOffsets, set below
        274: (_SHORT, [1]),  # Orientation: row 0 is the top
        277: (_SHORT, [1]),  # SamplesPerPixel
        278: (_LONG, [height]),  # RowsPerStrip
        279: (_LONG, [len(data)]),  # StripByteCounts
        306: (_ASCII, taken),
        33421: (_SHORT, [2, 2]),  # CFARepeatPatternDim
        33422: (_BYTE, [0, 1, 1, 2]),  # CFAPattern
        34665: (_LONG, [0]),  # where the EXIF directory lies, set below
        50706: (_BYTE, [1, 4, 0, 0]),  # DNGVersion
        50707: (_BYTE, [1, 1, 0, 0]),  # DNGBackwardVersion
        50708: (_ASCII, f"{MAKE} {MODEL}"),  # UniqueCameraModel
        50710: (_BYTE, [0, 1, 2]),  # CFAPlaneColor
        50711: (_SHORT, [1]),  # CFALayout: rectangular
        50713: (_SHORT, [2, 2]),  # BlackLevelRepeatDim
        50714: (_SHORT, [camera.black_level] * 4),  # BlackLevel
        50717: (_SHORT, [camera.saturation_level]),  # WhiteLevel
        50721: (_SRATIONAL, [_fraction(v, 10000) for v in np.ravel(colour_matrix)]),  # ColorMatrix1
        50728: (_RATIONAL, [_fraction(v, 1000000) for v in shot.as_shot]),  # AsShotNeutral
        50778: (_SHORT, [21]),  # CalibrationIlluminant1: D65
    }
    exif = {
        33434: (_RATIONAL, [shot.time_s]),  # ExposureTime
        33437: (_RATIONAL, [_fraction(camera.f_number, 10)]),  # FNumber
        34855: (_SHORT, [camera.iso]),  # ISOSpeedRatings
        36867: (_ASCII, taken),  # DateTimeOriginal
        37386: (_RATIONAL, [_fraction(camera.focal_length_mm, 10)]),  # FocalLength
        41486: (_RATIONAL, [per_cm]),  # FocalPlaneXResolution
        41487: (_RATIONAL, [per_cm]),  # FocalPlaneYResolution
        41488: (_SHORT, [3]),  # FocalPlaneResolutionUnit: centimetre
    }
    header = struct.pack("<2sHI", b"II", 42, 8)
    exif_at = len(header) + len(_packed(directory, 0))
    data_at = exif_at + len(_packed(exif, 0))
    directory |= {273: (_LONG, [data_at]), 34665: (_LONG, [exif_at])}
    path.write_bytes(header + _packed(directory, len(header)) + _packed(exif, exif_at) + data)


def _packed(directory: Directory, offset: int) -> bytes:
    """A TIFF directory, little endian, that is to lie at `offset`, with the values it points to."""
    table = struct.pack("<H", len(directory))
    values = b""
    values_at = offset + 2 + 12 * len(directory) + 4
    for tag, (kind, value) in sorted(directory.items()):
        if kind == _ASCII:
            data, count = value.encode("ascii") + b"\0", len(value) + 1
        else:
            data = b"".join(struct.pack(_FORMAT[kind], *np.atleast_1d(v)) for v in value)
            count = len(value)
        data += b"\0" * (len(data) % 2)
        if len(data) <= 4:
            table += struct.pack("<HHI", tag, kind, count) + data.ljust(4, b"\0")
        else:
            table += struct.pack("<HHII", tag, kind, count, values_at + len(values))
            values += data
    return table + struct.pack("<I", 0) + values


def _fraction(value: float, limit: int) -> tuple[int, int]:
    fraction = Fraction(float(value)).limit_denominator(limit)
    return fraction.numerator, fraction.denominator
