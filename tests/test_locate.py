"""Spheres at places known to the tracer, before all sorts of worlds."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from sphere_tracer import Camera, busy_world, chromium, photograph, smooth_world

from calibration.errors import InputError
from stages.demosaic import demosaic
from stages.locate import locate
from stages.mirror import Sphere
from stages.rim import RimFit, measure_rim
from stages.types import Measured, Radiance

COSINE = np.linspace(1.0, 0.0, 500) ** 2
METAL = np.arccos(COSINE), chromium(COSINE)  # as the step gives it for the sphere's material
LENS = {"radius_mm": 50.0, "distance_mm": 1500.0, "reflectance": METAL}


def measured(image, noise=0.003, seed=0, lens_px=0.0):
    """A photograph of an image (H, W) or (H, W, C), through a lens that blurs so much."""
    image = np.asarray(image, np.float64).reshape(*image.shape[:2], -1)
    image = gaussian_filter(image, (lens_px, lens_px, 0.0))
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
        (150.3, 110.7, 80.0, smooth_world(1), 0.1),
        (182.6, 141.2, 120.0, smooth_world(2), 0.1),
        (162.4, 133.9, 110.0, busy_world(1), 0.15),
        (120.7, 148.3, 100.0, busy_world(52), 0.2),
    ],
)
def test_the_rim_is_found_to_a_fraction_of_a_pixel(x, y, rim, world, tolerance):
    camera = Camera.seeing(x, y, rim, 280, 320)
    image = photograph(camera, world, chromium, samples=1, rim_samples=4)
    sphere = locate([measured(image)], **LENS)
    assert errors(sphere, camera, x, y, rim).max() < tolerance
    assert sphere.rim_found > 0.5
    assert sphere.rim_residual_px < 0.4


@pytest.mark.slow
@pytest.mark.parametrize("lens_px", [0.5, 1.0])
@pytest.mark.parametrize(("world", "tolerance"), [(busy_world(52), 0.1), (smooth_world(4), 0.2)])
def test_a_lens_may_blur_the_rim(world, tolerance, lens_px):
    x, y, rim = 120.7, 118.3, 90.0
    camera = Camera.seeing(x, y, rim, 230, 250)
    image = photograph(camera, world, chromium, samples=3, rim_samples=4)
    sphere = locate([measured(image, lens_px=lens_px)], **LENS)
    assert errors(sphere, camera, x, y, rim).max() < tolerance
    # The pixel's square, of variance 1 / 12, blurs too.
    assert sphere.blur_px == pytest.approx(np.hypot(lens_px, np.sqrt(1 / 12)), abs=0.15)


def through_a_mosaic(image, seed, noise=0.003):
    """What demosaicing makes of a Bayer sensor's view of an image (H, W, 3)."""
    height, width = image.shape[:2]
    cfa = np.array([[0, 1], [1, 2]])
    colour = np.tile(cfa, (height // 2, width // 2))[..., None]
    mosaic = np.take_along_axis(image, colour, axis=2)[..., 0]
    variance = (noise * mosaic) ** 2 + 1e-6
    mosaic = mosaic + np.random.default_rng(seed).normal(size=mosaic.shape) * np.sqrt(variance)
    return demosaic(
        Radiance(
            mosaic=mosaic.astype(np.float32),
            variance=variance.astype(np.float32),
            valid=np.ones(mosaic.shape, bool),
            defective=np.zeros(mosaic.shape, bool),
            cfa=cfa,
            tagged=(1.0,),
            solved=(1.0,),
            noise=np.array([[0.0, noise]]),
            clipped=(0.0,),
            lost=np.zeros(mosaic.shape, bool),
            moved=np.zeros(mosaic.shape, bool),
            at_least=np.full((2, 2), 1.0),
        )
    )


def dull(cosine):
    return np.full_like(cosine, 0.6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("grey", "reflectance", "tolerance"),
    [
        (smooth_world(31), chromium, 0.2),
        (busy_world(31), chromium, 0.3),
        (smooth_world(31), dull, 0.3),
    ],
)
def test_a_coloured_world_is_measured_through_a_bayer_mosaic(grey, reflectance, tolerance):
    x, y, rim = 131.4, 122.8, 100.0
    camera = Camera.seeing(x, y, rim, 240, 260)
    tint = smooth_world(90, degree=15.0, channels=3)
    image = photograph(camera, lambda d: grey(d) * tint(d), reflectance, samples=1, rim_samples=5)
    image = image * (0.3, 1.0, 0.6)  # the filter's
    sphere = locate(
        [through_a_mosaic(image, seed=31)],
        **(LENS | {"reflectance": None if reflectance is dull else METAL}),
    )
    assert errors(sphere, camera, x, y, rim).max() < tolerance


def test_a_rim_that_its_sectors_contradict_is_said_to_be_found_in_part():
    camera = Camera.seeing(150.3, 120.7, 90.0, 240, 300)
    photo = measured(photograph(camera, smooth_world(5), chromium, samples=1, rim_samples=4))

    def sphere_at(x, y, rim):
        return Sphere.from_rim(
            x, y, rim, radius_mm=50.0, principal_px=(150.0, 120.0), distance_mm=1500.0
        )

    near = measure_rim(photo, np.array([150.9, 120.0, 90.7]), sphere_at, METAL)
    astray = measure_rim(photo, np.array([180.3, 120.7, 60.0]), sphere_at, METAL)
    np.testing.assert_allclose(near.rim, (150.3, 120.7, 90.0), atol=0.2)
    assert near.found > 0.8 > 0.6 > astray.found


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


def test_a_sphere_is_found_before_a_wall_as_busy_as_itself():
    x, y, rim = 150.3, 120.7, 90.0
    camera = Camera.seeing(x, y, rim, 280, 320)
    image = photograph(camera, busy_world(4), chromium, samples=1, rim_samples=2)[..., 0]
    clutter = np.exp(2.0 * gaussian_filter(np.random.default_rng(4).normal(size=image.shape), 1.0))
    row, column = np.mgrid[:280, :320] + 0.5
    behind = np.hypot(column - x, row - y) >= rim
    sphere = locate([measured(np.where(behind, clutter, image), seed=1)], **LENS)
    # The wall is not that behind what the rim reflects, as one that is close is not.
    assert errors(sphere, camera, x, y, rim).max() < 0.3


def test_a_rim_that_ends_elsewhere_from_every_start_is_refused(monkeypatch):
    camera = Camera.seeing(150.3, 120.7, 90.0, 240, 300)
    photo = measured(photograph(camera, smooth_world(5), chromium, samples=1, rim_samples=4))

    apart = 2.5
    ends = []

    def elsewhere(image, start, sphere_at, reflectance):
        ends.append(150.0 + apart * len(ends))
        poor = tuple(k % 5 < 2 for k in range(36))
        return RimFit((ends[-1], 120.0, 90.0), (0.1, 0.1, 0.1), 0.5, poor, 0.5)

    monkeypatch.setattr("stages.locate.measure_rim", elsewhere)
    with pytest.raises(InputError, match=r"may be at \[150, 12\d, 9\d\], but too little"):
        locate([photo], **LENS)
    apart, ends = 1.5, []
    sphere = locate([photo], **LENS)
    assert len(ends) == 3
    # The one in the middle is near both; how far they are apart is an error of it.
    assert sphere.centre_px[0] == pytest.approx(151.5)
    assert sphere.rim_sigma_px[0] == pytest.approx(np.hypot(0.1, np.std([150.0, 151.5, 153.0])))


def test_close_up_the_rim_is_fitted_as_the_ellipse_it_is():
    camera = Camera.seeing(100.0, 110.0, 60.0, 240, 340, distance=150.0)
    image = photograph(camera, smooth_world(4), chromium, rim_samples=5)
    sphere = locate([measured(image)], radius_mm=50.0, focal_px=camera.focal_px, reflectance=METAL)
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


def test_two_spheres_are_said_with_both_outlines():
    left, right = (
        photograph(Camera.seeing(x, 90.0, 70.0, 180, 360), smooth_world(3), chromium, rim_samples=4)
        for x in (85.4, 271.2)
    )
    both = np.concatenate([left[:, :180], right[:, 180:]], axis=1)
    with pytest.raises(InputError, match=r"two spheres.*\[\d+, 9\d, [67]\d\] and .*outline"):
        locate([measured(both)], **LENS)
    chosen = locate([measured(both)], outline=[271.2, 90.0, 70.0], **LENS)
    assert chosen.centre_px[0] == pytest.approx(271.2, abs=0.5)


def test_an_outline_is_taken_as_the_rim_and_checked():
    blank = measured(np.ones((240, 320)))
    sphere = locate([blank], outline=[150.0, 110.0, 80.0], **LENS)
    rim = sphere.outline()
    np.testing.assert_allclose((rim.min(0) + rim.max(0)) / 2, (150.0, 110.0), atol=1e-3)
    assert np.hypot(*(rim - (150.0, 110.0)).T).mean() == pytest.approx(80.0, abs=1e-2)
    assert np.isnan(sphere.rim_found)
    with pytest.raises(InputError, match=r"cut by the top of the frame.*correct outline"):
        locate([blank], outline=[150.0, 70.0, 80.0], **LENS)
    outside = r"centre, at 350, 110 px, lies outside the frame.*320 x 240.*correct outline"
    with pytest.raises(InputError, match=outside):
        locate([blank], outline=[350.0, 110.0, 80.0], **LENS)
    with pytest.raises(InputError, match="radius is -3 px"):
        locate([blank], outline=[150.0, 70.0, -3.0], **LENS)


def test_distance_or_focal_length_must_be_known_and_sense():
    blank = measured(np.ones((240, 320)))
    with pytest.raises(InputError, match=r"distance_mm in \[sphere\], or focal_length_mm"):
        locate([blank], radius_mm=50.0)
    with pytest.raises(InputError, match="the camera outside the sphere"):
        locate([blank], radius_mm=50.0, distance_mm=40.0)
