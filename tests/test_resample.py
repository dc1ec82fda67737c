"""Resampling between layouts: worlds known on paper, energy, holes, noise; and py360convert."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from pipeline.convert import rotation
from stages import cube
from stages.layouts import CUBE, LATLONG, PROJECTIONS
from stages.resample import matrix_between, resample
from stages.types import Measured

PAIRS = list(itertools.product(PROJECTIONS.values(), repeat=2))
NAMES = [f"{a.name} to {b.name}" for a, b in PAIRS]
FACE = 24  # texels along a face, and as much detail in the other layouts
TURN = rotation("40,-25,70")


def rows_of(projection):
    return 2 * round(FACE * projection.rows_per_radian / CUBE.rows_per_radian / 2)


def world(d):
    """Three channels, polynomials of degree three: band-limited to 60 degrees."""
    x, y, z = np.moveaxis(d, -1, 0)
    return np.stack([2 + x, 2 + x * y - z, 2 + x * y * z + y * y * z], axis=-1)


def seen(projection, rows, of_direction, parts=8):
    """A Measured of a world: means over each pixel's solid angle of parts^2 samples of it."""
    sheets, height, width = projection.shape(rows)
    values, weights = [], []
    for sheet in range(sheets):
        u = (np.arange(width * parts) + 0.5) / (width * parts)
        v = (np.arange(height * parts) + 0.5)[:, None] / (height * parts)
        d = projection.direction(sheet, u[None, :], v)
        weight = projection.density(u[None, :], v)[..., None]
        value = np.where(weight > 0, of_direction(np.where(weight > 0, d, 0.0)), 0.0)
        values.append((value * weight).reshape(height, parts, width, parts, -1).sum(axis=(1, 3)))
        weights.append(weight.reshape(height, parts, width, parts, 1).sum(axis=(1, 3)))
    weight = np.stack(weights)
    values = np.stack(values) / np.where(weight > 0, weight, np.nan)
    values = (values if sheets > 1 else values[0]).astype(np.float32)
    valid = np.isfinite(values[..., 0]).astype(np.float32)
    return Measured(values, np.full_like(values, np.nan), valid)


def plain(values, variance=np.nan):
    values = np.asarray(values, np.float32)
    valid = np.isfinite(values).all(axis=-1).astype(np.float32)
    return Measured(values, np.full_like(values, variance), valid)


def energy(measured, projection, rows):
    light = np.nan_to_num(measured.values).reshape(projection.sheets, rows, -1, 3)
    return np.einsum("shwc,hw->c", light, projection.solid_angles(rows))


@pytest.mark.parametrize(("source", "target"), PAIRS, ids=NAMES)
def test_a_world_turned_is_that_world_and_comes_back(source, target):
    """On a world of mean 2 and range 2. At the rim a mirror ball's pixel spans tens of degrees."""
    rows, target_rows = rows_of(source), rows_of(target)
    before = seen(source, rows, world)
    there = resample(before, source, target, target_rows, rotation=TURN)
    wanted = seen(target, target_rows, lambda d: world(d @ TURN))
    np.testing.assert_array_equal(np.isnan(there.values), np.isnan(wanted.values))
    at_rim = 0.25 if "mirrorball" in (source.name, target.name) else 0.05
    apart = np.abs(there.values - wanted.values)
    assert np.nanmean(apart) < 0.006
    assert np.nanmax(apart) < at_rim
    back = resample(there, target, source, rows, rotation=TURN.T)
    apart = np.abs(back.values - before.values)
    assert np.nanmean(apart) < 0.01
    assert np.nanmax(apart) < 2 * at_rim


@pytest.mark.parametrize(("source", "target"), PAIRS, ids=NAMES)
def test_energy_over_the_sphere_stays(source, target):
    """Of lamps a thousand times brighter than the rest, a pixel each."""
    rows = rows_of(source)
    lamps = np.random.default_rng(3).random(source.shape(rows)[0 if source.sheets > 1 else 1 :])
    lamps = np.where(lamps > 0.97, 1000.0, 1.0)[..., None] * np.array([1.0, 2.0, 0.5])
    there = np.broadcast_to(source.solid_angles(rows) > 0, lamps.shape[:-1])
    before = plain(np.where(there[..., None], lamps, np.nan))
    target_rows = rows_of(target)
    after = resample(before, source, target, target_rows, rotation=TURN)
    kept = energy(after, target, target_rows) / energy(before, source, rows)
    np.testing.assert_allclose(kept, 1.0, atol=1e-3)


@pytest.mark.parametrize("size", [0.5, 2.0])
@pytest.mark.parametrize(("source", "target"), PAIRS, ids=NAMES)
def test_a_lamp_of_one_pixel_in_the_dark_keeps_its_light_wherever_it_is(source, target, size):
    """Every pixel of the source in turn, those beside the poles and on a disc's rim included.

    Not slivers under a hundredth of a mean pixel, of which the map has less than .1 % of its light.
    """
    rows, target_rows = rows_of(source), max(2, round(rows_of(target) * size))
    matrix = matrix_between(source, rows, target, target_rows, rotation=TURN)
    has = np.tile(source.solid_angles(rows).ravel(), source.sheets)
    takes = np.tile(target.solid_angles(target_rows).ravel(), target.sheets)
    counts = has > 0.01 * has[has > 0].mean()
    assert has[~counts].sum() < 1e-3 * has.sum()
    np.testing.assert_allclose((matrix.T @ takes)[counts], has[counts], rtol=1e-3)
    # and nothing is paid for it: a pixel is a mean still, of nothing negative
    np.testing.assert_allclose(matrix.sum(axis=1)[takes > 0], 1.0, atol=1e-5)
    assert matrix.data.min() >= 0


@pytest.mark.parametrize(("source", "target"), PAIRS, ids=NAMES)
def test_a_lit_direction_lands_where_it_belongs(source, target):
    """A lamp of a few pixels: the middle of its light within a tenth of a pixel."""
    towards = np.array([0.48, 0.6, 0.64])
    rows, target_rows = rows_of(source), rows_of(target)

    def lamp(d):
        return np.exp((d @ towards - 1) / 0.02)[..., None] * np.ones(3)

    after = resample(seen(source, rows, lamp), source, target, target_rows, rotation=TURN)

    # its mean direction, over the pixels of the target
    directions = seen(target, target_rows, lambda d: d).values.reshape(target.sheets, -1, 3)
    weight = np.nan_to_num(after.values[..., 0]).reshape(target.sheets, -1)
    weight = weight * target.solid_angles(target_rows).reshape(-1)
    mean = np.einsum("sp,spi->i", weight, np.nan_to_num(directions))
    mean /= np.linalg.norm(mean)
    assert np.linalg.norm(mean - TURN @ towards) < 0.1 * np.pi / 2 / FACE


@pytest.mark.parametrize("target", PROJECTIONS.values(), ids=PROJECTIONS)
def test_a_constant_world_stays_constant_and_known(target):
    after = resample(plain(np.full((6, 8, 8, 2), 3.25)), CUBE, target, 40, rotation=TURN)
    there = np.broadcast_to(target.solid_angles(40) > 0, after.valid.shape)
    np.testing.assert_allclose(after.values[there], 3.25, rtol=1e-6)
    assert (after.valid[there] == 1).all()
    assert (after.valid[~there] == 0).all()
    assert np.isnan(after.values[~there]).all()


def test_fine_patterns_made_small_become_grey_and_do_not_alias():
    stripes = np.indices((6, 256, 256))[2] % 2
    after = resample(plain(stripes[..., None]), CUBE, LATLONG, 16, rotation=TURN)
    # A lattice of points would show all of 0..1. A pixel here spans 16 stripes and more, of which
    # one may be too many or too few.
    assert np.abs(after.values - 0.5).max() < 1 / 16


def test_what_is_unknown_stays_unknown():
    values = np.ones((6, 8, 8, 1))
    values[5] = np.nan
    after = resample(plain(values), CUBE, LATLONG, 32)
    d = seen(LATLONG, 32, lambda d: d).values
    behind, before = d[..., 2] < -0.99, d[..., 2] > 0
    assert np.isnan(after.values[behind]).all()
    assert (after.valid[behind] == 0).all()
    np.testing.assert_allclose(after.values[before], 1, rtol=1e-6)
    assert ((after.valid > 0) == np.isfinite(after.values[..., 0])).all()
    partly = (after.valid > 0) & (after.valid < 1)
    assert partly.any()
    np.testing.assert_allclose(after.values[partly], 1, rtol=1e-5)


def test_half_known_texels_count_half():
    values = np.ones((6, 4, 4, 1))
    measured = plain(values)
    valid = np.full((6, 4, 4), 0.5, np.float32)
    after = resample(Measured(measured.values, measured.variance, valid), CUBE, LATLONG, 8)
    np.testing.assert_allclose(after.valid, 0.5, rtol=1e-5)


@pytest.mark.parametrize("rows", [8, 64])
def test_sigma_is_the_spread_that_noise_gives(rows):
    """Drawn: sixty noisy cubes, made smaller and larger."""
    rng = np.random.default_rng(8)
    noisy = rng.normal(0.0, 0.3, (6, 16, 16, 60)).astype(np.float32)
    after = resample(plain(noisy, variance=0.09), CUBE, LATLONG, rows)
    drawn = after.values.var(axis=-1, ddof=1).mean()
    np.testing.assert_allclose(after.variance[..., 0].mean(), drawn, rtol=0.03)
    assert (after.variance[..., 0] < 0.1).all()


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
    # Where its samples lie: ends of the image, not pixel centres.
    ours = resample(plain(world), CUBE, LATLONG, 8 * height).values[..., 0]
    row = np.linspace(0, 8 * height - 1, height).round().astype(int)
    column = np.linspace(0, 16 * height - 1, 2 * height).round().astype(int)
    # It stretches each face until the outer texels lie on its edges: at most half a texel there,
    # and we are half a pixel of the fine image off, on a world whose slope is under 6 a radian.
    off = (np.pi / 2 / n) / 2 + np.pi / (8 * height)
    assert np.abs(ours[row][:, column] - image).max() < 6 * off
