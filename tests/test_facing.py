"""Sides of worlds whose lights are known."""

import numpy as np

from stages import cube
from stages.facing import facing
from stages.prefilter import irradiance

LAMP, SKY = np.array([0.2, 0.9, 1.9]), np.array([1.5, 1.0, 0.7])
LUMINANCE = np.array([0.1, 0.8, 0.1])
LIGHTS = np.stack([LAMP / (LAMP @ LUMINANCE), SKY / (SKY @ LUMINANCE)])


def world(lamp, sky):
    """A wide lamp about +X and a wide sky about -X, of these luminances."""
    d = cube.directions(16)
    lit = np.clip(d[..., :1], 0, 1) ** 2 * lamp * LIGHTS[0]
    return (lit + np.clip(-d[..., :1], 0, 1) ** 2 * sky * LIGHTS[1]).astype(np.float32)


def test_each_light_is_found_on_its_side():
    first, second = facing(irradiance(world(1.0, 3.0)), LIGHTS, LUMINANCE)
    assert 45 <= first.azimuth_deg <= 135
    assert 225 <= second.azimuth_deg <= 315
    assert first.share > 0.9
    assert second.share < 0.1
    np.testing.assert_allclose(LIGHTS.T @ first.amounts, first.irradiance, rtol=1e-4)


def test_a_world_of_one_light_is_alike_on_all_sides():
    one = np.broadcast_to(LAMP, (6, 8, 8, 3)).astype(np.float32)
    first, second = facing(irradiance(one), LIGHTS, LUMINANCE)
    assert first.share - second.share < 1e-5


def test_a_side_too_dark_to_see_is_not_taken():
    first, _ = facing(irradiance(world(0.001, 3.0)), LIGHTS, LUMINANCE)
    assert first.irradiance @ LUMINANCE > 0.05 * 3.0 / 5.0
