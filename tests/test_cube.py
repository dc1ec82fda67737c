"""Directions are a promise; these are the values OpenGL's table gives on paper."""

import numpy as np
import pytest

from stages import cube


@pytest.mark.parametrize(
    ("face", "direction", "right", "down"),
    [
        (0, (1, 0, 0), (0, 0, -1), (0, -1, 0)),
        (1, (-1, 0, 0), (0, 0, 1), (0, -1, 0)),
        (2, (0, 1, 0), (1, 0, 0), (0, 0, 1)),
        (3, (0, -1, 0), (1, 0, 0), (0, 0, -1)),
        (4, (0, 0, 1), (1, 0, 0), (0, -1, 0)),
        (5, (0, 0, -1), (-1, 0, 0), (0, -1, 0)),
    ],
)
def test_faces_look_where_opengl_says(face, direction, right, down):
    d = cube.directions(3)[face]
    np.testing.assert_allclose(d[1, 1], direction, atol=1e-12)
    assert np.dot(d[1, 2] - d[1, 0], right) > 1
    assert np.dot(d[2, 1] - d[0, 1], down) > 1


def test_solid_angles_cover_the_sphere_and_match_the_corner_formula():
    assert 6 * cube.solid_angles(17).sum() == pytest.approx(4 * np.pi, rel=1e-12)
    # a texel of a fine face is dA / r^3
    n = 512
    d = cube.texel_centres(n)
    r = np.sqrt(1 + d[:, None] ** 2 + d[None, :] ** 2)
    np.testing.assert_allclose(cube.solid_angles(n), (2 / n) ** 2 / r**3, rtol=1e-5)


def test_face_positions_undo_directions():
    t = cube.texel_centres(8)
    face, u, v = cube.face_positions(cube.directions(8) * 3.0)
    assert (face == np.arange(6)[:, None, None]).all()
    np.testing.assert_allclose(u, np.broadcast_to(t[None, None, :], u.shape), atol=1e-12)
    np.testing.assert_allclose(v, np.broadcast_to(t[None, :, None], v.shape), atol=1e-12)


def test_sampling_a_smooth_world_has_no_seams():
    n = 64
    world = cube.directions(n) @ np.array([[1.0, 0.2], [-0.5, 0.1], [0.3, -1.0]]) + 2.0
    rng = np.random.default_rng(1)
    d = rng.normal(size=(20000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    expected = d @ np.array([[1.0, 0.2], [-0.5, 0.1], [0.3, -1.0]]) + 2.0
    # half a texel of a slope of at most 1.1 per radian at the worst (the cube's corners)
    assert np.abs(cube.sample(world, d) - expected).max() < 1.1 * 0.75 / n * 2


def test_sampling_at_texel_centres_gives_the_texels():
    rng = np.random.default_rng(2)
    world = rng.random((6, 5, 5, 3))
    np.testing.assert_allclose(cube.sample(world, cube.directions(5)), world, atol=1e-12)
