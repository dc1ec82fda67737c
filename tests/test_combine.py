import numpy as np
import pytest

from stages.combine import HALO, OWN_SIGNAL, SURELY, Readings, Rows, combine

LIGHT = (1600.0, 400.0, 300.0, 25.0)  # longest first
GAIN, READ2 = (0.5, 0.5, 0.6, 0.5), (4.0, 4.0, 5.0, 4.0)
FULL = np.array([[3900, 4000], [4010, 3950]])
BLACK = np.array([[100.0, 110.0], [120.0, 130.0]])
SCALE = np.array([[1.0, 1.1], [0.9, 1.0]])
SIZE = (37, 53)


def over(pattern, size=SIZE):
    """A value per CFA position as an image."""
    return np.tile(pattern, (size[0], size[1]))[: size[0], : size[1]]


def bracket(seed=1):
    """Raw samples (K, H, W), the longest exposure last, of a world with a lamp and a dark side."""
    rng = np.random.default_rng(seed)
    y, x = np.indices(SIZE)
    world = np.where(x < 20, 0.02, 2.0) * (1 + 0.5 * np.sin(y / 5))
    world[20:26, 30:40] = 1e3
    world[5, 7] = 30.0
    samples = [
        rng.poisson(np.minimum(world * t / g, 1e6)) * g + rng.normal(0, np.sqrt(r), SIZE)
        for t, g, r in zip(LIGHT, GAIN, READ2, strict=True)
    ]
    return np.array(
        [np.clip(s / over(SCALE) + over(BLACK), 0, 4095) for s in samples[::-1]]
    ).astype(np.uint16)


def readings(width=SIZE[1]):
    def rows(values, kind):
        return np.ascontiguousarray(np.tile(values, width)[..., :width].astype(kind))

    return Readings(
        np.array([3, 2, 1, 0]),
        *(np.array(v, np.float32) for v in (LIGHT, GAIN, READ2)),
        rows(np.array([FULL] * 4), np.uint16),
        rows(BLACK, np.float32),
        rows(SCALE, np.float32),
    )


def run(raw, above, rows):
    into = Rows(
        *(np.empty((rows, raw.shape[2]), np.float32) for _ in range(2)),
        *(np.empty((rows + 2, raw.shape[2]), np.float32) for _ in range(2)),
    )
    return into, combine(raw, above, readings(), into)


def plainly(raw):
    """The same, a pixel at a time: mosaic, variance, excess, freedom, clipped."""
    height, width = SIZE
    saturated = raw[::-1] >= over(FULL)  # now longest first
    signal = (raw[::-1] - over(BLACK)) * over(SCALE)

    def about(y, x):  # the pixels of the CFA position about one, in the frame
        for i in (y - 2, y, y + 2):
            for j in (x - 2, x, x + 2):
                if 0 <= i < height and 0 <= j < width:
                    yield i, j

    usable = np.zeros(signal.shape, bool)
    roughly, lit = np.zeros(SIZE), np.zeros(SIZE)
    for y, x in np.ndindex(SIZE):
        for k in range(len(LIGHT)):
            usable[k, y, x] = not saturated[k, y, x]
            if k == len(LIGHT) - 1 or not any(saturated[k, i, j] for i, j in about(y, x)):
                continue
            # Beside a saturated one: what does the next shorter exposure say of the light?
            full = (over(FULL) - over(BLACK))[y, x] * over(SCALE)[y, x]
            eight = [p for p in about(y, x) if p != (y, x)]
            ratio = LIGHT[k] / LIGHT[k + 1]
            noise2 = GAIN[k] * full + READ2[k]
            noise2 += ratio * (GAIN[k + 1] * full + ratio * READ2[k + 1]) / 8
            told = ratio * np.mean([signal[k + 1, i, j] for i, j in eight])
            clear = told < full - SURELY * np.sqrt(noise2)
            usable[k, y, x] &= clear and not any(saturated[k + 1, i, j] for i, j in eight)
        if usable[:, y, x].any():
            k = int(np.argmax(usable[:, y, x]))
            roughly[y, x], lit[y, x] = signal[k, y, x] / LIGHT[k], LIGHT[k]
    results = np.full((4, *SIZE), np.nan)
    for y, x in np.ndindex(SIZE):
        eight = []
        for i in (y - 2, y, y + 2):
            for j in (x - 2, x, x + 2):  # beyond an edge the opposite one stands in
                i_in = i if 0 <= i < height else 2 * y - i
                j_in = j if 0 <= j < width else 2 * x - j
                eight.append(roughly[i_in, j_in])
        around = max((sum(eight) - roughly[y, x]) / 8, 0)
        steps = around * lit[y, x]
        noise2 = float(OWN_SIGNAL) ** 2 * (GAIN[0] * steps + 2 * READ2[0])
        level = max(around + (roughly[y, x] - around) * steps**2 / (steps**2 + noise2), 0)
        known = np.flatnonzero(usable[:, y, x])
        if len(known) == 0:
            results[2:, y, x] = 0
            continue
        t, g, r = (np.array(v)[known] for v in (LIGHT, GAIN, READ2))
        s, v = signal[known, y, x], g * t * level + r
        variance = 1 / np.sum(t**2 / v)
        mean = np.sum(t * s / v) * variance
        results[:, y, x] = mean, variance, np.sum((s - t * mean) ** 2 / v) - len(s) + 1, len(s) - 1
    return *results, saturated.sum(axis=(1, 2))


def test_the_compiled_pass_does_what_plain_arithmetic_does():
    raw = bracket()
    mosaic, variance, excess, freedom, clipped = plainly(raw)
    assert 0.02 < np.isnan(mosaic).mean() < 0.05  # the lamp
    into, counted = run(raw, 0, SIZE[0])
    # Single precision: seven digits, of which a chi-square of large signals loses three.
    np.testing.assert_allclose(into.mosaic, mosaic, rtol=2e-5, atol=1e-6)
    np.testing.assert_allclose(into.variance, variance, rtol=2e-5)
    np.testing.assert_array_equal(into.freedom[1:-1], freedom)
    np.testing.assert_allclose(into.excess[1:-1], excess, rtol=1e-3, atol=0.02)
    np.testing.assert_array_equal(counted, clipped)
    assert not into.excess[[0, -1]].any()
    assert not into.freedom[[0, -1]].any()


@pytest.mark.parametrize("rows", [2, 8, 16])
def test_rows_come_out_the_same_however_many_are_taken_at_once(rows):
    raw = bracket()
    whole, clipped = run(raw, 0, SIZE[0])
    counted = 0
    for top in range(0, SIZE[0], rows):
        bottom, above = min(top + rows, SIZE[0]), min(top, HALO)
        part = np.ascontiguousarray(raw[:, top - above : bottom + HALO])
        into, some = run(part, above, bottom - top)
        counted = counted + some
        np.testing.assert_array_equal(into.mosaic, whole.mosaic[top:bottom])
        np.testing.assert_array_equal(into.variance, whole.variance[top:bottom])
        np.testing.assert_array_equal(into.excess, whole.excess[top : bottom + 2])
        np.testing.assert_array_equal(into.freedom, whole.freedom[top : bottom + 2])
    np.testing.assert_array_equal(counted, clipped)


def test_samples_are_read_and_left_alone():
    raw = bracket()
    before = raw.copy()
    run(raw, 0, SIZE[0])
    np.testing.assert_array_equal(raw, before)
