from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stages.demosaic import demosaic
from stages.develop import develop
from stages.merge import InMemory, merge
from stages.types import Frame

RGGB = np.array([[0, 1], [1, 2]])
BLACK, TAG = 512.0, 15000.0
FULL = TAG - BLACK
ELECTRONS = 30000.0  # at full scale


def frame(samples, cfa=RGGB, black=BLACK, tag=TAG):
    return Frame(
        samples=np.asarray(samples, np.uint16),
        cfa=cfa,
        black_level=np.broadcast_to(np.asarray(black, float), (2, 2)),
        saturation_level=np.full((2, 2), tag),
        time_s=1 / 30,
        iso=200.0,
        f_number=4.0,
    )


def sensor(signal, rng, clip=2.0, clip_spread=0.0, read=3.0):
    """Raw samples of a signal in full scale; `clip` where the sensor fills up, by tag's scale."""
    raw = BLACK + rng.poisson(signal * ELECTRONS) / ELECTRONS * FULL
    raw = np.minimum(raw, BLACK + clip * FULL + rng.normal(0, clip_spread, raw.shape))
    return np.round(np.minimum(raw + rng.normal(0, read, raw.shape), 16383)).astype(np.uint16)


def scene(brightest=3.0, seed=1):
    """A picture (200, 300) with all signals up to `brightest`, most of them dark."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:200, :300]
    lamp = brightest * np.exp(-((x - 150) ** 2 + (y - 100) ** 2) / 1500.0)
    return 0.05 + lamp, rng


def test_black_is_zero_and_the_tagged_saturation_one_for_each_position():
    black = np.array([[500.0, 510.0], [520.0, 530.0]])
    samples = np.tile(black, (10, 10))
    exposure = develop(frame(samples, black=black))
    assert np.all(exposure.mosaic == 0)
    samples[::2, 1::2] = (510 + TAG) / 2
    exposure = develop(frame(samples, black=black))
    np.testing.assert_allclose(exposure.mosaic[::2, 1::2], 0.5, rtol=1e-6)
    assert exposure.mosaic.dtype == np.float32
    assert exposure.levels == pytest.approx(TAG - 515)


def test_light_is_time_by_iso_by_aperture():
    exposure = develop(frame(np.full((20, 20), 600)))
    assert exposure.light == pytest.approx(1 / 30 * 2 / 16)  # ISO 200 is 2, f/4 is 1/16
    assert exposure.time_s == 1 / 30


def test_noise_around_black_stays_signed():
    rng = np.random.default_rng(1)
    exposure = develop(frame(np.round(BLACK + rng.normal(0, 10, (400, 400)))))
    assert (exposure.mosaic < 0).mean() == pytest.approx(0.5, abs=0.03)
    # Four standard errors of 160 000 samples: 0.1 step.
    assert abs(exposure.mosaic.mean() * FULL) < 0.1


def test_nothing_saturates_in_a_picture_without_clipping():
    signal, rng = scene(brightest=0.8)
    assert develop(frame(sensor(signal, rng))).usable.all()


def test_a_bright_plain_wall_is_not_a_pile_up():
    rng = np.random.default_rng(2)
    assert develop(frame(sensor(np.full((200, 300), 0.9), rng))).usable.all()


@pytest.mark.parametrize("clip", [0.78, 0.9, 0.985, 1.0, 1.08])
@pytest.mark.parametrize("clip_spread", [0.0, 12.0])
def test_clipped_samples_are_not_usable_wherever_the_sensor_clips(clip, clip_spread):
    signal, rng = scene()
    exposure = develop(frame(sensor(signal, rng, clip, clip_spread)))
    limit = min(clip, 1.0)
    assert not exposure.usable[signal > 1.03 * limit].any()
    assert exposure.usable[signal < 0.94 * limit].all()


def test_colours_that_clip_at_different_levels_are_told_apart():
    signal, rng = scene()
    raw = sensor(signal, rng, clip=0.97)
    raw[1::2, 1::2] = sensor(signal, rng, clip=0.85)[1::2, 1::2]  # blue
    usable = develop(frame(raw)).usable
    blue = np.tile(RGGB, (100, 150)) == 2
    assert not usable[(signal > 0.88) & blue].any()
    assert usable[(signal < 0.92) & ~blue].all()


def test_a_few_hot_samples_above_do_not_hide_a_pile_up():
    signal, rng = scene()
    raw = np.tile(sensor(signal, rng, clip=0.9), (4, 4))
    raw[7, 7] = raw[300, 500] = 16383
    assert not develop(frame(raw)).usable[np.tile(signal, (4, 4)) > 0.95].any()


REAL = Path(__file__).parents[2] / "shared/data/raw/colorchart.dng"


@pytest.fixture(scope="module")
def real():
    """A still of a Canon EOS 550D's video mode, of a chart before a window: unclipped."""
    if not REAL.exists():
        pytest.skip(f"no real raw file at {REAL}")
    from pipeline.io import read_frame

    return read_frame(REAL, time_s=1.0, iso=100.0, f_number=1.0)


def test_a_real_file_develops_to_neutral_greys(real):
    exposure = develop(real)
    assert exposure.usable.all()  # nothing clips in it: no heap at its top, 12128 of 15000
    assert exposure.mosaic.min() > -0.01
    image = demosaic(merge(InMemory([real]))).values
    # Black interstices reflect some 2 % of white; with a wrong black level they would not.
    assert np.all(np.abs(np.percentile(image, 1, axis=(0, 1))) < 0.01)
    # Four grey patches, from 59 % to 9 %; the window's flare tints darker ones.
    grey = np.array([image[909:949, x - 20 : x + 20].mean(axis=(0, 1)) for x in (811, 924, 1033)])
    balanced = grey / grey[0]
    np.testing.assert_allclose(balanced / balanced[:, 1:2], 1, atol=0.08)
    # Their published luminances, 0.591 0.362 0.198, in ratio, with flare and uneven light.
    np.testing.assert_allclose(balanced[:, 1], np.array([0.591, 0.362, 0.198]) / 0.591, atol=0.06)


def test_clipped_areas_of_a_real_file_are_unknown_not_magenta(real):
    rng = np.random.default_rng(3)
    level = 7000  # as if the sensor filled up there; the tag says 15 % more
    ceiling = np.round(rng.normal(level, 4, real.samples.shape)).astype(np.uint16)
    tag = 2056 + 1.15 * (level - 2056)
    clipped = replace(
        real, samples=np.minimum(real.samples, ceiling), saturation_level=np.full((2, 2), tag)
    )
    image = demosaic(merge(InMemory([clipped])))
    known = image.valid == 1
    truth = demosaic(merge(InMemory([real]))).values  # of what did not clip
    scale = (15000 - 2056) / (tag - 2056)
    assert (~known).sum() > 500  # the lamp behind the window
    # Green of all that is known and bright is that of the unclipped picture.
    bright = known & (image.values[..., 1] > 0.3)
    green, red = scale * truth[bright][:, 1], scale * truth[bright][:, 0]
    tint = (image.values[bright][:, 1] - green) / (red + green)
    assert np.abs(tint).max() < 0.2
    assert np.percentile(np.abs(tint), 99) < 0.02
    assert not known[truth[..., 1] * scale > 1].any()
