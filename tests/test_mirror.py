"""The mirror's geometry against paper and against rays traced by other code."""

import numpy as np
import pytest
from sphere_tracer import Camera

from stages.mirror import Sphere, rim_from_circle
from stages.room import Room


def sphere(x=760.0, y=480.0, rim=400.0, distance=1500.0, yaw=0.0, **known):
    known = known or {"distance_mm": distance}
    return Sphere.from_rim(
        x, y, rim, radius_mm=50.0, principal_px=(750.0, 500.0), yaw_deg=yaw, **known
    )


def test_the_centre_looks_back_at_the_camera():
    for s in (sphere(), sphere(x=1300.0, y=150.0, distance=200.0)):
        np.testing.assert_allclose(s.direction_of(s.centre_px), [0, 0, 1], atol=1e-12)


def test_from_far_away_sin_45_of_the_radius_looks_sideways():
    s = sphere(x=750.0, y=500.0, distance=1e7)
    step = 400.0 * np.sqrt(0.5)
    pixels = np.array([[750 + step, 500], [750 - step, 500], [750, 500 - step], [750, 500 + step]])
    paper = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]  # +X right, +Y up, though y runs down
    np.testing.assert_allclose(s.direction_of(pixels), paper, atol=1e-4)


def test_world_axes_are_a_rotation_with_plus_z_at_the_camera_and_y_up():
    s = sphere(x=300.0, y=900.0, distance=300.0)
    m = s.world_from_camera
    np.testing.assert_allclose(m @ m.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(m) == pytest.approx(1.0)
    np.testing.assert_allclose(m @ s.centre_mm, [0, 0, -300.0], atol=1e-9)
    up = m @ [0.0, -1.0, 0.0]
    assert up[0] == pytest.approx(0.0, abs=1e-12)
    assert up[1] > 0.5


def test_yaw_turns_the_content_from_plus_z_to_plus_x():
    s = sphere(yaw=90.0)
    np.testing.assert_allclose(s.direction_of(s.centre_px), [1, 0, 0], atol=1e-12)


@pytest.mark.parametrize("distance", [120.0, 1500.0])
def test_directions_agree_with_traced_rays(distance):
    camera = Camera.seeing(1100.0, 300.0, 300.0, 1000, 1500, distance=distance)
    s = Sphere(camera.centre, camera.radius, camera.focal_px, (750.0, 500.0))
    rng = np.random.default_rng(1)
    pixels = np.array(s.centre_px) + rng.uniform(-330, 330, (500, 2))
    # A world that is its own direction, seen through the tracer's sphere.
    traced = camera.radiance(lambda d: d.copy(), *pixels.T, reflectance=np.ones_like)
    on = s.inside_px(pixels) > 0
    assert 300 < on.sum() < 500
    np.testing.assert_allclose(s.direction_of(pixels[on]), traced[on], atol=1e-9)
    assert np.isnan(s.direction_of(pixels[~on])).all()


@pytest.mark.parametrize(("x", "distance"), [(750.0, 1500.0), (1200.0, 1500.0), (900.0, 90.0)])
def test_pixel_of_undoes_direction_of_up_to_the_rim(x, distance):
    s = sphere(x=x, distance=distance, yaw=25.0)
    rng = np.random.default_rng(2)
    rim = s.outline(2000)
    pixels = s.centre_px + (rim - s.centre_px) * rng.uniform(0, 0.99999, (2000, 1))
    back, visible = s.pixel_of(3.0 * s.direction_of(pixels))
    assert visible.all()
    np.testing.assert_allclose(back, pixels, atol=1e-5)


def test_the_blind_cone_is_as_wide_as_the_rim_looks_and_cannot_be_seen():
    s = sphere(distance=500.0)
    angle = np.arcsin(50.0 / 500.0)
    edge = np.pi - angle + np.array([-1e-6, 1e-6])
    directions = np.stack([np.sin(edge), np.zeros(2), np.cos(edge)], axis=-1)
    assert s.pixel_of(directions)[1].tolist() == [True, False]
    incidence = s.incidence_angle(directions)
    assert incidence[0] == pytest.approx(np.pi / 2, abs=1e-3)  # the rim is grazed
    assert np.isnan(incidence[1])
    assert s.incidence_angle([0.0, 0.0, 2.0]) == pytest.approx(0.0, abs=1e-12)


def test_incidence_is_half_the_angle_between_light_and_line_of_sight():
    s = sphere(x=1200.0, distance=400.0)
    pixels = s.centre_px + np.random.default_rng(3).uniform(-270, 270, (200, 2))
    light = s.direction_of(pixels)
    ray = np.append(pixels - (750.0, 500.0), np.full((200, 1), s.focal_px), axis=1)
    sight = -(ray / np.linalg.norm(ray, axis=1, keepdims=True)) @ s.world_from_camera.T
    paper = np.arccos(np.sum(light * sight, axis=1)) / 2.0
    np.testing.assert_allclose(s.incidence_angle(light), paper, atol=1e-6)


def test_the_outline_is_where_traced_rays_begin_to_miss():
    camera = Camera.seeing(1200.0, 200.0, 300.0, 1000, 1500, distance=150.0)
    s = Sphere(camera.centre, camera.radius, camera.focal_px, (750.0, 500.0))
    rim = s.outline(90)
    for step, hit in ((-0.01, True), (0.01, False)):
        x, y = (rim + step * s.outward(rim)).T
        straight = np.stack([x - 750.0, y - 500.0, np.full(90, s.focal_px)], axis=-1)
        straight /= np.linalg.norm(straight, axis=1, keepdims=True)
        seen = camera.radiance(lambda d: d.copy(), x, y, reflectance=lambda c: 2 * np.ones_like(c))
        assert (np.linalg.norm(seen, axis=1) > 1.5).tolist() == [hit] * 90
    np.testing.assert_allclose(s.inside_px(rim + 0.5 * s.outward(rim)), -0.5, atol=0.005)


def test_distance_and_focal_length_follow_from_each_other_and_the_rim():
    by_tape = sphere()
    by_lens = sphere(focal_px=by_tape.focal_px)
    np.testing.assert_allclose(by_lens.centre_mm, by_tape.centre_mm)
    assert (by_tape.rim_px, by_lens.distance_mm) == pytest.approx((400.0, 1500.0))
    both = sphere(distance_mm=1500.0, focal_px=9999.0)
    assert both.focal_px == by_tape.focal_px  # the tape is believed
    assert both.nominal_focal_px == 9999.0


def test_a_shifted_sphere_shows_the_same_directions_further_along():
    s, shift = sphere(), np.array([0.7, -0.4])
    p = np.array([[700.0, 450.0], [900.0, 600.0]])
    np.testing.assert_allclose(
        s.with_shift(shift).direction_of(p + shift), s.direction_of(p), atol=1e-12
    )


def test_a_drawn_circle_becomes_the_nearest_rim():
    def sphere_at(x, y, rim):
        return sphere(x, y, rim, distance=1500.0)

    outline = sphere_at(*rim_from_circle(1000.0, 300.0, 200.0, sphere_at)).outline()
    radius = np.hypot(*(outline - [1000.0, 300.0]).T)
    assert radius.mean() == pytest.approx(200.0, abs=0.2)
    assert np.abs(radius - 200.0).max() < 1.0  # the ellipse itself


def in_a_room(yaw=0.0):
    """A sphere in a box, pixels of it, and the directions of what the box's walls show there.

    By the plain way: the ray is traced to the mirror, from there to the first of six walls. Room
    and camera are those of a photographer who looks down by 10 degrees and 20 to the side.
    """
    camera = Camera.seeing(420.0, 380.0, 300.0, 800, 900, distance=1100.0)
    size, place = np.array([4.0, 2.5, 5.0]), np.array([1.5, 1.2, 2.0])
    down, aside = np.radians((10.0, 20.0))
    towards = [np.cos(down) * np.sin(aside), np.sin(down), np.cos(down) * np.cos(aside)]
    room = Room(tuple(size), tuple(place), tuple((place + 1.1 * np.array(towards)).tolist()))
    s = Sphere(
        camera.centre, camera.radius, camera.focal_px, (450.0, 400.0), yaw_deg=yaw, room=room
    )
    rng = np.random.default_rng(5)
    rim = s.outline(600)
    pixels = s.centre_px + (rim - s.centre_px) * rng.uniform(0, 0.995, (600, 1))
    reflected = camera.radiance(lambda d: d.copy(), *pixels.T, reflectance=np.ones_like)
    ray = np.append(pixels - (450.0, 400.0), np.full((600, 1), camera.focal_px), axis=1)
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    sight = -ray @ camera.world_axes().T
    normal = reflected + sight
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # The room's axes in the result's world: columns of a matrix made from three rotations' angles.
    z = np.array(towards)
    x = np.array([np.cos(aside), 0.0, -np.sin(aside)])
    axes = np.stack([x, np.cross(z, x), z])
    start = place + 0.05 * normal @ axes
    along = reflected @ axes
    nearest = np.full(600, np.inf)
    for axis in range(3):
        for wall in (0.0, size[axis]):
            steps = (wall - start[:, axis]) / along[:, axis]
            nearest = np.where(steps > 0, np.minimum(nearest, steps), nearest)
    seen = (start + nearest[:, None] * along - place) @ axes.T
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    c, sine = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
    return s, pixels, seen @ np.array([[c, 0, sine], [0, 1, 0], [-sine, 0, c]]).T, reflected


@pytest.mark.parametrize("yaw", [0.0, 70.0])
def test_in_a_room_a_direction_is_that_of_the_wall_from_the_spheres_centre(yaw):
    s, pixels, seen, reflected = in_a_room(yaw)
    np.testing.assert_allclose(s.direction_of(pixels), seen, atol=1e-9)
    if yaw == 0.0:  # it matters: half a degree and more
        assert np.median(np.linalg.norm(seen - reflected, axis=1)) > 0.01
    back, visible = s.pixel_of(seen)
    assert visible.all()
    np.testing.assert_allclose(back, pixels, atol=1e-3)


def test_in_a_room_light_is_still_reflected_at_the_angle_it_meets_the_mirror_at():
    s, pixels, seen, reflected = in_a_room()
    ray = np.append(pixels - (450.0, 400.0), np.full((600, 1), s.focal_px), axis=1)
    sight = -(ray / np.linalg.norm(ray, axis=1, keepdims=True)) @ s.world_from_camera.T
    paper = np.arccos(np.sum(reflected * sight, axis=1)) / 2.0
    np.testing.assert_allclose(s.incidence_angle(seen), paper, atol=1e-6)


def test_in_a_room_what_lies_behind_the_sphere_stays_hidden():
    s = in_a_room()[0]
    around = np.random.default_rng(6).normal(size=(500, 2)) * 0.01  # within a degree or two
    behind = np.column_stack([around, -np.ones(500)])
    assert not s.pixel_of(behind)[1].any()
    assert np.isnan(s.incidence_angle(behind)).all()
