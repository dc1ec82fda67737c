from dataclasses import replace

import numpy as np
import pytest

from stages import noise

LEVELS = 14000.0


def exposures(signal, gain, read, ratio, rng, step=0.0):
    """The same samples in a shorter and a longer exposure, of a sensor with that noise."""

    def shoot(clean):
        noisy = clean + rng.normal(size=clean.shape) * np.sqrt(gain * clean + read**2)
        noisy = np.round(noisy / step) * step if step else noisy
        return noisy.astype(np.float32)

    shorter, longer = shoot(ratio * signal), shoot(signal)
    usable = longer < 0.9
    return noise.Pair(shorter[usable], longer[usable], ratio)


@pytest.mark.parametrize("ratio", [0.25, 0.5, 1.0])
@pytest.mark.parametrize(("gain", "read"), [(3e-5, 2e-4), (2e-4, 3e-3)])
def test_gain_and_read_noise_are_found(gain, read, ratio):
    rng = np.random.default_rng(1)
    signal = 10 ** rng.uniform(-4, 0, 100_000)
    found = noise.measure([exposures(signal, gain, read, ratio, rng)], LEVELS)
    # 24 bins of 2000: each variance to 3 %.
    assert found.gain[0] == pytest.approx(gain, rel=0.05)
    assert found.read[0] == pytest.approx(read, rel=0.10)


def test_several_pairs_are_better_than_one():
    rng = np.random.default_rng(2)
    pairs = [
        exposures(10 ** rng.uniform(-4, 0, 50_000) * t, 5e-5, 4e-4, 0.25, rng)
        for t in (0.01, 0.1, 1, 10)
    ]
    found = noise.measure(pairs, LEVELS)
    assert found.gain[0] == pytest.approx(5e-5, rel=0.03)
    assert found.read[0] == pytest.approx(4e-4, rel=0.05)


def test_things_that_move_do_not_count_as_noise():
    rng = np.random.default_rng(3)
    pair = exposures(rng.uniform(0, 1, 100_000), 5e-5, 4e-4, 0.25, rng)
    moved = rng.uniform(size=pair.shorter.shape) < 0.03
    shorter = np.where(moved, rng.permutation(pair.shorter), pair.shorter)
    found = noise.measure([replace(pair, shorter=shorter)], LEVELS)
    assert found.gain[0] == pytest.approx(5e-5, rel=0.1)


def test_raw_steps_wider_than_the_noise_count_as_noise():
    # Rounding to steps of q adds q^2 / 12 where there is some noise to spread it; to 15 % at
    # a read noise of half a step.
    rng = np.random.default_rng(4)
    step, read = 1e-3, 5e-4
    signal = 10 ** rng.uniform(-4, 0, 200_000)
    found = noise.measure([exposures(signal, 3e-5, read, 0.5, rng, step)], 1 / step)
    assert found.read[0] == pytest.approx(np.sqrt(read**2 + step**2 / 12), rel=0.15)
    assert found.gain[0] == pytest.approx(3e-5, rel=0.15)


def test_read_noise_is_never_less_than_rounding():
    signal = np.linspace(0, 0.8, 10_000).astype(np.float32)
    rng = np.random.default_rng(5)
    pair = exposures(signal, 1e-5, 0.0, 1.0, rng)
    assert noise.measure([pair], 100.0).read[0] >= 0.01 / np.sqrt(12)


@pytest.mark.parametrize("pairs", [[], [noise.Pair(np.ones(5, "f4"), np.ones(5, "f4"), 1.0)]])
def test_without_overlaps_the_noise_is_that_of_a_typical_camera(pairs):
    model = noise.measure(pairs, LEVELS)
    gain, read = model.gain[0], model.read[0]
    assert (gain, read) == noise.typical(LEVELS)
    assert gain == 1 / LEVELS  # an electron a step
    assert read == 2 / LEVELS


def blocks(world, prnu, rng, electrons=150_000, read=6.0):
    """A merged mosaic (H, W) cut into blocks, and its noise: a sensor of that unequal response."""
    electrons_seen = rng.poisson(world * (1 + prnu * rng.normal(size=world.shape)) * electrons)
    mosaic = (electrons_seen + rng.normal(0, read, world.shape)) / electrons
    variance = world / electrons + (read / electrons) ** 2

    def cut(image):
        rows, columns = (n // 16 for n in image.shape)
        return image.reshape(rows, 16, columns, 16).swapaxes(1, 2).reshape(-1, 16, 16)

    return cut(mosaic), cut(variance)


def shaded(size=(512, 576)):
    """Two stops from side to side; red and blue darker than green, as they mostly are."""
    y, x = np.indices(size)
    world = 0.2 * np.exp2(2 * x / size[1] + y / size[0])
    world[::2, ::2] *= 0.5
    world[1::2, 1::2] *= 0.7
    return world


def texture(rng, size=(512, 576)):
    """Grain of all sizes through a lens of .6 px, of standard deviation 1."""
    frequency = np.hypot(np.fft.fftfreq(size[0])[:, None], np.fft.rfftfreq(size[1]))
    frequency[0, 0] = 1
    phases = rng.normal(size=frequency.shape) + 1j * rng.normal(size=frequency.shape)
    lens = np.exp(-2 * (np.pi * 0.6 * frequency) ** 2)
    grain = np.fft.irfft2(phases * lens / frequency, size)
    return grain / grain.std()


def textured(rng, share):
    """A share of the width, all contrasts from 1 to 30 %, beside plain walls."""
    world = shaded()
    contrast = np.geomspace(0.01, 0.3, world.shape[0])[:, None]
    grain = np.exp(contrast * texture(rng))
    columns = int(share * world.shape[1]) // 16 * 16
    world[:, :columns] *= grain[:, :columns]
    return world


@pytest.mark.parametrize("share", [0.0, 0.5, 0.9])
@pytest.mark.parametrize("prnu", [0.002, 0.004, 0.008, 0.015])
def test_the_response_is_told_from_noise_and_from_texture(prnu, share):
    rng = np.random.default_rng(11)
    found = noise.response(*blocks(textured(rng, share), prnu, rng))
    # Noise is about .4 % of the signal. A tenth of 1152 blocks of 211 free values know that of
    # their variance to .9 %: so .2 % to 2 %, twice that for 2 sigmas, and texture's rest.
    assert found == pytest.approx(prnu, rel=0.06)


def test_equal_pixels_are_told_to_be_so():
    rng = np.random.default_rng(12)
    assert noise.response(*blocks(textured(rng, 0.5), 0.0, rng)) < 0.0007


def test_texture_everywhere_is_not_taken_for_response():
    rng = np.random.default_rng(13)
    world = shaded() * np.exp(0.2 * texture(rng))
    assert noise.response(*blocks(world, 0.004, rng)) is None


def test_too_much_noise_tells_nothing_of_the_response():
    rng = np.random.default_rng(14)
    assert noise.response(*blocks(shaded(), 0.004, rng, electrons=1000)) is None


def test_hot_dead_and_lost_pixels_have_no_part_in_the_response():
    rng = np.random.default_rng(15)
    values, variance = blocks(shaded(), 0.004, rng)
    values[rng.random(values.shape) < 2e-4] *= 5
    values[rng.random(values.shape) < 2e-4] = 0
    values[:50, :4] = np.nan
    assert noise.response(values, variance) == pytest.approx(0.004, rel=0.04)


def test_the_uncertainty_of_the_model_is_that_of_its_errors():
    gain, read = 5e-5, 4e-4
    off = []
    for seed in range(20):
        rng = np.random.default_rng(100 + seed)
        signal = 10 ** rng.uniform(-4, 0, 40_000)
        found = noise.measure([exposures(signal, gain, read, 0.25, rng)], LEVELS)
        sigmas = noise.uncertainty(found)
        off.append([(found.gain[0] - gain) / sigmas[0], (found.read[0] - read) / sigmas[1]])
    # 20 draws know their spread to 16 %, 22 bins each sigma to 15 %.
    assert np.all(np.abs(np.log(np.sqrt(np.mean(np.square(off), axis=0)))) < np.log(1.6))


def test_what_was_not_measured_has_no_uncertainty():
    assert np.isnan(noise.uncertainty(noise.measure([], LEVELS))).all()
