"""What the page's own shaders compute, computed once more in NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.display import SHOULDER, SRGB, show
from stages import cube
from stages.layouts import LATLONG
from stages.opengl import cube_texture, opengl, program, set_uniforms
from stages.preview import _reduced
from stages.renderer import bind


@pytest.fixture(scope="module")
def context():
    with opengl() as context:
        yield context


def drawn(context, shader, picture_size, textures=None, defines=None, **uniforms):
    """(H, W, 3) of one of the shaders, row 0 below."""
    target = context.framebuffer([context.renderbuffer(picture_size, 4, dtype="f4")])
    target.use()
    compiled = program(context, "screen.vert", shader, **(defines or {}))
    set_uniforms(compiled, **uniforms)
    for name, value in uniforms.items():  # ivec2
        if name in compiled and np.asarray(value).dtype.kind == "i" and np.ndim(value) == 1:
            compiled[name].value = tuple(int(v) for v in value)
    bind(compiled, textures or {})
    context.vertex_array(compiled, []).render(vertices=3)
    pixels = np.frombuffer(target.read(components=3, dtype="f4"), np.float32)
    return pixels.reshape(picture_size[1], picture_size[0], 3)


def texture(context, picture):
    height, width = picture.shape[:2]
    four = np.concatenate([picture, np.ones_like(picture[..., :1])], axis=-1)
    made = context.texture((width, height), 4, four.astype(np.float32).tobytes(), dtype="f4")
    made.filter = (context.NEAREST, context.NEAREST)
    return made


@pytest.mark.parametrize("tone", ["shoulder", "clip"])
def test_display_shows_what_display_py_shows(context, tone):
    rng = np.random.default_rng(1)
    xyz = (rng.standard_normal((40, 50, 3)) * 0.6 + 0.5) * rng.choice([0.1, 1, 20], (40, 50, 1))
    matrix = np.eye(3) + 0.1 * rng.standard_normal((3, 3))
    signal = drawn(
        context,
        "display.frag",
        (50, 40),
        {"picture": [texture(context, xyz)]},
        display_from_xyz=matrix.T,
        rgb_from_xyz=SRGB.rgb_from_xyz.T,
        knee=SHOULDER if tone == "shoulder" else 1.0,
        size=(50.0, 40.0),
    )
    adapted = xyz @ matrix.T
    expected = show(adapted, SRGB) if tone == "shoulder" else SRGB.signal(adapted)
    assert np.std(expected) > 0.2
    assert np.abs(signal - expected).max() < 2e-4  # a twentieth of an 8-bit step


@pytest.mark.parametrize("supersampling", [1, 2])
@pytest.mark.parametrize("corner", [(0, 0), (3, 2)])
def test_reduce_takes_points_to_pixels_as_previews_do(context, supersampling, corner):
    """Of all of a picture, or of what lies above and to the right of a corner."""
    s, (x, y) = supersampling, corner
    points = np.random.default_rng(2).random(((8 - y) * s, (12 - x) * s, 3)).astype(np.float32)
    pixels = drawn(
        context,
        "reduce.frag",
        (12, 8),
        {"points": [texture(context, points)]},
        corner=np.array(corner),
        last=np.array([(12 - x) * s - 1, (8 - y) * s - 1]),
        supersampling=s,
    )
    assert np.allclose(pixels[y:, x:], _reduced(_reduced(points, s, 0), s, 1), atol=1e-6)


@pytest.mark.parametrize("turn", [0.0, np.pi / 2])
def test_latlong_shows_each_direction_where_layouts_py_has_it(context, turn):
    size, width = 64, 128
    channels = cube.directions(size)[..., [0, 1, 2, 0, 1, 2]].astype(np.float32)
    maps = [cube_texture(context, [channels[..., k : k + 3]]) for k in (0, 3)]
    picture = drawn(
        context,
        "latlong.frag",
        (width, width // 2),
        {"radiance": maps},
        {"TRIPLES": 2},
        level=0.0,
        place=(0.0, 0.0, float(width), float(width // 2)),
        turn=turn,
        xyz_from_triple=np.stack([np.eye(3), np.zeros((3, 3))]),
    )[::-1]
    v, u = (np.mgrid[0 : width // 2, 0:width] + 0.5) / np.array([width // 2, width])[:, None, None]
    expected = LATLONG.direction(0, (u + turn / (2 * np.pi)) % 1.0, v)
    assert np.abs(picture - expected).max() < 2e-3  # between two texels
