"""DDS files against Microsoft's programming guide, read by a parser of the test's own."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from test_ktx2 import mips

from pipeline.files import dds


def parse(content: bytes) -> list[np.ndarray]:
    """Levels (6, n, n, 4) of an RGBA16F cube with the DX10 header."""
    assert content[:4] == b"DDS "
    size, flags, height, width, pitch, depth, count = struct.unpack_from("<7I", content, 4)
    assert (size, depth) == (124, 0)
    assert flags & 0x21007 == 0x21007  # caps, height, width, pixel format, mip count
    assert (flags & 0x8, pitch) == (0x8, 8 * width)
    assert width == height
    format_size, format_flags, four_cc = struct.unpack_from("<2I4s", content, 76)
    assert (format_size, format_flags, four_cc) == (32, 0x4, b"DX10")
    caps, caps2 = struct.unpack_from("<2I", content, 108)
    assert caps == 0x401008
    assert caps2 == 0x200 | 0xFC00  # a cube map, all of its faces
    dxgi, dimension, misc, array_size, _ = struct.unpack_from("<5I", content, 128)
    assert (dxgi, dimension, misc, array_size) == (10, 3, 0x4, 1)
    levels = [np.empty((6, width >> k, width >> k, 4), np.float16) for k in range(count)]
    at = 148
    for face in range(6):
        for level in levels:
            n = level.shape[1]
            level[face] = np.frombuffer(content, "<f2", n * n * 4, at).reshape(n, n, 4)
            at += n * n * 8
    assert at == len(content)
    return levels


@pytest.mark.parametrize("size", [1, 8])
def test_a_reader_by_the_guide_finds_every_texel(tmp_path, size):
    path, levels = tmp_path / "a.dds", mips(size)
    dds.write(path, levels)
    for level, wanted in zip(parse(path.read_bytes()), levels, strict=True):
        np.testing.assert_array_equal(level[..., :3], wanted)
        assert (level[..., 3] == 1).all()


def test_panda3d_reads_the_same(tmp_path):
    core = pytest.importorskip("panda3d.core", reason="Panda3D is not installed")
    path, levels = tmp_path / "a.dds", mips(8)
    dds.write(path, levels)
    texture = core.Texture()
    assert texture.read(core.Filename.from_os_specific(str(path)))
    assert texture.texture_type == core.Texture.TT_cube_map
    assert texture.num_ram_mipmap_images == len(levels)
    for k, wanted in enumerate(levels):
        kind = "<f2" if texture.component_width == 2 else "<f4"
        n = wanted.shape[1]
        read = np.frombuffer(bytes(texture.get_ram_mipmap_image(k)), kind).reshape(6, n, n, 4)
        # Panda3D keeps images bottom up, blue first, and turns files into its world, which has +Z
        # up and looks to +Y: our -Z, +Z, +Y and -Y are its +Y, -Y, +Z and -Z.
        np.testing.assert_array_equal(read[:, ::-1, :, 2::-1], wanted[[0, 1, 5, 4, 2, 3]])


def test_openimageio_says_which_format_it_cannot_read(tmp_path):
    """It takes the header and stops at the format: of floats it reads but BC6H (3.2, 2026)."""
    import OpenImageIO as oiio

    path = tmp_path / "a.dds"
    dds.write(path, mips(8))
    if oiio.ImageInput.open(str(path)) is None:
        assert "DXGI format: 10" in oiio.geterror()  # DXGI_FORMAT_R16G16B16A16_FLOAT
    # With a format of 8 bits that it does read, and as many bytes a texel, faces and mips are
    # where it looks for them: two of its texels a texel of ours.
    content = bytearray(path.read_bytes())
    struct.pack_into("<I", content, 128, 28)  # DXGI_FORMAT_R8G8B8A8_UNORM
    halved = b"".join(
        level[face].astype(np.uint8).tobytes()
        for face in range(6)
        for level in [np.repeat(m[..., 2:], 4, axis=-1) for m in mips(8)]
    )
    path.write_bytes(bytes(content[:148]) + halved)
    image = oiio.ImageInput.open(str(path))
    assert image is not None, oiio.geterror()
    assert image.spec()["textureformat"] == "CubeFace Environment"
    assert image.spec()["dds:CubeMapSides"] == "+x -x +y -y +z -z"
    faces = image.read_image("uint8").reshape(6, 8, 8, 4)
    image.close()
    np.testing.assert_array_equal(faces[..., 0], mips(8)[0][..., 2])
