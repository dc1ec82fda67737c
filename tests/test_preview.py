"""Pictures whose every pixel is known: on paper, from the numpy cube, or by plain quadrature."""

import numpy as np
import pytest

from calibration.errors import InputError
from stages import cube as cubes
from stages import preview as module
from stages.meshes import revolved, sphere
from stages.prefilter import area_average
from stages.preview import preview, side_by_side
from stages.scene import Camera, Material, Scene

XYZ_FROM_SIX = np.array(
    [
        [0.35, 0.10, 0.02, 0.15, 0.28, 0.05],
        [0.05, 0.08, 0.22, 0.30, 0.25, 0.10],
        [0.90, 0.15, 0.03, 0.01, 0.00, 0.00],
    ]
)
CAMERA = Camera((0.0, 0.0, 6.0), (0.0, 0.0, 0.0), 22.0)
AXES = [(1, 0, 0), (-1, 0, 0), (1e-3, 1, 1e-3), (1e-3, -1, 1e-3), (0, 0, 1), (0, 0, -1)]


def material(diffuse, specular=0.0, roughness=0.2, channels=6):
    return Material(np.full(channels, diffuse), np.full(channels, specular), roughness)


def asymmetric(n, channels=3):
    """A smooth world with nothing the same on any two sides."""
    rng = np.random.default_rng(6)
    d = cubes.directions(n)
    bumps = rng.normal(size=(5, 3))
    bumps /= np.linalg.norm(bumps, axis=1, keepdims=True)
    lobes = np.exp(4 * (d @ bumps.T - 1))
    return (0.2 + lobes @ rng.random((5, channels)) * 3).astype(np.float32)


def rays(camera, width, height):
    """Unit directions (height, width, 3) through the centres of pixels, by similar triangles."""
    forward = np.subtract(camera.target, camera.eye).astype(float)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 1, 0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    half = np.tan(np.radians(camera.vertical_view_deg) / 2)
    x = (2 * (np.arange(width) + 0.5) / width - 1) * half * width / height
    y = (1 - 2 * (np.arange(height) + 0.5) / height) * half
    d = forward + x[None, :, None] * right + y[:, None, None] * up
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


@pytest.mark.parametrize("axis", AXES)
def test_glsl_and_numpy_see_the_same_cube(axis):
    world = asymmetric(16)
    camera = Camera((0.0, 0.0, 0.0), axis, 100.0)
    seen = preview(world, np.eye(3), Scene((), camera), width=30, height=20, supersampling=1)
    d = rays(camera, 30, 20)
    # within half a texel of a corner of the cube three texels meet, and each has its own rule
    _, u, v = cubes.face_positions(d)
    inside = np.minimum(np.abs(u), np.abs(v)) < 1 - 1 / 16
    assert inside.mean() > 0.98
    np.testing.assert_allclose(seen[inside], cubes.sample(world, d)[inside], rtol=1e-5)


def test_a_white_diffuser_in_a_uniform_world_is_exactly_white():
    world = np.ones((6, 8, 8, 6), np.float32)
    things = ((sphere(segments=32), material(1.0)),)
    picture = preview(world, XYZ_FROM_SIX, Scene(things, CAMERA), width=24, height=24)
    white = XYZ_FROM_SIX.sum(axis=1)
    np.testing.assert_allclose(picture, np.broadcast_to(white, picture.shape), rtol=2e-3)
    # and not because there is nothing but background
    grey = ((sphere(segments=32), material(0.5)),)
    picture = preview(world, XYZ_FROM_SIX, Scene(grey, CAMERA), width=24, height=24)
    np.testing.assert_allclose(picture[12, 12], white / 2, rtol=1e-5)


@pytest.mark.parametrize("channels", [3, 6, 7])
def test_any_number_of_channels_comes_to_the_same_xyz(channels):
    # each channel of one colour, the matrix a share of that colour each
    world = np.repeat(asymmetric(8, 1), channels, axis=-1)
    matrix = np.outer([0.9, 1.0, 1.1], np.full(channels, 1 / channels))
    scene = Scene(((sphere(segments=16), material(0.3, 0.2, channels=channels)),), CAMERA)
    picture = preview(world, matrix, scene, width=16, height=16)
    single = Scene(((sphere(segments=16), material(0.3, 0.2, channels=1)),), CAMERA)
    expected = preview(world[..., :1], matrix.sum(axis=1)[:, None], single, width=16, height=16)
    np.testing.assert_allclose(picture, expected, rtol=1e-4)


PLACES = [(16, 16), (16, 6), (9, 22), (22, 12), (5, 16), (20, 24), (12, 26), (28, 15)]


def ward(n, v, light, alpha, bounded):
    """The BRDF over rho_s for one n and v and many lights, as the papers print it."""
    n_l, n_v = light @ n, v @ n
    h = light + v
    h_n = h @ n
    tan2 = np.einsum("ij,ij->i", h, h) / h_n**2 - 1
    lobe = np.exp(-tan2 / alpha**2)
    with np.errstate(invalid="ignore"):
        value = (
            lobe / (np.pi * alpha**2) * np.einsum("ij,ij->i", h, h) / h_n**4
            if bounded
            else lobe / (4 * np.pi * alpha**2 * np.sqrt(n_l * n_v))
        )
    return np.where(n_l > 0, value, 0)


@pytest.mark.parametrize("alpha", [0.1, 0.3])
@pytest.mark.parametrize("brdf", ["ward", "ward1992"])
def test_gloss_agrees_with_plain_quadrature_over_the_sphere(brdf, alpha):
    world = asymmetric(64, 6)
    lamp = np.array([0.6, 0.5, 0.62])
    near = cubes.directions(64) @ (lamp / np.linalg.norm(lamp))
    world += (30 * np.exp((near - 1) / 0.01))[..., None].astype(np.float32)
    specular = np.array([0.9, 0.8, 0.7, 0.6, 0.5, 0.4])
    shiny = Material(np.full(6, 0.1), specular, alpha)
    # many pixels: a pixel's share of the curvature, which roughens it, is then small
    size, camera = 256, Camera((0.0, 0.0, 40.0), (0.0, 0.0, 0.0), 3.4)
    scene = Scene(((sphere(segments=128), shiny),), camera)
    picture = preview(
        world, XYZ_FROM_SIX, scene, width=size, height=size, supersampling=1, brdf=brdf
    )

    light = cubes.directions(64).reshape(-1, 3)
    power = (world * cubes.solid_angles(64)[..., None]).reshape(-1, 6)
    errors = []
    for row, column in 8 * np.array(PLACES):
        ray = rays(camera, size, size)[row, column]
        eye = np.array(camera.eye)
        b = ray @ eye
        n = eye - ray * (b + np.sqrt(b * b - (eye @ eye - 1)))  # on the unit sphere: its normal
        n_l = np.maximum(light @ n, 0)
        gloss = (ward(n, -ray, light, alpha, brdf == "ward") * n_l) @ power
        expected = XYZ_FROM_SIX @ (0.1 * (n_l @ power) / np.pi + specular * gloss)
        errors.append(np.abs(picture[row, column] / expected - 1).max())
    # 64 samples of a filtered map; it is the broad lobes that see the filter
    assert np.mean(errors) < (0.01 if alpha < 0.2 else 0.035)
    assert np.max(errors) < (0.03 if alpha < 0.2 else 0.08)


def test_a_polished_ball_mirrors_the_world():
    world = asymmetric(64)
    size, camera = 256, Camera((0.0, 0.0, 40.0), (0.0, 0.0, 0.0), 3.4)
    scene = Scene(((sphere(segments=128), material(0.0, 1.0, 0.01, channels=3)),), camera)
    picture = preview(world, np.eye(3), scene, width=size, height=size, supersampling=1, samples=8)
    for row, column in 8 * np.array(PLACES):
        ray = rays(camera, size, size)[row, column]
        eye = np.array(camera.eye)
        b = ray @ eye
        n = eye - ray * (b + np.sqrt(b * b - (eye @ eye - 1)))
        mirrored = cubes.sample(world, ray - 2 * (ray @ n) * n)
        # what facets and roughness turn the reflection by, times the world's slope
        np.testing.assert_allclose(picture[row, column], mirrored, rtol=0.02)


def test_bounded_ward_keeps_a_white_world_where_the_old_one_darkens():
    world = np.ones((6, 8, 8, 3), np.float32)
    floor = np.linspace(0, 3, 4)
    flat = revolved((np.stack([floor, 0 * floor], axis=1), np.tile([0.0, 1.0], (4, 1))), 32)
    grazing = Camera((0.0, 0.5, 6.0), (0.0, 0.0, 0.0), 4.0)  # 85 degrees from the normal
    scene = Scene(((flat, material(0.0, 1.0, 0.05, channels=3)),), grazing)
    seen = {
        brdf: preview(world, np.eye(3), scene, width=8, height=8, brdf=brdf)[4, 4, 1]
        for brdf in module.BRDFS
    }
    assert 0.85 < seen["ward"] <= 1.001
    assert seen["ward1992"] < 0.9 * seen["ward"]


def test_a_small_bright_lamp_gives_a_smooth_highlight():
    # 1e4 times the room, 2 degrees across: neighbours must not jump (speckle, blocks)
    world = np.full((6, 64, 64, 3), 0.1, np.float32)
    lamp = np.array([0.35, 0.45, 0.82]) / np.linalg.norm([0.35, 0.45, 0.82])
    world[np.degrees(np.arccos(np.clip(cubes.directions(64) @ lamp, -1, 1))) < 1] = 1000
    for alpha in (0.08, 0.25):
        ball = Scene(((sphere(segments=96), material(0.0, 0.05, alpha, channels=3)),), CAMERA)
        picture = preview(world, np.eye(3), ball, width=48, height=48, supersampling=1)[..., 1]
        inside = picture[10:38, 10:38]
        assert inside.max() > 2 * np.median(inside)
        # one hill: along each row up to its top, then down, but for 3 % of the top
        rows = inside[inside.max(axis=1) > 0.2 * inside.max()]
        for row in rows:
            top = int(np.argmax(row))
            assert np.diff(row[: top + 1]).min(initial=0) > -0.03 * inside.max()
            assert np.diff(row[top:]).max(initial=0) < 0.03 * inside.max()


def test_a_lamp_beyond_half_float_is_not_lost():
    world = np.full((6, 8, 8, 3), 1e6, np.float32)
    picture = preview(world, np.eye(3), Scene((), CAMERA), width=4, height=4)
    np.testing.assert_allclose(picture, 1e6, rtol=1e-5)


def test_left_is_left_on_a_lit_thing():
    world = np.zeros((6, 16, 16, 3), np.float32)
    world[1, ..., 2] = 1  # blue from -X
    world[0, ..., 0] = 1  # red from +X
    scene = Scene(((sphere(segments=32), material(0.8, channels=3)),), CAMERA)
    picture = preview(world, np.eye(3), scene, width=32, height=32)
    assert picture[16, 8, 2] > 3 * picture[16, 8, 0]
    assert picture[16, 24, 0] > 3 * picture[16, 24, 2]


def test_the_same_picture_twice_is_the_same_bit_for_bit():
    world = area_average(asymmetric(32, 6), 16)
    scene = Scene(((sphere(segments=24), material(0.4, 0.1)),), CAMERA)
    first, second = (preview(world, XYZ_FROM_SIX, scene, width=24, height=16) for _ in range(2))
    assert first.tobytes() == second.tobytes()


def test_without_opengl_the_user_is_told_what_to_install(monkeypatch):
    monkeypatch.setattr(module, "_LIBEGL", "libEGL-not-there.so")
    with pytest.raises(InputError, match=r"OpenGL is not available.*apt-get install"):
        preview(np.ones((6, 2, 2, 3), np.float32), np.eye(3), Scene((), CAMERA))


def test_pictures_stand_side_by_side_with_their_captions():
    left, right = np.zeros((128, 100, 3)), np.full((128, 60, 3), 0.25)
    both = side_by_side([left, right], ["six", ""])
    assert both.shape == (128, 160, 3)
    assert both[100:, :100].max() > 0.5
    assert (both[:64, :100] == 0).all()
    np.testing.assert_array_equal(both[:, 100:], 0.25)
