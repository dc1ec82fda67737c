"""Occlusion whose answer is known: none on a convex body, none for a hidden light, half a sky."""

import numpy as np

from stages import cube as cubes
from stages.meshes import revolved, sphere
from stages.scene import Camera, Material, Mesh, Scene
from stages.shadows import sky

CAMERA = Camera((0.0, 1.0, 3.0), (0.0, 0.0, 0.0), 40.0)
BLACK = Material(np.zeros(2), np.zeros(2), 0.1)  # so that nothing but the sky sheds light
WHITE_SKY = np.ones((6, 16, 16, 2), np.float32)


def disc(radius, rings=25):
    r = np.linspace(0, radius, rings)
    flat = np.stack([r, np.zeros_like(r)], axis=1)
    return revolved((flat, np.tile([0.0, 1.0], (rings, 1))), 48)


def lifted(mesh: Mesh, y):
    return Mesh(mesh.positions + np.float32([0, y, 0]), mesh.normals, mesh.triangles)


def test_a_convex_body_sees_all_of_its_sky():
    (seen,) = sky(Scene(((sphere(segments=48), BLACK),), CAMERA), WHITE_SKY)
    assert seen.shape[1] == 2
    assert seen.min() > 0.98  # the last grazing lights are lost on the facets


def test_a_sphere_above_a_floor_hides_what_it_should():
    # Of the cosine-weighted sky a sphere of radius r, d away at an angle theta from the normal,
    # hides (r / d)^2 cos theta, as long as all of it is above the floor.
    ball, floor = lifted(sphere(radius=0.5, segments=48), 0.8), disc(2.0)
    _, seen = sky(Scene(((ball, BLACK), (floor, BLACK)), CAMERA), WHITE_SKY)
    distance = np.linalg.norm(floor.positions - [0, 0.8, 0], axis=1)
    error = seen[:, 0] - (1 - (0.5 / distance) ** 2 * 0.8 / distance)
    assert np.abs(error).mean() < 0.03  # a cell is 7 % of the sphere: its edge is that uncertain
    assert np.abs(error).max() < 0.12  # 160 lights, each hidden whole or not at all


def test_a_small_lamp_throws_its_shadow_to_the_other_side():
    world = np.full((6, 32, 32, 2), 1e-6, np.float32)
    world[np.degrees(np.arccos(cubes.directions(32) @ np.array([0.6, 0.8, 0]))) < 5] = 1
    ball, floor = lifted(sphere(radius=0.3, segments=32), 0.8), disc(2.0, rings=49)
    _, seen = sky(Scene(((ball, BLACK), (floor, BLACK)), CAMERA), world)
    # the middle of the shadow is 0.8 * 0.6 / 0.8 from the foot, away from the lamp
    at = floor.positions[:, [0, 2]]
    assert seen[np.linalg.norm(at - [-0.6, 0], axis=1) < 0.15].max() < 0.05
    assert seen[np.linalg.norm(at - [0.6, 0], axis=1) < 0.3].min() > 0.95


def test_a_white_world_of_white_things_is_white_everywhere():
    white = Material(np.ones(2), np.zeros(2), 0.1)
    ball, floor = lifted(sphere(radius=0.5, segments=16), 0.6), disc(1.0, rings=9)
    _, seen = sky(Scene(((ball, white), (floor, white)), CAMERA), WHITE_SKY)
    below = seen[np.linalg.norm(floor.positions, axis=1) < 0.3]
    np.testing.assert_allclose(below, 1, atol=1e-3)


def test_a_dark_world_has_no_shadows():
    floor = disc(1.0, rings=5)
    (seen,) = sky(Scene(((floor, BLACK),), CAMERA), np.zeros((6, 4, 4, 2), np.float32))
    np.testing.assert_array_equal(seen, 1)
