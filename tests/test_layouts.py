"""Every layout's directions against paper: its middle, its edges, the size of its pixels."""

from __future__ import annotations

import numpy as np
import pytest

from stages import cube
from stages.layouts import PACKINGS, PROJECTIONS, BallPhotograph, packed, unpacked
from stages.mirror import Sphere

X, Y, Z = np.eye(3)
ON_ONE_SHEET = [p for p in PROJECTIONS.values() if p.sheets == 1]


def random_directions(count=2000):
    d = np.random.default_rng(4).normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


# What the interface, P. Debevec's probes, a photograph of a ball, and the octahedron's net say:
# direction, u, v.
ON_PAPER = {
    "latlong": [
        (-Z, 0.5, 0.5),
        (X, 0.75, 0.5),
        (-X, 0.25, 0.5),
        (Y + 1e-9 * X, 0.75, 0.0),
        ((-Z + Y) / np.sqrt(2), 0.5, 0.25),
    ],
    "mirrorball": [
        (Z, 0.5, 0.5),
        (X, 0.5 + np.sqrt(0.125), 0.5),  # sin 45 degrees of the radius looks sideways
        (Y, 0.5, 0.5 - np.sqrt(0.125)),
        ((-X - Z) / np.sqrt(2), 0.5 - 0.5 * np.sin(3 * np.pi / 8), 0.5),
    ],
    "angular": [
        (-Z, 0.5, 0.5),
        (X, 0.75, 0.5),
        (Y, 0.5, 0.25),
        ((X + Z) / np.sqrt(2), 0.875, 0.5),
    ],
    "octahedral": [
        (Y, 0.5, 0.5),
        (X, 1.0, 0.5),
        (Z, 0.5, 1.0),
        ((X + Y) / np.sqrt(2), 0.75, 0.5),
        ((X - Y + Z) / np.sqrt(3), 5 / 6, 5 / 6),
    ],
    "cube": [],
}


@pytest.mark.parametrize("name", ON_PAPER)
def test_directions_lie_where_paper_says(name):
    projection = PROJECTIONS[name]
    for direction, u, v in ON_PAPER[name]:
        _, at_u, at_v = projection.position(direction)
        np.testing.assert_allclose((at_u, at_v), (u, v), atol=1e-7)
    for face, axis in enumerate((X, -X, Y, -Y, Z, -Z)):
        if name == "cube":
            assert projection.position(axis) == (face, 0.5, 0.5)


@pytest.mark.parametrize("projection", PROJECTIONS.values(), ids=PROJECTIONS)
def test_position_undoes_direction(projection):
    d = random_directions()
    back = projection.direction(*projection.position(d))
    np.testing.assert_allclose(back, d, atol=1e-9)  # sqrt(1 - r^2) near a mirror ball's rim


@pytest.mark.parametrize("projection", PROJECTIONS.values(), ids=PROJECTIONS)
def test_density_and_fineness_are_those_of_the_directions(projection):
    sheet, u, v = projection.position(random_directions())
    step = 1e-6
    du = projection.direction(sheet, u + step, v) - projection.direction(sheet, u - step, v)
    dv = projection.direction(sheet, u, v + step) - projection.direction(sheet, u, v - step)
    du, dv = du / (2 * step), dv / (2 * step)
    near = np.isfinite(du + dv).all(axis=-1)  # not where the step leaves a mirror ball
    assert near.mean() > 0.99
    solid_angle = np.linalg.norm(np.cross(du, dv), axis=-1)[near]
    wanted = projection.density(u, v)[near]
    np.testing.assert_allclose(np.percentile(solid_angle / wanted, [1, 99]), 1, rtol=1e-6)
    jacobian = np.stack([du[near] / projection.aspect, dv[near]], axis=-1)
    coarsest = np.linalg.svd(jacobian, compute_uv=False)[:, -1]
    fine = projection.pixels_per_radian(random_directions(), u, v)[near]
    np.testing.assert_allclose(np.percentile(fine * coarsest, [1, 99]), 1, rtol=1e-4)


@pytest.mark.parametrize("projection", PROJECTIONS.values(), ids=PROJECTIONS)
def test_solid_angles_add_up_to_the_sphere(projection):
    total = projection.solid_angles(30).sum() * projection.sheets
    np.testing.assert_allclose(total, 4 * np.pi, rtol=1e-12)


def test_a_mirror_balls_pixels_have_equal_solid_angles():
    # J. Lambert 1772: sin of half the angle is the equal-area azimuthal projection's radius.
    angles = PROJECTIONS["mirrorball"].solid_angles(128)
    np.testing.assert_allclose(angles[48:80, 48:80], 16 / 128**2, rtol=1e-3)
    assert angles[0, 0] == 0


@pytest.mark.parametrize("projection", ON_ONE_SHEET, ids=[p.name for p in ON_ONE_SHEET])
def test_past_an_edge_the_picture_goes_on(projection):
    """A step over the edge of the sheet, or of the disc, turns no further than one before it."""
    if projection.name == "mirrorball":
        pytest.skip("nothing lies past a mirror ball's rim")
    t, step = np.linspace(0.05, 0.95, 19), 1e-4
    sides = [(t, 0 * t, 0, -1), (t, 0 * t + 1, 0, 1), (0 * t, t, -1, 0), (0 * t + 1, t, 1, 0)]
    if projection.name == "angular":
        angle = 2 * np.pi * t
        c, s = np.cos(angle) / 2, np.sin(angle) / 2
        sides = [(c + 0.5, s + 0.5, 2 * c, 2 * s)]
    for u, v, du, dv in sides:
        du, dv = np.asarray(du) * step, np.asarray(dv) * step
        inside = projection.direction(0, u - du, v - dv)
        outside = projection.direction(0, u + du, v + dv)
        apart = np.linalg.norm(outside - inside, axis=-1)
        assert apart.max() < 20 * step  # 2 pi and a little, times two steps
        # and what the position of that direction says is on the sheet
        _, at_u, at_v = projection.position(outside)
        assert (np.abs(np.stack([at_u, at_v]) - 0.5) <= 0.5 + 1e-12).all()
        np.testing.assert_allclose(projection.direction(0, at_u, at_v), outside, atol=1e-9)


@pytest.mark.parametrize("packing", PACKINGS)
def test_packing_loses_nothing(packing):
    faces = np.random.default_rng(2).random((6, 4, 4, 3))
    image = packed(faces, packing, np.nan)
    np.testing.assert_array_equal(unpacked(image, packing), faces)
    assert np.isnan(image[..., 0]).sum() == image[..., 0].size - faces[..., 0].size


@pytest.mark.parametrize("packing", ["hcross", "vcross"])
def test_in_a_cross_the_picture_goes_on_across_every_inner_edge(packing):
    n = 8
    image = packed(cube.directions(n), packing, np.nan)
    apart_down = np.linalg.norm(np.diff(image, axis=0), axis=-1)
    apart_right = np.linalg.norm(np.diff(image, axis=1), axis=-1)
    steps = np.concatenate([apart_down[n - 1 :: n].ravel(), apart_right[:, n - 1 :: n].ravel()])
    steps = steps[np.isfinite(steps)]
    assert len(steps) == 5 * n  # a net of the cube keeps five of its twelve edges
    assert steps.max() < 2 / n  # at most a texel


def test_a_photograph_shows_no_more_than_the_ball():
    sphere = Sphere.from_rim(
        30.0, 20.0, 15.0, radius_mm=1.0, principal_px=(32.0, 24.0), distance_mm=6.0
    )
    photograph = BallPhotograph(sphere, 48, 64)
    d = sphere.direction_of(np.array([[30.0, 20.0], [40.0, 20.0], [30.0, 12.0]]))
    _, u, v = photograph.position(d)
    np.testing.assert_allclose(u * 64, [30, 40, 30], atol=1e-3)
    np.testing.assert_allclose(v * 48, [20, 20, 12], atol=1e-3)
    counted = photograph.solid_angles(48).sum()
    assert np.pi * 13.8**2 < counted < np.pi * 14.3**2  # a pixel inside the rim
    hidden = -(sphere.world_from_camera @ -np.array(sphere.centre_mm) / 6.0)
    assert photograph.position(hidden)[1] < 0
