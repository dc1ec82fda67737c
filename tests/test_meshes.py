"""Shapes against what is known of them: Newell's outline, closed surfaces, unit normals."""

import numpy as np
import pytest

from stages.meshes import revolved, sphere, teapot_mesh


def volume(mesh):
    """By Gauss's theorem: right for a closed surface whose triangles face outwards."""
    a, b, c = (mesh.positions[mesh.triangles[:, k]].astype(float) for k in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


def face_normals(mesh):
    a, b, c = (mesh.positions[mesh.triangles[:, k]].astype(float) for k in range(3))
    return np.cross(b - a, c - a)


@pytest.mark.parametrize("mesh", [teapot_mesh(segments=8), sphere(segments=16)])
def test_normals_are_unit_and_outward_even_at_the_poles(mesh):
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-5)
    faces = face_normals(mesh)
    large = np.linalg.norm(faces, axis=1) > 1e-9
    agreement = np.einsum("ij,ij->i", faces, mesh.normals[mesh.triangles].mean(axis=1))
    assert (agreement[large] > 0).all()


def test_a_sphere_has_its_volume_and_its_positions_for_normals():
    ball = sphere(radius=2.0, segments=64)
    assert volume(ball) == pytest.approx(4 / 3 * np.pi * 8, rel=2e-3)
    np.testing.assert_allclose(ball.normals, ball.positions / 2, atol=1e-6)


def test_a_teapot_stands_upright_with_its_spout_to_the_right():
    pot = teapot_mesh(segments=8, height=3.15)
    low, high = pot.positions.min(axis=0), pot.positions.max(axis=0)
    # Newell's numbers, z up there: handle to -3, spout's lip past 3.4, radius 2, knob at 3.15
    np.testing.assert_allclose(low, [-3.0, 0.0, -2.0], atol=0.02)
    np.testing.assert_allclose(high, [3.434, 3.15, 2.0], atol=0.02)
    knob = pot.normals[pot.positions[:, 1] > 3.1499]
    bottom = pot.normals[np.linalg.norm(pot.positions, axis=1) < 1e-6]
    np.testing.assert_allclose(knob, np.tile([0, 1, 0], (len(knob), 1)), atol=2e-3)
    np.testing.assert_allclose(bottom, np.tile([0, -1, 0], (len(bottom), 1)), atol=2e-3)


def test_the_bodys_outline_is_that_of_its_control_points():
    # the widest ring lies where two patches meet, at the control points (2, .9)
    pot = teapot_mesh(segments=8, height=3.15)
    ring = pot.positions[np.abs(pot.positions[:, 1] - 0.9) < 1e-5]
    assert ring[:, 2].max() == pytest.approx(2.0, rel=1e-6)
    # halfway round a quarter, by hand: x = (2 + 3 * 2 + 3 * 1.12) / 8
    diagonal = ring[np.abs(np.abs(ring[:, 0]) - np.abs(ring[:, 2])) < 1e-4]
    np.testing.assert_allclose(np.abs(diagonal[:, 0]), 1.42, rtol=1e-5)


def test_a_profile_turned_is_round():
    outline = np.array([[1.0, 1.0], [1.0, 0.0]]), np.array([[1.0, 0.0], [1.0, 0.0]])
    tube = revolved(outline, 32)
    np.testing.assert_allclose(np.hypot(tube.positions[:, 0], tube.positions[:, 2]), 1, atol=1e-6)
    assert (face_normals(tube) @ [0, 1, 0] == 0).all()
