"""Shapes against what is known of them: Newell's outline, closed surfaces, unit normals."""

from dataclasses import replace

import numpy as np
import pytest

from stages.meshes import (
    joined,
    placed,
    plane,
    revolved,
    sphere,
    standing,
    teapot_mesh,
    with_normals,
    with_tangents,
)


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


@pytest.mark.parametrize("mesh", [sphere(segments=12), plane(segments=3)])
def test_tangents_run_along_u_at_right_angles_to_the_normals(mesh):
    along = np.einsum("ij,ij->i", mesh.tangents, mesh.normals)
    np.testing.assert_allclose(along, 0, atol=1e-6)
    from_uv = with_tangents(replace(mesh, tangents=None)).tangents
    # on a coarse mesh two ways to the same direction; at a sphere's poles there is none
    away = np.linalg.norm(mesh.positions[:, [0, 2]], axis=1) > 0.3
    agreement = np.einsum("ij,ij->i", from_uv, mesh.tangents)[away]
    assert agreement.min() > 0.95


def test_a_sphere_without_normals_gets_its_positions_for_them():
    ball = sphere(segments=32)
    faces = ball.positions[ball.triangles]
    whole = np.linalg.norm(np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]), axis=1)
    made = with_normals(ball.positions, ball.triangles[whole > 1e-9])
    cosine = np.einsum("ij,ij->i", made.normals, made.positions)
    assert cosine.min() > np.cos(np.radians(2.0))
    assert len(made.positions) < len(ball.positions)  # its seam is closed
    assert volume(made) == pytest.approx(volume(ball), rel=1e-5)


def test_uv_parts_vertices_but_not_normals():
    # two triangles of a plane that share an edge, with an image's seam along it
    positions = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0.3]])
    uv = np.array([[0, 0], [1, 0], [1, 1], [0.5, 0], [0.5, 1], [0, 1]])
    made = with_normals(positions, np.array([[0, 1, 2], [3, 4, 5]]), uv)
    assert len(made.positions) == 6
    at_origin = made.normals[(made.positions == 0).all(axis=1)]
    assert len(at_origin) == 2
    np.testing.assert_allclose(at_origin[0], at_origin[1])
    np.testing.assert_array_equal(made.uv[made.triangles], uv.reshape(2, 3, 2))


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_a_mesh_of_any_size_stands_on_the_stand(size):
    mesh = placed(sphere(radius=size, segments=16), at=(7 * size, 3 * size, -size))
    fitted, scale = standing(mesh, reach=0.2, height=0.1)
    assert scale == pytest.approx(0.05 / size, rel=1e-4)
    low, high = fitted.positions.min(axis=0), fitted.positions.max(axis=0)
    np.testing.assert_allclose(low, [-0.05, 0.0, -0.05], atol=1e-5)
    np.testing.assert_allclose(high, [0.05, 0.1, 0.05], atol=1e-5)


def test_a_mesh_is_turned_from_z_towards_x():
    turned = placed(plane(size=2.0, segments=2), turn_deg=90.0, at=(0.0, 1.0, 0.0), scale=2.0)
    foot = turned.positions[turned.uv[:, 1] == 0]  # lay at +Z
    np.testing.assert_allclose(foot[:, 0], 2.0, atol=1e-6)
    np.testing.assert_allclose(turned.positions[:, 1], 1.0)
    np.testing.assert_allclose(turned.tangents[0], [0, 0, -1], atol=1e-6)


def test_joined_meshes_keep_their_shapes():
    both = joined([sphere(segments=8), placed(sphere(segments=8), at=(5.0, 0.0, 0.0))])
    assert volume(both) == pytest.approx(2 * volume(sphere(segments=8)), rel=1e-5)
    assert both.uv is not None
    assert joined([sphere(segments=8), teapot_mesh(segments=2)]).uv is None
