import numpy as np
import pytest

from calibration.chromaticity import possible, temperature
from calibration.sets import observer
from calibration.spectra import WAVELENGTHS
from stages import cube
from stages.illuminants import illuminants, impossible
from stages.types import Measured

N = 96
PRIMARIES = 2
LUMINANCE = np.array([0.25, 0.75])


def angle_deg(a, b):
    return np.degrees(np.arccos(np.clip(np.dot(a, b), -1, 1)))


def disc(direction, radius_deg, n=N):
    """The texels (6, N, N) whose centres lie in a disc."""
    direction = np.array(direction) / np.linalg.norm(direction)
    return cube.directions(n) @ direction > np.cos(np.radians(radius_deg))


def place(*lamps, grey=1.0):
    """A cubemap of one grey with lamps (texels, colour) in it."""
    values = np.full((6, N, N, PRIMARIES), grey, np.float32)
    for texels, colour in lamps:
        values[texels] = colour
    return Measured(values, np.full_like(values, 1e-4), np.ones((6, N, N), np.float32))


def test_an_even_place_has_no_lights_of_its_own():
    (rest,) = illuminants(place(), LUMINANCE)
    assert rest.direction is None
    assert rest.share == pytest.approx(1.0)
    assert rest.solid_angle_sr == pytest.approx(4 * np.pi)
    np.testing.assert_allclose(rest.light, 1.0)


def test_a_lamp_has_the_share_and_the_colour_it_was_given():
    texels, colour = disc((1, 2, 3), 8), np.array([300.0, 100.0])
    lamp, rest = illuminants(place((texels, colour)), LUMINANCE)
    omega = np.broadcast_to(cube.solid_angles(N), (6, N, N))[texels].sum()
    flux = omega * LUMINANCE @ colour
    assert lamp.share == pytest.approx(flux / (flux + 4 * np.pi - omega), rel=1e-6)
    assert lamp.solid_angle_sr == pytest.approx(omega)
    assert angle_deg(lamp.direction, np.array([1, 2, 3]) / np.sqrt(14)) < 1.0
    np.testing.assert_allclose(lamp.light, colour, rtol=1e-6)
    assert lamp.share + rest.share == pytest.approx(1.0)


def test_a_lamp_over_a_corner_of_the_cube_is_one():
    lamp, _ = illuminants(place((disc((1, 1, 1), 10), 200.0)), LUMINANCE)
    assert angle_deg(lamp.direction, np.ones(3) / np.sqrt(3)) < 1.0


def test_two_lamps_on_a_lit_wall_are_two():
    wall = disc((0, 0, -1), 40), 20.0
    places = [(-0.3, 0, -1), (0.3, 0, -1)]
    found = illuminants(place(wall, *((disc(p, 5), 3000.0) for p in places)), LUMINANCE)
    assert len(found) == 3
    sides = sorted(f.direction[0] for f in found[:2])
    assert sides[0] < -0.2
    assert sides[1] > 0.2


def test_bars_do_not_divide_a_window():
    window = disc((0, 0, -1), 25)
    bars = window & (np.abs(cube.directions(N)[..., 0]) < np.radians(0.8))
    assert bars.any()
    found = illuminants(place((window, 100.0), (bars, 1.0)), LUMINANCE)
    assert len(found) == 2


def test_what_is_not_known_gives_no_light():
    light = place((disc((1, 0, 0), 10), 100.0))
    hidden = disc((-1, 0, 0), 30)
    light.values[hidden], light.variance[hidden], light.valid[hidden] = np.nan, np.nan, 0
    lamp, rest = illuminants(light, LUMINANCE)
    known = 4 * np.pi - np.broadcast_to(cube.solid_angles(N), (6, N, N))[hidden].sum()
    assert lamp.solid_angle_sr + rest.solid_angle_sr == pytest.approx(known)
    assert np.isfinite(rest.light).all()


def test_a_black_place_is_all_rest():
    (rest,) = illuminants(place(grey=0.0), LUMINANCE)
    assert rest.share == 0.0


def test_noise_averages_out_over_a_light():
    lamp, _ = illuminants(place((disc((1, 0, 0), 10), 100.0)), LUMINANCE)
    count = disc((1, 0, 0), 10).sum()
    np.testing.assert_allclose(lamp.sigma, 0.01 / np.sqrt(count), rtol=0.05)  # texels differ in sr


def test_temperatures_are_those_of_standard_illuminants():
    # CIE 15: illuminant A is a Planckian at 2855.5 K (of today's constants), D65 6504 K.
    assert temperature([109.85, 100.0, 35.585]).kelvin == pytest.approx(2856, abs=3)
    d65 = temperature([95.047, 100.0, 108.883])
    assert d65.kelvin == pytest.approx(6504, abs=5)
    assert d65.duv == pytest.approx(0.0032, abs=2e-4)


def test_a_green_light_has_no_temperature():
    assert temperature([20.0, 100.0, 10.0]) is None
    assert temperature([0.0, 0.0, 0.0]) is None


def test_light_of_one_wavelength_is_possible_and_what_lies_beyond_is_not():
    assert possible([95.0, 100.0, 109.0])
    for nm in (450, 500, 520, 550, 600, 650):
        line = observer()[nm == WAVELENGTHS][0]
        beyond = line + 0.1 * (line - line.sum() / 3)  # further from equal energy than the locus
        assert possible(line), nm
        assert not possible(beyond), nm
    assert not possible([-1.0, 2.0, 1.0])
    assert not possible([-1.0, -1.0, -1.0])


def test_the_share_of_impossible_light_is_by_amount():
    light = place((disc((1, 0, 0), 10), (0.0, 100.0)))
    omega = np.broadcast_to(cube.solid_angles(N), (6, N, N))[disc((1, 0, 0), 10)].sum()
    # The second primary is a negative blue; the first is white.
    xyz = np.array([[1.0, 0.0], [1.0, 0.0], [1.0, -1.0]])
    grey, lamp = (4 * np.pi - omega) * 2.0, omega * 100.0
    assert impossible(light, xyz) == pytest.approx(lamp / (grey + lamp), rel=0.03)
