import numpy as np
import pytest

from calibration.difference import delta_e_2000, delta_e_2000_parts, lab
from calibration.slopes import delta_e_2000_slopes, lab_slopes


def numerical(function, at, step=1e-5):
    """Slopes (n, 3, 3) of function (n, 3) -> (n, 3) by central differences."""
    return np.stack(
        [(function(at + step * e) - function(at - step * e)) / (2.0 * step) for e in np.eye(3)],
        axis=-1,
    )


def colours(rng, count):
    return np.stack([rng.uniform(5, 100, count), *rng.uniform(-90, 90, (2, count))], axis=-1)


def test_the_slopes_of_lab_are_those_of_its_differences():
    xyz = np.random.default_rng(1).uniform(-0.01, 1.0, (500, 3))
    values, slopes = lab_slopes(xyz)
    np.testing.assert_allclose(values, lab(xyz))
    off_edge = np.abs(xyz / [0.9505, 1.0, 1.089] - (6 / 29) ** 3).min(axis=1) > 1e-4
    expected = numerical(lab, xyz, 1e-7)
    np.testing.assert_allclose(slopes[off_edge], expected[off_edge], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("distance", [0.1, 3.0, 30.0])
def test_the_slopes_of_ciede2000_are_those_of_its_differences(distance):
    rng = np.random.default_rng(2)
    first = colours(rng, 2000)
    second = first + rng.normal(0.0, distance, first.shape)
    parts, slopes = delta_e_2000_slopes(first, second)
    np.testing.assert_allclose(parts, delta_e_2000_parts(first, second), atol=1e-12)
    expected = numerical(lambda c: delta_e_2000_parts(first, c), second)
    # Opposite hues, and a mean hue that passes 360 degrees, are jumps of the formula itself.
    smooth = np.abs(expected).max(axis=(1, 2)) < 1e3
    assert smooth.mean() > 0.98
    np.testing.assert_allclose(slopes[smooth], expected[smooth], rtol=1e-4, atol=1e-6)


def test_a_grey_that_is_met_exactly_has_slopes_too():
    grey = np.array([[100.0, 0.0, 0.0], [50.0, 0.0, 0.0]])
    parts, slopes = delta_e_2000_slopes(grey, grey)
    np.testing.assert_allclose(parts, 0.0, atol=1e-11)
    assert np.isfinite(slopes).all()
    # Small steps about grey: CIEDE2000 stretches a* by 1.5 there, and weighs lightness by S_L.
    np.testing.assert_allclose(slopes[:, 1, 1], 1.5, rtol=1e-6)
    np.testing.assert_allclose(slopes[:, 2, 2], 1.0, rtol=1e-6)
    assert slopes[1, 0, 0] == pytest.approx(1.0)


def test_beside_grey_the_parts_have_the_same_sum_of_squares():
    rng = np.random.default_rng(3)
    grey = np.stack([rng.uniform(5, 100, 200), np.zeros(200), np.zeros(200)], axis=-1)
    beside = grey + rng.normal(0.0, 2.0, grey.shape)
    parts, slopes = delta_e_2000_slopes(grey, beside)
    np.testing.assert_allclose(
        np.sqrt(np.sum(parts**2, axis=-1)), delta_e_2000(grey, beside), rtol=1e-9
    )
    expected = numerical(lambda c: delta_e_2000_slopes(grey, c)[0], beside)
    np.testing.assert_allclose(slopes, expected, rtol=1e-4, atol=1e-6)
