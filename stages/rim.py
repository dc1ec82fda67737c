"""The rim of a mirror sphere below a pixel: what each place of it says, and what all say together.

`locate` finds the rim to a pixel or so; this measures it. Near the rim a mirror is grazed: e pixels
inside it the reflected direction is turned by sqrt(8 e / radius), by which the whole world behind
the sphere, panels, lamps and all, is squeezed into the last few pixels, while outside a pixel is
thousands of times less of it. So a profile across the rim is a random walk in sqrt(e) on its
inside and nearly a straight line on its outside, both blurred. As a Gaussian process that is a
likelihood of every place the rim might have, whatever is reflected, with nothing fitted; three
kinds of world are held possible: broken by edges, smooth, or with a step at the rim itself
(a dull sphere reflects less than all even there).

A metal darkens all this: at the rim itself it reflects everything, a pixel inside three quarters,
and that fall alone, like a root too, looks like a rim that lies further out. Where the metal is
known, the fall by Fresnel's equations, times the light outside, is taken off each profile first.

Beside edges of what is reflected the likeliest place is wrong, and not by chance but along a whole
arc: a panel's edge makes a line of its own, always inside the rim. Places are therefore gathered
in sectors, each of which says one thing, with a bounded weight; and a rim outside of what a
sector says is far less unlikely than one inside of it. All rims about the first guess are tried.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from stages.mirror import Array, Sphere
from stages.types import Measured

_PROFILE = np.arange(-2.0, 4.01, 0.5)  # px across the rim, outwards
_OUTER = 4  # of its samples, the outermost: the light outside the rim
_PLACES = np.arange(-2.4, 2.41, 0.2)  # px, where on a profile the rim may be
_FINE = np.arange(-2.4, 2.401, 0.02)  # and to what a sector's sum is interpolated
# px, sigma of lens, pixel, demosaicing and interpolation together: the one that explains the
# profiles best. Taken .2 px too small it moves the rim out by a quarter of a pixel.
_BLURS = (0.45, 0.55, 0.65, 0.75)
# Variances of a profile's parts, of which that of the world's change over the first pixel inside
# is about 1: random walk in sqrt(e); terms in sqrt(e), e, e^1.5; step.
_WORLDS = ((0.3, 1.0, 0.0, 0.0, 0.0), (0.01, 1.0, 1.0, 0.3, 0.0), (0.3, 1.0, 0.0, 0.0, 0.5))
_PRIOR = (0.5, 0.45, 0.05)  # and how likely each is
_OUTSIDE = 1e-3  # and of the background's over a pixel: both are the world, seen at 30 radii
_CONTRAST = 10.0 ** np.arange(-1, 7)  # what it all is multiplied by, in variances of the noise
_MODEL_ERROR = 0.01  # of a profile's range: what demosaicing and interpolation get wrong
_ALONG = 4  # px along the rim over which profiles are averaged: a Bayer cell in every direction
_TEMPER = 0.6  # power of a profile's likelihood: its channels show the same edges ...
_SECTORS = 48
_SECTOR_TEMPER = 0.15  # ... and so do the profiles of a sector
_ASTRAY = 0.05  # likelihood, against the best, of a sector that shows a place outside the rim's ...
_BEYOND = 0.002  # ... or inside it, outside the rim: nothing does but a stand or clutter


@dataclass(frozen=True)
class RimFit:
    """A measured rim.

    rim          x, y, rim_px as `Sphere.from_rim` has them
    residual_px  robust standard deviation of the sectors' own places about the rim
    found        share of sectors whose own place lies within .3 px
    """

    rim: tuple[float, float, float]
    residual_px: float
    found: float


def measure_rim(
    image: Measured,
    start: Array,
    sphere_at: Callable[..., Sphere],
    reflectance: tuple[Array, Array] | None = None,
    rounds: int = 3,
) -> RimFit:
    """The rim about a first guess.

    image      (H, W, C)
    start      (3,) x, y, rim_px to within a pixel or so
    sphere_at  (x, y, rim_px) -> Sphere
    reflectance  of the sphere: angles of incidence (K,) in rad, ascending to pi/2, and the factor
                 there (K,); None for a perfect mirror
    rounds     each starts from the rim the last has found
    """
    from scipy.optimize import minimize

    sphere = sphere_at(*start)
    origin, values, variance = _about(image, sphere)
    blurs: tuple[float, ...] = _BLURS
    rim = np.array(start, np.float64)
    for k in range(rounds):
        sphere = sphere_at(*rim)
        count = int(np.clip(2.0 * np.pi * sphere.rim_px, 4 * _SECTORS, 4000)) // 2 * 2
        outline = sphere.outline(count)
        profiles, noise = _profiles(values, variance, outline - origin, sphere.outward(outline))
        profiles, noise = profiles[1::2], noise[1::2]
        tried = []
        for blur in blurs:
            dips = _dips(sphere.rim_px, reflectance, blur)
            tried.append(_evidence(profiles, noise, *_processes(blur), dips))
        explained = [float(np.sum(e.total)) for e in tried]
        likeliest = int(np.argmax(explained))
        evidence, blurs = tried[likeliest].of_places, blurs[likeliest : likeliest + 1]
        # How far the rim's places move outwards when x, y and size grow by a pixel.
        moves = np.stack(
            [10.0 * sphere_at(*(rim + d)).inside_px(outline[1::2]) for d in 0.1 * np.eye(3)],
            axis=-1,
        )
        sectors = _Sectors(evidence, moves)
        reach = np.arange(-1.2, 1.21, 0.15) if k == 0 else np.arange(-0.45, 0.46, 0.15)
        grid = np.stack(np.meshgrid(reach, reach, reach, indexing="ij"), axis=-1).reshape(-1, 3)
        best = grid[np.argmax(sectors.likelihood(grid).sum(axis=-1))]
        step = minimize(
            lambda s, sectors=sectors: -sectors.likelihood(s).sum(),
            best,
            method="Nelder-Mead",
            options={
                "initial_simplex": best + np.vstack([np.zeros(3), 0.1 * np.eye(3)]),
                "xatol": 2e-3,
                "fatol": 1e-4,
            },
        ).x
        rim = rim + step
    beyond = sectors.own - sectors.moves @ step
    return RimFit(
        rim=(float(rim[0]), float(rim[1]), float(rim[2])),
        residual_px=1.4826 * float(np.median(np.abs(beyond))),
        found=float(np.mean(np.abs(beyond) < 0.3)),
    )


def _about(image: Measured, sphere: Sphere) -> tuple[Array, list[Array], list[Array]]:
    """Corner (x, y), spline coefficients and variance of each channel, of the part in question."""
    from scipy.ndimage import spline_filter

    rim, margin = sphere.outline(), 12
    low = np.maximum(np.floor(rim.min(axis=0)).astype(int) - margin, 0)
    high = np.ceil(rim.max(axis=0)).astype(int) + margin
    part = (slice(low[1], high[1]), slice(low[0], high[0]))
    known = image.valid[part] > 0.5
    known &= np.isfinite(image.values[part]).all(axis=-1)
    values, variance = [], []
    for c in range(image.values.shape[-1]):
        # The spline's filter would spread a NaN along its row: gaps are filled, and cut out again.
        light = image.values[part][..., c].astype(np.float64)
        fill = np.max(light, where=known, initial=0.0)
        values.append(spline_filter(np.where(known, light, fill), order=3))
        variance.append(np.where(known, image.variance[part][..., c], np.nan))
    return low.astype(np.float64), values, variance


def _profiles(values, variance, outline: Array, outward: Array) -> tuple[Array, Array]:
    """Profiles (n, C, T) across the rim, averaged along it, and variances (n, C) of their noise."""
    from scipy.ndimage import map_coordinates

    x, y = np.moveaxis(outline[:, None] + _PROFILE[:, None] * outward[:, None], -1, 0)
    at = np.stack([y - 0.5, x - 0.5])
    light = np.stack([map_coordinates(v, at, order=3, prefilter=False) for v in values], axis=1)
    noise = np.stack(
        [map_coordinates(v, at, order=1, cval=np.nan).mean(axis=-1) for v in variance], axis=1
    )
    light[~np.isfinite(noise)] = np.nan
    light = np.mean([np.roll(light, k - _ALONG // 2, axis=0) for k in range(_ALONG)], axis=0)
    noise = np.mean([np.roll(noise, k - _ALONG // 2, axis=0) for k in range(_ALONG)], axis=0)
    return light, noise / 3.0  # not 4: neighbours share pixels


def _taps(blur: float) -> tuple[Array, Array]:
    """Positions (T, 25) about each sample of a profile, and weights (25,) of a blur in px."""
    spread = np.linspace(-3.0, 3.0, 25) * blur
    weight = np.exp(-0.5 * (spread / blur) ** 2)
    return _PROFILE[:, None] + spread, weight / weight.sum()


def _dips(rim_px: float, reflectance: tuple[Array, Array] | None, blur: float) -> Array:
    """How much darker (S, T) than the light outside the metal makes a profile, for each place."""
    dips = np.zeros((len(_PLACES), len(_PROFILE)))
    if reflectance is None:
        return dips
    x, weight = _taps(blur)
    for s, place in enumerate(_PLACES):
        # At e px inside, the sine of the angle of incidence is (rim - e) / rim.
        sine = 1.0 - np.clip((place - x) / rim_px, 0.0, 1.0)
        factor = np.where(x < place, np.interp(np.arcsin(sine), *reflectance), 1.0)
        dips[s] = (factor - 1.0) @ weight
    return dips - dips.mean(axis=-1, keepdims=True)


@cache
def _processes(blur_px: float) -> tuple[Array, Array]:
    """Eigenvalues (W, S, T) and vectors (W, S, T, T) of the profiles' covariance.

    One for each world and place of the rim; a profile's mean is projected out.
    """
    taps, weight = _taps(blur_px)
    size = len(_PROFILE)
    # (T, T * 25): from 25 positions about each sample to the blurred profile, less its mean.
    blur = np.kron(np.eye(size) - 1.0 / size, weight)
    x = taps.ravel()
    covariance = np.empty((len(_WORLDS), len(_PLACES), size, size))
    for s, place in enumerate(_PLACES):
        inside, outside = np.maximum(place - x, 0.0), np.maximum(x - place, 0.0)
        root = np.sqrt(inside)
        walk = blur @ np.minimum.outer(root, root) @ blur.T
        background = blur @ np.minimum.outer(outside, outside) @ blur.T
        background += 0.3 * np.outer(blur @ outside, blur @ outside)
        terms = [blur @ term for term in (root, inside, inside**1.5, np.sign(inside))]
        for w, (rough, *amounts) in enumerate(_WORLDS):
            covariance[w, s] = rough * walk + _OUTSIDE * background
            for amount, term in zip(amounts, terms, strict=True):
                covariance[w, s] += amount * np.outer(term, term)
    values, vectors = np.linalg.eigh(covariance)
    return np.maximum(values, 0.0), vectors


@dataclass(frozen=True)
class _Evidence:
    """What profiles say of the rim: logs of likelihoods.

    of_places  (n, S) of each place against all alike, tempered
    total      (n,) of the profile, wherever the rim is
    """

    of_places: Array
    total: Array


def _evidence(
    profiles: Array, noise: Array, eigenvalues: Array, vectors: Array, dips: Array
) -> _Evidence:
    """What profiles (n, C, T) with noise of variance (n, C) say of the rim's places.

    Worlds and contrasts are averaged over for each channel, channels multiplied, and one profile in
    twenty may show anything.
    """
    worlds, places, size = eigenvalues.shape
    gain = 1.0 / (1.0 + _CONTRAST[:, None, None, None] * eigenvalues)  # (R, W, S, T)
    volume = 0.5 * np.log(gain).sum(axis=-1).reshape(-1, places, 1)
    total = np.zeros((places, len(profiles)))
    dip = np.matmul(dips[:, None], vectors)  # (W, S, 1, T)
    for c in range(profiles.shape[1]):
        usable = np.isfinite(profiles[:, c]).all(axis=-1) & np.isfinite(noise[:, c])
        profile = np.where(usable[:, None], profiles[:, c], 0.0)
        least = noise[:, c] + (_MODEL_ERROR * np.ptp(profile, axis=-1)) ** 2
        profile = profile / np.sqrt(np.where(usable & (least > 0), least, 1.0))[:, None]
        outside = profile[:, -_OUTER:].mean(axis=-1, keepdims=True)
        profile = profile - profile.mean(axis=-1, keepdims=True)
        parts = (profile @ vectors.reshape(-1, size, size)).reshape(worlds, places, -1, size)
        square = (parts - outside * dip) ** 2
        misfit = np.matmul(square, np.moveaxis(gain, 0, -1))  # (W, S, n, R)
        misfit = np.moveaxis(misfit, -1, 0).reshape(-1, places, len(profile))
        log = volume - 0.5 * misfit
        most = log.max(axis=0)
        share = np.exp(np.maximum(log - most, -80.0)).reshape(len(_CONTRAST), worlds, places, -1)
        log = most + np.log(np.tensordot(_PRIOR, share.mean(axis=0), 1))
        total += np.where(usable, log, 0.0)
    most = total.max(axis=0)
    likelihood = np.exp(_TEMPER * (total - most))
    alike = likelihood.mean(axis=0)
    of_places: Array = np.log(0.95 * likelihood / alike + 0.05)
    return _Evidence(of_places.T, _TEMPER * most + np.log(alike))


class _Sectors:
    """What the sectors of a rim say.

    own    (K,) the place outwards, px, each holds likeliest
    moves  (K, 3) how far its place moves when x, y and size grow by a pixel
    """

    def __init__(self, evidence: Array, moves: Array):
        from scipy.interpolate import CubicSpline

        first = np.arange(_SECTORS) * len(evidence) // _SECTORS
        count = np.diff(np.append(first, len(evidence)))[:, None]
        log = _SECTOR_TEMPER * np.add.reduceat(evidence, first, axis=0)
        log = CubicSpline(_PLACES, log, axis=1)(_FINE)
        self._log = log - log.max(axis=1, keepdims=True)
        self.own = _FINE[np.argmax(log, axis=1)]
        self.moves = np.add.reduceat(moves, first, axis=0) / count

    def likelihood(self, steps) -> Array:
        """Log likelihood (..., K) of rims moved by steps (..., 3)."""
        place = np.asarray(steps) @ self.moves.T
        at = np.clip((place - _FINE[0]) / (_FINE[1] - _FINE[0]), 0, len(_FINE) - 1.001)
        low = at.astype(int)
        share, k = at - low, np.arange(len(self.own))
        log = self._log[k, low] * (1.0 - share) + self._log[k, low + 1] * share
        outside = 0.5 + 0.5 * np.tanh((place - self.own) / 0.2)
        return np.log(np.exp(log) + _BEYOND + (_ASTRAY - _BEYOND) * outside)
