"""Spheres at places known to the tracer, before all sorts of worlds."""

import numpy as np
import pytest
from sphere_tracer import Camera, busy_world, chromium, photograph, smooth_world

from calibration.errors import InputError
from stages.locate import locate
from stages.types import Measured

LENS = {"radius_mm": 50.0, "distance_mm": 1500.0}


def measured(image, noise=0.003, seed=0):
    image = np.asarray(image, np.float64).reshape(*image.shape[:2], -1)
    variance = (noise * image) ** 2 + 1e-6
    image = image + np.random.default_rng(seed).normal(size=image.shape) * np.sqrt(variance)
    return Measured(
        image.astype(np.float32), variance.astype(np.float32), np.ones(image.shape[:2], np.float32)
    )


def errors(sphere, camera, x, y, rim):
    assert sphere.focal_px == pytest.approx(camera.focal_px, rel=0.01)
    return np.abs(np.array([*sphere.centre_px, sphere.rim_px]) - (x, y, rim))


@pytest.mark.parametrize(
    ("x", "y", "rim", "world", "tolerance"),
    [
        (150.3, 110.7, 80.0, smooth_world(1), 0.15),
        (182.6, 141.2, 120.0, smooth_world(2), 0.1),
        (162.4, 133.9, 110.0, busy_world(1), 0.25),
        (120.7, 148.3, 100.0, busy_world(52), 0.25),
    ],
)
def test_the_rim_is_found_to_a_fraction_of_a_pixel(x, y, rim, world, tolerance):
    camera = Camera.seeing(x, y, rim, 280, 320)
    image = photograph(camera, world, chromium, samples=1, rim_samples=4)
    sphere = locate([measured(image)], **LENS)
    assert errors(sphere, camera, x, y, rim).max() < tolerance
    assert sphere.rim_found > 0.5
    assert sphere.rim_residual_px < 0.4


def test_a_stand_a_cluttered_background_and_unknown_pixels_do_no_harm():
    camera = Camera.seeing(210.4, 160.8, 110.0, 360, 420)
    image = photograph(camera, smooth_world(3, degree=12.0), chromium, rim_samples=5)[..., 0]
    clutter = photograph(Camera.seeing(900, 900, 1, 360, 420), busy_world(9), samples=1)[..., 0]
    y, x = np.mgrid[:360, :420] + 0.5
    far = np.hypot(x - 210.4, y - 160.8) > 125.0
    image[far] = np.clip(clutter + 0.5 * ((x // 23 + y // 31) % 3), 0.05, 3.0)[far]
    image[(np.abs(x - 200.0) < 35.0) & (y > 255.0)] = 0.02  # the stand, a tenth of the rim
    photo = measured(image)
    lamp = (np.hypot(x - 290.0, y - 85.0) < 9.0) | (np.hypot(x - 180.0, y - 150.0) < 4.0)
    values = np.where(lamp[..., None], np.nan, photo.values)
    photo = Measured(values, photo.variance, (~lamp).astype(np.float32))
    sphere = locate([photo], **LENS)
    assert errors(sphere, camera, 210.4, 160.8, 110.0).max() < 0.15


def test_close_up_the_rim_is_fitted_as_the_ellipse_it_is():
    camera = Camera.seeing(100.0, 110.0, 60.0, 240, 340, distance=150.0)
    image = photograph(camera, smooth_world(4), chromium, rim_samples=5)
    sphere = locate([measured(image)], radius_mm=50.0, focal_px=camera.focal_px)
    np.testing.assert_allclose(sphere.centre_mm, camera.centre, rtol=3e-3)
    assert sphere.distance_mm == pytest.approx(150.0, rel=2e-3)


def test_no_sphere_is_said():
    empty = photograph(Camera.seeing(5000, 5000, 10, 200, 260), busy_world(4), samples=1)
    y, x = np.mgrid[:200, :260]
    boxes = np.random.default_rng(8).uniform(0.1, 3.0, (9, 9))[y // 30, x // 40]
    flat = np.ones((200, 260))
    for image in (empty, boxes, flat):
        with pytest.raises(InputError, match=r"no sphere found.*outline = \[x, y, radius\]"):
            locate([measured(image)], **LENS)


@pytest.mark.parametrize(
    ("x", "y", "side"), [(60.0, 150.0, "left"), (150.0, 190.0, "bottom"), (260.0, 120.0, "right")]
)
def test_a_sphere_cut_by_the_frame_is_said_with_its_side(x, y, side):
    camera = Camera.seeing(x, y, 80.0, 240, 320)
    image = photograph(camera, smooth_world(7), chromium, rim_samples=4)
    with pytest.raises(InputError, match=rf"cut by the {side} of the frame.*outline"):
        locate([measured(image)], **LENS)


def test_an_outline_is_taken_as_the_rim_and_checked():
    blank = measured(np.ones((240, 320)))
    sphere = locate([blank], outline=[150.0, 110.0, 80.0], **LENS)
    rim = sphere.outline()
    np.testing.assert_allclose((rim.min(0) + rim.max(0)) / 2, (150.0, 110.0), atol=1e-3)
    assert np.hypot(*(rim - (150.0, 110.0)).T).mean() == pytest.approx(80.0, abs=1e-2)
    assert np.isnan(sphere.rim_found)
    with pytest.raises(InputError, match=r"cut by the top of the frame.*correct outline"):
        locate([blank], outline=[150.0, 70.0, 80.0], **LENS)
    with pytest.raises(InputError, match="radius is -3 px"):
        locate([blank], outline=[150.0, 70.0, -3.0], **LENS)


def test_distance_or_focal_length_must_be_known_and_sense():
    blank = measured(np.ones((240, 320)))
    with pytest.raises(InputError, match=r"distance_mm in \[sphere\], or focal_length_mm"):
        locate([blank], radius_mm=50.0)
    with pytest.raises(InputError, match="the camera outside the sphere"):
        locate([blank], radius_mm=50.0, distance_mm=40.0)
