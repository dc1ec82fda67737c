"""Shifts known to the tracer, between photographs through unlike filters."""

import dataclasses

import numpy as np
import pytest
from sphere_tracer import Camera, busy_world, chromium, photograph, smooth_world

from calibration.errors import InputError
from stages.align import Alignment, align
from stages.mirror import Sphere
from stages.types import Measured

CAMERA = Camera.seeing(120.3, 110.7, 90.0, 220, 240)
SPHERE = Sphere(CAMERA.centre, CAMERA.radius, CAMERA.focal_px, (120.0, 110.0))
# Camera channels from the world's three bands: what a cyan and a yellow filter leave of each.
CYAN = np.array([[0.05, 0.1, 0.0], [0.05, 0.9, 0.3], [0.0, 0.3, 1.0]])
YELLOW = 3.0 * np.array([[1.0, 0.3, 0.0], [0.1, 1.0, 0.05], [0.0, 0.1, 0.02]])


def room(seed):
    """A busy world whose bands are alike but not the same."""
    grey, tint = busy_world(seed), smooth_world(seed + 500, degree=15.0, channels=3)
    return lambda d: grey(d) * tint(d)


def measured(image, seed):
    variance = 0.005**2 * image + (1e-3 * image.mean(axis=(0, 1))) ** 2
    noise = np.random.default_rng(seed).normal(size=image.shape) * np.sqrt(variance)
    return Measured(
        (image + noise).astype(np.float32),
        variance.astype(np.float32),
        np.ones(image.shape[:2], np.float32),
    )


def view(world, filter_bands, shift=(0.0, 0.0), seed=0):
    image = photograph(CAMERA, world, chromium, shift, rim_samples=4)
    return measured(image @ filter_bands.T, seed)


def test_one_filter_lies_where_it_lies():
    alone = align([view(room(1), CYAN)], SPHERE)
    assert alone.shifts.tolist() == [[0.0, 0.0]]


@pytest.mark.parametrize(("seed", "shift"), [(1, (0.31, 0.47)), (2, (-2.6, 3.2))])
def test_a_shift_is_found_to_a_twentieth_of_a_pixel_through_unlike_filters(seed, shift):
    world = room(seed)
    found = align([view(world, CYAN, seed=3), view(world, YELLOW, shift, seed=4)], SPHERE)
    np.testing.assert_allclose(found.shifts, [(0.0, 0.0), shift], atol=0.05)
    assert found.correlation[1] > 0.9
    assert 0.0 < found.error_px[1] < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(("scale", "turn_deg"), [(1.002, 0.0), (0.9985, 0.08)])
def test_a_filter_that_magnifies_and_turns_is_found_to_do_so(scale, turn_deg):
    """Through the tracer's own camera: a longer focal length magnifies about the optical axis,
    and turning positions about it turns the picture."""
    world, bands = room(4), YELLOW
    focal = dataclasses.replace(CAMERA, focal_px=CAMERA.focal_px * scale)
    t = np.radians(turn_deg)
    turn = np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]])  # from x towards y, down

    class Turned(Camera):
        def radiance(self, world, x, y, reflectance, shift=(0.0, 0.0)):
            middle = np.array([self.width / 2, self.height / 2])
            x, y = ((np.stack([x, y], axis=-1) - middle) @ turn + middle).T
            return super().radiance(world, x, y, reflectance, shift)

    seen = photograph(Turned(**vars(focal)), world, chromium, rim_samples=4) @ bands.T
    found = align([view(world, CYAN, seed=3), measured(seen, 4)], SPHERE)
    middle = np.array([120.0, 110.0])
    places = middle + 60.0 * np.random.default_rng(5).uniform(-1, 1, (50, 2))
    expected = middle + scale * (places - middle) @ turn.T
    off = found.to_image(1, places) - expected
    assert np.sqrt(np.mean(off**2)) < 0.03
    assert found.scales[1] == pytest.approx(scale, abs=4e-4)
    assert found.turns_deg[1] == pytest.approx(turn_deg, abs=0.025)


def test_a_clipped_lamp_does_not_pull():
    world = room(1)
    first, other = view(world, CYAN, seed=3), view(world, YELLOW, (0.5, -0.5), seed=4)
    clipped = other.values[..., 1] > 8.0
    assert clipped.any()
    values = np.where(clipped[..., None], np.nan, other.values)
    other = Measured(values, other.variance, (~clipped).astype(np.float32))
    np.testing.assert_allclose(align([first, other], SPHERE).shifts[1], (0.5, -0.5), atol=0.05)


@pytest.mark.slow
def test_photographs_of_different_things_are_refused():
    flat = measured(np.ones((220, 240, 3)), 1)
    with pytest.raises(InputError, match="does not match"):
        align([view(room(1), CYAN), flat], SPHERE)


def test_positions_go_to_a_turned_and_scaled_image_and_back():
    turned = Alignment(
        np.array([(0.0, 0.0), (2.0, -1.0)]),
        np.ones(2),
        np.zeros(2),
        about_px=(100.0, 80.0),
        scales=np.array([1.0, 1.01]),
        turns_deg=np.array([0.0, 90.0]),
    )
    # 10 px to the right of the centre, turned towards y, which runs down, and a hundredth larger.
    np.testing.assert_allclose(turned.to_image(1, np.array([110.0, 80.0])), [102.0, 89.1])
    places = np.random.default_rng(1).uniform(0, 200, (20, 2))
    np.testing.assert_allclose(turned.to_first(1, turned.to_image(1, places)), places)
    np.testing.assert_allclose(turned.to_image(0, places), places)
