"""What noise does to a white, against noise really drawn: on texels, and in a photograph."""

import numpy as np
import pytest

from calibration.adaptation import D65, cat02
from calibration.difference import delta_e_2000, lab
from calibration.primaries import load
from stages import cube
from stages.align import Alignment
from stages.assess import FACINGS, assess, shared_noise
from stages.mirror import Sphere
from stages.types import Measured
from stages.unwrap import unwrap

XYZ_FROM = load("darling2011").xyz_from_primaries
MATRIX = np.eye(6) + 0.12 * np.random.default_rng(1).normal(size=(6, 6))
SPHERE = Sphere.from_rim(
    120.0, 120.0, 110.0, radius_mm=50, principal_px=(120, 120), distance_mm=1500
)


def map_of(n, rng, sigma=0.002):
    """A cubemap of six bands around .6, of which a corner is not known, and a reflectance."""
    values = rng.uniform(0.3, 0.9, (6, n, n, 6)).astype(np.float32)
    variance = (sigma * values) ** 2
    valid = np.ones((6, n, n), np.float32)
    valid[5, 0, 0] = 0
    values[valid == 0] = variance[valid == 0] = np.nan
    reflectance = rng.uniform(0.5, 0.7, values.shape).astype(np.float32)
    return Measured(values, variance, valid), reflectance


def rms_difference(white, seen):
    """Of a white and the same under noise (draws, 3), the eye adapted to it."""
    adapted = cat02(white, D65) / white[1]
    return np.sqrt(np.mean(delta_e_2000(lab(adapted @ white), lab(seen @ adapted.T)) ** 2))


def gathering(n):
    """Weights (6, 6 n n) of a diffuse white that faces each way."""
    cosine = np.stack(list(FACINGS.values())) @ cube.directions(n).reshape(-1, 3).T
    solid_angle = np.broadcast_to(cube.solid_angles(n), (6, n, n)).ravel()
    return np.maximum(cosine, 0) * solid_angle / np.pi


def test_it_is_the_spread_of_noise_drawn_at_every_texel():
    """1,000 draws: rms to 2 % each; noise so small that the first order is all there is."""
    rng = np.random.default_rng(2)
    n = 4
    bands, reflectance = map_of(n, rng)
    got = assess(bands, MATRIX, reflectance, XYZ_FROM, np.ones_like(bands.values))
    noise = rng.standard_normal((1000, *bands.values.shape))
    noisy = bands.values + np.sqrt(bands.variance) * noise
    xyz = (bands.values @ MATRIX.T / reflectance) @ XYZ_FROM.T
    seen = (noisy @ MATRIX.T / reflectance) @ XYZ_FROM.T
    known = np.flatnonzero(bands.valid)
    xyz, seen = xyz.reshape(-1, 3)[known], seen.reshape(1000, -1, 3)[:, known]

    alone = np.array([rms_difference(x, seen[:, i]) for i, x in enumerate(xyz)])
    order = np.argsort(alone)
    share = np.cumsum(np.broadcast_to(cube.solid_angles(n), (6, n, n)).ravel()[known][order])
    share /= share[-1]
    assert got.median == pytest.approx(np.interp(0.5, share, alone[order]), rel=0.05)
    assert got.p95 == pytest.approx(np.interp(0.95, share, alone[order]), rel=0.08)
    weights = gathering(n)[:, known]
    for (name, value), weight in zip(got.facing.items(), weights, strict=True):
        drawn = rms_difference(weight @ xyz, np.einsum("n,kni->ki", weight, seen))
        assert value == pytest.approx(drawn, rel=0.08), name  # 3 / sqrt(2 draws)


def test_light_that_noise_hides_is_told_as_not_known():
    bands, reflectance = map_of(4, np.random.default_rng(3))
    dark = Measured(-bands.values, bands.variance, bands.valid)
    got = assess(dark, MATRIX, reflectance, XYZ_FROM, np.ones_like(bands.values))
    assert got.median is None
    assert got.p95 is None
    assert set(got.facing.values()) == {None}


@pytest.mark.slow
@pytest.mark.parametrize("block", [1, 2], ids=["independent pixels", "noise in 2 x 2 blocks"])
def test_a_sum_over_the_map_is_as_unsure_as_the_photograph_makes_it(block):
    """200 photographs of noise, unwrapped and gathered: texels smaller than pixels share noise.

    200 draws: the spread is known to 5 %. Facing away, a white sees little but the last pixels
    before the rim, each in many texels; there more noise is told than there is, never less.
    """
    draws, n, size = 200, 64, 240
    rng = np.random.default_rng(4)
    noise = rng.standard_normal((size // block, size // block, draws)).astype(np.float32)
    noise = noise.repeat(block, 0).repeat(block, 1)
    image = Measured(noise, np.ones_like(noise), np.ones((size, size), np.float32))
    area = [float(block**2)] * draws
    still = Alignment(np.zeros((1, 2)), np.ones(1), np.zeros(1))
    texels = unwrap([image], SPHERE, still, face_size=n, noise_area_px=area)
    known = texels.valid.ravel() > 0
    weights = gathering(n)[:, known]
    values = texels.values.reshape(-1, draws)[known]
    variance = texels.variance[..., 0].ravel()[known]
    common = shared_noise(SPHERE, n, area[:1]).ravel()[known]
    drawn = (weights @ values).std(axis=1)
    told = np.sqrt(weights**2 @ (variance * common)) / drawn
    np.testing.assert_allclose(told[:-1], 1.0, atol=0.2)
    assert 0.9 < told[-1] < 1.6
    # Were texels independent, it would be far less than it is.
    assert (np.sqrt(weights**2 @ variance) / drawn < 0.85).all()


def test_large_maps_are_summed_in_squares_without_changing_what_is_told(monkeypatch):
    """32 texels a side in squares of 2: the cosine of a square's middle stands for its own."""
    rng = np.random.default_rng(5)
    bands, reflectance = map_of(32, rng)
    smooth = cube.directions(32)[..., :1].astype(np.float32) * 0.05 + 0.6
    reflectance = np.broadcast_to(smooth, reflectance.shape)
    common = np.full_like(bands.values, 3.0)
    fine = assess(bands, MATRIX, reflectance, XYZ_FROM, common)
    coarse_noise = shared_noise(SPHERE, 32, [6.2, 2.9])
    monkeypatch.setattr("stages.assess._FINE_ENOUGH", 16)
    coarse = assess(bands, MATRIX, reflectance, XYZ_FROM, common)
    np.testing.assert_allclose(list(coarse.facing.values()), list(fine.facing.values()), rtol=0.01)
    np.testing.assert_allclose([coarse.median, coarse.p95], [fine.median, fine.p95], rtol=0.05)
    again = shared_noise(SPHERE, 32, [6.2, 2.9])
    front = coarse_noise[4].reshape(16, 2, 16, 2, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(again[4, ::2, ::2], front, rtol=0.02)
