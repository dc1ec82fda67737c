"""KTX2 files against the Khronos specification, read by a parser of the test's own."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
import pytest

from pipeline.files import ktx2


@dataclass(frozen=True)
class Texture:
    levels: list[np.ndarray]  # (6, n, n, 4)
    header: dict[str, str]


def parse(content: bytes) -> Texture:
    """What KTX 2.0 says of an uncompressed RGBA16F cube, every must of it checked."""
    assert content[:12] == bytes([0xAB, *b"KTX 20", 0xBB, *b"\r\n", 0x1A, *b"\n"])
    vk_format, type_size, width, height, depth, layers, faces, count, scheme = struct.unpack_from(
        "<9I", content, 12
    )
    assert (vk_format, type_size) == (97, 2)  # VK_FORMAT_R16G16B16A16_SFLOAT, 2-byte components
    assert (depth, layers, faces, scheme) == (0, 0, 6, 0)
    assert width == height > 0
    assert 1 <= count <= int(np.log2(width)) + 1
    dfd_at, dfd_size, kvd_at, kvd_size, sgd_at, sgd_size = struct.unpack_from("<4I2Q", content, 48)
    assert (sgd_at, sgd_size) == (0, 0)
    assert dfd_at == 80 + 24 * count  # right after the level index
    assert kvd_at == dfd_at + dfd_size
    _check_descriptor(content[dfd_at : dfd_at + dfd_size])
    header = _pairs(content[kvd_at : kvd_at + kvd_size])
    levels, places = [], []
    for k in range(count):
        offset, size, uncompressed = struct.unpack_from("<3Q", content, 80 + 24 * k)
        n = width >> k
        assert size == uncompressed == 6 * n * n * 8
        assert offset % 8 == 0  # lcm(bytes of a texel, 4)
        assert offset + size <= len(content)
        places.append((offset, offset + size))
        levels.append(np.frombuffer(content, "<f2", 6 * n * n * 4, offset).reshape(6, n, n, 4))
    # The smallest level first, none over another, padding below 8 bytes and zero.
    end = kvd_at + kvd_size
    for start, stop in reversed(places):
        assert 0 <= start - end < 8
        assert content[end:start] == bytes(start - end)
        end = stop
    assert end == len(content)
    return Texture(levels, header)


def _check_descriptor(block: bytes) -> None:
    assert struct.unpack_from("<I", block)[0] == len(block)
    vendor_and_type, versions, size = struct.unpack_from("<I2H", block, 4)
    assert (vendor_and_type, versions, size) == (0, 2, len(block) - 4)
    model, primaries, transfer, flags = struct.unpack_from("<4B", block, 12)
    assert (model, primaries, transfer, flags) == (1, 0, 1, 0)  # RGBSDA, unspecified, linear
    assert block[16:20] == bytes(4)  # a block is one texel
    assert block[20:28] == bytes([8, 0, 0, 0, 0, 0, 0, 0])  # bytes of plane 0, the only one
    samples = [struct.unpack_from("<HBB4B2f", block, k) for k in range(28, len(block), 16)]
    for sample, (offset, channel) in zip(
        samples, [(0, 0), (16, 1), (32, 2), (48, 15)], strict=True
    ):
        # 16 bits less one; signed and float; -1 and 1 stand for the range
        assert sample == (offset, 15, channel | 0xC0, 0, 0, 0, 0, -1.0, 1.0)


def _pairs(data: bytes) -> dict[str, str]:
    header, at = {}, 0
    while at < len(data):
        size = struct.unpack_from("<I", data, at)[0]
        key, value, rest = data[at + 4 : at + 4 + size].split(b"\0")
        assert rest == b""
        header[key.decode()] = value.decode()
        at += 4 + size
        padding = -at % 4
        assert data[at : at + padding] == bytes(padding)
        at += padding
    assert list(header) == sorted(header)
    assert at == len(data)
    return header


def mips(size=8):
    """Levels whose texels tell face, level and place; half floats hold them exactly."""
    levels = []
    for k in range(int(np.log2(size)) + 1):
        n = size >> k
        face, y, x = np.indices((6, n, n))
        levels.append(np.stack([x / 16, y / 16, face * 16 + k], axis=-1).astype(np.float32))
    return levels


@pytest.mark.parametrize("size", [1, 2, 8])
def test_a_reader_by_the_specification_finds_every_texel(tmp_path, size):
    path, levels = tmp_path / "a.ktx2", mips(size)
    ktx2.write(path, levels, {"scale": "4", "units": "µ"})
    texture = parse(path.read_bytes())
    for level, wanted in zip(texture.levels, levels, strict=True):
        np.testing.assert_array_equal(level[..., :3], wanted)
        assert (level[..., 3] == 1).all()
    assert texture.header["KTXorientation"] == "rd"
    assert texture.header["KTXwriter"].startswith("sixlight ")
    assert texture.header["sixlight:scale"] == "4"
    assert texture.header["sixlight:units"] == "µ"


def test_negative_light_is_kept(tmp_path):
    ktx2.write(tmp_path / "a.ktx2", [np.full((6, 1, 1, 3), -0.25, np.float32)], {})
    assert (parse((tmp_path / "a.ktx2").read_bytes()).levels[0][..., :3] == -0.25).all()
