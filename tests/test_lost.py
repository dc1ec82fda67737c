"""Light that saturates every exposure, against lamps of known place and size."""

import numpy as np
import pytest

from stages.align import Alignment
from stages.cube import directions, solid_angles
from stages.lost import lost, lost_share, taken, warnings
from stages.mirror import Sphere
from stages.types import Measured, Saturated

SPHERE = Sphere.from_rim(
    161.0, 149.0, 130.0, radius_mm=50.0, principal_px=(165.0, 155.0), distance_mm=900.0
)
SIZE = (310, 330)
STILL = Alignment(np.zeros((1, 2)), np.ones(1), np.zeros(1))
BOUND = np.array([[2.0, 3.0], [5.0, 7.0]])  # red, green, green, blue
CFA = np.array([[0, 1], [1, 2]])


def lamp(towards, radius_deg, shift=(0.0, 0.0)):
    """Pixels that show a round lamp, by their middles."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    seen = SPHERE.direction_of(np.stack([x - shift[0], y - shift[1]], axis=-1))
    towards = np.asarray(towards) / np.linalg.norm(towards)
    return np.nan_to_num(seen) @ towards > np.cos(np.radians(radius_deg))


def known(level):
    """A map of constant light, one unit in every band."""
    values = np.full((6, 16, 16, 3), level, np.float32)
    return Measured(values, np.zeros_like(values), np.ones((6, 16, 16), np.float32))


@pytest.mark.parametrize("towards", [(0.3, 0.4, 0.8), (0.9, 0.1, -0.4)])
def test_a_lamp_is_told_by_its_size_its_direction_and_a_lower_bound(towards):
    radius = 9.0
    found = lost(Saturated(lamp(towards, radius), BOUND, CFA), SPHERE, STILL, 0, known(1.0))
    cap = 2 * np.pi * (1 - np.cos(np.radians(radius)))
    own = np.array(found.at_least) / (2.0, 4.0, 7.0)  # by the mean of each colour's bound
    np.testing.assert_allclose(own, cap, rtol=0.06)  # pixels along its edge
    assert cap < found.solid_angle_sr < 1.5 * cap  # with the pixels next to it
    assert found.share == pytest.approx(found.solid_angle_sr / (4 * np.pi))
    middle = np.asarray(towards) / np.linalg.norm(towards)
    assert np.degrees(np.arccos(np.dot(found.direction, middle))) < 0.5
    # Blue's bound is the highest: 7 over the lamp, against 1 over all.
    blue = 7.0 * cap / (7.0 * cap + 4 * np.pi)
    assert found.of_light == pytest.approx(blue, rel=0.06)


def test_another_filters_lamp_is_told_where_the_first_one_sees_it():
    shift = (3.0, -2.0)
    moved = Alignment(np.array([(0.0, 0.0), shift]), np.ones(2), np.zeros(2))
    towards = (0.3, 0.4, 0.8)
    plain = lost(Saturated(lamp(towards, 9.0), BOUND, CFA), SPHERE, STILL, 0, known(1.0))
    other = lost(Saturated(lamp(towards, 9.0, shift), BOUND, CFA), SPHERE, moved, 1, known(1.0))
    np.testing.assert_allclose(other.direction, plain.direction, atol=2e-3)


def test_the_share_of_texels_that_was_lost_adds_up_to_its_solid_angle():
    one = Saturated(lamp((0.3, 0.4, 0.8), 9.0), BOUND, CFA)
    share = lost_share([one], SPHERE, STILL, face_size=64)
    found = lost(one, SPHERE, STILL, 0, known(1.0))
    total = (share * solid_angles(64)).sum()
    assert total == pytest.approx(found.solid_angle_sr, rel=0.02)
    middle = np.array((0.3, 0.4, 0.8)) / np.linalg.norm((0.3, 0.4, 0.8))
    near = directions(64) @ middle
    assert (share[near > np.cos(np.radians(7.0))] > 0.99).all()
    assert (share[near < np.cos(np.radians(13.0))] == 0).all()


def test_nothing_lost_is_told_as_nothing():
    nothing = Saturated(np.zeros(SIZE, bool), BOUND, CFA)
    found = lost(nothing, SPHERE, STILL, 0, known(1.0))
    assert found.solid_angle_sr == 0.0
    assert found.direction is None
    assert found.of_light == 0.0
    assert not lost_share([nothing], SPHERE, STILL, face_size=16).any()
    assert warnings([found], ["cyan"]) == []


def test_what_lies_beside_the_sphere_is_not_counted():
    beside = np.zeros(SIZE, bool)
    beside[:20, :20] = True
    found = lost(Saturated(beside, BOUND, CFA), SPHERE, STILL, 0, known(1.0))
    assert found.solid_angle_sr == 0.0


def test_the_pixels_next_to_a_lost_one_go_with_it():
    one = np.zeros((9, 9), bool)
    one[4, 4] = one[0, 8] = True
    expected = np.zeros((9, 9), bool)
    expected[3:6, 3:6] = expected[:2, 7:] = True
    np.testing.assert_array_equal(taken(Saturated(one, BOUND, CFA)), expected)


@pytest.mark.parametrize(("level", "said"), [(1.0, 1), (1e4, 0)])
def test_a_warning_is_given_where_it_matters(level, said):
    one = Saturated(lamp((0.3, 0.4, 0.8), 2.0), BOUND, CFA)
    found = lost(one, SPHERE, STILL, 0, known(level))
    notes = warnings([found], ["cyan"])
    assert len(notes) == said
    if said:
        assert "cyan saturates in every exposure" in notes[0]
        assert "(0.32, 0.42, 0.85)" in notes[0]
