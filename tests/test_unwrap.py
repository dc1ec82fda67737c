"""Worlds known as functions of direction, photographed by the tracer, come back as cubemaps."""

import cv2
import numpy as np
import pytest
from sphere_tracer import Camera, photograph, smooth_world

from stages.align import Alignment
from stages.cube import directions, face_directions
from stages.demosaic import demosaic
from stages.mirror import Sphere
from stages.room import Room
from stages.types import Measured, Radiance
from stages.unwrap import (
    BAYER_NOISE_AREA_PX,
    BAYER_NOISE_CORRELATION,
    _corners,
    default_face_size,
    unwrap,
)

CAMERA = Camera.seeing(178.3, 149.6, 130.0, 310, 330, distance=900.0)
SPHERE = Sphere(CAMERA.centre, CAMERA.radius, CAMERA.focal_px, (165.0, 155.0))
STILL = Alignment(np.zeros((1, 2)), np.ones(1), np.zeros(1))


def measured(image, variance=1e-4):
    image = np.asarray(image, np.float32)
    spread = np.broadcast_to(np.float32(variance), image.shape).copy()
    return Measured(image, spread, np.ones(image.shape[:2], np.float32))


def angle_from_camera(face_size):
    return np.degrees(np.arccos(directions(face_size)[..., 2]))


def relative_error(cube, world):
    d = directions(cube.valid.shape[1])
    truth = world(d.reshape(-1, 3)).reshape(*d.shape[:3], -1)
    return np.abs(cube.values / truth - 1.0).max(axis=-1)


@pytest.mark.parametrize("where", [(165.0, 155.0), (150.4, 163.9)])
def test_a_band_limited_world_comes_back_all_round(where):
    camera = Camera.seeing(*where, 130.0, 310, 330, distance=400.0)
    sphere = Sphere(camera.centre, camera.radius, camera.focal_px, (165.0, 155.0))
    world = smooth_world(5, degree=8.0, channels=3)
    cube = unwrap([measured(photograph(camera, world))], sphere, STILL, face_size=64)
    error, angle = relative_error(cube, world), angle_from_camera(64)
    for limit, median, tail in ((135.0, 5e-4, 2e-3), (160.0, 1e-3, 5e-3)):
        inside = error[(angle < limit) & (cube.valid > 0.5)]
        assert np.median(inside) < median
        assert np.percentile(inside, 95) < tail


def test_an_asymmetric_world_comes_out_the_right_way_round():
    def world(d):  # a coloured patch on each axis but the blind one
        return np.stack([d[:, 0] > 0.8, d[:, 1] > 0.8, (d[:, 0] < -0.8) * 2.0], axis=1) * 1.0

    cube = unwrap([measured(photograph(CAMERA, world))], SPHERE, STILL, face_size=16).values
    middle = cube[:, 7:9, 7:9].mean(axis=(1, 2))
    np.testing.assert_allclose(
        middle[:5], [[1, 0, 0], [0, 0, 2], [0, 1, 0], [0, 0, 0], [0, 0, 0]], atol=1e-6
    )


def test_a_constant_world_stays_exactly_constant_where_anything_is_known():
    cube = unwrap([measured(np.full((310, 330, 3), 0.7))], SPHERE, STILL, face_size=32)
    known = cube.valid > 0
    np.testing.assert_allclose(cube.values[known], 0.7, rtol=2e-6)
    assert np.isnan(cube.values[~known]).all()
    assert np.isnan(cube.variance[~known]).all()


def test_valid_falls_from_one_to_nothing_at_the_rim_and_in_the_blind_cone():
    cube = unwrap([measured(np.ones((310, 330, 1)))], SPHERE, STILL, face_size=128)
    angle = angle_from_camera(128)
    np.testing.assert_allclose(cube.valid[angle < 145.0], 1.0, atol=1e-5)
    blind = 180.0 - np.degrees(np.arcsin(50.0 / 900.0))
    assert (cube.valid[angle > blind] == 0).all()
    falling = cube.valid[(angle > 155.0) & (angle < 172.0)]
    assert ((falling > 0.1) & (falling < 0.9)).mean() > 0.2  # a slope and not a step
    assert (cube.valid <= 1.0).all()


def test_nothing_beside_the_sphere_leaks_into_the_cubemap():
    image = np.ones((310, 330, 1))
    y, x = np.mgrid[:310, :330] + 0.5
    image[SPHERE.inside_px(np.stack([x, y], axis=-1)) < 0.8] = 1e6
    cube = unwrap([measured(image)], SPHERE, STILL, face_size=64)
    np.testing.assert_allclose(cube.values[cube.valid > 0], 1.0, rtol=1e-5)


def test_a_texel_is_the_mean_over_its_area_and_never_steps_over_a_pixel():
    # Finest stripes the photograph has, under texels of many pixels: all must be near the mean.
    stripes = np.where(np.arange(330) % 2, 2.0, 0.0) * np.ones((310, 1))
    cube = unwrap([measured(stripes[..., None])], SPHERE, STILL, face_size=8)
    front = cube.values[angle_from_camera(8) < 120.0]
    assert np.abs(front - 1.0).max() < 0.1


def test_unknown_pixels_are_left_out_and_lower_valid():
    image = np.ones((310, 330, 1), np.float32)
    image[149:151, 150:210] = np.nan
    cube = unwrap([measured(image)], SPHERE, STILL, face_size=32)
    front = cube.valid[4]
    assert 0.05 < front.min() < 0.9
    known = cube.valid > 0
    np.testing.assert_allclose(cube.values[known], 1.0, rtol=1e-5)


def test_a_filter_is_read_where_its_image_lies():
    world = smooth_world(6, degree=8.0, channels=2)
    shift = (0.75, -1.4)
    images = [
        measured(photograph(CAMERA, world, samples=1)),
        measured(photograph(CAMERA, world, shift=shift, samples=1)),
    ]
    alignment = Alignment(np.array([(0.0, 0.0), shift]), np.ones(2), np.zeros(2))
    cube = unwrap(images, SPHERE, alignment, face_size=32)
    assert cube.values.shape == (6, 32, 32, 4)
    both = (angle_from_camera(32) < 150.0) & (cube.valid > 0.9)
    ratio = cube.values[both][:, 2:] / cube.values[both][:, :2]
    assert np.percentile(np.abs(ratio - 1.0), 95) < 2e-3


def test_a_sphere_cut_by_the_frame_comes_out_as_far_as_it_is_seen():
    # One channel and two, of noise, as far as the frame's very last pixel; both reach past the
    # array's end where four numbers are read at once.
    image = np.random.default_rng(11).random((310, 330, 2)).astype(np.float32)
    whole = unwrap([measured(image)], SPHERE, STILL, face_size=64)
    for channels in (1, 2):
        frame = image[:240, :260, :channels]
        cut = unwrap([measured(frame)], SPHERE, STILL, face_size=64)
        seen = cut.valid == 1.0
        assert 0.5 < seen.mean() < (whole.valid == 1.0).mean() - 0.1
        np.testing.assert_allclose(
            cut.values[seen], whole.values[seen][:, :channels], rtol=1e-6, atol=1e-6
        )


@pytest.mark.parametrize(
    ("distance", "room"),
    [
        (900.0, None),
        (90.0, None),  # the blind cone reaches far beyond the faces' middle
        (600.0, Room((1.5, 1.6, 2.0), (0.4, 0.7, 0.8), (0.5, 0.8, 1.4))),  # kinks at walls' edges
    ],
)
def test_between_knots_the_mirror_is_good_to_a_hundredth_of_a_pixel(distance, room):
    sphere = Sphere.from_rim(
        1500.0, 1480.0, 1400.0, radius_mm=50.0, principal_px=(1350.0, 1600.0), distance_mm=distance,
        yaw_deg=25.0, room=room,
    )  # fmt: skip
    corners, hidden = _corners(sphere, 256, 2)
    edge = np.linspace(-1.0, 1.0, 257)
    exact, seen = sphere.pixel_of(face_directions(edge[None, :], edge[:, None]))
    np.testing.assert_array_equal(hidden, ~seen)
    off = np.hypot(*(np.moveaxis(corners, 1, 0) - np.moveaxis(exact, -1, 0)))
    assert off.max() < 0.01


def bilinear(image, x, y):
    """Values (..., C) of an image (H, W, C) between its pixels' middles."""
    column, row = np.floor(x - 0.5).astype(int), np.floor(y - 0.5).astype(int)
    fx, fy = (x - 0.5 - column)[..., None], (y - 0.5 - row)[..., None]
    top = image[row, column] * (1 - fx) + image[row, column + 1] * fx
    bottom = image[row + 1, column] * (1 - fx) + image[row + 1, column + 1] * fx
    return top * (1 - fy) + bottom * fy


def test_the_compiled_loops_give_what_plain_sums_over_each_texels_area_give():
    # 32 x 32 places a texel, the mirror exact at each; the photograph is noise, blurred by a pixel.
    rng = np.random.default_rng(9)
    noise = rng.normal(size=(310, 330, 2)).astype(np.float32)
    image = cv2.GaussianBlur(noise, (0, 0), 1.0)
    shift = np.array([(0.3, -0.6)])
    cube = unwrap(
        [measured(image)], SPHERE, Alignment(shift, np.ones(1), np.zeros(1)), face_size=16
    )
    fine = (np.arange(16 * 32) + 0.5) / (16 * 16) - 1.0
    pixel, seen = SPHERE.pixel_of(face_directions(fine[None, :], fine[:, None]))
    read = bilinear(image, *np.moveaxis(pixel + shift[0], -1, 0))
    read[~seen] = np.nan
    plain = read.reshape(6, 16, 32, 16, 32, 2).mean(axis=(2, 4))
    whole = cube.valid > 1 - 1e-6
    assert whole.mean() > 0.9
    error = np.abs(cube.values - plain)[whole].max()
    assert error < 0.02 * image.std()


def test_the_number_of_threads_changes_nothing(monkeypatch):
    image = measured(photograph(CAMERA, smooth_world(4, channels=4), samples=1), 1e-4)
    cubes = []
    for threads in (1, 5):
        monkeypatch.setattr("os.cpu_count", lambda threads=threads: threads)
        cubes.append(unwrap([image], SPHERE, STILL, face_size=32, noise_area_px=(6.2, 2.9, 6.2, 1)))
    for one, other in zip(*(vars(c).values() for c in cubes), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_variance_is_the_spread_of_noisy_repeats():
    rng = np.random.default_rng(7)
    clean = np.ones((310, 330, 24), np.float32)  # 24 repeats, one a channel
    x = np.linspace(0.5, 2.0, 330)[None, :, None]
    noisy = clean + rng.normal(size=clean.shape) * 0.05 * x
    cube = unwrap([measured(noisy, (0.05 * x) ** 2)], SPHERE, STILL, face_size=64)
    known = cube.valid > 0.3
    spread = cube.values[known].var(axis=-1, ddof=1)
    stated = cube.variance[known].mean(axis=-1)
    angle = angle_from_camera(64)[known]
    for low, high in ((0, 60), (60, 120), (120, 150), (150, 180)):
        ring = (angle >= low) & (angle < high)
        # Neighbours share pixels, so a ring is some hundreds of variances of 23 freedoms.
        assert np.mean(spread[ring] / stated[ring]) == pytest.approx(1.0, abs=0.06)


def flat_mosaic(rng, sigma):
    """A merged mosaic of even light 1 and noise sigma."""
    flat = np.ones((310, 330), np.float32)
    return Radiance(
        mosaic=flat + rng.normal(size=flat.shape).astype(np.float32) * sigma,
        variance=flat * sigma**2,
        valid=flat > 0,
        cfa=np.array([[0, 1], [1, 2]]),
        tagged=(1.0,),
        solved=(1.0,),
        noise=np.array([[0.0, sigma]]),
        clipped=(0.0,),
        lost=flat < 0,
        defective=flat < 0,
        moved=flat < 0,
        at_least=np.full((2, 2), 1.0),
    )


def flat_cubes(count, *, seed, **options):
    rng = np.random.default_rng(seed)
    images = (demosaic(flat_mosaic(rng, 0.01)) for _ in range(count))
    return [unwrap([image], SPHERE, STILL, **options) for image in images]


@pytest.mark.slow
def test_the_variance_knows_what_demosaicing_shares_between_pixels():
    cubes = flat_cubes(8, seed=8, face_size=32, noise_area_px=BAYER_NOISE_AREA_PX)
    angle = angle_from_camera(32)
    spread = np.var([cube.values for cube in cubes], axis=0, ddof=1)
    stated = np.mean([cube.variance for cube in cubes], axis=0)
    for low, high in ((0, 60), (60, 120), (120, 150)):
        ring = (angle >= low) & (angle < high)
        ratio = spread[ring].mean(axis=0) / stated[ring].mean(axis=0)
        # If noise were taken as independent, the spread would be 1.3 to 2.3 times the stated.
        np.testing.assert_allclose(np.sqrt(ratio), 1.0, atol=0.12)


@pytest.mark.slow
def test_colours_of_a_texel_share_as_much_noise_as_is_said():
    noise = np.array([each.values - 1.0 for each in flat_cubes(4, seed=10, face_size=88)])
    noise = noise[:, angle_from_camera(88) < 140.0].reshape(-1, 3)
    # A texel in front is a pixel and a half wide here, as it is by default.
    np.testing.assert_allclose(np.corrcoef(noise.T), BAYER_NOISE_CORRELATION, atol=0.05)


def test_the_default_face_is_a_power_of_two_near_a_third_of_the_diameter():
    def of(rim):
        return default_face_size(
            Sphere.from_rim(0, 0, rim, radius_mm=50, principal_px=(0, 0), distance_mm=1500)
        )

    assert [of(425.0), of(1500.0), of(30.0)] == [256, 1024, 64]
