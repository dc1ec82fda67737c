"""A lens's radial distortion, against OpenCV's own and back."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from sphere_tracer import Camera, chromium, smooth_world

from stages.align import Alignment
from stages.cube import directions
from stages.lens import distorted, reach, stretch, undistorted
from stages.locate import locate
from stages.mirror import Sphere
from stages.types import Measured
from stages.unwrap import unwrap

BARREL = (-0.21, 0.07, -0.01)
PLACES = np.random.default_rng(1).uniform(-0.7, 0.7, (200, 2))


@pytest.mark.parametrize("k", [BARREL, (0.15, 0.0, 0.0), (0.0, 0.0, 0.0)])
def test_places_move_as_opencv_moves_them_and_back(k):
    points = np.column_stack([PLACES, np.ones(200)])
    k1, k2, k3 = k
    theirs = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), np.eye(3), np.array([k1, k2, 0.0, 0.0, k3])
    )[0]
    np.testing.assert_allclose(distorted(PLACES, k), theirs[:, 0], atol=1e-12)
    np.testing.assert_allclose(undistorted(theirs[:, 0], k), PLACES, atol=1e-12)


def test_the_stretch_is_the_slope_of_the_distortion():
    step = 1e-6
    slopes = [
        (distorted(PLACES + d, BARREL) - distorted(PLACES - d, BARREL)) / (2 * step)
        for d in step * np.eye(2)
    ]
    np.testing.assert_allclose(stretch(PLACES, BARREL), np.stack(slopes, axis=-1), atol=1e-8)


def test_the_middle_stays_where_it_is():
    assert (undistorted(np.zeros(2), BARREL) == 0).all()


def test_places_that_no_lens_shows_come_from_the_end_of_what_it_shows():
    fold = np.sqrt(1 / 0.6)
    np.testing.assert_allclose(undistorted([(9.0, 0.0)], (-0.2, 0.0, 0.0)), [(fold, 0.0)])
    assert np.isfinite(undistorted([(500.0, 0.0)], (0.2, 0.1, 0.0))).all()


def test_the_reach_ends_where_the_picture_folds_back():
    # r (1 - .2 r^2) is largest at r^2 = 1 / .6
    r = np.sqrt(1 / 0.6)
    assert reach((-0.2, 0.0, 0.0)) == pytest.approx(r * (1 - 0.2 * r * r))
    assert reach((0.2, 0.1, 0.0)) == np.inf


CAMERA = Camera.seeing(128.0, 132.0, 95.0, 310, 330, distance=220.0)


def photograph(world):
    """What the tests' tracer sees through a lens that distorts as OpenCV says, in 9 rays."""
    height, width = CAMERA.height, CAMERA.width
    k1, k2, k3 = BARREL
    matrix = np.diag([CAMERA.focal_px, CAMERA.focal_px, 1.0])
    matrix[:2, 2] = width / 2, height / 2
    rows, columns = (a.ravel() for a in np.mgrid[:height, :width])
    total = 0.0
    for dy in (1 / 6, 3 / 6, 5 / 6):
        for dx in (1 / 6, 3 / 6, 5 / 6):
            seen = np.column_stack([columns + dx, rows + dy])
            ideal = cv2.undistortPoints(
                seen[:, None],
                matrix,
                np.array([k1, k2, 0.0, 0.0, k3]),
                P=matrix,
                criteria=(cv2.TERM_CRITERIA_COUNT, 60, 1e-12),
            )[:, 0]
            total = total + CAMERA.radiance(world, *ideal.T, reflectance=chromium)
    return (total / 9).reshape(height, width, -1)


@pytest.mark.slow
def test_a_sphere_seen_through_a_bad_lens_is_found_and_its_world_comes_back():
    world = smooth_world(5, degree=8.0, channels=2)
    image = photograph(world).astype(np.float32)
    measured = Measured(image, np.full_like(image, 1e-8), np.ones(image.shape[:2], np.float32))
    cosine = np.linspace(1.0, 0.0, 500) ** 2
    found = locate(
        [measured],
        radius_mm=50.0,
        distance_mm=220.0,
        reflectance=(np.arccos(cosine), chromium(cosine)),
        distortion=BARREL,
    )
    truth = Sphere(CAMERA.centre, 50.0, CAMERA.focal_px, (165.0, 155.0), distortion=BARREL)
    assert np.hypot(*np.subtract(found.centre_px, truth.centre_px)) < 0.1
    assert found.rim_px == pytest.approx(truth.rim_px, abs=0.1)
    still = Alignment(np.zeros((1, 2)), np.ones(1), np.zeros(1))
    d = directions(32)
    light = world(d.reshape(-1, 3)).reshape(*d.shape[:3], -1)
    errors = []
    for sphere in (truth, found):
        cube = unwrap([measured], sphere, still, face_size=32)
        seen = (cube.valid > 0.5) & (d[..., 2] > np.cos(np.radians(135.0)))
        mirror = chromium(np.cos(sphere.incidence_angle(d)))[..., None]
        errors.append(np.median(np.abs(cube.values / mirror / light - 1.0)[seen]))
    assert errors[0] < 1e-3
    assert errors[1] < 4e-3
    pixels = truth.pixel_of(directions(8))[0]
    plain = replace(truth, distortion=(0.0, 0.0, 0.0)).direction_of(pixels)
    moved = np.linalg.norm(plain - truth.direction_of(pixels), axis=-1)
    assert np.degrees(np.nanmedian(moved)) > 0.5  # it matters


def test_pixels_and_directions_stay_each_others_inverse_through_a_bad_lens():
    s = Sphere(CAMERA.centre, 50.0, CAMERA.focal_px, (165.0, 155.0), distortion=BARREL)
    rim = s.outline(300)
    pixels = s.centre_px + (rim - s.centre_px) * np.random.default_rng(3).uniform(
        0, 0.999, (300, 1)
    )
    back, visible = s.pixel_of(s.direction_of(pixels))
    assert visible.all()
    np.testing.assert_allclose(back, pixels, atol=1e-5)
    np.testing.assert_allclose(s.direction_of(s.centre_px), [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(s.inside_px(rim - 0.3 * s.outward(rim)), 0.3, atol=2e-3)
    by_rim = Sphere.from_rim(
        *s.centre_px,
        s.rim_px,
        radius_mm=50.0,
        principal_px=(165.0, 155.0),
        distance_mm=220.0,
        distortion=BARREL,
    )
    np.testing.assert_allclose(by_rim.centre_mm, s.centre_mm, atol=1e-9)
