"""How several cameras about one sphere lie to each other, told by what the sphere shows each.

Each view's map has +Z towards its own camera. Two maps of one distant world differ by a rotation:
first all rotations are tried, evenly spread, on maps so coarse that the nearest is not far; the
best are followed downhill, and of these the one whose texture matches best is taken. Then all pairs
of views together are brought to lie on each other in least squares, from coarse maps to fine ones.

What is compared are logarithms of the light: lamps count no more than walls. What only one view
sees - a camera, its tripod, the photographer - differs by much, and so counts for nothing (Tukey's
biweight, A. E. Beaton and J. W. Tukey 1974). What is near stands elsewhere in each map, as each
camera sees it from another place on the mirror: by r / L for a sphere of radius r at a distance L.
Unless it is part of the model it turns the maps, as rooms are not the same on all sides; so the
inverse distance, a smooth function of direction, is solved for beside the rotations. And so is by
how much the sphere's reflectance rises otherwise towards the rim than was said: the light has a
colour that one mean reflectance does not know, and a per cent of it turns the maps of a dim, even
world by half a degree.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calibration.errors import fault
from stages import cube
from stages.align import Alignment
from stages.mirror import Array, Sphere
from stages.normalise import reflectance_at
from stages.types import Float, Measured
from stages.unwrap import unwrap

_FINEST = 128  # texels along a face: a twentieth of a degree is a fourteenth of a texel there
_SIZES = (8, 16, 32)  # texels along a face, that rotations are looked for on, one after the other
_ROTATIONS = 24000  # tried; the farthest from any is some 8 degrees away, and a texel of 8 has 11
_KEPT = (1500, 300, 100)  # of them
_FOLLOWED = 12  # of those, and those so far apart ...
_APART = np.radians(15.0)  # ... are others
_BOXES = 48  # along each axis, that directions are sorted into
_BEFORE_CAMERA = np.radians(45.0)  # where it, and who took the photograph, are to be seen
_HINT = np.radians(35.0)  # how far off a hint may be
_DARK = 0.02  # of the median light: below it logarithms tell noise from noise
_BROAD_RAD = np.radians(12.0)  # sigma of what is taken away before textures are correlated

LEAST_CORRELATION = 0.3  # of textures; those of two worlds stay below .25
LEAST_LEAD = 0.08  # over the second best, which is another rotation
NEAR_PER_M = 0.1  # with a sphere of 100 mm, half a degree between two views
LARGEST_GAIN = 0.02  # by which views may differ in brightness before it is worth telling

_ROUNDS = 12  # of least squares, at each size
_STILL = np.radians(1e-3)  # a round that moves no view by more is the last
_LARGEST_STEP = np.radians(10.0)
_FAR = 4.685  # robust standard deviations, from which on a texel counts for nothing
_LEAST_SPREAD = 0.01  # of logarithms: reflectances and demosaicing are no better
_EDGE = 0.5  # texels by which an edge may seem to be elsewhere
_NEARNESS_PER_M = 2.0  # 1 / L that is thought likely, standard deviation
_REFLECTANCE_OFF = 0.1  # by which logarithms of reflectance may be off, likewise
_POWERS = np.arange(1, 4)  # of sin^2 of the incidence, in which they are
_PASSES = 3  # of laying the views out anew where walls are near, whose parallax depends on the turn
_SETTLED = np.radians(0.005)


@dataclass(frozen=True)
class Place:
    """Where a camera roughly stands, from the first view's.

    yaw_deg    to the right as the first camera sees it: 90 is in its world's +X
    pitch_deg  above the plane through the sphere that the first camera's right and forward span
    """

    yaw_deg: float
    pitch_deg: float = 0.0

    @property
    def turn(self) -> Array:
        """Rotation (3, 3) to the first view's world from that of an upright camera there."""
        turn = Rotation.from_euler("YX", [self.yaw_deg, -self.pitch_deg], degrees=True)
        return np.asarray(turn.as_matrix())


@dataclass(frozen=True)
class Orientation:
    """How one view lies to the first.

    turn         (3, 3) rotation from its own world, +Z towards its camera, to the first view's
    sigma_deg    standard deviation of that, about the worst axis, from how the map's parts agree
    correlation  of its texture with the first's, as they lie then
    gain         its light over the first view's, as its first filter sees it
    """

    turn: list[list[float]]
    sigma_deg: float
    correlation: float
    gain: float


@dataclass(frozen=True)
class Orientations:
    """How all views lie, the first first.

    nearness_per_m  mean over directions of 1 / distance of what is seen; 0 where a room's walls
                    were given, and so not asked for
    """

    views: list[Orientation]
    nearness_per_m: float


def orient(
    images: Sequence[Measured],
    spheres: Sequence[Sphere],
    *,
    names: Sequence[str],
    places: Sequence[Place | None],
    reflectance: tuple[Array, Array] | None = None,
) -> Orientations:
    """The rotations that bring several views of one sphere into the first view's world.

    images       of one filter, (H, W, C), one a view
    spheres      as they are seen there; their `turn` is not looked at
    names        of the views, for messages
    places       where cameras roughly stand; None where that is not known
    reflectance  angles (K,) rad and the sphere's mean reflectance (K,) there

    raises InputError where a view shows nothing of what the first one shows, or fits it in more
    than one way
    """
    distant = [replace(s, room=None, turn=None, yaw_deg=0.0) for s in spheres]
    maps = [_map(i, s, reflectance) for i, s in zip(images, distant, strict=True)]
    turns = [np.eye(3)]
    for other, place, name in zip(maps[1:], places[1:], names[1:], strict=True):
        turns.append(_found(maps[0], other, place, f"{name!r}", f"{names[0]!r}"))
    fitted = _fitted(maps, distant, turns)
    for _ in range(_PASSES if any(s.room is not None for s in spheres) else 0):
        before = fitted.turns
        turned = [
            replace(s, turn=t.tolist(), yaw_deg=0.0) for s, t in zip(spheres, before, strict=True)
        ]
        maps = [_map(i, s, reflectance) for i, s in zip(images, turned, strict=True)]
        still = [np.eye(3)] * len(maps)
        fitted = _fitted(maps, turned, still, walls_known=True, sizes=(_FINEST,))
        fitted = replace(fitted, turns=[d @ t for d, t in zip(fitted.turns, before, strict=True)])
        moved = max(_angle(a @ b.T) for a, b in zip(fitted.turns, before, strict=True))
        if moved < _SETTLED:
            break
    views = [
        Orientation(t.tolist(), s, c, g)
        for t, s, c, g in zip(
            fitted.turns, fitted.sigma_deg, fitted.correlation, fitted.gain, strict=True
        )
    ]
    return Orientations(views, fitted.nearness_per_m)


def warnings(found: Orientations, names: Sequence[str]) -> list[str]:
    """What the photographer should know, a sentence each."""
    said = []
    for view, name in zip(found.views[1:], names[1:], strict=True):
        if abs(view.gain - 1.0) > LARGEST_GAIN:
            said.append(
                f"{name}: all light is {view.gain:.3g} times that of {names[0]}; it changed between"
                " the views, or exposure did by more than the tags say"
            )
    if found.nearness_per_m > NEAR_PER_M:
        said.append(
            f"what is about the sphere is near, {1.0 / found.nearness_per_m:.1f} m on average, and"
            " seen elsewhere in each view: measure the walls and give them as [room]"
        )
    return said


# ------------------------------------------------------------------------------------- the maps


@dataclass(frozen=True)
class _Map:
    """Light, of whatever colour, and weight on a cubemap, both (6, n, n); 0 where not known."""

    values: Float
    weight: Float

    def at(self, size: int) -> _Map:
        """The same with `size` texels along a face, or as few as it has."""
        result = self
        while result.weight.shape[1] > size:
            weight = _fours(result.weight)
            values = _fours(result.values * result.weight) / np.maximum(weight, 1e-6)
            result = _Map(values.astype(np.float32), weight / np.float32(4.0))
        return result

    @property
    def level(self) -> float:
        """The median light."""
        known = self.weight > 0
        return max(float(np.median(self.values[known])), 1e-30) if known.any() else 1.0

    def logs(self, level: float) -> Float:
        """Logarithms of the light over `level`; linear, about, in what is dark or noise."""
        logs = np.arcsinh(self.values / (2.0 * _DARK * level)) - np.arcsinh(0.5 / _DARK)
        return np.where(self.weight > 0, logs, 0.0).astype(np.float32)

    @property
    def clipped(self) -> Float:
        """Logarithms, those far from the middle no further than three spreads: lamps are small."""
        logs, known = self.logs(self.level), self.weight > 0
        if not known.any():
            return logs
        low, middle, high = np.quantile(logs[known], [0.16, 0.5, 0.84])
        reach = 1.5 * (high - low) + 1e-6
        return np.clip(logs, middle - reach, middle + reach)


def _fours(a: Float) -> Float:
    """Sums (6, n / 2, n / 2) of four texels."""
    return a[:, ::2, ::2] + a[:, 1::2, ::2] + a[:, ::2, 1::2] + a[:, 1::2, 1::2]


def _map(image: Measured, sphere: Sphere, reflectance) -> _Map:
    """What the sphere shows, its own reflectance divided out, weighted by how finely it does."""
    n = _FINEST
    still = Alignment(np.zeros((1, 2)), np.ones(1), np.zeros(1))
    bands = unwrap([image], sphere, still, face_size=n)
    d = cube.directions(n)
    values = bands.values.mean(axis=-1)
    if reflectance is not None:
        angles, factors = reflectance
        values = (
            values / reflectance_at(sphere.incidence_angle(d), angles, factors[:, None])[..., 0]
        )
    known = (bands.valid > 0) & np.isfinite(values)
    # A texel finer than the photograph is a blurred one, and tells less of where things are.
    fine = np.minimum(1.0, sphere.pixels_per_radian(d) * (pi / 2 / n)) ** 2
    weight = np.where(known, bands.valid * fine, 0.0).astype(np.float32)
    return _Map(np.where(known, values, 0.0).astype(np.float32), weight)


# --------------------------------------------------------------------------- the rotation, roughly


def _found(first: _Map, other: _Map, place: Place | None, name: str, first_name: str) -> Array:
    """The rotation (3, 3) that brings a view upon the first, to a degree or so."""
    first, other = _past_camera(first), _past_camera(other)
    tried = _rotations(_ROTATIONS)
    if place is not None:
        turn = tried @ place.turn.T
        cosine = (np.trace(turn, axis1=1, axis2=2) - 1.0) / 2.0
        tried = np.concatenate([place.turn[None], tried[cosine > np.cos(_HINT)]])
    for size, kept in zip(_SIZES, _KEPT, strict=True):
        score = _correlations(first.at(size), other.at(size), tried)
        tried = tried[np.argsort(-score)[:kept]]
    best: list[Array] = []
    for turn in tried:
        if len(best) < _FOLLOWED and all(_angle(turn @ t.T) > _APART / 2 for t in best):
            best.append(turn)
    ends = _followed(first, other, best, _SIZES[1])
    ends = _followed(first, other, [turn for _, turn in ends[:3]], _SIZES[2])
    correlation, turn = ends[0]
    others = [c for c, t in ends[1:] if _angle(t @ turn.T) > _APART]
    remedy = (
        "check that both are of one sphere, left in its place, in the same light"
        + (", or give yaw_deg and pitch_deg of" if place is None else ", and yaw_deg, pitch_deg of")
        + " its camera in [[view]]"
    )
    if correlation < LEAST_CORRELATION:
        raise fault(
            f"the view {name} shows nothing that the view {first_name} shows"
            f" (correlation {correlation:.2f})",
            f"the same surroundings, {LEAST_CORRELATION} or more",
            remedy,
        )
    if others and correlation - max(others) < LEAST_LEAD:
        raise fault(
            f"the view {name} fits the view {first_name} in more than one way"
            f" (correlation {correlation:.2f} and {max(others):.2f})",
            "surroundings that look different on each side",
            remedy,
        )
    return turn


def _past_camera(m: _Map) -> _Map:
    """Without what is before the camera: photographers look alike from wherever they stand."""
    ahead = cube.directions(m.weight.shape[1])[..., 2] > np.cos(_BEFORE_CAMERA)
    return _Map(m.values, np.where(ahead, np.float32(0.0), m.weight))


def _followed(first: _Map, other: _Map, turns: Sequence[Array], size: int):
    """Rotations made better, one of those that end alike, each with its correlation, best first."""
    a, b = first.at(size), other.at(size)
    better = [_least_squares([a, b], None, [np.eye(3), t], rounds=6).turns[1] for t in turns]
    ends = [(_texture_correlation(a, b, turn), turn) for turn in better]
    ends.sort(key=lambda end: -end[0])
    different: list[tuple[float, Array]] = []
    for end in ends:
        if all(_angle(end[1] @ turn.T) > _APART for _, turn in different):
            different.append(end)
    return different


def _rotations(count: int) -> Array:
    """Rotations (count, 3, 3), spread evenly: super-Fibonacci spirals (M. Alexa, CVPR 2022)."""
    s = np.arange(count) + 0.5
    r, big_r = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    a, b = 2.0 * pi * s / sqrt(2.0), 2.0 * pi * s / 1.533751168755204288118041
    quaternions = np.stack([r * np.sin(a), r * np.cos(a), big_r * np.sin(b), big_r * np.cos(b)])
    return np.asarray(Rotation.from_quat(quaternions.T).as_matrix())


def _correlations(first: _Map, other: _Map, turns: Array) -> Array:
    """How well the other map (k, 3, 3) rotations matches the first: (k,) correlations."""
    n = first.weight.shape[1]
    seen = first.weight.reshape(-1) > 0
    d = cube.directions(n).reshape(-1, 3)[seen].astype(np.float32)
    omega = (first.weight * cube.solid_angles(n)).reshape(-1)[seen].astype(np.float32)
    a = first.clipped.reshape(-1)[seen]
    b, b_weight = other.clipped.reshape(-1), other.weight.reshape(-1)
    result = np.empty(len(turns))
    table = _texels(n)
    for start in range(0, len(turns), 256):
        some = turns[start : start + 256].astype(np.float32)
        box = ((d @ some + np.float32(1.0)) * np.float32(_BOXES / 2.0001)).astype(np.int32)
        texel = table[(box[..., 0] * _BOXES + box[..., 1]) * _BOXES + box[..., 2]]
        w = b_weight[texel] * omega
        w /= np.maximum(w.sum(axis=1, keepdims=True), 1e-9)
        there = b[texel]
        mean_a, mean_b = w @ a, np.sum(w * there, axis=1)
        product = np.sum(w * there * a, axis=1) - mean_a * mean_b
        spread_a = w @ a**2 - mean_a**2
        spread_b = np.sum(w * there**2, axis=1) - mean_b**2
        result[start : start + 256] = product / np.sqrt(np.maximum(spread_a * spread_b, 1e-12))
    return result


@cache
def _texels(n: int) -> NDArray[np.int32]:
    """The flat index of a cubemap's texel for each of the boxes that fill the cube of directions.

    Coarser than `cube.face_positions` by half a box, and many times quicker.
    """
    t = (np.arange(_BOXES) + 0.5) * (2.0 / _BOXES) - 1.0
    face, u, v = cube.face_positions(np.stack(np.meshgrid(t, t, t, indexing="ij"), axis=-1))
    column, row = (np.clip(((p + 1.0) * (n / 2)).astype(np.int32), 0, n - 1) for p in (u, v))
    return ((face.astype(np.int32) * n + row) * n + column).reshape(-1)


def _texture_correlation(first: _Map, other: _Map, turn: Array) -> float:
    """Of what is left of the maps without what changes slowly over them."""
    n = first.weight.shape[1]
    there = cube.sample(np.stack([other.clipped, other.weight], axis=-1), cube.directions(n) @ turn)
    weight = np.sqrt(first.weight * there[..., 1])
    pair = np.stack([first.clipped, there[..., 0]], axis=-1)
    sigma = _BROAD_RAD / (pi / 2 / n)
    broad = cube.blurred(pair * weight[..., None], sigma)
    broad = broad / np.maximum(cube.blurred(weight[..., None], sigma), 1e-6)
    a, b = np.moveaxis((pair - broad) * np.sqrt(weight)[..., None], -1, 0)
    return float(np.sum(a * b) / np.sqrt(max(np.sum(a * a) * np.sum(b * b), 1e-30)))


def _angle(turn: Array) -> float:
    """By how much a rotation turns, rad."""
    return float(Rotation.from_matrix(turn).magnitude())


# --------------------------------------------------------------------------- and all of them, well


@dataclass(frozen=True)
class _Fit:
    """See `Orientation` and `Orientations`; all lists one a view, the first first."""

    turns: list[Array]
    sigma_deg: list[float]
    gain: list[float]
    correlation: list[float]
    nearness_per_m: float


def _fitted(
    maps: Sequence[_Map],
    spheres: Sequence[Sphere],
    turns,
    *,
    walls_known: bool = False,
    sizes=(32, 64, _FINEST),
) -> _Fit:
    """All views brought upon each other, from coarse maps to the finest.

    walls_known  what is left of parallax then is furniture, which no smooth function of direction
                 follows
    """
    finest = min(m.weight.shape[1] for m in maps)
    fit = None
    for size in dict.fromkeys(min(s, finest) for s in sizes):
        some = [m.at(size) for m in maps]
        turns = turns if fit is None else fit.turns
        fit = _least_squares(some, spheres, turns, parallax=not walls_known, rounds=_ROUNDS)
    assert fit is not None
    return fit


def _least_squares(
    maps: Sequence[_Map], spheres, turns, *, rounds: int, parallax: bool = False
) -> _Fit:
    """Rotations, gains, reflectance and nearness by Gauss and Newton, over all pairs of views.

    A small rotation by delta moves a map's content f at d by -delta . (d x grad f); a point at
    distance L in direction d appears at d - t / L, with t the part across d of where on the mirror
    it is seen. Both are linear, with the mean slope of the two views of a pair.

    spheres   None for rotations and gains alone
    parallax  whether 1 / L is an unknown
    """
    n, count = maps[0].weight.shape[1], len(maps)
    turns = [np.asarray(t) for t in turns]
    d = cube.directions(n)
    omega = np.tile(cube.solid_angles(n).reshape(-1) * n * n, 6)
    basis = _quadratic(d).reshape(-1, 9) if parallax else np.empty((len(omega), 0))
    level = maps[0].level
    fields = [_field(m, level) for m in maps]
    pairs = list(itertools.combinations(range(count), 2))
    others = count - 1
    # The unknowns: three of a rotation and a gain for each view but the first, the reflectance, and
    # nearness.
    of_view = [(slice(3 * (v - 1), 3 * v), 3 * others + v - 1) for v in range(count)]
    reflecting = slice(4 * others, 4 * others + (0 if spheres is None else len(_POWERS)))
    near = slice(reflecting.stop, None)
    unknowns = near.start + basis.shape[1]
    x = np.zeros(unknowns)
    for _ in range(rounds):
        seen = [_seen(f, t, d) for f, t in zip(fields, turns, strict=True)]
        own = [] if spheres is None else list(zip(spheres, turns, strict=True))
        rising = [_rising(s, t, d) for s, t in own]
        places = [_across(s, t, d) for s, t in own] if parallax else []
        equations = []
        for i, j in pairs:
            left, slopes, weight = _pair(seen[i], seen[j])
            some = np.flatnonzero(weight)
            slopes = slopes[some]
            jacobian = np.zeros((len(some), unknowns))
            for view, sign in ((i, 1.0), (j, -1.0)):
                if view:
                    turning, gaining = of_view[view]
                    jacobian[:, turning] = sign * slopes
                    jacobian[:, gaining] = -sign
            gradient = np.cross(d.reshape(-1, 3)[some], slopes)
            if rising:
                jacobian[:, reflecting] = (rising[i] - rising[j])[some]
            if places:
                apart = np.sum(gradient * (places[i] - places[j]).reshape(-1, 3)[some], axis=1)
                jacobian[:, near] = -apart[:, None] * basis[some]
            left = left[some] + jacobian[:, 3 * others :] @ x[3 * others :]
            # Beside an edge maps differ by more, if only as one is sharper than the other.
            allowed = np.linalg.norm(gradient, axis=1) * (_EDGE * pi / 2 / n)
            equations.append((some, left, jacobian, (weight * omega)[some], allowed))
        spread = _spread([e[1] for e in equations], [e[3] for e in equations])
        normal, right = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
        scores = np.zeros((len(omega), unknowns))
        for some, left, jacobian, weight, allowed in equations:
            scale = spread**2 + allowed**2
            usual = np.maximum(1.0 - left**2 / (_FAR**2 * scale), 0.0) ** 2
            weighted = jacobian * (weight * usual / scale)[:, None]
            normal += weighted.T @ jacobian
            right -= weighted.T @ left
            scores[some] += weighted * left[:, None]
        prior = np.full(unknowns, 1e-9 * np.trace(normal) / unknowns)
        prior[reflecting] += _REFLECTANCE_OFF**-2
        prior[near] += _NEARNESS_PER_M**-2
        right[4 * others :] -= (prior * x)[4 * others :]
        step = np.linalg.solve(normal + np.diag(prior), right)
        x[3 * others :] += step[3 * others :]
        moves = step[: 3 * others].reshape(-1, 3)
        size = np.linalg.norm(moves, axis=1)
        moves = moves * np.minimum(1.0, _LARGEST_STEP / np.maximum(size, 1e-12))[:, None]
        for view, move in enumerate(moves, 1):
            turns[view] = np.asarray(Rotation.from_rotvec(move).as_matrix()) @ turns[view]
        if size.max() < _STILL:
            break
    # What neighbours differ by they differ by together: the parts of the sphere are independent.
    parts = n // min(n, 4)
    blocks = scores.reshape(6, -1, parts, n // parts, parts, unknowns).sum(axis=(2, 4))
    inverse = np.linalg.inv(normal + np.diag(prior))
    turned = np.einsum("ij,...j->...i", inverse, blocks).reshape(-1, unknowns)
    covariance = turned.T @ turned
    worst = [np.linalg.eigvalsh(covariance[s, s])[-1] for s, _ in of_view[1:]]
    textures = [
        _texture_correlation(maps[0], m, t) for m, t in zip(maps[1:], turns[1:], strict=True)
    ]
    return _Fit(
        turns,
        [0.0, *np.degrees(np.sqrt(worst)).tolist()],
        [1.0, *np.exp(x[3 * others : 4 * others]).tolist()],
        [1.0, *textures],
        float(np.average(basis @ x[near], weights=omega)),
    )


def _spread(values: Sequence[Array], weights: Sequence[Array]) -> float:
    """Weighted median of what is left, as the standard deviation that normal values would have."""
    left, weight = np.abs(np.concatenate(values)), np.concatenate(weights)
    order = np.argsort(left)
    total = np.cumsum(weight[order])
    middle = left[order[np.searchsorted(total, total[-1] / 2.0)]]
    return max(float(middle) / 0.6745, _LEAST_SPREAD)


def _field(m: _Map, level: float) -> Float:
    """A map's logarithms, their slopes by rotations about its X, Y, Z, and its weight.

    returns  (6, n, n, 5)
    """
    n = m.weight.shape[1]
    logs = m.logs(level)[..., None]
    d = cube.directions(n)
    half = 0.5 * pi / 2 / n
    slopes = []
    for axis in np.eye(3):
        # The content turned by +h has at d what was at d turned back.
        ahead, behind = (
            cube.sample(logs, d @ Rotation.from_rotvec(h * axis).as_matrix()) for h in (half, -half)
        )
        slopes.append((ahead - behind) / np.float32(2 * half))
    return np.concatenate([logs, *slopes, m.weight[..., None]], axis=-1)


def _seen(field: Float, turn: Array, d: Array):
    """A field turned: logs (t,), slopes (t, 3) by rotations about the first's axes, weight (t,)."""
    still = np.array_equal(turn, np.eye(3))
    there = (field if still else cube.sample(field, d @ turn)).reshape(-1, 5)
    # About an axis a of the first's is about turn.T @ a of its own.
    return there[:, 0], there[:, 1:4] @ turn.T, there[:, 4]


def _pair(one, other):
    """What two fields differ by (t,), their mean slopes (t, 3), and weight (t,)."""
    weight = np.where(np.minimum(one[2], other[2]) > 0, np.sqrt(one[2] * other[2]), 0.0)
    return one[0] - other[0], 0.5 * (one[1] + other[1]), weight


def _incidence(sphere: Sphere, turn: Array, d: Array) -> tuple[Array, Array]:
    """Angle of incidence (6, n, n), rad, of directions, and where the camera is (3,)."""
    own = replace(sphere, room=None, yaw_deg=0.0, turn=None)
    turn = turn if sphere.turn is None else turn @ np.asarray(sphere.turn)
    return np.nan_to_num(own.incidence_angle(d @ turn), nan=pi / 2), turn[:, 2]


def _rising(sphere: Sphere, turn: Array, d: Array) -> Array:
    """Shapes (6 n n, P) that the logarithm of the reflectance may have over the incidence."""
    incidence, _ = _incidence(sphere, turn, d)
    return np.asarray((np.sin(incidence) ** 2).reshape(-1, 1) ** _POWERS)


def _across(sphere: Sphere, turn: Array, d: Array) -> Array:
    """Where on the mirror directions are seen, m, less what lies along them: (6, n, n, 3)."""
    incidence, towards = _incidence(sphere, turn, d)
    # The normal lies between the direction and the axis, by the angle of incidence from the first.
    aside = towards - (d @ towards)[..., None] * d
    aside /= np.maximum(np.linalg.norm(aside, axis=-1, keepdims=True), 1e-9)
    reach = np.sin(incidence)[..., None]
    place: Array = sphere.radius_mm * 1e-3 * reach * aside
    return place


def _quadratic(d: Array) -> Array:
    """A quadratic's terms (..., 9) in directions (..., 3)."""
    x, y, z = np.moveaxis(d, -1, 0)
    terms = [np.ones_like(x), x, y, z, x * y, y * z, z * x, x * x - y * y, 3 * z * z - 1]
    return np.stack(terms, axis=-1)
