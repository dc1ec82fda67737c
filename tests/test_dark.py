import numpy as np
import pytest

from stages.dark import Dark, dark_current, subtract
from stages.merge import InMemory, Known, merge
from tests.test_merge import BLACK, ELECTRONS, LEVELS, READ, TAGS, TIMES, expose, frame

SIZE = (120, 160)


def currents(rng):
    """Current (H, W), full scale per second: a glow from one corner, and hot pixels; which are."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    glow = 0.02 * np.exp(-(y + x) / 80)
    hot = rng.random(SIZE) < 0.01
    return np.where(hot, 10 ** rng.uniform(-1.5, -0.5, SIZE), glow), hot


def taken(current, rng, times=(1.0, 1.0, 2.0, 2.0), **file):
    """Dark frames; of no light but their own."""
    nothing = np.zeros(SIZE)
    return InMemory([expose(nothing, t, t, rng, dark=current, **file) for t in times])


def test_hot_pixels_and_glow_are_measured_to_their_noise():
    rng = np.random.default_rng(1)
    current, hot = currents(rng)
    found = dark_current(taken(current, rng), 1 / ELECTRONS)
    off = found.current - current
    # sum(g^2) = 10: read noise over its root.
    sigma = READ / ELECTRONS / np.sqrt(10)
    # sum(g^3) = 18: photons of current make g * current / ELECTRONS of variance a frame.
    photons = np.sqrt(current[hot] / ELECTRONS * 18) / 10
    assert np.std(off[hot] / np.hypot(sigma, photons)) == pytest.approx(1, abs=0.15)
    assert np.std(off[hot] / np.sqrt(found.variance[hot])) == pytest.approx(1, abs=0.15)
    # The others' is a mean of many: better than a pixel knows it, but for its rounded corner.
    assert np.abs(off[~hot]).mean() < 0.5 * sigma + 0.02 * 0.02
    assert np.mean(found.variance[~hot] < sigma**2) > 0.98


def test_a_bracket_comes_back_without_its_dark_current():
    rng = np.random.default_rng(2)
    current, _ = currents(rng)
    world = np.full(SIZE, 0.2)
    given = [
        expose(world, t, tag, rng, dark=current) for t, tag in zip(TIMES[2:], TAGS[2:], strict=True)
    ]
    known = Known({100.0: (1 / ELECTRONS, READ / ELECTRONS, 0.0)})  # every pixel responds alike
    merged = merge(InMemory(given), known)
    cleared = subtract(merged, dark_current(taken(current, rng), 1 / ELECTRONS), f_number=1.0)
    before, after = merged.mosaic / world - 1, cleared.mosaic / world - 1
    assert np.nanmean(before) > 0.02  # or there were nothing to take off
    assert abs(np.nanmean(after)) < 1e-3
    # Left is the noise of the bracket, hot pixels' included.
    assert np.nanmean((cleared.mosaic - world) ** 2 / cleared.variance) == pytest.approx(1, abs=0.1)
    assert np.array_equal(cleared.valid, merged.valid)


def test_the_error_of_the_dark_current_is_one_of_the_result():
    rng = np.random.default_rng(7)
    world = np.full(SIZE, 0.2)
    given = [expose(world, t, t, rng, f_number=2.0) for t in (0.25, 1.0)]
    dark = Dark(rng.normal(0, 0.01, SIZE), np.full(SIZE, 0.01**2))
    known = Known({100.0: (1 / ELECTRONS, READ / ELECTRONS, 0.0)})
    cleared = subtract(merge(InMemory(given), known), dark, f_number=2.0)
    off2 = (cleared.mosaic - 4 * world) ** 2
    assert np.mean(off2 / cleared.variance) == pytest.approx(1, abs=0.05)


def test_time_sensitivity_and_aperture_scale_the_current():
    rng = np.random.default_rng(3)
    current, _ = currents(rng)
    world = np.full(SIZE, 0.2)
    # ISO 400 has four times the signal of either; f/4 lets in a sixteenth of the light.
    given = [
        expose(4 * world, t, tag, rng, dark=4 * current, iso=400.0, f_number=4.0)
        for t, tag in zip(TIMES[2:5], TAGS[2:5], strict=True)
    ]
    found = dark_current(taken(current, rng, iso=100.0, f_number=22.0), 1 / ELECTRONS)
    cleared = subtract(merge(InMemory(given)), found, f_number=4.0)
    assert np.nanmean(cleared.mosaic) / (16 * 0.2) == pytest.approx(1, abs=2e-3)


def test_noise_alone_is_not_subtracted():
    rng = np.random.default_rng(4)
    found = dark_current(taken(np.zeros(SIZE), rng, times=(0.1,)), 1 / ELECTRONS)
    sigma = READ / ELECTRONS / 0.1
    # A mean of 49 has a seventh of it; of fewer different ones, along the edges, more.
    assert np.std(found.current) < 0.2 * sigma
    assert abs(found.current.mean()) < 0.05 * sigma


def test_a_pixel_that_dark_alone_fills_is_defective():
    rng = np.random.default_rng(5)
    dark = np.zeros(SIZE)
    dark[50, 60] = 3.0
    found = dark_current(taken(dark, rng), 1 / ELECTRONS)
    assert np.isnan(found.current[50, 60])
    flat = merge(InMemory([frame(np.full(SIZE, 0.4 * t), t) for t in (0.25, 1.0)]))
    cleared = subtract(flat, found, f_number=1.0)
    assert np.argwhere(cleared.defective).tolist() == [[50, 60]]
    assert np.isnan(cleared.mosaic[50, 60])
    assert not cleared.valid[50, 60]


def test_levels_of_each_position_and_odd_sizes():
    rng = np.random.default_rng(6)
    raw = np.full((71, 133), BLACK + 0.25 * LEVELS)
    one = frame(np.zeros(raw.shape), 1.0)
    one.samples[...] = rng.integers(-1, 2, raw.shape) + raw
    one.black_level[0, 1] += 0.05 * LEVELS
    found = dark_current(InMemory([one]), 1 / ELECTRONS).current
    assert found[0::2, 0::2].mean() == pytest.approx(0.25, abs=1e-4)
    assert found[0::2, 1::2].mean() == pytest.approx(0.20 / 0.95, abs=1e-4)
