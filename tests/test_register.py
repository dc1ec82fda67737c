"""Images of a flat surface laid on each other: a known shift comes back, and is taken out."""

import numpy as np
import pytest

from calibration.errors import InputError
from stages.register import register, shifted
from stages.types import Measured

SIZE = (150, 190)
Y, X = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5


def picture(x, y):
    """A smooth pattern (H, W, 3); green and blue share most of it."""
    rng = np.random.default_rng(6)
    waves = [
        np.sin(a * x + b * y + c)
        for a, b, c in rng.uniform([-0.5, -0.5, 0], [0.5, 0.5, 6], (24, 3))
    ]
    whole = np.stack(waves, axis=-1) @ rng.uniform(-1, 1, (24, 3)) * 0.05
    return 0.5 + whole + 0.04 * np.stack(waves[:8], axis=-1).sum(axis=-1, keepdims=True)


def measured(values, sigma=0.002, rng=None):
    values = np.asarray(values, np.float32)
    if rng is not None:
        values = values + rng.normal(0, sigma, values.shape).astype(np.float32)
    variance = np.full(values.shape, sigma**2, np.float32)
    return Measured(values, variance, np.ones(values.shape[:2], np.float32))


def moved(dx, dy):
    return picture(X - dx, Y - dy)


@pytest.mark.parametrize("shift", [(0.62, -1.37), (-6.2, 3.5), (0.0, 0.25)])
def test_a_shift_is_found_and_taken_out(shift):
    rng = np.random.default_rng(7)
    colours = [1.0, 0.6, 0.2]  # the other filter's light
    found = register([measured(moved(0, 0), rng=rng), measured(moved(*shift) * colours, rng=rng)])
    np.testing.assert_allclose(found.shifts, [(0, 0), shift], atol=0.03)
    assert found.correlation[1] > 0.9
    first, second = found.bands.values[..., :3], found.bands.values[..., 3:]
    known = found.bands.valid > 0
    assert known.mean() > 0.85
    left = second[known] - (first * colours)[known]
    # noise of both is .0028; 1.2 px unaligned would leave .05
    assert left.std() < 0.006
    np.testing.assert_array_equal(
        first[known], measured(moved(0, 0)).values[known] * 0 + first[known]
    )


def test_the_first_image_is_not_resampled():
    first = measured(moved(0, 0), rng=np.random.default_rng(8))
    found = register([first, measured(moved(0.5, 0.5))])
    known = found.bands.valid > 0
    np.testing.assert_array_equal(found.bands.values[known][:, :3], first.values[known])


def test_a_plain_card_stays_where_it_is():
    rng = np.random.default_rng(9)
    plain = [measured(np.full((*SIZE, 3), v), 0.01, rng) for v in (0.5, 0.3)]
    found = register(plain)
    np.testing.assert_array_equal(found.shifts, 0)
    assert np.isnan(found.correlation[1])
    np.testing.assert_array_equal(found.bands.values[..., 3:], plain[1].values)


def test_two_different_pictures_are_refused():
    other = picture(Y * 1.3 + 40, X * 0.7 - 90)
    with pytest.raises(InputError, match="does not match"):
        register([measured(moved(0, 0)), measured(other)])


def test_a_whole_shift_moves_samples_unchanged():
    image = measured(moved(0, 0))
    result = shifted(image, (3, -2))
    np.testing.assert_array_equal(result.values[2:, :-3], image.values[:-2, 3:])
    assert (result.valid[:2] == 0).all()
    assert (result.valid[:, -3:] == 0).all()
    assert np.isnan(result.values[0]).all()


def test_a_part_of_a_pixel_is_exact_for_a_parabola():
    """Cubic convolution reproduces second degree."""
    values = np.stack([0.01 * X, 1e-4 * X**2, 1e-4 * (X * Y)], axis=-1)
    result = shifted(measured(values), (0.3, -0.4))
    x, y = X + 0.3, Y - 0.4
    expected = np.stack([0.01 * x, 1e-4 * x**2, 1e-4 * (x * y)], axis=-1)
    known = result.valid > 0
    np.testing.assert_allclose(result.values[known], expected[known], rtol=2e-5, atol=1e-5)
    assert known[2:-2, 2:-2].all()


def test_variance_of_a_moved_image_is_that_of_the_weighted_mean():
    rng = np.random.default_rng(10)
    noise = measured(np.zeros((*SIZE, 3)), 0.01, rng)
    result = shifted(noise, (0.5, 0.25))
    known = result.valid > 0
    z = result.values[known] / np.sqrt(result.variance[known])
    assert z.std() == pytest.approx(1, abs=0.02)
    assert result.variance[known].max() < 0.01**2  # half-way between pixels noise is averaged


def test_an_unknown_pixel_spoils_only_those_it_has_a_part_in():
    image = measured(moved(0, 0))
    image.values[60, 70] = np.nan
    image.valid[60, 70] = 0
    result = shifted(image, (0.3, 0.0))
    unknown = np.argwhere(result.valid[5:-5, 5:-5] == 0) + 5
    assert set(unknown[:, 0]) == {60}
    assert set(unknown[:, 1]) == {68, 69, 70, 71}
