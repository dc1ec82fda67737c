"""The comparators are right where three channels are right: under daylight."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from calibration.primaries import load
from calibration.sets import lights
from stages.meshes import sphere
from stages.scene import Camera, Material, Scene
from stages.trichromatic import SHARP_FROM_XYZ, SPACES, Trichromatic

XYZ_FROM_PRIMARIES = np.array(
    [
        [0.35, 0.10, 0.02, 0.15, 0.28, 0.05],
        [0.05, 0.08, 0.22, 0.30, 0.25, 0.10],
        [0.90, 0.15, 0.03, 0.01, 0.00, 0.00],
    ]
)
DAYLIGHT = np.array([1.1, 1.05, 1.0, 1.0, 0.95, 0.9])
PAINT = np.array([0.1, 0.2, 0.5, 0.6, 0.4, 0.3])


def scene(**changed):
    camera = Camera((0.0, 0.0, 3.0), (0.0, 0.0, 0.0), 30.0)
    material = replace(Material(PAINT, np.full(6, 0.04), 0.1), **changed)
    return Scene(((sphere(segments=8), material),), camera)


@pytest.mark.parametrize("space", SPACES)
def test_three_channels_agree_with_six_under_daylight(space):
    three = Trichromatic(XYZ_FROM_PRIMARIES, DAYLIGHT, SPACES[space])
    world = np.broadcast_to(DAYLIGHT, (6, 2, 2, 6)).astype(np.float32)
    light = three.light(world)
    assert light.shape == (6, 2, 2, 3)
    material = three.scene(scene()).things[0][1]
    np.testing.assert_allclose(
        three.xyz_from_channels @ (light[0, 0, 0] * material.diffuse),
        XYZ_FROM_PRIMARIES @ (DAYLIGHT * PAINT),
        rtol=1e-5,
    )
    np.testing.assert_allclose(material.specular, 0.04)


@pytest.mark.parametrize("space", SPACES)
def test_light_itself_is_kept_whatever_its_colour(space):
    lamp = np.array([0.2, 0.4, 0.9, 1.0, 1.4, 2.0])
    three = Trichromatic(XYZ_FROM_PRIMARIES, DAYLIGHT, SPACES[space])
    expected = XYZ_FROM_PRIMARIES @ lamp
    np.testing.assert_allclose(three.xyz_from_channels @ three.light(lamp), expected, rtol=1e-5)


def test_pictures_and_glosses_by_angle_are_surfaces_too():
    three = Trichromatic(XYZ_FROM_PRIMARIES, DAYLIGHT)
    table = np.stack([PAINT, np.ones(6)])
    picture = np.broadcast_to(PAINT, (2, 3, 6)).astype(np.float32)
    material = three.scene(scene(specular=table, image=picture, brdf="ggx")).things[0][1]
    np.testing.assert_allclose(material.specular, [three.surface(PAINT), [1, 1, 1]])
    np.testing.assert_allclose(material.image[1, 2], three.surface(PAINT), rtol=1e-6)
    assert material.brdf == "ggx"


def test_a_named_space_has_daylight_for_its_white():
    primaries = load("darling2011")
    three = Trichromatic.named("sharp", primaries)
    d65 = primaries.project(lights("darling2011")["D65"])
    patch = primaries.project(np.linspace(0.1, 0.9, 36))
    np.testing.assert_allclose(
        three.xyz_from_channels @ (three.light(d65) * three.surface(patch)),
        primaries.xyz_from_primaries @ (d65 * patch),
        rtol=1e-5,
    )


def test_the_sharpening_is_the_published_one():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        colour = pytest.importorskip("colour")
        published = colour.adaptation.CHROMATIC_ADAPTATION_TRANSFORMS["Sharp"]
    np.testing.assert_array_equal(SHARP_FROM_XYZ, published)
