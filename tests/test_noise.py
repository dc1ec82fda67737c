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
