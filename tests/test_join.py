"""Views joined on paper: worlds of which each view shows a part, and somebody in front of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sphere_tracer import smooth_world

from stages import cube
from stages.join import join
from stages.mirror import Sphere
from stages.types import Measured

N = 64
D = cube.directions(N)
SPHERE = Sphere.from_rim(
    200.0, 200.0, 150.0, radius_mm=50.0, principal_px=(200.0, 200.0), distance_mm=1500.0
)
TURNS = [Rotation.from_euler("Y", a, degrees=True).as_matrix() for a in (0.0, 120.0, 240.0)]
SPHERES = [replace(SPHERE, turn=turn.tolist()) for turn in TURNS]


def lit(seed=1, channels=3):
    return smooth_world(seed, degree=6.0, channels=channels)(D.reshape(-1, 3)).reshape(6, N, N, -1)


def before_camera(turn):
    """Somebody beside the camera, as it sees him: (6, N, N) bool."""
    x, y, z = np.moveaxis(D @ turn, -1, 0)
    return (np.abs(np.degrees(np.arctan2(x, z)) - 8.0) < 8.0) & (y > -0.6) & (y < 0.3)


def view(world, sphere, *, people=True, sigma=0.003, seed=0, gain=1.0):
    values = world * gain
    if people:
        values = np.where(before_camera(np.asarray(sphere.turn))[..., None], 0.05, values)
    spread = sigma * values
    values = values + np.random.default_rng(seed).normal(size=values.shape) * spread
    seen = sphere.pixel_of(D)[1]
    values = np.where(seen[..., None], values, np.nan)
    spread = np.where(seen[..., None], spread, np.nan)
    return Measured(
        values.astype(np.float32), (spread**2).astype(np.float32), seen.astype(np.float32)
    )


def test_who_stands_before_one_camera_vanishes_and_so_does_the_blind_cone():
    world = lit()
    views = [view(world, s, seed=k) for k, s in enumerate(SPHERES)]
    joined = join(views, SPHERES)
    assert (joined.light.valid == 1).all()
    error = np.abs(joined.light.values / world - 1.0)
    assert np.quantile(error, 0.99) < 0.01  # three sigma
    hidden = before_camera(TURNS[0])
    assert np.abs(joined.light.values[hidden] / world[hidden] - 1.0).max() < 0.02
    assert np.abs(views[0].values[hidden] / world[hidden] - 1.0).min() > 0.5  # it was there
    person = np.sum(hidden * cube.solid_angles(N)) / (4 * np.pi)
    for removed in joined.removed:
        assert person * 0.8 < removed < person * 3.0  # with its surroundings, a degree or two
    assert joined.shares == pytest.approx([1 / 3] * 3, abs=0.02)


def test_a_constant_world_stays_constant():
    world = np.full((6, N, N, 3), 2.5)
    joined = join([view(world, s, people=False, sigma=0.0) for s in SPHERES], SPHERES)
    np.testing.assert_allclose(joined.light.values, 2.5, rtol=1e-6)
    assert joined.removed == (0.0, 0.0, 0.0)


def test_of_two_that_contradict_each_other_the_one_past_its_own_camera_is_believed():
    world, turn = lit(), Rotation.from_euler("Y", 150.0, degrees=True).as_matrix()
    spheres = [SPHERES[0], replace(SPHERE, turn=turn.tolist())]
    joined = join([view(world, s, seed=k) for k, s in enumerate(spheres)], spheres)
    for sphere in spheres:
        hidden = before_camera(np.asarray(sphere.turn))
        assert np.abs(joined.light.values[hidden] / world[hidden] - 1.0).max() < 0.05


def test_views_of_unlike_brightness_meet_without_a_seam():
    world = np.ones((6, N, N, 1))
    gains = (1.0, 1.02, 0.98)
    views = [
        view(world, s, people=False, sigma=0.0, gain=g) for s, g in zip(SPHERES, gains, strict=True)
    ]
    values = join(views, SPHERES).light.values[..., 0]
    steps = [np.abs(np.diff(values, axis=axis)).max() for axis in (1, 2)]
    # Four per cent between the brightest and the darkest, and a step no eye sees from texel to
    # texel, 1.4 degrees: well below the half per cent that is seen at a sharp edge.
    assert max(steps) < 0.003
    assert values.max() - values.min() > 0.01


def test_noise_is_that_of_the_mean():
    world = lit(3)
    drawn = []
    for number in range(12):
        views = [
            view(world, s, people=False, sigma=0.01, seed=10 * number + k)
            for k, s in enumerate(SPHERES)
        ]
        drawn.append(join(views, SPHERES).light)
    spread = np.std([d.values for d in drawn], axis=0, ddof=1)
    told = np.sqrt(drawn[0].variance)
    assert np.median(spread / told) == pytest.approx(1.0, abs=0.06)
    assert np.median(told / (0.01 * world)) < 0.75  # better than any one view
    # Weights that followed each texel's own noise would prefer what is dark by chance.
    mean = np.mean([d.values for d in drawn], axis=0)
    assert np.median(mean / world) == pytest.approx(1.0, abs=5e-4)


def test_what_no_view_shows_is_not_known():
    world = lit()
    blind = np.arccos(np.clip(D @ (0.0, -1.0, 0.0), -1, 1)) < np.radians(12.0)
    views = []
    for sphere in SPHERES:
        v = view(world, sphere, people=False)
        known = np.where(blind, 0.0, v.valid).astype(np.float32)
        nan = np.where(known[..., None] > 0, 1.0, np.nan).astype(np.float32)
        views.append(Measured(v.values * nan, v.variance * nan, known))
    joined = join(views, SPHERES).light
    assert np.isnan(joined.values[blind]).all()
    assert (joined.valid[blind] == 0).all()
    assert np.isfinite(joined.values[~blind]).all()
