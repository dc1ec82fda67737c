"""How views lie to each other, from photographs traced apart from the code under test."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_views import photographed
from sphere_tracer import Camera, busy_world, chromium

from calibration.errors import InputError
from stages.orient import Place, orient, warnings

COSINE = np.linspace(1.0, 0.0, 500) ** 2
REFLECTANCE = np.arccos(COSINE), chromium(COSINE)
TURN = Rotation.from_euler("YXZ", [112.0, 6.0, -2.5], degrees=True).as_matrix()


def taken(world, turn, *, gain=1.0, seed=0, rim=140.0):
    """A photograph with whoever took it, and the sphere in it."""
    height, width = int(2.4 * rim), int(2.6 * rim)
    camera = Camera.seeing(width / 2 + 3.0, height / 2 - 4.0, rim, height, width)
    return photographed(camera, world, turn, gain=gain, seed=seed)


def oriented(views, places=None):
    images, spheres = zip(*views, strict=True)
    names = ("front", "right", "left")[: len(views)]
    places = places or [None] * len(views)
    return orient(images, spheres, names=names, places=places, reflectance=REFLECTANCE)


def off_deg(turn, truth):
    return np.degrees(Rotation.from_matrix(np.asarray(turn) @ truth.T).magnitude())


@pytest.fixture(scope="module")
def front():
    world = busy_world(3, channels=3)
    return world, taken(world, np.eye(3))


def test_a_rotation_is_found_without_being_told_anything(front):
    world, first = front
    found = oriented([first, taken(world, TURN, gain=1.1, seed=1)])
    first_view, second = found.views
    np.testing.assert_allclose(first_view.turn, np.eye(3))
    assert off_deg(second.turn, TURN) < 0.05
    assert 0.001 < second.sigma_deg < 0.05
    assert second.gain == pytest.approx(1.1, rel=0.005)
    assert abs(found.nearness_per_m) < 0.02  # all of it is far away
    (note,) = warnings(found, ("front", "right"))
    assert "right: all light is 1.1 times that of front" in note


@pytest.mark.slow
def test_a_hint_is_enough_within_30_degrees_and_refused_where_it_is_wrong(front):
    world, first = front
    views = [first, taken(world, TURN, seed=2)]
    x, y, z = TURN[:, 2]
    yaw, pitch = np.degrees([np.arctan2(x, z), np.arcsin(y)])
    found = oriented(views, [None, Place(yaw + 18.0, pitch - 10.0)])
    assert off_deg(found.views[1].turn, TURN) < 0.05
    with pytest.raises(InputError, match="the view 'right' shows nothing that the view 'front'"):
        oriented(views, [None, Place(yaw + 140.0)])


@pytest.mark.slow
def test_another_world_is_refused_in_a_line(front):
    _, first = front
    with pytest.raises(InputError) as error:
        oriented([first, taken(busy_world(77, channels=3), TURN, seed=3)])
    (problem,) = error.value.problems
    assert "'right' shows nothing" in problem.found
    assert "yaw_deg" in problem.remedy


@pytest.mark.slow
def test_a_world_that_looks_alike_from_two_sides_is_refused():
    half = busy_world(3, channels=3)

    def world(directions):
        return half(np.where(directions[:, 2:] > 0, directions, directions * (-1.0, 1.0, -1.0)))

    with pytest.raises(InputError, match="in more than one way"):
        oriented([taken(world, np.eye(3)), taken(world, TURN, seed=4)])


def test_a_place_says_where_the_camera_stands():
    np.testing.assert_allclose(Place(90.0).turn[:, 2], (1.0, 0.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(Place(90.0).turn[:, 1], (0.0, 1.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(Place(0.0, 30.0).turn[:, 2], (0.0, 0.5, np.sqrt(0.75)), atol=1e-12)
