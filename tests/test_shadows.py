"""Occlusion whose answer is known: none on a convex body, none for a hidden light, half a sky."""

import numpy as np
import pytest

from stages import cube as cubes
from stages.light import light
from stages.meshes import revolved, sphere
from stages.scene import Camera, Material, Mesh, Scene, turned
from stages.shadows import shade, sight

CAMERA = Camera((0.0, 1.0, 3.0), (0.0, 0.0, 0.0), 40.0)
BLACK = Material(np.zeros(2), np.zeros(2), 0.1)  # so that nothing but the sky sheds light
WHITE_SKY = np.ones((6, 16, 16, 2), np.float32)


def disc(radius, rings=25):
    r = np.linspace(0, radius, rings)
    flat = np.stack([r, np.zeros_like(r)], axis=1)
    return revolved((flat, np.tile([0.0, 1.0], (rings, 1))), 48)


def lifted(mesh: Mesh, y):
    return Mesh(mesh.positions + np.float32([0, y, 0]), mesh.normals, mesh.triangles)


def ball_on_floor(radius, height, rings=25, material=BLACK):
    ball, floor = lifted(sphere(radius=radius, segments=48), height), disc(2.0, rings)
    return Scene(((ball, material), (floor, material)), CAMERA)


def test_a_convex_body_loses_exactly_nothing():
    rng = np.random.default_rng(7)
    world = rng.random((6, 16, 16, 2)).astype(np.float32) ** 4
    (lost,) = shade(Scene(((sphere(segments=48), BLACK),), CAMERA), world)
    assert lost.light.shape[1] == 2
    np.testing.assert_array_equal(lost.light, 0)
    np.testing.assert_array_equal(lost.sky, 0)


def test_a_sphere_above_a_floor_hides_what_it_should():
    # Of the cosine-weighted sky a sphere of radius r, d away at an angle theta from the normal,
    # hides (r / d)^2 cos theta, as long as all of it is above the floor.
    scene = ball_on_floor(0.5, 0.8)
    _, lost = shade(scene, WHITE_SKY)
    distance = np.linalg.norm(scene.things[1][0].positions - [0, 0.8, 0], axis=1)
    error = lost.light[:, 0] - (0.5 / distance) ** 2 * 0.8 / distance
    assert np.abs(error).mean() < 0.015
    assert np.abs(error).max() < 0.06  # two hundred directions, each hidden whole or not at all


def test_the_share_of_each_direction_that_is_hidden_is_roughly_known():
    scene = ball_on_floor(0.5, 0.8)
    _, lost = shade(scene, WHITE_SKY)
    d = cubes.directions(16).reshape(-1, 3)
    d = d[d[:, 1] > 0.05]
    terms = np.concatenate([d, d * d, d * np.roll(d, -1, axis=1)], axis=1)
    for vertex in (0, 48 * 8, 48 * 15):
        place = scene.things[1][0].positions[vertex]
        away = np.float64([0, 0.8, 0]) - place
        distance = np.linalg.norm(away)
        hidden = d @ (away / distance) > np.sqrt(1 - (0.5 / distance) ** 2)
        share = np.clip(terms @ lost.sky[vertex], 0, 1)
        # a quadratic is a blurred disc: right on the whole, and on the right side
        assert share.mean() == pytest.approx(hidden.mean(), abs=0.06)
        assert share[hidden].mean() > share[~hidden].mean() + 0.2


def test_a_small_lamp_throws_its_shadow_to_the_other_side():
    world = np.full((6, 32, 32, 2), 1e-6, np.float32)
    world[np.degrees(np.arccos(cubes.directions(32) @ np.array([0.6, 0.8, 0]))) < 5] = 1
    scene = ball_on_floor(0.3, 0.8, rings=49)
    floor = scene.things[1][0]
    _, lost = shade(scene, world)
    whole = 0.8 * np.sin(np.radians(5)) ** 2  # irradiance over pi of a disc, on paper
    # the middle of the shadow is 0.8 * 0.6 / 0.8 from the foot, away from the lamp
    at = floor.positions[:, [0, 2]]
    assert lost.light[np.linalg.norm(at - [-0.6, 0], axis=1) < 0.15].min() > 0.9 * whole
    assert np.abs(lost.light[np.linalg.norm(at - [0.6, 0], axis=1) < 0.3]).max() < 0.01 * whole


def test_a_white_world_of_white_things_is_white_everywhere():
    white = Material(np.ones(2), np.zeros(2), 0.1)
    scene = ball_on_floor(0.5, 0.6, material=white)
    for lost in shade(scene, WHITE_SKY):
        np.testing.assert_allclose(lost.light, 0, atol=0.02)


def test_light_that_is_negative_in_a_channel_is_lost_in_proportion():
    scene = ball_on_floor(0.5, 0.8)
    world = WHITE_SKY * np.float32([1.0, -0.1])
    _, lost = shade(scene, world)
    np.testing.assert_allclose(lost.light[:, 1], -0.1 * lost.light[:, 0], atol=1e-6)


def test_a_dark_world_has_no_shadows():
    floor = disc(1.0, rings=5)
    (lost,) = shade(Scene(((floor, BLACK),), CAMERA), np.zeros((6, 4, 4, 2), np.float32))
    np.testing.assert_array_equal(lost.light, 0)


def test_what_is_hidden_turns_with_the_scene():
    scene = ball_on_floor(0.5, 0.8)
    seen = sight(scene)
    still = shade(scene, WHITE_SKY, sight=seen)[1].sky
    moved = shade(turned(scene, 40.0), WHITE_SKY, sight=seen.turned(40.0))[1].sky
    d = np.float64([[0.6, 0.0, 0.8], [-0.36, 0.8, 0.48]])
    angle = np.radians(40.0)
    x, y, z = d.T
    about_y = [np.cos(angle) * x + np.sin(angle) * z, y, np.cos(angle) * z - np.sin(angle) * x]

    def terms(d):
        return np.concatenate([d, d * d, d * np.roll(d, -1, axis=1)], axis=1)

    np.testing.assert_allclose(
        moved @ terms(np.stack(about_y, axis=1)).T, still @ terms(d).T, atol=1e-5
    )


@pytest.mark.slow
def test_a_turned_scene_is_shaded_from_the_sight_of_the_scene_as_it_was():
    rng = np.random.default_rng(8)
    smooth = 1 + cubes.directions(32) @ rng.normal(size=(3, 2)) * 0.4
    world = light(smooth.astype(np.float32))
    scene = Scene((*ball_on_floor(0.5, 0.8).things,), CAMERA)
    seen = sight(scene)
    for degrees in (90.0, 31.0):
        quick = shade(turned(scene, degrees), world, sight=seen.turned(degrees))
        anew = shade(turned(scene, degrees), world)
        for a, b in zip(quick, anew, strict=True):
            # at 90 degrees the same directions are asked again, on another grid; at 31 others
            assert np.abs(a.light - b.light).mean() < (0.005 if degrees == 90 else 0.01)
