"""An environment in parts is still that environment."""

import numpy as np
import pytest

from stages import cube as cubes
from stages.light import form, light


def total(cube):
    return np.einsum("fyxc,yx->c", cube, cubes.solid_angles(cube.shape[1]))


@pytest.mark.parametrize("n", [8, 32, 128])
def test_every_form_has_all_the_light(n):
    world = np.full((6, n, n, 2), 0.2, np.float32)
    world[1, : n // 2, : n // 2] = [9.0, 7.0]  # a window
    world[4, n // 3, n // 4] = [4000.0, 1000.0]  # a lamp
    world[5, 0, 0] = -0.05  # noise around black
    made = light(world)
    for parts in (made.whole, made.narrow, made.broad):
        light_of_all = total(parts.mips[0]) + parts.flux.sum(axis=0)
        np.testing.assert_allclose(light_of_all, total(world), rtol=1e-4)
    assert len(made.whole.flux) == 0


def test_an_even_world_is_left_exactly_as_it_is():
    made = light(np.full((6, 16, 16, 3), 0.7, np.float32))
    for parts in (made.whole, made.narrow, made.broad):
        assert len(parts.flux) == 0
        np.testing.assert_array_equal(parts.mips[0], np.float32(0.7))


def test_mirrors_see_the_map_and_rough_surfaces_its_lights():
    assert [form(alpha) for alpha in (0.02, 0.05, 0.3)] == ["whole", "narrow", "broad"]
    assert form((0.05, 0.3)) == "narrow"
