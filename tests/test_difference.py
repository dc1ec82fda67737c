import numpy as np

from calibration import sets
from calibration.adaptation import D65
from calibration.difference import delta_e_2000, delta_e_2000_parts, lab

# G. Sharma, W. Wu, E. N. Dalal (2005), table 1: the pairs chosen to catch faulty
# implementations (mean hue across 0, grey, the rotation term, large differences).
SHARMA = np.array(
    [
        [50.0000, 2.6772, -79.7751, 50.0000, 0.0000, -82.7485, 2.0425],
        [50.0000, 3.1571, -77.2803, 50.0000, 0.0000, -82.7485, 2.8615],
        [50.0000, 2.8361, -74.0200, 50.0000, 0.0000, -82.7485, 3.4412],
        [50.0000, -1.3802, -84.2814, 50.0000, 0.0000, -82.7485, 1.0000],
        [50.0000, -1.1848, -84.8006, 50.0000, 0.0000, -82.7485, 1.0000],
        [50.0000, -0.9009, -85.5211, 50.0000, 0.0000, -82.7485, 1.0000],
        [50.0000, 0.0000, 0.0000, 50.0000, -1.0000, 2.0000, 2.3669],
        [50.0000, -1.0000, 2.0000, 50.0000, 0.0000, 0.0000, 2.3669],
        [50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0009, 7.1792],
        [50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0010, 7.1792],
        [50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0011, 7.2195],
        [50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0012, 7.2195],
        [50.0000, -0.0010, 2.4900, 50.0000, 0.0009, -2.4900, 4.8045],
        [50.0000, -0.0010, 2.4900, 50.0000, 0.0011, -2.4900, 4.7461],
        [50.0000, 2.5000, 0.0000, 50.0000, 0.0000, -2.5000, 4.3065],
        [50.0000, 2.5000, 0.0000, 73.0000, 25.0000, -18.0000, 27.1492],
        [50.0000, 2.5000, 0.0000, 61.0000, -5.0000, 29.0000, 22.8977],
        [50.0000, 2.5000, 0.0000, 56.0000, -27.0000, -3.0000, 31.9030],
        [50.0000, 2.5000, 0.0000, 58.0000, 24.0000, 15.0000, 19.4535],
        [50.0000, 2.5000, 0.0000, 50.0000, 3.1736, 0.5854, 1.0000],
        [60.2574, -34.0099, 36.2677, 60.4626, -34.1751, 39.4387, 1.2644],
        [63.0109, -31.0961, -5.8663, 62.8187, -29.7946, -4.0864, 1.2630],
        [35.0831, -44.1164, 3.7933, 35.0232, -40.0716, 1.5901, 1.8645],
        [22.7233, 20.0904, -46.6940, 23.0331, 14.9730, -42.5619, 2.0373],
        [90.8027, -2.0831, 1.4410, 91.1528, -1.6435, 0.0447, 1.4441],
        [2.0776, 0.0795, -1.1350, 0.9033, -0.0636, -0.5514, 0.9082],
    ]
)


def colours(n, seed=0):
    return np.random.default_rng(seed).uniform([0, -100, -100], [100, 100, 100], (n, 3))


def test_the_published_pairs_come_out():
    got = delta_e_2000(SHARMA[:, :3], SHARMA[:, 3:6])
    np.testing.assert_allclose(got, SHARMA[:, 6], atol=5e-5)  # printed to four places


def test_colour_science_agrees_on_near_and_far_colours():
    colour = sets._colour()
    one = colours(5000)
    two = np.concatenate([colours(2500, 1), one[2500:] + colours(2500, 2) * 0.02])
    one[:10, 1:] = 0.0  # greys
    expected = colour.difference.delta_E_CIE2000(one, two)
    np.testing.assert_allclose(delta_e_2000(one, two), expected, atol=1e-9)


def test_the_squares_of_the_three_parts_are_the_formula():
    """Against the formula as printed, with its product of chroma and hue."""
    one, two = colours(1000, 3), colours(1000, 4)
    expected = sets._colour().difference.delta_E_CIE2000(one, two)
    np.testing.assert_allclose(np.sum(delta_e_2000_parts(one, two) ** 2, -1), expected**2)


def test_the_parts_are_smooth_through_no_difference():
    base, way = np.array([50.0, 20.0, 10.0]), np.array([0.3, -0.5, 0.8])
    steps = np.array([-2e-3, -1e-3, 1e-3, 2e-3])[:, None]
    parts = delta_e_2000_parts(base, base + steps * way)
    slopes = parts / steps
    np.testing.assert_allclose(slopes, np.broadcast_to(slopes[0], slopes.shape), rtol=2e-3)


def test_lab_is_colour_sciences():
    colour = sets._colour()
    xyz = np.random.default_rng(5).uniform(0.0, 1.1, (500, 3))
    xyz[:50] *= 0.005  # the straight part
    expected = colour.XYZ_to_Lab(xyz, colour.XYZ_to_xy(D65))
    np.testing.assert_allclose(lab(xyz), expected, atol=1e-9)


def test_white_is_100_0_0():
    np.testing.assert_allclose(lab(D65), [100.0, 0.0, 0.0], atol=1e-12)
