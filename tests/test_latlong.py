"""Latlong against paper and against py360convert, whose conventions differ as the test says."""

from __future__ import annotations

import numpy as np
import pytest

from stages import cube
from stages.latlong import directions, latlong
from stages.types import Measured


def measured(values):
    values = values.astype(np.float32)
    return Measured(values, np.ones_like(values), np.ones(values.shape[:-1], np.float32))


def test_directions_are_where_the_interface_says():
    d = directions(64)
    assert d.shape == (64, 128, 3)
    assert d[0, :, 1].min() > 0.999
    np.testing.assert_allclose(d[31:33, 63:65].mean((0, 1)), (0, 0, -1), atol=1e-3)
    assert d[32, 96, 0] > 0.99
    np.testing.assert_allclose(d[31:33, [0, -1]].mean((0, 1)), (0, 0, 1), atol=1e-3)


def test_an_asymmetric_world_comes_out_the_right_way_round():
    world = 2.0 + cube.directions(32) @ np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
    image = latlong(measured(world), 64)
    np.testing.assert_allclose(image.values, 2.0 + directions(64), atol=0.02)


def test_a_constant_world_stays_constant():
    image = latlong(measured(np.full((6, 8, 8, 2), 3.25)), 16)
    np.testing.assert_allclose(image.values, 3.25, rtol=1e-6)
    np.testing.assert_allclose(image.valid, 1, rtol=1e-6)


def test_what_is_unknown_stays_unknown():
    world = measured(np.ones((6, 8, 8, 1)))
    world.values[5], world.valid[5] = np.nan, 0
    image = latlong(world, 32)
    behind = directions(32)[..., 2] < -0.99
    assert np.isnan(image.values[behind]).all()
    assert (image.valid[behind] == 0).all()
    assert np.isfinite(image.values[directions(32)[..., 2] > 0]).all()


def test_py360convert_agrees_but_for_its_texel_convention():
    """Its columns run from -pi to pi with both ends, and rows from pole to pole; F looks to -Z."""
    py360convert = pytest.importorskip("py360convert")
    n, height = 64, 32
    d = cube.directions(n)
    world = (2.0 + np.sin(3 * d[..., 0] + 1) + np.cos(2 * d[..., 1]) * d[..., 2])[..., None]
    # F R B L look to -Z +X +Z -X as seen from inside, which OpenGL's faces are mirror images of;
    # up and down hang on F as in its dice layout.
    faces = dict(zip(cube.FACES, world[..., 0], strict=True))
    theirs = {
        "F": faces["nz"][:, ::-1],
        "R": faces["px"][:, ::-1],
        "B": faces["pz"][:, ::-1],
        "L": faces["nx"][:, ::-1],
        "U": faces["py"][::-1],
        "D": faces["ny"][::-1],
    }
    image = py360convert.c2e(theirs, height, 2 * height, mode="bilinear", cube_format="dict")
    azimuth = np.linspace(-np.pi, np.pi, 2 * height)
    polar = np.linspace(0, np.pi, height)[:, None]
    there = np.stack(
        np.broadcast_arrays(
            np.sin(polar) * np.sin(azimuth), np.cos(polar), -np.sin(polar) * np.cos(azimuth)
        ),
        axis=-1,
    )
    ours = cube.sample(world, there)[..., 0]
    # It stretches each face until the outer texels lie on its edges: at most half a texel there,
    # on a world whose slope is under 6 a radian.
    assert np.abs(ours - image).max() < 6 * (np.pi / 2 / n) / 2
