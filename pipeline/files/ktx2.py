"""Cubemaps with mips as KTX 2.0, half float, for engines; no installable library writes them.

Khronos, "KTX File Format Specification" 2.0, revision 3, and "Khronos Data Format Specification"
1.3 for the data format descriptor. Nothing is compressed, so that any reader can read it.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np

from pipeline.errors import storing

_IDENTIFIER = b"\xabKTX 20\xbb\r\n\x1a\n"
_RGBA16F = 97  # VK_FORMAT_R16G16B16A16_SFLOAT: three channels alone few GPUs take
_TEXEL = 8  # bytes
_RGBSDA, _LINEAR = 1, 1  # KHR_DF_MODEL_RGBSDA, KHR_DF_TRANSFER_LINEAR
_SIGNED_FLOAT = 0xC0  # qualifiers of a sample
_MINUS_ONE, _ONE = 0xBF800000, 0x3F800000  # its range, as float32
# Descriptor blocks name Rec. 709 or no primaries; ours are none that it knows.
_PRIMARIES_UNSPECIFIED = 0


def write(path: Path, levels: Sequence[np.ndarray], header: Mapping[str, str]) -> None:
    """A cubemap as KTX2.

    levels  (6, N, N, 3), (6, N / 2, N / 2, 3) ..., faces +X -X +Y -Y +Z -Z as OpenGL has them; what
            lies beyond half floats must have been scaled before. Alpha is 1
    header  text, stored as sixlight:NAME
    """
    images = [_rgba(level).tobytes() for level in levels]
    descriptor = _descriptor()
    about = {f"sixlight:{name}": text for name, text in header.items()}
    writer = f"sixlight {version('sixlight')}"
    data = _key_values({**about, "KTXorientation": "rd", "KTXwriter": writer})
    index = 80 + 24 * len(levels)
    data_at = index + len(descriptor)
    end = data_at + len(data)
    # The smallest level comes first, each at a multiple of the texel's size.
    offsets = [0] * len(levels)
    for k in reversed(range(len(levels))):
        offsets[k] = -(-end // _TEXEL) * _TEXEL
        end = offsets[k] + len(images[k])
    size = levels[0].shape[1]
    with storing(path), path.open("wb") as file:
        file.write(_IDENTIFIER)
        # format, bytes of a component, width, height, depth, layers, faces, levels, compression
        file.write(struct.pack("<9I", _RGBA16F, 2, size, size, 0, 0, 6, len(levels), 0))
        file.write(struct.pack("<4I2Q", index, len(descriptor), data_at, len(data), 0, 0))
        for offset, image in zip(offsets, images, strict=True):
            file.write(struct.pack("<3Q", offset, len(image), len(image)))
        file.write(descriptor)
        file.write(data)
        for k in reversed(range(len(levels))):
            file.write(bytes(offsets[k] - file.tell()))
            file.write(images[k])


def _rgba(level) -> np.ndarray:
    alpha = np.ones((*level.shape[:-1], 1), level.dtype)
    return np.concatenate([level, alpha], axis=-1).astype("<f2")


def _descriptor() -> bytes:
    """The basic descriptor block of four signed half floats, its total size before it."""
    samples = b""
    for k, channel in enumerate((0, 1, 2, 15)):  # red, green, blue, alpha
        samples += struct.pack(
            "<HBB4B2I", 16 * k, 15, channel | _SIGNED_FLOAT, 0, 0, 0, 0, _MINUS_ONE, _ONE
        )
    size = 24 + len(samples)
    # vendor and type 0 (Khronos, basic), version 2; texel block 1 x 1 x 1 x 1; one plane
    head = struct.pack("<I2H", 0, 2, size)
    head += struct.pack("<4B", _RGBSDA, _PRIMARIES_UNSPECIFIED, _LINEAR, 0)
    head += struct.pack("<4B8B", 0, 0, 0, 0, _TEXEL, *[0] * 7)
    return struct.pack("<I", 4 + size) + head + samples


def _key_values(about: Mapping[str, str]) -> bytes:
    """Keys in the order of their code points, each pair padded to four bytes."""
    result = b""
    for key in sorted(about):
        pair = key.encode() + b"\0" + about[key].encode() + b"\0"
        result += struct.pack("<I", len(pair)) + pair + bytes(-len(pair) % 4)
    return result
