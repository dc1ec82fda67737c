"""The rim of a mirror sphere below a pixel: what each place of it says, and what all say together.

`locate` finds the rim to a pixel or so; this measures it. Near the rim a mirror is grazed: e pixels
inside it the reflected direction is turned by sqrt(8 e / radius), by which the whole world behind
the sphere is squeezed into the last few pixels, while outside a pixel is thousands of times less of
it. All that a photograph shows of the background within some degrees of the sphere is reflected in
the outermost twentieth of a pixel. So there is no step at the rim, and there may well be one almost
at it. A profile across the rim shows, e pixels inside,

    F(e) w(sqrt(e)),    blurred,

F the metal's reflectance (all at the rim itself, three quarters a pixel inside) and w the world
behind, which begins as what is seen outside and then changes with sqrt(e): slowly, or as a random
walk, or not at all up to a first edge and somehow from there on. Each of these is a Gaussian
process, whose likelihood for every place of the rim is known with nothing fitted; they are
averaged, the first edge's place over all there is. A world that changes slowly tells the rim to
both sides by F; an edge says that the rim is not inside of it and likely close.

Two things have to be right for that, as what lies beyond the outermost edge is all there is to
see. The blur is not a Gaussian: a pixel's square and the spline that profiles are read with
have no tails, and with a Gaussian of the same variance rims come out a tenth of a pixel too large.
How wide it is has two sources. Where the sphere reflects enough clean edges, they tell it
(`stages.blur`), not the rim: with edges near the rim too, a narrower blur and edges further inside
look the same there. Where it does not, as before plain walls, there are few near the rim either:
worlds with edges are left out, and with these gone the rim tells its blur, as the one that explains
all profiles best.

Beside things that no such model knows, a stand, a hand, clutter, the likeliest place is wrong along
a whole arc. Places are therefore gathered in sectors, each of which has a vote of bounded weight;
and a rim outside of what a sector says is less unlikely than one inside, where nothing but
such things can show an edge. All rims about the first guess are tried.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np

from stages.blur import edge_blur
from stages.mirror import Array, Sphere
from stages.types import Measured

_OUTER = 3  # samples of a profile, the outermost: the light outside the rim
_ALONG = 6  # px along the rim over which profiles are averaged, and apart
_MOST = 250  # profiles; of larger rims they lie further apart
_FAR = 1.8  # px: after a step so long, the rim is looked for about the new place just as far ...
_TWICE = 2  # ... so many times
_FINE = 0.02  # px, to which a sector's sum is interpolated
_USUAL_LENS = 0.5  # px, blur of lens and demosaicing, to begin with where no edge tells it ...
_LENSES = np.array([0.05, 0.2, 0.35, 0.5, 0.7, 0.9, 1.15])  # ... and of which the rim then chooses
_SQUARE = 1.0 / 12.0  # px^2, variance of a pixel's square
_EDGES = np.array([0.0, 0.03, 0.1, 0.2, 0.35, 0.55, 0.85, 1.3, 2.0, 3.0])  # px inside: bounds
_RATE = 1.5  # edges per root of a pixel
_CONTRAST = 10.0 ** np.arange(-1, 7.1, 1.5)  # what a process is multiplied by, in noise variances
_MODEL_ERROR = 0.01  # of a profile's range: what demosaicing and interpolation get wrong
_TEMPER = 0.3  # power of a profile's likelihood: its channels and neighbours show the same edges
_ANYTHING = 0.05  # share of profiles that may show anything
_SECTORS = 36
_ARCS = 12  # of three sectors each: what is left out at a time to tell the error
_ASTRAY = 0.1  # likelihood, against the best, of a rim outside of what a sector says ...
_BEYOND = 0.002  # ... and of one inside of it
# Sectors disagree by their own errors; one they share, as by a wrong blur, makes none disagree, and
# neighbouring arcs are wrong together. So on simulated spheres errors are larger than the jackknife
# tells, by this factor in root mean square.
_UNTOLD = 2.8
_LEAST_SIGMA = 0.02  # px
_AGREE = 0.3  # px: sectors that show the rim no further away agree with it


@dataclass(frozen=True, eq=False)
class _About:
    """How far about a guess is looked.

    profile  (T,) px across the rim, outwards
    places   (S,) px, where on a profile the rim may be
    reach    px, steps of x, y and size that are tried
    """

    profile: Array
    places: Array
    reach: Array


_WIDE = _About(np.arange(-4.0, 4.51, 0.75), np.arange(-3.6, 3.61, 0.3), np.arange(-2.8, 2.81, 0.35))
_NEAR = _About(np.arange(-2.5, 3.51, 0.5), np.arange(-1.5, 1.51, 0.1), np.arange(-0.6, 0.61, 0.15))


@dataclass(frozen=True)
class RimFit:
    """A measured rim.

    rim          x, y, rim_px as `Sphere.from_rim` has them
    sigma_px     standard errors of these, from how much the sectors disagree
    residual_px  robust standard deviation of the sectors' own places about the rim
    agrees       (K,) of its sectors, clockwise from the right: whether their own place is near
    blur_px      of lens, pixel and demosaicing together, that was found or assumed
    """

    rim: tuple[float, float, float]
    sigma_px: tuple[float, float, float]
    residual_px: float
    agrees: tuple[bool, ...]
    blur_px: float

    @property
    def found(self) -> float:
        """Share of sectors that agree."""
        return float(np.mean(self.agrees))


def measure_rim(
    image: Measured,
    start: Array,
    sphere_at: Callable[..., Sphere],
    reflectance: tuple[Array, Array] | None = None,
    rounds: int = 3,
) -> RimFit:
    """The rim about a first guess.

    image      (H, W, C)
    start      (3,) x, y, rim_px to within three pixels or so
    sphere_at  (x, y, rim_px) -> Sphere
    reflectance  of the sphere: angles of incidence (K,) in rad, ascending to pi/2, and the factor
                 there (K,); None for a perfect mirror
    rounds     each starts from the rim the last has found; where the first ends far from its
               start, it is done again from there
    """
    rim = np.array(start, np.float64)
    part = _Part(image, sphere_at(*rim))
    blur = part.blur_inside(rim)
    lens = _USUAL_LENS if np.isnan(blur) else float(np.sqrt(max(blur**2 - _SQUARE, 0.01)))
    edges = not np.isnan(blur)
    about, far = _WIDE, _TWICE
    while rounds:
        sectors = _Sectors(
            *_evidence_about(part, rim, sphere_at, reflectance, lens, about, edges), about
        )
        step = sectors.best(about.reach)
        rim = rim + step
        if about is _WIDE and far and np.abs(step).max() > _FAR:
            far -= 1  # near the end of the reach, where it may not end: once more
            continue
        rounds -= 1
        if about is _WIDE and not edges:
            lens = _likeliest_lens(part, rim, sphere_at, reflectance)
        about = _NEAR
    beyond = sectors.own - sectors.moves @ step
    sigma = sectors.sigma(step)
    return RimFit(
        rim=(float(rim[0]), float(rim[1]), float(rim[2])),
        sigma_px=(float(sigma[0]), float(sigma[1]), float(sigma[2])),
        residual_px=1.4826 * float(np.median(np.abs(beyond))),
        agrees=tuple(bool(a) for a in np.abs(beyond) < _AGREE),
        blur_px=float(np.sqrt(lens**2 + _SQUARE)),
    )


def _likeliest_lens(part: _Part, rim: Array, sphere_at, reflectance) -> float:
    """The blur of the lens, px, that explains what is seen across the rim best, wherever it is."""
    from scipy.interpolate import CubicSpline
    from scipy.special import logsumexp

    explained = []
    for lens in _LENSES:
        evidence, _ = _evidence_about(
            part, rim, sphere_at, reflectance, float(lens), _NEAR, edges=False
        )
        explained.append(float(logsumexp(_TEMPER * evidence, axis=1).sum()))
    fine = np.arange(_LENSES[0], _LENSES[-1], 0.01)
    return float(fine[np.argmax(CubicSpline(_LENSES, explained)(fine))])


def _evidence_about(
    part: _Part, rim: Array, sphere_at, reflectance, lens_px: float, about: _About, edges: bool
) -> tuple[Array, Array]:
    """Log likelihood (n, S) of the places about a guess of the rim, and how far (n, 3) they move
    outwards when its x, y and size grow by a pixel."""
    sphere = sphere_at(*rim)
    fitting = int(2.0 * np.pi * sphere.rim_px / _ALONG)
    outline = sphere.outline(int(np.clip(fitting, 2 * _SECTORS, _MOST)) * _ALONG)
    profiles, noise = part.profiles(outline, sphere.outward(outline), about.profile)
    middle = outline[_ALONG // 2 :: _ALONG]
    moves = np.stack(
        [10.0 * sphere_at(*(rim + d)).inside_px(middle) for d in 0.1 * np.eye(3)], axis=-1
    )
    table = None if reflectance is None else tuple(tuple(map(float, v)) for v in reflectance)
    # Rounded, so that rims of about one size share what is worked out for them.
    size = float(np.exp(np.round(np.log(sphere.rim_px) / 0.02) * 0.02))
    processes = _processes(round(lens_px, 2), size, table, about, edges)
    evidence = sum(
        _evidence(profiles[:, c], noise[:, c], edges, *processes) for c in range(profiles.shape[1])
    )
    return np.asarray(evidence), moves


class _Part:
    """The part of an image that holds the sphere, its channels added up, each by its mean."""

    def __init__(self, image: Measured, sphere: Sphere):
        from scipy.ndimage import spline_filter

        rim, margin = sphere.outline(), 12
        low = np.maximum(np.floor(rim.min(axis=0)).astype(int) - margin, 0)
        high = np.ceil(rim.max(axis=0)).astype(int) + margin
        part = (slice(low[1], high[1]), slice(low[0], high[0]))
        values = image.values[part]
        known = (image.valid[part] > 0.5) & np.isfinite(values).all(axis=-1)
        mean = np.abs(values[known]).mean(axis=0) if known.any() else np.ones(values.shape[-1])
        gain = (1.0 / np.maximum(mean, 1e-12)).astype(np.float32)
        self._corner = low.astype(np.float64)
        self._light = np.where(known, values @ gain, np.nan)
        self._variance = np.where(known, image.variance[part] @ gain**2, np.nan)
        # The spline's filter would spread a NaN along its row: gaps are filled, and cut out again.
        self._splines, self._noises = [], []
        for c in range(values.shape[-1]):
            light = values[..., c].astype(np.float64)
            filled = np.where(known, light, np.max(light, where=known, initial=0.0))
            self._splines.append(spline_filter(filled, order=3))
            self._noises.append(np.where(known, image.variance[part][..., c], np.nan))

    def blur_inside(self, rim: Array) -> float:
        """The blur of edges in the middle of the sphere, px; NaN where there are too few."""
        half = min(0.6 * rim[2], 700.0)
        x, y = rim[:2] - self._corner
        low = np.maximum(np.array([y - half, x - half]), 0).astype(int)
        square = (slice(low[0], int(y + half)), slice(low[1], int(x + half)))
        return edge_blur(self._light[square], self._variance[square])

    def profiles(self, outline: Array, outward: Array, profile: Array) -> tuple[Array, Array]:
        """Profiles (n, C, T) across the rim, averaged along it, and their noise's variances (n, C).

        outline, outward  (n * _ALONG, 2), as of the `Sphere`
        """
        from scipy.ndimage import map_coordinates

        place = outline[:, None] + profile[:, None] * outward[:, None] - self._corner
        at = np.stack([place[..., 1] - 0.5, place[..., 0] - 0.5])
        count = len(outline) // _ALONG
        profiles, noises = [], []
        for spline, variance in zip(self._splines, self._noises, strict=True):
            light = map_coordinates(spline, at, order=3, prefilter=False)
            noise = map_coordinates(variance, at, order=1, cval=np.nan).mean(axis=-1)
            light[~np.isfinite(noise)] = np.nan
            profiles.append(light.reshape(count, _ALONG, -1).mean(axis=1))
            # Divided by less than their number: neighbours share pixels.
            noises.append(noise.reshape(count, _ALONG).mean(axis=1) / (_ALONG - 2))
        return np.stack(profiles, axis=1), np.stack(noises, axis=1)


# ------------------------------------------------------------------------- what profiles look like


@dataclass(frozen=True)
class _World:
    """What may lie behind a sphere, in variances of a profile's parts.

    prior    how likely it is
    walk     random walk in sqrt(e), from the rim
    terms    in sqrt(e), e, e^1.5
    outside  random walk of the background, per px
    edges    indices to _EDGES: between which bounds there is an edge
    after    random walk in sqrt(e) from the first edge inwards
    """

    prior: float
    walk: float
    terms: tuple[float, float, float]
    outside: float
    edges: tuple[int, ...] = ()
    after: float = 0.0


def _worlds() -> list[_World]:
    root = np.sqrt(_EDGES)
    first = np.diff(root) * np.exp(-0.5 * _RATE * (root[:-1] + root[1:]))
    first /= first.sum()
    worlds = []
    # The background is the world as well, but seen at 30 radii; though it may be clutter, down to
    # what changes from pixel to pixel.
    for outside, share in ((1e-3, 0.7), (3e-2, 0.15), (0.3, 0.15)):
        worlds += [
            _World(0.1 * share, 0.3, (1.0, 0.0, 0.0), outside),
            _World(0.3 * share, 0.01, (1.0, 1.0, 0.3), outside),
        ]
        few = 3e-3, (1e-2, 1e-2, 0.0), outside
        for i, likely in enumerate(first):
            worlds.append(_World(0.3 * share * likely, *few, (i,)))
            worlds.append(_World(0.6 * share * likely, *few, (i,), 0.5))
            if outside < 1e-2:
                worlds += [
                    _World(0.4 * share * likely * first[j], *few, (i, j))
                    for j in range(i + 1, len(first))
                ]
    return worlds


_WORLDS = _worlds()


@cache
def _prior(edges: bool) -> Array:
    """How likely each world is, of all or of those that have no edge."""
    prior = np.array([w.prior for w in _WORLDS if edges or not w.edges])
    return np.asarray(prior / prior.sum(), np.float32)


@cache
def _spread(lens_px: float) -> tuple[Array, Array]:
    """Positions (K,) px and weights (K,): the lens's Gaussian, a pixel's square, and the cardinal
    spline that reads between pixels (Unser 1999, Splines: a perfect fit, equation 18)."""
    step, reach = 0.05, 200
    x = np.linspace(-reach * step, reach * step, 2 * reach + 1)
    pole = np.sqrt(3.0) - 2.0
    cardinal = np.zeros_like(x)
    for k in range(-6, 7):
        away = np.abs(x - k)
        near = 2.0 / 3.0 - away**2 + away**3 / 2.0
        spline = np.where(away < 1, near, np.maximum(2.0 - away, 0.0) ** 3 / 6.0)
        cardinal += -6.0 * pole / (1.0 - pole * pole) * pole ** abs(k) * spline
    square = np.clip((0.5 - np.abs(x)) / step + 0.5, 0.0, 1.0)
    kernel = np.exp(-0.5 * (x / lens_px) ** 2)
    kernel = np.convolve(np.convolve(kernel, square, "same"), cardinal, "same")
    wide = int(np.ceil((3.0 * lens_px + 2.0) / step / 2)) * 2
    part = slice(reach - wide, reach + wide + 1, 2)
    weight: Array = kernel[part] / kernel[part].sum()
    return x[part], weight


@lru_cache(maxsize=64)
def _processes(
    lens_px: float,
    rim_px: float,
    reflectance: tuple[Any, ...] | None,
    about: _About,
    edges: bool,
) -> tuple[Array, Array, Array]:
    """Eigenvalues (W, S, T) and vectors (W, S, T, T) of profiles' covariances, and dips (S, T).

    One for each world and place of the rim; a profile's mean is projected out. The dip is how much
    darker than the light outside the metal makes a profile.
    """
    spread, weight = _spread(lens_px)
    size = len(about.profile)
    centred = np.eye(size) - 1.0 / size
    x = (about.profile[:, None] + spread).ravel()

    def blurred(parts) -> Array:  # (T * K, P) -> (T, P)
        return np.asarray(
            centred @ np.tensordot(weight, parts.reshape(size, len(weight), -1), (0, 1))
        )

    nodes = np.linspace(0.0, 2.6, 40)  # a walk is a sum of many small steps
    back = np.arange(0.0, 5.0, 0.25)
    inner, outer = np.sqrt(_EDGES[:-1, None]), np.sqrt(_EDGES[1:, None])
    within = (inner + (outer - inner) * (np.arange(4) + 0.5) / 4) ** 2  # an edge is at one of them
    width = np.maximum(np.gradient(within.ravel()), 0.01)
    worlds = [w for w in _WORLDS if edges or not w.edges]
    covariance = np.empty((len(worlds), len(about.places), size, size))
    dips = np.empty((len(about.places), size))
    for s, place in enumerate(about.places):
        inside, outside = (np.maximum(v, 0.0)[:, None] for v in (place - x, x - place))
        factor = np.ones_like(inside)
        if reflectance is not None:
            # At e px inside, the sine of the angle of incidence is (rim - e) / rim.
            sine = 1.0 - np.clip(inside / rim_px, 0.0, 1.0)
            factor = np.interp(np.arcsin(sine), *reflectance)
        dips[s] = blurred(factor - 1.0)[:, 0]
        root = np.sqrt(inside)
        steps = blurred(factor * np.clip(root - nodes, 0.0, nodes[1])) / np.sqrt(nodes[1])
        walks = [steps[:, nodes > r - 1e-9] for r in (0.0, *outer[:, 0])]
        walk, *after = [w @ w.T for w in walks]
        background = blurred(np.clip(outside - back, 0.0, back[1])) / np.sqrt(back[1])
        background = background @ background.T
        smooth = blurred(factor * np.concatenate([root, inside, inside**1.5], axis=1))
        edge = blurred(
            factor * (inside > 0) * np.clip((inside - within.ravel()) / width + 0.5, 0.0, 1.0)
        ).reshape(size, *within.shape)
        steps_at = np.einsum("tjk,ujk->jtu", edge, edge) / within.shape[1]
        for w, world in enumerate(worlds):
            terms = smooth * np.sqrt(world.terms)
            sum_ = world.walk * walk + world.outside * background + terms @ terms.T
            sum_ += steps_at[list(world.edges)].sum(axis=0)
            if world.after:
                sum_ += world.after * after[world.edges[0]]
            covariance[w, s] = sum_
    values, vectors = np.linalg.eigh(covariance)
    return (
        np.maximum(values, 0.0).astype(np.float32),
        vectors.astype(np.float32),
        dips.astype(np.float32),
    )


def _evidence(profiles: Array, noise: Array, edges: bool, eigenvalues, vectors, dips) -> Array:
    """Log likelihood (n, S) of the places by profiles (n, T) with noise of variance (n,).

    Averaged over worlds and contrasts; 0 throughout where a profile is not known.
    """
    usable = np.isfinite(profiles).all(axis=-1) & np.isfinite(noise)
    profile = np.where(usable[:, None], profiles, 0.0)
    least = noise + (_MODEL_ERROR * np.ptp(profile, axis=-1)) ** 2
    profile = profile / np.sqrt(np.where(usable & (least > 0), least, 1.0))[:, None]
    outside = profile[:, -_OUTER:].mean(axis=-1, keepdims=True)
    profile = profile - profile.mean(axis=-1, keepdims=True)
    rest = profile.astype(np.float32) - outside.astype(np.float32) * dips[:, None]  # (S, n, T)
    contrast = _CONTRAST.astype(np.float32)
    gain = 1.0 / (1.0 + eigenvalues[..., None] * contrast)  # (W, S, T, R)
    volume = 0.5 * np.log(gain).sum(axis=-2)[:, :, None]
    most = np.full((len(dips), len(profile)), -np.inf, np.float32)
    logs = []
    for w in range(len(eigenvalues)):
        log = volume[w] - 0.5 * ((rest @ vectors[w]) ** 2 @ gain[w])  # (S, n, R)
        logs.append(log)
        most = np.maximum(most, log.max(axis=-1))
    total = np.zeros_like(most)
    for prior, log in zip(_prior(edges), logs, strict=True):
        total += prior * np.exp(np.maximum(log - most[..., None], -60.0)).mean(axis=-1)
    return np.where(usable[:, None], (most + np.log(total)).T.astype(np.float64), 0.0)


def _robust(evidence: Array) -> Array:
    """Tempered log likelihoods (n, S) of places, if a few profiles may show anything."""
    tempered = _TEMPER * evidence
    likelihood = np.exp(tempered - tempered.max(axis=1, keepdims=True))
    mean = likelihood.mean(axis=1, keepdims=True)
    return np.asarray(np.log((1.0 - _ANYTHING) * likelihood + _ANYTHING * mean))


class _Sectors:
    """What the sectors of a rim say.

    own    (K,) the place outwards, px, each holds likeliest
    moves  (K, 3) how far its place moves when x, y and size grow by a pixel
    """

    def __init__(self, evidence: Array, moves: Array, about: _About):
        from scipy.interpolate import CubicSpline

        likely, places = _robust(evidence), about.places
        self._fine = np.arange(places[0], places[-1] + 1e-9, _FINE)
        first = np.arange(_SECTORS) * len(likely) // _SECTORS
        count = np.diff(np.append(first, len(likely)))[:, None]
        log = np.add.reduceat(likely, first, axis=0)
        log = CubicSpline(places, log, axis=1)(self._fine)
        self._log = log - log.max(axis=1, keepdims=True)
        self.own = self._fine[np.argmax(log, axis=1)]
        self.moves = np.add.reduceat(moves, first, axis=0) / count

    def likelihood(self, steps) -> Array:
        """Log likelihood (..., K) of rims moved by steps (..., 3)."""
        place = np.asarray(steps) @ self.moves.T
        at = np.clip((place - self._fine[0]) / _FINE, 0, len(self._fine) - 1.001)
        low = at.astype(int)
        share, k = at - low, np.arange(len(self.own))
        log = self._log[k, low] * (1.0 - share) + self._log[k, low + 1] * share
        outside = 0.5 + 0.5 * np.tanh((place - self.own) / 0.2)
        return np.log(np.exp(log) + _BEYOND + (_ASTRAY - _BEYOND) * outside)

    def best(self, reach: Array) -> Array:
        """The likeliest step (3,), of all within a reach of steps along each axis."""
        grid = np.stack(np.meshgrid(reach, reach, reach, indexing="ij"), axis=-1).reshape(-1, 3)
        return self._climb(grid[np.argmax(self.likelihood(grid).sum(axis=-1))], slice(None))

    def sigma(self, step: Array) -> Array:
        """Standard errors (3,) of a step: a jackknife that leaves out an arc at a time.

        Neighbouring sectors are wrong together, so nothing is to be learnt from their number.
        """
        arc = np.arange(_SECTORS) * _ARCS // _SECTORS
        without = np.stack([self._climb(step, arc != k) for k in range(_ARCS)])
        spread = without - without.mean(axis=0)
        variance = (_ARCS - 1) / _ARCS * np.sum(spread**2, axis=0)
        return np.asarray(np.sqrt(_UNTOLD**2 * variance + _LEAST_SIGMA**2))

    def _climb(self, start: Array, counted) -> Array:
        from scipy.optimize import minimize

        return np.asarray(
            minimize(
                lambda s: -self.likelihood(s)[counted].sum(),
                start,
                method="Nelder-Mead",
                options={
                    "initial_simplex": start + np.vstack([np.zeros(3), 0.1 * np.eye(3)]),
                    "xatol": 2e-3,
                    "fatol": 1e-4,
                },
            ).x
        )
