"""The comparator is right where three channels are right: under daylight."""

import warnings

import numpy as np
import pytest

from stages.meshes import sphere
from stages.scene import Camera, Material, Scene
from stages.sharpen import SHARP_FROM_XYZ, sharpen

XYZ_FROM_PRIMARIES = np.array(
    [
        [0.35, 0.10, 0.02, 0.15, 0.28, 0.05],
        [0.05, 0.08, 0.22, 0.30, 0.25, 0.10],
        [0.90, 0.15, 0.03, 0.01, 0.00, 0.00],
    ]
)
DAYLIGHT = np.array([1.1, 1.05, 1.0, 1.0, 0.95, 0.9])
PAINT = np.array([0.1, 0.2, 0.5, 0.6, 0.4, 0.3])


def scene():
    camera = Camera((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), 30.0)
    return Scene(((sphere(segments=8), Material(PAINT, np.full(6, 0.04), 0.1)),), camera)


def test_three_channels_agree_with_six_under_daylight():
    world = np.broadcast_to(DAYLIGHT, (6, 2, 2, 6)).astype(np.float32)
    light, sharpened, xyz_from_sharp = sharpen(world, scene(), XYZ_FROM_PRIMARIES, DAYLIGHT)
    assert light.shape == (6, 2, 2, 3)
    material = sharpened.things[0][1]
    np.testing.assert_allclose(
        xyz_from_sharp @ (light[0, 0, 0] * material.diffuse),
        XYZ_FROM_PRIMARIES @ (DAYLIGHT * PAINT),
        rtol=1e-5,
    )
    np.testing.assert_allclose(material.specular, 0.04)


def test_light_itself_is_kept_whatever_its_colour():
    lamp = np.array([0.2, 0.4, 0.9, 1.0, 1.4, 2.0])
    world = np.broadcast_to(lamp, (6, 2, 2, 6)).astype(np.float32)
    light, _, xyz_from_sharp = sharpen(world, scene(), XYZ_FROM_PRIMARIES, DAYLIGHT)
    expected = XYZ_FROM_PRIMARIES @ lamp
    np.testing.assert_allclose(xyz_from_sharp @ light[1, 0, 1], expected, rtol=1e-5)


def test_the_sharpening_is_the_published_one():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        colour = pytest.importorskip("colour")
        published = colour.adaptation.CHROMATIC_ADAPTATION_TRANSFORMS["Sharp"]
    np.testing.assert_array_equal(SHARP_FROM_XYZ, published)
