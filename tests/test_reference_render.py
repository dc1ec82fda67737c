"""The reference the renders are judged by: against quadrature, a second tracer, and on paper.

Tiny pictures; without Mitsuba and its LLVM there is nothing to test.
"""

import numpy as np
import pytest

from benchmarks import quadrature, worlds
from calibration import sets
from calibration.errors import InputError
from stages import cube as cubes
from stages.meshes import placed, revolved, sphere
from stages.prefilter import mean
from stages.scene import Camera, Material, Scene

CAMERA = Camera((0.5, 1.0, 6.0), (0.0, 0.0, 0.0), 22.0)


@pytest.fixture(scope="module")
def reference():
    pytest.importorskip("mitsuba", reason="pictures are traced by Mitsuba")
    from benchmarks import reference
    from pipeline.simulate.render import mitsuba

    try:
        mitsuba()
    except InputError as error:
        pytest.skip(str(error))
    return reference


def world(n=16):
    """Smooth, unlike on any two sides, and a lamp."""
    rng = np.random.default_rng(6)
    bumps = rng.normal(size=(5, 3))
    bumps /= np.linalg.norm(bumps, axis=1, keepdims=True)
    light = 0.2 + np.exp(4 * (cubes.directions(n) @ bumps.T - 1)) @ rng.random((5, 4)) * 3
    light[4, 2, 10] = 60
    return light.astype(np.float32)


def ball(alpha, brdf):
    diffuse, specular = np.array([[0.1, 0.5, 0.3, 0.2], [0.05, 0.6, 0.3, 0.1]])
    return Material(diffuse, specular, alpha, brdf)


@pytest.mark.parametrize(("brdf", "alpha"), [("ward", 0.1), ("ward1992", 0.2), ("ggx", 0.3)])
def test_a_lone_ball_is_as_quadrature_has_it(reference, brdf, alpha):
    light, material = world(), ball(alpha, brdf)
    scene = Scene(((sphere(segments=64), material),), CAMERA)
    picture = reference.render(light, scene, width=30, height=24)
    rays = reference.camera_rays(CAMERA, 30, 24)
    rows, columns = (where[::23] for where in np.nonzero(picture.thing == 1))
    ray, eye = rays[rows, columns], np.array(CAMERA.eye)
    b = ray @ eye
    normal = eye - ray * (b + np.sqrt(b * b - (eye @ eye - 1)))[:, None]
    facing = -np.einsum("ij,ij->i", normal, ray)
    expected = material.diffuse * quadrature.diffuse(light, normal)
    expected += material.specular * quadrature.gloss(light, normal, -ray, alpha, brdf)
    found = picture.radiance[rows, columns]
    # texels of 6 degrees: a lamp of one, parted by four, in a lobe of 8 is right to a percent
    np.testing.assert_allclose(found[facing > 0.3], expected[facing > 0.3], rtol=0.02)
    assert np.abs(found / expected - 1).mean() < 0.005


def test_the_environment_is_seen_where_nothing_is(reference):
    light = world()
    scene = Scene(((sphere(segments=16), ball(0.3, "ward")),), CAMERA)
    picture = reference.render(light, scene, width=30, height=24)
    empty = picture.thing == 0
    rays = reference.camera_rays(CAMERA, 30, 24)
    assert 0.2 < empty.mean() < 0.9
    np.testing.assert_allclose(picture.radiance[empty], cubes.sample(light, rays[empty]), rtol=1e-5)


@pytest.mark.parametrize("brdf", ["ward", "ggx"])
def test_mitsubas_own_tracer_agrees_but_for_its_noise(reference, brdf):
    light = world()[..., :3]
    material = ball(0.3, brdf)
    material = Material(material.diffuse[:3], material.specular[:3], 0.3, brdf)
    scene = Scene(((sphere(segments=64), material),), CAMERA)
    exact = reference.render(light, scene, width=30, height=24)
    traced = reference.traced(light, scene, width=30, height=24, samples=256, margin=4)
    inside = np.zeros((24, 30), bool)
    inside[8:16, 11:19] = True
    assert (exact.thing[inside] == 1).all()
    ratio = traced[inside] / exact.radiance[inside]
    # 64 pixels of 3 % noise, and pixels have an area there
    assert ratio.mean() == pytest.approx(1, abs=0.01)
    assert np.abs(ratio - 1).max() < 0.15


def test_what_stands_in_the_way_hides_the_light(reference):
    # light from above alone; a disc under another twice as wide and a tenth as high above it
    def disc(radius, height):
        outline = np.stack([np.linspace(0, radius, 5), np.zeros(5)], axis=1)
        flat = revolved((outline, np.tile([0.0, 1.0], (5, 1))), 48)
        return placed(flat, at=(0.0, height, 0.0))

    n = 16
    light = np.zeros((6, n, n, 3), np.float32)
    light[cubes.directions(n)[..., 1] > np.cos(np.radians(20))] = 1
    white = Material(np.ones(3), np.zeros(3), 0.3)
    camera = Camera((0.0, 1.2, 6.0), (0.0, 0.0, 0.0), 8.0)
    floor, lid = (disc(0.3, 0.0), white), (disc(2.0, 3.0), white)
    bare = reference.render(light, Scene((floor,), camera), width=12, height=12)
    under = reference.render(light, Scene((floor, lid), camera), width=12, height=12)
    on = (bare.thing == 1) & (under.thing == 1)
    assert on.sum() > 5
    assert bare.radiance[on].min() > 0.05
    np.testing.assert_array_equal(under.radiance[on], 0)


def test_two_white_things_in_a_white_world_lose_nothing_when_light_may_bounce(reference):
    light = np.ones((6, 8, 8, 3), np.float32)
    white = Material(np.full(3, 0.8), np.zeros(3), 0.3)
    balls = tuple((placed(sphere(segments=24), at=(x, 0.0, 0.0)), white) for x in (-1.02, 1.02))
    scene = Scene(balls, Camera((0.0, 0.0, 9.0), (0.0, 0.0, 0.0), 26.0))
    settings = {"width": 24, "height": 16, "samples": 64}
    alone = reference.render(light, Scene(balls[:1], scene.camera), **settings)
    direct = reference.render(light, scene, **settings)
    full = reference.render(light, scene, bounces=6, **settings)
    seen = alone.thing == 1
    np.testing.assert_allclose(alone.radiance[seen], 0.8, rtol=0.01)  # on paper; 8 texels a face
    assert direct.radiance[seen].min() < 0.7  # the other hides some
    # and gives some back, but not more than there is
    between = full.radiance[seen] - direct.radiance[seen]
    assert between.mean() > 0.01
    assert full.radiance[seen].max() < 0.83


def test_a_material_it_does_not_know_is_named(reference):
    pair = Material(np.ones(3), np.ones(3), (0.1, 0.2))
    scene = Scene(((sphere(segments=8), pair),), CAMERA)
    with pytest.raises(InputError, match="a material the reference does not know"):
        reference.render(np.ones((6, 4, 4, 3), np.float32), scene, width=4, height=4)


def test_worlds_have_the_light_they_say():
    sun = worlds.sun(32)
    towards = np.array([0.45, 0.62, 0.64])
    near = cubes.directions(32) @ towards / np.linalg.norm(towards) > np.cos(np.radians(4))
    solid = np.broadcast_to(cubes.solid_angles(32), near.shape)
    flux = (sets.xyz(sun[near])[:, 1] * solid[near]).sum()
    assert flux == pytest.approx(4 * np.pi, rel=0.01)
    assert sets.xyz(mean(worlds.uniform(4)))[1] == pytest.approx(1)
    lights = sets.lights("darling2011")
    both = worlds.two_lights(lights["D65"], lights["A"], 16)
    d = cubes.directions(16)
    for side, name in ((d[..., 0] < 0, "D65"), (d[..., 0] > 0, "A")):
        total = both[side].sum(axis=0)
        np.testing.assert_allclose(
            total / total.sum(), lights[name] / lights[name].sum(), rtol=1e-5
        )
