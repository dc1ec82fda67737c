"""What the render's benchmark counts and draws, on pictures whose answer is known."""

import numpy as np
import pytest

from benchmarks import quadrature
from benchmarks.render import CAMERA, Compared, Fireflies, difference, sphere_places
from calibration.adaptation import D65, white
from stages import cube as cubes


def test_whites_of_any_light_are_the_same_white():
    for name in ("A", "D65", "F11"):
        lit = 7.0 * white(name)
        assert difference(lit, lit, lit) == pytest.approx(0, abs=1e-6)
        # half of a white is the same grey in each: L* 76.07 against 100, and no colour
        step = difference(0.5 * lit, lit, lit)
        assert step == pytest.approx(difference(0.5 * D65, D65, D65), rel=1e-6)


def test_each_pixel_may_have_its_own_white():
    whites = np.stack([white("A"), white("D65"), white("F11")])
    seen = whites * np.array([[0.2], [0.9], [0.5]])
    together = difference(seen, whites, whites)
    alone = [difference(s, w, w) for s, w in zip(seen, whites, strict=True)]
    np.testing.assert_allclose(together, alone)


def test_a_firefly_is_counted_once_and_a_lamp_is_none():
    picture = np.ones((9, 9))
    picture[2, 3] = 3.5
    picture[6, 6] = 2.9
    everywhere = np.ones((9, 9), bool)
    flies = Fireflies()
    flies.look_at(picture, everywhere)
    assert flies.count == 1
    flies.look_at(picture, everywhere, reference=picture)
    assert flies.count == 1
    flies.look_at(picture, ~everywhere)
    assert flies.count == 1


def test_the_spheres_pixels_face_the_camera_and_meet_the_sphere():
    places = sphere_places(50, 96, least_cosine=0.3)
    np.testing.assert_allclose(np.linalg.norm(places.normals, axis=1), 1)
    facing = np.einsum("ij,ij->i", places.normals, places.views)
    assert facing.min() > 0.3
    # from the point on the unit sphere, the view leads to the camera
    to_eye = np.array(CAMERA.eye) - places.normals
    to_eye /= np.linalg.norm(to_eye, axis=1, keepdims=True)
    np.testing.assert_allclose(to_eye, places.views, atol=1e-9)
    # a world that is its direction's height: a white diffuser shows 2/3 of its normal's
    world = cubes.directions(16)[..., 1:2]
    shown = quadrature.diffuse(world, places.normals)[:, 0]
    np.testing.assert_allclose(shown, 2 / 3 * places.normals[:, 1], atol=3e-3)


def test_the_error_picture_is_drawn_with_a_map_for_each_way(tmp_path):
    pytest.importorskip("matplotlib", reason="the picture is drawn by matplotlib")
    import cv2

    from benchmarks.error_picture import error_picture

    truth = np.full((12, 16, 3), 0.4) * D65
    things = np.zeros((12, 16), bool)
    things[3:9, 4:12] = True
    sizes = []
    for ways in (["six"], ["six", "sharp", "xyz"]):
        pictures = {way: truth * (1 + 0.1 * k) for k, way in enumerate(ways)}
        found = Compared(truth, truth, pictures, pictures, things, D65)
        assert np.isnan(found.errors("six")[0, 0])
        assert found.errors("six")[5, 5] == pytest.approx(0, abs=1e-9)
        path = tmp_path / f"{len(ways)}.png"
        error_picture(found, path, title="errors")
        sizes.append(cv2.imread(str(path)).shape)
    assert sizes[1][1] > 1.5 * sizes[0][1]
