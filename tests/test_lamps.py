"""Light is neither made nor lost when an environment becomes lamps, and stays where it was."""

import numpy as np

from stages import cube as cubes
from stages.lamps import MOST, lights, take_out


def total(cube):
    return np.einsum("fyxc,yx->c", cube, cubes.solid_angles(cube.shape[1]))


def room(n=64):
    """A dim room, a large window to -X at 20, a small lamp to +X at 4000."""
    d = cubes.directions(n)
    world = np.full((6, n, n, 3), 0.3, np.float32)
    world[(d[..., 0] < 0) & (np.abs(d[..., 1:]) < 0.35).all(axis=-1)] = [18, 20, 22]
    lamp = np.array([0.8, 0.5, 0.33])
    world[d @ (lamp / np.linalg.norm(lamp)) > np.cos(np.radians(2))] = [6000, 4000, 2000]
    return world, lamp / np.linalg.norm(lamp)


def test_few_lights_keep_all_the_light_and_where_it_comes_from():
    rng = np.random.default_rng(5)
    world = rng.random((6, 24, 24, 3)).astype(np.float32) ** 4
    world[0, 3, 5] = 500
    directions, flux = lights(world, 64)
    assert len(directions) == 64
    texels = world * cubes.solid_angles(24)[..., None]
    np.testing.assert_allclose(flux.sum(axis=0), texels.sum(axis=(0, 1, 2)), rtol=1e-5)
    brightest = directions[np.argmax(flux.sum(axis=1))]
    assert brightest @ cubes.directions(24)[0, 3, 5] > np.cos(np.radians(3))
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-6)


def test_a_lamp_is_taken_out_and_the_light_stays_the_same():
    world, lamp = room()
    rest, directions, flux = take_out(world)
    assert 0 < len(flux) <= MOST
    assert (directions @ lamp > np.cos(np.radians(3.5))).all()
    np.testing.assert_allclose(total(rest) + flux.sum(axis=0), total(world), rtol=1e-5)
    assert flux.sum() > 0.98 * (total(world)[:3].sum() - total(rest).sum()) > 0
    assert rest.max() < 100


def test_a_window_is_left_in():
    world, _ = room()
    rest, _, _ = take_out(world)
    window = world[..., 2] == 22
    np.testing.assert_array_equal(rest[window], world[window])


def test_an_even_world_has_no_lamps():
    rest, directions, flux = take_out(np.ones((6, 8, 8, 3), np.float32))
    np.testing.assert_array_equal(rest, 1)
    assert directions.shape == (0, 3)
    assert flux.shape == (0, 3)


def test_a_dark_world_has_no_lights():
    directions, flux = lights(np.zeros((6, 4, 4, 2), np.float32), 16)
    assert directions.shape == (0, 3)
    assert flux.shape == (0, 2)
