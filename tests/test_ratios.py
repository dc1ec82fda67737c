import numpy as np
import pytest

from stages.ratios import DARKEST, log_ratio

RATIO = 0.25


def two(signal, gain, read, rng, off=1.0):
    """The same samples in a shorter and a longer exposure, of a sensor with that noise."""
    shorter, longer = RATIO * signal * off, signal
    return (
        (clean + rng.normal(size=clean.shape) * np.sqrt(gain * clean + read**2)).astype(np.float32)
        for clean in (shorter, longer)
    )


def test_samples_that_are_chosen_in_the_dark_do_not_pull_the_ratio():
    """Half of them are left out, by noise of a third of the shorter one's signal."""
    rng, noise = np.random.default_rng(1), (1e-5, 0.003)
    signal = DARKEST / RATIO * np.exp(rng.uniform(-0.3, 0.3, 100_000))
    block = np.arange(len(signal)) // 256
    ratio, error, still = log_ratio(*two(signal, *noise, rng), block, RATIO, noise, noise)
    assert error < 0.003
    assert ratio == pytest.approx(np.log(RATIO), abs=3 * error)
    assert still.mean() > 0.99


def test_blocks_that_differ_by_no_more_than_good_sensors_do_are_still():
    rng, noise = np.random.default_rng(2), (1e-6, 1e-6)  # a thousandth shows in the sum of a block
    signal = np.exp(rng.uniform(-2, -0.5, 100 * 256))
    block = np.arange(len(signal)) // 256
    for share, expected in ((0.001, True), (0.01, False)):
        off = 1 + share * (block % 5 == 0)
        _, _, still = log_ratio(*two(signal, *noise, rng, off), block, RATIO, noise, noise)
        assert still[1::5].all()
        assert (still[::5] == expected).all()


def test_a_ratio_of_too_few_samples_is_not_known():
    noise = (1e-5, 1e-4)
    signal = np.full(40, 0.4, np.float32)
    both = RATIO * signal, signal
    assert log_ratio(*both, np.zeros(40, int), RATIO, noise, noise) is None
