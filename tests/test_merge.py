from dataclasses import replace

import numpy as np
import pytest

from calibration.errors import InputError
from stages import merge as merging
from stages.merge import InMemory, Known, warnings
from stages.shutter import true_shutter
from stages.types import Frame

BAYER = {
    "RGGB": np.array([[0, 1], [1, 2]]),
    "BGGR": np.array([[2, 1], [1, 0]]),
    "GRBG": np.array([[1, 0], [2, 1]]),
    "GBRG": np.array([[1, 2], [0, 1]]),
}
RGGB = BAYER["RGGB"]
ELECTRONS, READ = 30000.0, 6.0  # full scale, read noise
BLACK, LEVELS = 1000.0, 14000.0
NOISE = (1 / ELECTRONS, READ / ELECTRONS)

TAGS = (1 / 1000, 1 / 250, 1 / 60, 1 / 15, 0.3, 1.0)
TIMES = (2.0**-10, 2.0**-8, 2.0**-6, 2.0**-4, 2.0 ** (-5 / 3), 1.0)  # what those tags stand for


def frame(signal, tag_s, *, iso=100.0, f_number=1.0, cfa=RGGB, black=BLACK, levels=LEVELS):
    """A raw file of a signal (H, W) in full scale; rounded and clipped."""
    raw = np.clip(np.round(black + signal * levels), 0, black + levels)
    level = np.full((2, 2), float(black))
    return Frame(raw.astype(np.uint16), cfa, level, level + levels, tag_s, iso, f_number)


def expose(world, time_s, tag_s, rng, electrons=ELECTRONS, read=READ, dark=0.0, prnu=0.0, **file):
    """A raw file of a world in full scale per second: photon and read noise, rounding, clipping.

    dark  (H, W) dark current in full scale per second
    prnu  (H, W) by what share more a pixel responds
    """
    electrons_seen = rng.poisson(np.minimum((world * (1 + prnu) + dark) * time_s, 30.0) * electrons)
    return frame((electrons_seen + rng.normal(0, read, world.shape)) / electrons, tag_s, **file)


def shoot(world, rng, times=TIMES, tags=TAGS, **sensor):
    return [
        expose(world, time_s, tag, rng, **sensor) for time_s, tag in zip(times, tags, strict=True)
    ]


def merge(frames, known=None):
    return merging.merge(InMemory(frames), known)


def steps_of_light(darkest=0.003, brightest=700.0, n=24, size=(200, 240)):
    """A world of vertical stripes (H, W), each brighter than the last by the same ratio."""
    levels = np.geomspace(darkest, brightest, n)
    return np.tile(np.repeat(levels, size[1] // n), (size[0], 1)), levels


def stripes(image, n=24):
    """Stripe by stripe, without the two columns beside the next one."""
    width = image.shape[1] // n
    return image.reshape(len(image), n, width)[:, :, 2:-2].swapaxes(0, 1).reshape(n, -1)


@pytest.fixture(scope="module")
def merged():
    world, levels = steps_of_light()
    return merge(shoot(world, np.random.default_rng(1))), world, levels


def test_all_levels_come_back_unbiased(merged):
    result, _, levels = merged
    samples = stripes(result.mosaic)
    error = np.nanmean(samples, axis=1) / levels - 1
    standard_error = np.nanstd(samples, axis=1) / np.sqrt(samples.shape[1]) / levels
    # 24 stripes: four standard errors, and .1 % for the ratios.
    assert np.all(np.abs(error) < 4 * standard_error + 1e-3)
    # Where it is well known that is better than 1 %.
    assert np.all(np.abs(error[levels > 0.05]) < 2e-3)


def test_the_variance_is_what_is_seen(merged):
    result, _, _ = merged
    seen = np.nanvar(stripes(result.mosaic), axis=1)
    said = np.nanmean(stripes(result.variance), axis=1)
    # 1200 samples a stripe give a variance to 4 %.
    np.testing.assert_allclose(said, seen, rtol=0.2)
    assert np.mean(said / seen) == pytest.approx(1, abs=0.05)


def test_no_unbiased_estimate_could_have_less_variance(merged):
    """The Cramer-Rao bound: the information of all exposures that did not saturate adds up."""
    result, _, levels = merged
    information = np.zeros_like(levels)
    for time_s in TIMES:
        noise = levels * time_s * NOISE[0] + NOISE[1] ** 2 + 1 / LEVELS**2 / 12
        information += np.where(levels * time_s < 0.95, time_s**2 / noise, 0)
    seen = np.nanvar(stripes(result.mosaic), axis=1)
    assert np.mean(seen * information) == pytest.approx(1, abs=0.06)


def test_the_noise_of_the_camera_is_found(merged):
    result, _, _ = merged
    np.testing.assert_allclose(result.noise, np.tile(NOISE, (len(TIMES), 1)), rtol=0.1)


def test_true_times_are_found_behind_rounded_tags(merged):
    result, _, _ = merged
    assert result.tagged == TAGS
    # To .1 % each, scale included: the tag 1/15 alone is 6.7 % off.
    np.testing.assert_allclose(result.solved, TIMES, rtol=1e-3)


def test_ratios_of_a_scattering_shutter_are_solved():
    scatter = np.array([1.03, 0.98, 1.01, 0.96, 1.02, 1.0])
    times = np.array(TIMES) * scatter
    world, _ = steps_of_light()
    result = merge(shoot(world, np.random.default_rng(2), times=times))
    off = np.array(result.solved) / times
    np.testing.assert_allclose(off / off.mean(), 1, atol=1e-3)
    # The scale is that of the shutter's mean error, which nothing in the bracket knows.
    assert off.mean() == pytest.approx(1 / scatter.mean(), rel=2e-3)


def test_tags_that_are_kept_to_the_letter_are_believed():
    # An electronic shutter: the overlaps contradict 1/64 and 1/16.
    world, _ = steps_of_light()
    result = merge(shoot(world, np.random.default_rng(3), times=TAGS))
    np.testing.assert_allclose(result.solved, TAGS, rtol=1e-3)


def test_ratios_hold_where_part_of_the_scene_moved():
    rng = np.random.default_rng(4)
    world, _ = steps_of_light()
    moved = world.copy()
    moved[:60] = world[:60, ::-1]
    exposures = shoot(world, rng)
    exposures[3] = expose(moved, TIMES[3], TAGS[3], rng)
    np.testing.assert_allclose(merge(exposures).solved, TIMES, rtol=3e-3)


def test_the_order_of_exposures_does_not_matter(merged):
    world, _ = steps_of_light()
    exposures = shoot(world, np.random.default_rng(1))
    order = [3, 0, 5, 1, 4, 2]
    shuffled = merge([exposures[i] for i in order])
    result = merged[0]
    np.testing.assert_allclose(shuffled.solved, np.array(result.solved)[order], rtol=1e-6)
    np.testing.assert_allclose(shuffled.mosaic, result.mosaic, rtol=1e-5, atol=1e-7)
    assert np.array_equal(shuffled.valid, result.valid)


def test_the_samples_are_left_as_they_are():
    exposures = shoot(*_small())
    before = [exposure.samples.copy() for exposure in exposures]
    merge(exposures)
    for exposure, samples in zip(exposures, before, strict=True):
        np.testing.assert_array_equal(exposure.samples, samples)


def _small():
    """A small smooth world (40, 60) of .1 to 7 per second."""
    y, x = np.mgrid[:40, :60]
    return 0.1 * 70 ** (0.5 + 0.25 * np.sin(x / 5) + 0.25 * np.cos(y / 4)), np.random.default_rng(5)


def test_a_constant_world_stays_constant():
    result = merge([frame(np.full((30, 40), 0.4 * t), t) for t in (0.25, 1.0, 4.0)])
    np.testing.assert_allclose(result.mosaic, 0.4, rtol=1e-6)
    assert result.valid.all()


def test_noise_around_black_is_not_cut_off():
    rng = np.random.default_rng(6)
    world, _ = steps_of_light()
    world[:100] = 0
    result = merge(shoot(world, rng))
    black = result.mosaic[:98]
    assert (black < 0).mean() == pytest.approx(0.5, abs=0.02)
    assert abs(black.mean()) < 4 * black.std() / np.sqrt(black.size)


def test_saturated_samples_do_not_count():
    world, rng = _small()
    exposures = shoot(world, rng)
    known = Known(saturation_level=BLACK + LEVELS)
    clean = merge(exposures, known)
    limit = BLACK + 0.99 * LEVELS
    spoilt = [replace(e, samples=np.where(e.samples < limit, e.samples, 65535)) for e in exposures]
    result = merge(spoilt, known)
    np.testing.assert_array_equal(result.mosaic, clean.mosaic)
    assert result.clipped[-1] == pytest.approx(np.mean(exposures[-1].samples >= limit))


def test_what_saturates_in_every_exposure_is_not_known():
    world, rng = _small()
    world[10:20, 30:45] = 1e5
    result = merge(shoot(world, rng))
    expected = np.zeros(world.shape, bool)
    expected[10:20, 30:45] = True
    assert np.array_equal(~result.valid, expected)
    assert np.isnan(result.mosaic[expected]).all()
    assert np.isnan(result.variance[expected]).all()
    assert np.array_equal(result.lost, expected)
    # Clipped samples pile up at 1; usable is what lies below them by a band and a margin, 1.5 %.
    np.testing.assert_allclose(result.at_least, 0.985 / TIMES[0], rtol=2e-3)


def test_levels_at_the_edge_of_saturation_are_not_pulled_down():
    """Where half of a level's samples saturate the other half is darker than it by chance."""
    rng = np.random.default_rng(7)
    levels = 0.99 / TIMES[4] * np.linspace(0.985, 1.01, 12)
    world = np.tile(np.repeat(levels, 40), (200, 1))
    world[:40] = np.geomspace(0.01, 500, 480)  # something to solve ratios from
    result = merge(shoot(world, rng, electrons=5000.0))
    samples = result.mosaic[42:].reshape(-1, 12, 40).swapaxes(0, 1).reshape(12, -1)
    # The noise of a sample at full scale is 1.4 %; its truncation alone would be .5 % and more.
    np.testing.assert_allclose(samples.mean(axis=1) / levels, 1, atol=2.5e-3)


def test_a_single_exposure_is_its_signal_per_light():
    world, rng = _small()
    exposure = expose(world, 2.0**-4, 1 / 15, rng)
    result = merge([exposure])
    assert result.solved == pytest.approx((2.0**-4,))
    signal = (exposure.samples - BLACK) / LEVELS
    np.testing.assert_allclose(result.mosaic, signal * 16, rtol=1e-5, atol=1e-9)
    np.testing.assert_array_equal(result.noise, [(1 / LEVELS, 2 / LEVELS)])


def test_without_overlaps_the_tags_decide():
    rng = np.random.default_rng(8)
    world = np.full((40, 60), 1e-3)
    world[:, 30:] = 800.0  # dark in the one, saturated in the other
    result = merge(shoot(world, rng, times=(2.0**-10, 1.0), tags=(1 / 1000, 1.0)))
    assert result.solved == pytest.approx((2.0**-10, 1.0))


def test_light_is_scaled_by_iso_and_aperture():
    world, rng = _small()
    result = merge(shoot(world, rng, iso=200.0, f_number=4.0))
    np.testing.assert_allclose(result.solved, np.array(TIMES) / 8, rtol=2e-3)


def test_hot_and_dead_pixels_are_marked_and_nothing_else():
    rng = np.random.default_rng(9)
    y, x = np.mgrid[:120, :160]
    world = 0.3 + 0.2 * np.sin(x / 5) * np.cos(y / 7)  # a scene with shape, and an edge
    world[:, 100:] *= 40
    world[40:43, 20:80] = 6.0  # a thin bright line
    dark = np.zeros_like(world)
    hot = rng.permutation(np.flatnonzero((y % 6 == 3) & (x % 6 == 3) & (x < 95) & (y > 48)))[:30]
    dark.flat[hot] = rng.uniform(1.0, 50.0, 30)
    exposures = shoot(world, rng, dark=dark)
    for exposure in exposures:
        exposure.samples[70, 120] = BLACK  # dead
    result = merge(exposures)
    expected = np.zeros(world.shape, bool)
    expected.flat[hot] = True
    expected[70, 120] = True
    assert np.array_equal(result.defective, expected)
    assert np.array_equal(~result.valid, expected)
    assert np.isnan(result.mosaic[expected]).all()
    assert not result.lost.any()


@pytest.mark.parametrize("along", [(0, 1), (1, 0)], ids=["across", "down"])
def test_two_hot_pixels_beside_each_other_are_found(along):
    rng = np.random.default_rng(15)
    world = rolling(rng, (320, 400))
    first = np.zeros(world.shape, bool)
    first[10:-10:32, 10:-10:33] = True
    dark = np.zeros(world.shape)
    for one in (first, np.roll(first, along, axis=(0, 1))):
        dark[one] = world[one] * rng.uniform(1, 5, one.sum())
    found = merge(shoot(world, rng, dark=dark)).defective
    assert found[dark > 0].mean() > 0.95
    assert not found[dark == 0].any()


def test_weak_hot_pixels_are_found_and_texture_is_left_alone():
    import cv2

    rng = np.random.default_rng(16)
    texture = cv2.GaussianBlur(rng.normal(0, 1, (400, 400)), (0, 0), 0.8)  # a sharp lens
    hot = rng.random(texture.shape) < 1e-3
    hot[:2] = hot[-2:] = hot[:, :2] = hot[:, -2:] = False
    smooth = merge(shoot(np.where(hot, 1.2, 1.0), rng))  # by a fifth, some thirty sigmas
    assert smooth.defective[hot].mean() > 0.95
    assert smooth.defective[~hot].mean() < 1e-4
    world = np.exp(0.3 * texture)
    result = merge(shoot(np.where(hot, 1.5 * world, world), rng))
    assert result.defective[~hot].mean() < 1e-4


def test_a_glint_between_two_pixels_is_not_a_pair_of_hot_ones():
    import cv2

    rng = np.random.default_rng(17)
    fine = np.zeros((480, 480))
    fine[42::80, 40::80] = 3000.0  # on the border of two pixels, an eighth of one about it
    fine[80::80, 80::80] = 3000.0
    glints = cv2.GaussianBlur(fine, (0, 0), 0.5 * 8).reshape(60, 8, 60, 8).mean(axis=(1, 3))
    assert glints.max() > 5
    assert not merge(shoot(0.3 + glints, rng)).defective.any()


def test_a_glint_is_not_a_hot_pixel():
    import cv2

    rng = np.random.default_rng(10)
    glint = np.zeros((60, 60))
    for y, x in ((20, 20), (21, 41), (40, 21), (41, 40)):  # on each colour
        glint[y, x] = 300.0
    world = 0.3 + cv2.GaussianBlur(glint, (0, 0), 0.6)  # a sharp lens
    assert not merge(shoot(world, rng)).defective.any()


def test_texture_of_single_pixels_is_not_a_defect():
    rng = np.random.default_rng(13)
    world = rng.normal(1, 0.03, (80, 80))  # ten times the noise
    assert not merge(shoot(world, rng)).defective.any()


def test_a_black_bracket_is_refused():
    rng = np.random.default_rng(11)
    with pytest.raises(InputError, match="expose longer"):
        merge(shoot(np.zeros((60, 80)), rng))


def test_a_black_single_photograph_is_refused():
    rng = np.random.default_rng(11)
    with pytest.raises(InputError, match="expose longer"):
        merge([expose(np.zeros((60, 80)), 1.0, 1.0, rng)])


@pytest.mark.parametrize("size", [(5, 40), (40, 5), (2, 2)])
def test_a_picture_of_hardly_any_samples_is_refused(size):
    with pytest.raises(InputError, match="at least 6 x 6"):
        merge(shoot(np.full(size, 0.4), np.random.default_rng(12)))


def test_a_picture_of_six_by_six_samples_is_merged():
    result = merge([frame(np.full((6, 6), 0.4 * t), t) for t in (0.25, 1.0)])
    np.testing.assert_allclose(result.mosaic, 0.4, rtol=1e-4)


def test_samples_beside_saturated_ones_count_where_the_light_is_surely_below():
    """A slope so steep that all near the limit have a saturated neighbour."""
    rng = np.random.default_rng(14)
    y, x = np.mgrid[:400, :400]
    world = np.geomspace(0.5, 12, 400)[(x + 3 * y) % 400]
    world[:, ::50] *= 2.0  # not smooth all over
    result = merge(shoot(world, rng, times=TIMES[3:], tags=TAGS[3:], electrons=40000.0))
    signal = world[..., None] * np.array(TIMES[3:])
    error = result.mosaic / world - 1
    noise = signal / 40000 + (READ / 40000) ** 2 + 1 / LEVELS**2 / 12
    smooth = (x % 50 > 4) & (x % 50 < 46) & ((x + 3 * y) % 400 > 8) & ((x + 3 * y) % 400 < 392)
    for low, high in ((0.85, 0.9), (0.9, 0.93), (0.93, 0.96), (0.96, 0.985)):
        near = ((signal > low) & (signal < high)).any(axis=-1) & smooth
        assert abs(error[near].mean()) < 1e-3 + 4 * error[near].std() / np.sqrt(near.sum())
        information = np.where(signal < 0.985, np.array(TIMES[3:]) ** 2 / noise, 0).sum(axis=-1)
        over = np.mean((result.mosaic - world)[near] ** 2 * information[near])
        if high <= 0.9:  # the rule that dropped all of them came to four times the bound
            assert over < 1.1


def test_a_bracket_that_saturates_throughout_is_refused():
    rng = np.random.default_rng(12)
    with pytest.raises(InputError, match="add shorter exposures"):
        merge(shoot(np.full((60, 80), 1e5), rng))


@pytest.mark.parametrize(
    ("tag", "true"),
    [
        (1 / 8000, 2.0**-13),
        (1 / 1000, 2.0**-10),
        (1 / 320, 2.0 ** (-25 / 3)),
        (1 / 125, 2.0**-7),
        (1 / 60, 1 / 64),
        (1 / 30, 1 / 32),
        (1 / 15, 1 / 16),
        (1 / 13, 2.0 ** (-11 / 3)),
        (1 / 6, 2.0 ** (-8 / 3)),
        (0.3, 2.0 ** (-5 / 3)),
        (1 / 3, 2.0 ** (-5 / 3)),
        (0.4, 2.0 ** (-4 / 3)),
        (0.5, 0.5),
        (0.6, 2.0 ** (-2 / 3)),
        (1.3, 2.0 ** (1 / 3)),
        (6.0, 2.0 ** (8 / 3)),
        (15.0, 16.0),
        (30.0, 32.0),
        (1 / 45, 2.0**-5.5),  # halves of a stop
        (1 / 350, 2.0**-8.5),
        (0.7, 2.0**-0.5),
        (1.5, 2.0**0.5),
        (1 / 32, 1 / 32),  # not names: kept
        (1 / 33, 1 / 33),
        (1 / 48, 1 / 48),
        (0.0123, 0.0123),
        (60.0, 60.0),
        (0.03333, 1 / 32),  # as written by tools that round
    ],
)
def test_shutter_names_stand_for_powers_of_two(tag, true):
    assert true_shutter(tag) == pytest.approx(true, rel=1e-12)


def test_thirds_of_a_stop_are_evenly_spaced():
    series = [60, 50, 40, 30, 25, 20, 15, 13, 10, 8, 6, 5, 4]
    times = [true_shutter(1 / d) for d in series]
    np.testing.assert_allclose(np.diff(np.log2(times)), 1 / 3, rtol=1e-9)


# What moved, and what single pixels do.


def rolling(rng, size=(160, 200)):
    """A smooth world of some four stops, mean about .5 full scale per second."""
    import cv2

    coarse = rng.normal(0, 1, (size[0] // 40, size[1] // 40))
    return 0.3 * np.exp2(cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC) * 1.5)


def test_what_moved_is_found_and_taken_from_what_agrees():
    rng = np.random.default_rng(20)
    world = rolling(rng)
    thing = np.zeros(world.shape, bool)
    thing[40:80, 50:100] = True
    frames = shoot(world, rng)
    frames[4] = expose(np.where(thing, 0.6 * world, world), TIMES[4], TAGS[4], rng)
    result = merge(frames)
    inner, outer = np.zeros_like(thing), np.ones_like(thing)
    inner[42:78, 52:98], outer[38:82, 48:102] = True, False
    assert result.moved[inner].mean() > 0.98
    assert result.moved[outer].mean() < 1e-4
    error = result.mosaic / world - 1
    # The mean of 1600 pixels of 2 % noise; with the fourth exposure it would be 10 % too dark.
    assert abs(error[inner].mean()) < 3e-3
    assert any("moved" in said for said in warnings(result, list("abcdef")))


def test_nothing_moves_in_noise_alone(merged):
    assert not merged[0].moved.any()


def test_a_lamp_that_flickers_does_not_pull_the_rest_with_it():
    rng = np.random.default_rng(21)
    world = rolling(rng)
    lit = np.zeros(world.shape, bool)
    lit[:, :70] = True
    frames = shoot(world, rng)
    frames[5] = expose(np.where(lit, 1.15 * world, world), TIMES[5], TAGS[5], rng)
    result = merge(frames)
    np.testing.assert_allclose(result.solved, TIMES, rtol=3e-3)
    assert abs((result.mosaic / world - 1)[:, 75:].mean()) < 2e-3


def test_a_particle_in_one_exposure_costs_only_that_sample():
    rng = np.random.default_rng(22)
    world = rolling(rng)
    frames = shoot(world, rng)
    frames[4].samples[60, 70] += 6000
    result = merge(frames)
    assert result.valid[60, 70]
    assert not result.moved[60, 70]
    off = result.mosaic[60, 70] - world[60, 70]
    assert abs(off) < 5 * np.sqrt(result.variance[60, 70])


def test_a_stuck_pixel_is_defective():
    rng = np.random.default_rng(23)
    world = rolling(rng)
    frames = shoot(world, rng)
    for one in frames:
        one.samples[60, 70] = BLACK + 3000
    result = merge(frames)
    assert result.defective[60, 70]
    assert result.defective.sum() == 1


# What the files are like.


@pytest.mark.parametrize("cfa", BAYER.values(), ids=BAYER.keys())
@pytest.mark.parametrize("size", [(41, 61), (70, 131)])
def test_any_bayer_order_and_odd_sizes_with_levels_a_colour(cfa, size):
    rng = np.random.default_rng(24)
    world = np.full(size, 0.5)
    world[:, 30:] = 8.0
    black = np.array([[100.0, 110.0], [120.0, 130.0]])
    full = np.array([[4000.0, 3900.0], [3800.0, 3700.0]])
    tiles = [np.tile(v, (40, 70))[: size[0], : size[1]] for v in (black, full)]
    frames = []
    for time_s, tag in zip(TIMES[2:], TAGS[2:], strict=True):
        signal = rng.poisson(np.minimum(world * time_s, 5) * 1e5) / 1e5
        raw = np.round(np.minimum(tiles[0] + signal * tiles[1], tiles[0] + tiles[1]))
        frames.append(Frame(raw.astype(np.uint16), cfa, black, black + full, tag, 100.0, 1.0))
    result = merge(frames)
    assert result.valid.all()
    np.testing.assert_array_equal(result.cfa, cfa)
    for y, x in np.ndindex(2, 2):
        error = (result.mosaic / world - 1)[y::2, x::2]
        assert abs(error.mean()) < 3e-3
        assert error.std() < 0.05


def test_the_noise_of_each_iso_is_found():
    rng = np.random.default_rng(25)
    world, _ = steps_of_light()
    frames = [
        expose(world * (iso / 100), t, tag, rng, electrons=ELECTRONS * 100 / iso, iso=iso)
        for iso in (100.0, 400.0)
        for t, tag in zip(TIMES[:4], TAGS[:4], strict=True)
    ]
    result = merge(frames)
    np.testing.assert_allclose(result.solved[4:], 4 * np.array(result.solved[:4]), rtol=2e-3)
    np.testing.assert_allclose(result.noise[:4, 0], NOISE[0], rtol=0.15)
    np.testing.assert_allclose(result.noise[4:, 0], 4 * NOISE[0], rtol=0.15)


def test_noise_and_saturation_that_are_known_are_believed():
    world, rng = _small()
    frames = shoot(world, rng)
    known = Known({100.0: (1e-4, 1e-3, 0.01)}, saturation_level=BLACK + 0.5 * LEVELS)
    result = merge(frames, known)
    np.testing.assert_array_equal(result.noise, np.tile([1e-4, 1e-3], (len(TIMES), 1)))
    assert result.prnu == 0.01
    clipped = np.mean(frames[-1].samples >= BLACK + 0.49 * LEVELS)
    assert result.clipped[-1] == pytest.approx(clipped)


def test_each_iso_saturates_where_its_own_photographs_say():
    rng = np.random.default_rng(28)
    world, _ = steps_of_light()
    frames, full = [], {100.0: 1.0, 400.0: 0.8}
    for iso, at in full.items():
        for time_s, tag in zip(TIMES[2:5], TAGS[2:5], strict=True):
            one = expose(world * iso / 100, time_s, tag, rng, iso=iso)
            frames.append(replace(one, samples=np.minimum(one.samples, int(BLACK + at * LEVELS))))
    for one, clipped in zip(frames, merge(frames).clipped, strict=True):
        seen = np.mean(one.samples >= BLACK + (full[one.iso] - 0.015) * LEVELS)
        assert clipped == pytest.approx(seen, rel=1e-3)


def test_photographs_that_are_white_throughout_are_not_the_same_one():
    assert merge([frame(np.full((30, 40), 0.4 * t), t) for t in (0.5, 1.0, 4.0, 16.0)]).alike == (
        0,
        1,
        2,
        3,
    )


def test_a_file_given_twice_counts_once():
    world, _ = steps_of_light()
    frames = shoot(world, np.random.default_rng(1))
    once, twice = merge(frames), merge([*frames, frames[2]])
    np.testing.assert_allclose(twice.variance, once.variance, rtol=1e-3)
    assert twice.solved[6] == twice.solved[2]
    assert warnings(twice, list("abcdefg")) == ["g is the same photograph as c and counts once"]


def test_unequal_response_is_measured_and_told():
    rng = np.random.default_rng(26)
    world = np.full((256, 256), 0.6)
    unequal = 0.006 * rng.normal(size=world.shape)
    result = merge(shoot(world, rng, prnu=unequal))
    assert result.prnu == pytest.approx(0.006, rel=0.1)
    seen = np.var(result.mosaic / world - 1)
    assert np.mean(result.variance / world**2) == pytest.approx(seen, rel=0.15)


@pytest.mark.parametrize(("threads", "band"), [(1, 16), (3, 30), (4, 1000)])
def test_neither_threads_nor_bands_change_anything(threads, band, monkeypatch):
    rng = np.random.default_rng(27)
    world = rolling(rng)
    world[50:60, 60:80] = 1e5
    frames = shoot(world, rng)
    frames[4].samples[20:40, 30:60] //= 2  # something moved
    frames[3].samples[::31, ::17] += 5000  # particles
    for one in frames:
        one.samples[63:140:8, 100:180:9] = BLACK + 9000  # stuck
    once = merge(frames)
    monkeypatch.setattr(merging, "workers", lambda: threads)
    monkeypatch.setattr(merging, "BAND", band)
    again = merge(frames)
    assert once.moved.any()
    assert once.defective.any()
    for name in ("mosaic", "variance", "valid", "lost", "defective", "moved"):
        np.testing.assert_array_equal(getattr(again, name), getattr(once, name), name)
    assert again.clipped == once.clipped
