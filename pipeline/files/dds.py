"""Cubemaps with mips as DDS, half float, for engines; no installable library writes them.

Microsoft, "Programming Guide for DDS" and DDS_HEADER, DDS_HEADER_DXT10. Direct3D looks a cube up as
OpenGL does, face by face and row by row, so the texels lie as they do everywhere here.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.errors import storing

_RGBA16F = 10  # DXGI_FORMAT_R16G16B16A16_FLOAT
# caps, height, width, pitch, pixel format, mip count
_FLAGS = 0x1 | 0x2 | 0x4 | 0x8 | 0x1000 | 0x20000
_CAPS = 0x8 | 0x1000 | 0x400000  # complex, texture, mips
_CAPS2 = 0xFE00  # a cube with all its faces
_FOUR_CC = 0x4
_TEXTURE_2D, _CUBE, _ALPHA_STRAIGHT = 3, 0x4, 1


def write(path: Path, levels: Sequence[np.ndarray]) -> None:
    """A cubemap as DDS with a DX10 header.

    levels  (6, N, N, 3), (6, N / 2, N / 2, 3) ..., faces +X -X +Y -Y +Z -Z; what lies beyond half
            floats must have been scaled before. Alpha is 1
    """
    size = levels[0].shape[1]
    with storing(path), path.open("wb") as file:
        file.write(b"DDS ")
        # size of this header, flags, height, width, pitch, depth, mips, reserved
        file.write(struct.pack("<7I44x", 124, _FLAGS, size, size, 8 * size, 0, len(levels)))
        file.write(struct.pack("<2I4s20x", 32, _FOUR_CC, b"DX10"))
        file.write(struct.pack("<2I12x", _CAPS, _CAPS2))
        file.write(struct.pack("<5I", _RGBA16F, _TEXTURE_2D, _CUBE, 1, _ALPHA_STRAIGHT))
        for face in range(6):
            for level in levels:
                alpha = np.ones((*level.shape[1:-1], 1), level.dtype)
                file.write(np.concatenate([level[face], alpha], axis=-1).astype("<f2").tobytes())
