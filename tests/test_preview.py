"""Pictures whose every pixel is known: on paper, from the numpy cube, or by plain quadrature."""

from dataclasses import replace

import numpy as np
import pytest

import shaders
from calibration.errors import InputError
from stages import cube as cubes
from stages import opengl, renderer
from stages.meshes import revolved, sphere
from stages.prefilter import area_average
from stages.preview import Drawing, draw_times, preview, sequence, side_by_side
from stages.scene import BRDFS, Camera, Material, Mesh, Scene
from stages.shadows import shade

XYZ_FROM_SIX = np.array(
    [
        [0.35, 0.10, 0.02, 0.15, 0.28, 0.05],
        [0.05, 0.08, 0.22, 0.30, 0.25, 0.10],
        [0.90, 0.15, 0.03, 0.01, 0.00, 0.00],
    ]
)
CAMERA = Camera((0.0, 0.0, 6.0), (0.0, 0.0, 0.0), 22.0)
AXES = [(1, 0, 0), (-1, 0, 0), (1e-3, 1, 1e-3), (1e-3, -1, 1e-3), (0, 0, 1), (0, 0, -1)]


def material(diffuse, specular=0.0, roughness=0.2, channels=6, brdf="ward"):
    return Material(np.full(channels, diffuse), np.full(channels, specular), roughness, brdf)


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
    seen = preview(world, np.eye(3), Scene((), camera), Drawing(30, 20, supersampling=1))
    d = rays(camera, 30, 20)
    # within half a texel of a corner of the cube three texels meet, and each has its own rule
    _, u, v = cubes.face_positions(d)
    inside = np.minimum(np.abs(u), np.abs(v)) < 1 - 1 / 16
    assert inside.mean() > 0.98
    np.testing.assert_allclose(seen[inside], cubes.sample(world, d)[inside], rtol=1e-5)


def test_a_white_diffuser_in_a_uniform_world_is_exactly_white():
    world = np.ones((6, 8, 8, 6), np.float32)
    things = ((sphere(segments=32), material(1.0)),)
    picture = preview(world, XYZ_FROM_SIX, Scene(things, CAMERA), Drawing(24, 24))
    white = XYZ_FROM_SIX.sum(axis=1)
    np.testing.assert_allclose(picture, np.broadcast_to(white, picture.shape), rtol=2e-3)
    # and not because there is nothing but background
    grey = ((sphere(segments=32), material(0.5)),)
    picture = preview(world, XYZ_FROM_SIX, Scene(grey, CAMERA), Drawing(24, 24))
    np.testing.assert_allclose(picture[12, 12], white / 2, rtol=1e-5)


@pytest.mark.parametrize("channels", [3, 6, 7, 11])
def test_any_number_of_channels_comes_to_the_same_xyz(channels):
    # each channel of one colour, the matrix a share of that colour each
    world = np.repeat(asymmetric(8, 1), channels, axis=-1)
    matrix = np.outer([0.9, 1.0, 1.1], np.full(channels, 1 / channels))
    scene = Scene(((sphere(segments=16), material(0.3, 0.2, channels=channels)),), CAMERA)
    picture = preview(world, matrix, scene, Drawing(16, 16))
    single = Scene(((sphere(segments=16), material(0.3, 0.2, channels=1)),), CAMERA)
    expected = preview(world[..., :1], matrix.sum(axis=1)[:, None], single, Drawing(16, 16))
    np.testing.assert_allclose(picture, expected, rtol=1e-4)


PLACES = [(16, 16), (16, 6), (9, 22), (22, 12), (5, 16), (20, 24), (12, 26), (28, 15)]


def lobe(brdf, n, v, light, alpha):
    """The BRDF over rho_s for one n and v and many lights, as the papers print it."""
    n_l, n_v = light @ n, v @ n
    h = light + v
    h_n, h_h = h @ n, np.einsum("ij,ij->i", h, h)
    with np.errstate(all="ignore"):
        facets = np.exp(-(h_h / h_n**2 - 1) / alpha**2) / (np.pi * alpha**2)
        if brdf == "ward":
            value = facets * h_h / h_n**4
        elif brdf == "ward1992":
            value = facets / (4 * np.sqrt(n_l * n_v))
        else:
            cos2 = h_n**2 / h_h
            facets = alpha**2 / (np.pi * (cos2 * (alpha**2 - 1) + 1) ** 2)
            masking = [(np.sqrt(1 + alpha**2 * (1 / c**2 - 1)) - 1) / 2 for c in (n_l, n_v)]
            value = facets / (4 * n_l * n_v * (1 + sum(masking)))
    return np.where(n_l > 0, value, 0)


@pytest.mark.parametrize("alpha", [0.1, 0.3])
@pytest.mark.parametrize("brdf", ["ward", "ward1992", "ggx"])
def test_gloss_agrees_with_plain_quadrature_over_the_sphere(brdf, alpha):
    world = asymmetric(64, 6)
    lamp = np.array([0.6, 0.5, 0.62])
    near = cubes.directions(64) @ (lamp / np.linalg.norm(lamp))
    world += (30 * np.exp((near - 1) / 0.01))[..., None].astype(np.float32)
    specular = np.array([0.9, 0.8, 0.7, 0.6, 0.5, 0.4])
    shiny = Material(np.full(6, 0.1), specular, alpha, brdf)
    # many pixels: a pixel's share of the curvature, which roughens it, is then small
    size, camera = 256, Camera((0.0, 0.0, 40.0), (0.0, 0.0, 0.0), 3.4)
    scene = Scene(((sphere(segments=128), shiny),), camera)
    picture = preview(world, XYZ_FROM_SIX, scene, Drawing(size, size, supersampling=1, samples=64))

    light = cubes.directions(64).reshape(-1, 3)
    power = (world * cubes.solid_angles(64)[..., None]).reshape(-1, 6)
    errors = []
    for row, column in 8 * np.array(PLACES):
        ray = rays(camera, size, size)[row, column]
        eye = np.array(camera.eye)
        b = ray @ eye
        n = eye - ray * (b + np.sqrt(b * b - (eye @ eye - 1)))  # on the unit sphere: its normal
        n_l = np.maximum(light @ n, 0)
        gloss = (lobe(brdf, n, -ray, light, alpha) * n_l) @ power
        expected = XYZ_FROM_SIX @ (0.1 * (n_l @ power) / np.pi + specular * gloss)
        errors.append(np.abs(picture[row, column] / expected - 1).max())
    # 64 samples of a filtered map; it is the broad lobes that see the filter
    narrow = alpha < 0.2 and brdf != "ggx"
    assert np.mean(errors) < (0.01 if narrow else 0.035)
    assert np.max(errors) < (0.03 if narrow else 0.08)


def test_a_polished_ball_mirrors_the_world():
    world = asymmetric(64)
    size, camera = 256, Camera((0.0, 0.0, 40.0), (0.0, 0.0, 0.0), 3.4)
    scene = Scene(((sphere(segments=128), material(0.0, 1.0, 0.01, channels=3)),), camera)
    picture = preview(world, np.eye(3), scene, Drawing(size, size, supersampling=1, samples=8))
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
    seen = {}
    for brdf in BRDFS:
        scene = Scene(((flat, material(0.0, 1.0, 0.05, 3, brdf)),), grazing)
        seen[brdf] = preview(world, np.eye(3), scene, Drawing(8, 8))[4, 4, 1]
    assert 0.85 < seen["ward"] <= 1.001
    assert seen["ward1992"] < 0.9 * seen["ward"]


def test_a_small_bright_lamp_gives_a_smooth_highlight():
    # 1e4 times the room, 2 degrees across: neighbours must not jump (speckle, blocks)
    world = np.full((6, 64, 64, 3), 0.1, np.float32)
    lamp = np.array([0.35, 0.45, 0.82]) / np.linalg.norm([0.35, 0.45, 0.82])
    world[np.degrees(np.arccos(np.clip(cubes.directions(64) @ lamp, -1, 1))) < 1] = 1000
    for alpha in (0.08, 0.25):
        ball = Scene(((sphere(segments=96), material(0.0, 0.05, alpha, channels=3)),), CAMERA)
        picture = preview(world, np.eye(3), ball, Drawing(48, 48, supersampling=1))[..., 1]
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
    picture = preview(world, np.eye(3), Scene((), CAMERA), Drawing(4, 4))
    np.testing.assert_allclose(picture, 1e6, rtol=1e-5)


def test_left_is_left_on_a_lit_thing():
    world = np.zeros((6, 16, 16, 3), np.float32)
    world[1, ..., 2] = 1  # blue from -X
    world[0, ..., 0] = 1  # red from +X
    scene = Scene(((sphere(segments=32), material(0.8, channels=3)),), CAMERA)
    picture = preview(world, np.eye(3), scene, Drawing(32, 32))
    assert picture[16, 8, 2] > 3 * picture[16, 8, 0]
    assert picture[16, 24, 0] > 3 * picture[16, 24, 2]


def test_the_same_picture_twice_is_the_same_bit_for_bit():
    world = area_average(asymmetric(32, 6), 16)
    scene = Scene(((sphere(segments=24), material(0.4, 0.1)),), CAMERA)
    first, second = (preview(world, XYZ_FROM_SIX, scene, Drawing(24, 16)) for _ in range(2))
    assert first.tobytes() == second.tobytes()


def test_without_opengl_the_user_is_told_what_to_install(monkeypatch):
    monkeypatch.setattr(opengl, "_LIBEGL", "libEGL-not-there.so")
    with pytest.raises(InputError, match=r"OpenGL is not available.*apt-get install"):
        preview(np.ones((6, 2, 2, 3), np.float32), np.eye(3), Scene((), CAMERA), Drawing())


def test_pictures_stand_side_by_side_with_their_captions():
    left, right = np.zeros((128, 100, 3)), np.full((128, 60, 3), 0.25)
    both = side_by_side([left, right], ["six", ""])
    assert both.shape == (128, 160, 3)
    assert both[100:, :100].max() > 0.5
    assert (both[:64, :100] == 0).all()
    np.testing.assert_array_equal(both[:, 100:], 0.25)


def ball_seen_from_afar(shiny, *, tangents=None, size=256):
    """The scene, and per place of PLACES the normal and the direction to the viewer."""
    camera = Camera((0.0, 0.0, 40.0), (0.0, 0.0, 0.0), 3.4)
    mesh = sphere(segments=128)
    if tangents is not None:
        mesh = replace(mesh, tangents=tangents(mesh))
    eye, normals = np.array(camera.eye), []
    for row, column in 8 * np.array(PLACES):
        ray = rays(camera, size, size)[row, column]
        b = ray @ eye
        normals.append((eye - ray * (b + np.sqrt(b * b - (eye @ eye - 1))), -ray))
    return Scene(((mesh, shiny),), camera), normals


def test_brushed_metal_agrees_with_quadrature():
    # brushed around the pole: roughness .1 along the tangent, .3 up and down
    def around(mesh):
        t = np.cross([0.0, 1.0, 0.0], mesh.normals)
        return t / np.maximum(np.linalg.norm(t, axis=1, keepdims=True), 1e-9)

    world = asymmetric(64, 3)
    brushed = Material(np.zeros(3), np.ones(3), (0.1, 0.3))
    scene, places = ball_seen_from_afar(brushed, tangents=around)
    picture = preview(world, np.eye(3), scene, Drawing(256, 256, supersampling=1, samples=64))
    light = cubes.directions(64).reshape(-1, 3)
    power = (world * cubes.solid_angles(64)[..., None]).reshape(-1, 3)
    errors = []
    for (row, column), (n, v) in zip(8 * np.array(PLACES), places, strict=True):
        t = np.cross([0.0, 1.0, 0.0], n)
        t /= np.linalg.norm(t)
        h = light + v
        slopes = (h @ t / 0.1) ** 2 + (h @ np.cross(n, t) / 0.3) ** 2
        h_n = h @ n
        value = np.exp(-slopes / h_n**2) / (np.pi * 0.03) * np.einsum("ij,ij->i", h, h) / h_n**4
        expected = (value * np.maximum(light @ n, 0)) @ power
        errors.append(np.abs(picture[row, column] / expected - 1).max())
    assert np.mean(errors) < 0.03
    assert np.max(errors) < 0.08
    # and the brush matters: the other way round it is another picture
    across = replace(brushed, roughness=(0.3, 0.1))
    scene, _ = ball_seen_from_afar(across, tangents=around)
    other = preview(world, np.eye(3), scene, Drawing(256, 256, supersampling=1, samples=64))
    assert np.abs(other - picture).max() > 0.05 * picture.max()


def test_reflectance_by_angle_is_looked_up_on_the_facets():
    # a mirror in a white world shows its own table: at each place the cosine of n and v
    cosine = np.linspace(1, 0, 46)
    table = np.stack([0.04 + 0.96 * (1 - cosine) ** 5, 0.5 + 0 * cosine, cosine], axis=1)
    world = np.ones((6, 16, 16, 3), np.float32)
    scene, places = ball_seen_from_afar(Material(np.zeros(3), table, 0.02))
    picture = preview(world, np.eye(3), scene, Drawing(256, 256, supersampling=1))
    for (row, column), (n, v) in zip(8 * np.array(PLACES), places, strict=True):
        expected = [np.interp(n @ v, cosine[::-1], channel[::-1]) for channel in table.T]
        np.testing.assert_allclose(picture[row, column], expected, atol=0.006)


def test_an_image_of_reflectances_lies_as_its_uv_say():
    # a square seen head on, its image half as large as the picture: four by two colours
    corners = np.float32([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    mesh = Mesh(
        corners,
        np.tile(np.float32([0, 0, 1]), (4, 1)),
        np.int32([[0, 1, 2], [0, 2, 3]]),
        uv=(corners[:, :2] + 1) / 2,
    )
    rng = np.random.default_rng(9)
    image = rng.random((2, 4, 6)).astype(np.float32)
    image[0, 0, 2] = -0.03  # sharp primaries have negative reflectances
    blocks = image.repeat(32, axis=0).repeat(16, axis=1)
    printed = replace(material(0.0), image=blocks)
    camera = Camera((0.0, 0.0, 10.0), (0.0, 0.0, 0.0), float(np.degrees(2 * np.arctan(0.1))))
    world = np.ones((6, 8, 8, 6), np.float32)
    scene = Scene(((mesh, printed),), camera)
    picture = preview(world, np.eye(6)[[0, 2, 5]], scene, Drawing(64, 64))
    seen = picture.reshape(2, 32, 4, 16, 3)[:, 8:24, :, 4:12].mean(axis=(1, 3))
    np.testing.assert_allclose(seen, image[..., [0, 2, 5]], atol=2e-3)


def test_an_image_far_away_is_its_mean():
    corners = np.float32([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    mesh = Mesh(
        corners,
        np.tile(np.float32([0, 0, 1]), (4, 1)),
        np.int32([[0, 1, 2], [0, 2, 3]]),
        uv=(corners[:, :2] + 1) / 2,
    )
    board = np.indices((256, 256)).sum(axis=0) % 2
    printed = replace(material(0.0, channels=3), image=np.repeat(board[..., None], 3, axis=-1))
    camera = Camera((0.0, 0.0, 10.0), (0.0, 0.0, 0.0), 12.0)
    world = np.ones((6, 8, 8, 3), np.float32)
    picture = preview(world, np.eye(3), Scene(((mesh, printed),), camera), Drawing(48, 48))
    np.testing.assert_allclose(picture[14:34, 14:34], 0.5, atol=1e-3)


def test_frames_of_a_sequence_are_the_pictures_by_themselves():
    world = asymmetric(16, 6)
    scenes = [Scene(((sphere(segments=16), material(0.4, 0.1)),), replace(CAMERA, eye=eye))
              for eye in ((0.0, 0.0, 6.0), (6.0, 0.0, 0.0))]  # fmt: skip
    frames = list(sequence(world, XYZ_FROM_SIX, iter(scenes), Drawing(24, 16)))
    for scene, frame in zip(scenes, frames, strict=True):
        alone = preview(world, XYZ_FROM_SIX, scene, Drawing(24, 16))
        assert frame.tobytes() == alone.tobytes()


def test_two_environments_may_be_drawn_by_turns():
    """Each has a context of its own, as six channels and three beside them have."""
    scene, how = Scene(((sphere(segments=16), material(0.4, 0.1)),), CAMERA), Drawing(24, 16)
    worlds = asymmetric(16, 6), asymmetric(16, 6)[::-1].copy()
    alone = [preview(world, XYZ_FROM_SIX, scene, how).tobytes() for world in worlds]
    drawn = [sequence(world, XYZ_FROM_SIX, [scene] * 2, how) for world in worlds]
    for pictures in zip(*drawn, strict=True):
        assert [picture.tobytes() for picture in pictures] == alone


def test_a_picture_drawn_in_tiles_is_the_picture(monkeypatch):
    world = asymmetric(16, 6)
    scene = Scene(((sphere(segments=24), material(0.4, 0.1)),), CAMERA)
    whole = preview(world, XYZ_FROM_SIX, scene, Drawing(40, 24))
    monkeypatch.setattr(renderer, "_TILE", 32)
    tiles = preview(world, XYZ_FROM_SIX, scene, Drawing(40, 24))
    np.testing.assert_allclose(tiles, whole, rtol=1e-4, atol=1e-5)


def test_what_is_hidden_is_not_mirrored():
    # a mirror floor under a black ball: in its middle there is nothing but the ball
    flat = np.stack([np.linspace(0, 2, 17), np.zeros(17)], axis=1)
    floor = revolved((flat, np.tile([0.0, 1.0], (17, 1))), 48)
    ball = sphere(radius=0.8, segments=32)
    ball = replace(ball, positions=ball.positions + np.float32([0, 0.9, 0]))
    black, mirror = material(0.0, channels=3), material(0.0, 1.0, 0.2, channels=3)
    camera = Camera((0.0, 1.5, 6.0), (0.0, 0.0, 0.6), 8.0)
    scene = Scene(((floor, mirror), (ball, black)), camera)
    world = np.ones((6, 8, 8, 3), np.float32)
    how = Drawing(16, 16)
    open_sky = preview(world, np.eye(3), scene, how)[10, 8, 1]
    hidden = preview(world, np.eye(3), scene, how, shade=shade(scene, world))[10, 8, 1]
    assert open_sky > 0.8
    assert hidden < 0.4 * open_sky


@pytest.mark.parametrize("spoilt", [np.nan, np.inf])
def test_a_map_with_holes_is_refused(spoilt):
    world = np.ones((6, 4, 4, 3), np.float32)
    world[2, 1, 1, 0] = spoilt
    with pytest.raises(InputError, match="1 texels of the map are not numbers"):
        preview(world, np.eye(3), Scene((), CAMERA), Drawing())


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"roughness": 0.0}, "roughness is 0"),
        ({"roughness": 1.2}, "roughness is 1.2"),
        ({"roughness": (0.1, 0.2)}, "tangents or uv"),
        ({"brdf": "phong"}, "phong"),
        ({"image": np.ones((2, 2, 3))}, "uv"),
        ({"diffuse": np.ones(6)}, "channels"),
    ],
)
def test_a_material_that_cannot_be_shown_is_refused_in_one_line(changes, said):
    odd = replace(material(0.5, channels=3), **changes)
    bare = replace(sphere(segments=8), uv=None, tangents=None)
    with pytest.raises(InputError, match=said) as caught:
        preview(
            np.ones((6, 4, 4, 3), np.float32), np.eye(3), Scene(((bare, odd),), CAMERA), Drawing()
        )
    assert "\n" not in str(caught.value)


def test_the_device_is_chosen_by_number():
    found = opengl.devices()
    assert [device.number for device in found] == list(range(len(found)))
    assert found[0].renderer
    beyond = len(found)
    with pytest.raises(InputError, match=f"no OpenGL device {beyond}"):
        preview(
            np.ones((6, 2, 2, 3), np.float32), np.eye(3), Scene((), CAMERA), Drawing(device=beyond)
        )


def test_drawing_is_timed_by_the_device():
    scene = Scene(((sphere(segments=16), material(0.4, 0.1)),), CAMERA)
    times = draw_times(asymmetric(8, 6), XYZ_FROM_SIX, scene, 3, Drawing(32, 32))
    assert len(times) == 3
    assert all(0 < seconds < 60 for seconds in times)


def test_browsers_see_the_same_picture(monkeypatch):
    world = asymmetric(16, 6)
    table = np.linspace(0.1, 0.9, 8)[:, None] * np.ones(6)
    scene = Scene(((sphere(segments=24), Material(np.full(6, 0.4), table, 0.2)),), CAMERA)
    desktop = preview(world, XYZ_FROM_SIX, scene, Drawing(32, 32))
    as_desktop = shaders.program

    def as_browser(*arguments, **options):
        return as_desktop(*arguments, version=shaders.ES_VERSION, **options)

    monkeypatch.setattr(shaders, "program", as_browser)
    browser = preview(world, XYZ_FROM_SIX, scene, Drawing(32, 32))
    np.testing.assert_allclose(browser, desktop, rtol=1e-5)


def test_a_lamp_lights_a_matt_ball_up_to_a_sharp_terminator():
    """On paper: the sky everywhere, and flux cos / pi where the lamp is above the horizon."""
    world = np.full((6, 64, 64, 3), 0.1, np.float32)
    world[0, 20, 40] = 3000.0  # towards +X, above and beside
    lamp = cubes.directions(64)[0, 20, 40]
    flux = (3000.0 - 0.1) * cubes.solid_angles(64)[20, 40]
    ball = (sphere(segments=128), material(0.8, channels=3))
    size, camera = 96, Camera((0.0, 0.0, 40.0), (0.0, 0.0, 0.0), 3.4)
    picture = preview(
        world, np.eye(3), Scene((ball,), camera), Drawing(size, size, supersampling=1)
    )
    d = rays(camera, size, size)
    along = -(d @ camera.eye)
    inside = along**2 - (40.0**2 - 1.0)
    n = camera.eye + (along - np.sqrt(np.maximum(inside, 0)))[..., None] * d
    expected = 0.8 * (0.1 + flux * np.maximum(n @ lamp, 0) / np.pi)
    seen = inside > 0.05  # off the outline, where the mesh is a polygon
    assert (n @ lamp)[seen].min() < -0.3 < 0.3 < (n @ lamp)[seen].max()
    np.testing.assert_allclose(picture[seen][:, 1], expected[seen], atol=0.01 * expected.max())
