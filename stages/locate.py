"""Find the sphere in the photograph: its rim to a fraction of a pixel, and so its place in space.

A circle is voted for by the image's gradients at low resolution, in logarithm, so that a lamp is
worth no more votes than a dark edge; then the one model that is right, the image of a cone of
tangents, is fitted to the rim at that resolution and, halving the pixel each time, up to the full.
That gives the rim to a pixel; `rim.measure_rim` then measures it. A wall as busy as what the sphere
reflects has better circles than its rim: there the sphere is where the picture is squeezed towards
one (`stages.squeeze`).

Only the first filter's image is measured. All filters' together, aligned, did no better on 80
simulated spheres (median error of the centre .20 px against .20, of the radius .11 against .09):
what is wrong is wrong in all, as they show the same edges beside the rim.

What a rim looks like decides how it is measured. At the rim a mirror is grazed: it reflects nearly
all light and bends it hardly at all, so just inside it shows the very thing that is seen just
outside. There is no step. Going in by e pixels, the reflected direction turns away like sqrt(e),
thousands of times faster than outside, so brightness bends off like a root: a step detector finds
an edge half a pixel or more inside the rim, by an amount that hangs on what is reflected.
Each profile across the rim is therefore fitted by

    outside  a + b x           inside, e = -x  a + c sqrt(e) + d e + f e^1.5,     blurred

with its kink at every place in reach, and the best place is the profile's vote. Where the world
behind the sphere is even the profile shows nothing and has no vote; where a panel's edge runs along
the rim, or a stand hides it, the vote is wrong: the rim is therefore where most votes agree,
not where their mean is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from calibration.errors import fault
from stages.mirror import Array, Sphere, rim_from_circle
from stages.region import Region
from stages.rim import RimFit, measure_rim
from stages.room import Room
from stages.squeeze import squeezed_circles
from stages.types import Measured

_REMEDY = "give the rim as outline = [x, y, radius] in [sphere], in px of the full-size raw image"

_COARSE = 360  # px, longest side of the image in which circles are voted for
_LOOKED_AT = 720  # px, longest side of the image in which a squeezed picture is looked for
_DISTINCT = 1.25  # times the next best: a squeezed circle's score. No clutter has 1.1, spheres 1.4
_SAME = 0.15  # of the radius: a rim no further from a squeezed circle is its own
# Of its radius: a squeezed circle's rim. Rings just outside are hardly worse; +-.016 on spheres.
_WITHIN = (0.975, 0.955)
_WELL = 0.5  # share of a measured rim's sectors that agree; below it, it is measured again ...
_AGAIN = 2  # ... from so many other starts about the same place, ...
_BESIDE = (1.5, -1.5)  # ... px larger where there are too few of them; ...
_REPEATED = 0.7  # ... starts are further apart, px, and rims that are the same are less
_ASTRAY = 2.0  # px: a rim so far from all others is not one
_CANDIDATES = 12  # circles that are fitted there
_FOLLOWED = 3  # of them that are followed to the full image
_AGREE = 0.4  # share of a rim's votes that must agree; a circle fitted to clutter gets .2 to .4 ...
_CLEAR = 0.15  # share of a rim that agrees, beyond what clutter would: it is clear
_SMALLEST = 12.0  # px, radius: a smaller sphere is worth no map, and clutter has many such
_RIVAL = 0.6  # of the best rim's merit and share, which nothing elsewhere has but another sphere
_FOUND = 0.2  # ... and the share of the whole rim: a flat background leaves parts without a vote
_MEASURED = 0.3  # share of sectors that agree with a rim once measured; clutter has .14 to .28


def locate(
    images: Sequence[Measured],
    *,
    radius_mm: float,
    distance_mm: float | None = None,
    focal_px: float | None = None,
    outline: Sequence[float] | None = None,
    yaw_deg: float = 0.0,
    room: Room | None = None,
    reflectance: tuple[Array, Array] | None = None,
    region: Region | None = None,
    distortion: Sequence[float] = (0.0, 0.0, 0.0),
) -> Sphere:
    """Find the sphere in the first image.

    images       of one view, one a filter, (H, W, C) each; the others' shifts are `align`'s
    radius_mm    of the sphere
    distance_mm  entrance pupil to centre; where given, the focal length is solved from the rim
    focal_px     focal length in px; where it alone is given, the distance is solved
    outline      x, y, radius in px: taken as the rim, instead of a search
    yaw_deg      turn of the result about +Y, handed on
    room         the walls about the sphere, handed on
    reflectance  the sphere's, by angle of incidence: see `measure_rim`; None: of a perfect mirror
    region       of the photograph that the images show; None: all of it. The outline, the result
                 and what is said are in px of the whole photograph nevertheless
    distortion   k1, k2, k3 of the lens, see `stages/lens.py`
    returns      Sphere
    raises       InputError: neither distance nor focal length; no sphere; cut by the frame
    """
    region = region or Region.whole(images[0].values.shape[:2])
    sphere_at = sphere_maker(
        region,
        radius_mm=radius_mm,
        distance_mm=distance_mm,
        focal_px=focal_px,
        yaw_deg=yaw_deg,
        room=room,
        distortion=distortion,
    )
    if outline is not None:
        x, y, radius = (float(v) for v in outline)
        if radius <= 0:
            raise fault(f"the outline's radius is {radius:g} px", "more than 0", _REMEDY)
        rim = rim_from_circle(x - region.left, y - region.top, radius, sphere_at)
        sphere = sphere_at(*rim).with_shift(region.origin_px)
        _refuse_cut(sphere, region, "correct outline = [x, y, radius] in [sphere]")
        return sphere
    sphere = _search(images[0], sphere_at, reflectance).with_shift(region.origin_px)
    _refuse_cut(sphere, region, f"photograph the whole sphere, or, if this is not it, {_REMEDY}")
    return sphere


def sphere_maker(
    region: Region,
    *,
    radius_mm: float,
    distance_mm: float | None,
    focal_px: float | None,
    yaw_deg: float = 0.0,
    room: Room | None = None,
    distortion: Sequence[float] = (0.0, 0.0, 0.0),
) -> Callable[..., Sphere]:
    """The function (x, y, rim_px, scale=1) -> Sphere of one camera, in px of a region.

    scale   px of the image that x, y, rim_px are of, per px of the photograph
    raises  InputError where neither distance nor focal length is known, or the distance is wrong

    The optical axis meets the middle of the whole photograph.
    """
    if distance_mm is None and focal_px is None:
        raise fault(
            "neither the sphere's distance nor the lens's focal length is known",
            "one of them",
            "give distance_mm in [sphere], or focal_length_mm and pixel_pitch_um in [camera]",
        )
    if distance_mm is not None and distance_mm <= radius_mm:
        raise fault(
            f"the sphere's distance is {distance_mm:g} mm and its radius {radius_mm:g} mm",
            "the camera outside the sphere",
            "measure distance_mm from the lens's entrance pupil to the sphere's centre",
        )

    def sphere_at(x: float, y: float, rim_px: float, scale: float = 1.0) -> Sphere:
        height, width = region.frame
        axis = (width / 2.0 - region.left) * scale, (height / 2.0 - region.top) * scale
        return Sphere.from_rim(
            x,
            y,
            rim_px,
            radius_mm=radius_mm,
            principal_px=axis,
            distance_mm=distance_mm,
            focal_px=None if focal_px is None else focal_px * scale,
            yaw_deg=yaw_deg,
            room=room,
            distortion=distortion,
        )

    return sphere_at


def _refuse_cut(sphere: Sphere, region: Region, remedy: str) -> None:
    height, width = region.frame
    x, y = sphere.centre_px
    if not (0 <= x <= width and 0 <= y <= height):
        raise fault(
            f"the sphere's centre, at {x:.0f}, {y:.0f} px, lies outside the frame",
            f"the whole sphere within {width} x {height} px",
            remedy,
        )
    rim = sphere.outline()
    low, high = rim.min(axis=0), rim.max(axis=0)
    sides = {
        "left": low[0] < 0,
        "right": high[0] > width,
        "top": low[1] < 0,
        "bottom": high[1] > height,
    }
    cut = [side for side, beyond in sides.items() if beyond]
    if cut:
        raise fault(
            f"the sphere at {x:.0f}, {y:.0f} px, radius "
            f"{sphere.rim_px:.0f} px, is cut by the {' and '.join(cut)} of the frame",
            f"its whole rim within {width} x {height} px",
            remedy,
        )


@dataclass(frozen=True)
class _Level:
    """The image at one resolution.

    light  (h, w) mean of the channels; NaN where not known
    noise  (h, w) its variance
    scale  px of this level per px of the full image
    """

    light: Array
    noise: Array
    scale: float

    def halved(self) -> _Level:
        """The same at half the resolution."""
        return _Level(_halve(self.light), _halve(self.noise) / 4.0, self.scale / 2.0)


def _pyramid(image: Measured, scale: float) -> list[_Level]:
    """The image at its own scale, half, quarter, ... down to `_COARSE`."""
    light = np.where(image.valid > 0.5, image.values.mean(axis=-1), np.nan)
    noise = image.variance.mean(axis=-1) / image.values.shape[-1]
    levels = [_Level(light, noise, scale)]
    while max(levels[-1].light.shape) > _COARSE:
        levels.append(levels[-1].halved())
    return levels


def _halve(image: Array) -> Array:
    """Means of 2 x 2 px; an odd last row or column falls away."""
    h, w = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    return (
        image[0:h:2, 0:w:2] + image[1:h:2, 0:w:2] + image[0:h:2, 1:w:2] + image[1:h:2, 1:w:2]
    ) / 4.0


def _search(
    image: Measured,
    sphere_at: Callable[..., Sphere],
    reflectance: tuple[Array, Array] | None,
) -> Sphere:
    """The sphere found without help, and what was learnt of its rim."""
    rims = _candidates(image, sphere_at)
    if not rims:
        raise fault("no sphere found in the photograph", "one mirror sphere, all of it", _REMEDY)
    best, *others = rims
    for other in others:
        apart = float(np.hypot(*(other.rim[:2] - best.rim[:2])))
        alike = other.merit > _RIVAL * best.merit and other.found > _RIVAL * best.found
        sizes = sorted([float(best.rim[2]), float(other.rim[2])])
        alike &= sizes[0] > 0.5 * sizes[1] and min(best.found, other.found) > 0.5
        if alike and apart > 0.8 * (other.rim[2] + best.rim[2]):
            raise fault(
                f"two spheres found in the photograph, {_as_outline(best)} and "
                f"{_as_outline(other)}",
                "one",
                "say which it is: outline = [x, y, radius] in [sphere]",
            )
    about = [rim for rim in others if np.abs(rim.rim - best.rim).max() < _SAME * best.rim[2]]
    starts = [best.rim]
    for start in (
        *[rim.rim for rim in about],
        *[np.add(best.rim, (0.0, 0.0, larger)) for larger in _BESIDE],
    ):
        if all(np.abs(start - other).max() > _REPEATED for other in starts):
            starts.append(start)
    fit = _measured(image, starts[: 1 + _AGAIN], sphere_at, reflectance)
    if fit is None or fit.found < _MEASURED:
        raise fault(
            f"a sphere may be at {_as_outline(best)}, but too little of its rim agrees on where",
            "a rim that can be told from what is seen around it",
            _REMEDY,
        )
    return replace(
        sphere_at(*fit.rim),
        rim_residual_px=fit.residual_px,
        rim_found=fit.found,
        rim_sigma_px=fit.sigma_px,
        rim_agrees=fit.agrees,
        blur_px=fit.blur_px,
    )


def _measured(
    image: Measured,
    starts: list[Array],
    sphere_at: Callable[..., Sphere],
    reflectance: tuple[Array, Array] | None,
) -> RimFit | None:
    """The rim as measured from the first start, if half of it agrees.

    Otherwise, as in clutter, from all, that on which most of them end; how far they end apart is
    then part of its error. None where each ends somewhere else, and none is to be believed.
    """
    fits: list[RimFit] = []
    for start in starts:
        fits.append(measure_rim(image, start, sphere_at, reflectance))
        if fits[-1].found >= _WELL:
            return fits[-1]
    rims = np.array([fit.rim for fit in fits])
    apart = np.abs(rims[:, None] - rims).max(axis=-1)
    agree = [fit.found for fit in fits], (apart < _ASTRAY).sum(axis=1)
    likely = np.lexsort((*agree, (apart < _REPEATED).sum(axis=1)))[-1]
    near = apart[likely] < _ASTRAY
    if near.sum() < 2:
        return None
    sigma = np.hypot(fits[likely].sigma_px, np.std(rims[near], axis=0))
    return replace(fits[likely], sigma_px=tuple(sigma.tolist()))


def _as_outline(rim: Rim) -> str:
    x, y, radius = rim.rim
    return f"[{x:.0f}, {y:.0f}, {radius:.0f}]"


def _candidates(image: Measured, sphere_at: Callable[..., Sphere]) -> list[Rim]:
    """The rims that a sphere may have, the best first, in px of the image.

    Those of `search_rims`, as long as they are where the picture is squeezed as by a mirror. Where
    they are not, or none is clear, the one circle where it is is followed: clutter has none.
    """
    rims = [rim for rim in search_rims(image, sphere_at) if rim.rim[2] > _SMALLEST]
    levels = _pyramid(image, 1.0)
    finest = next(k for k, level in enumerate(levels) if max(level.light.shape) <= _LOOKED_AT)
    squeezed = squeezed_circles(_log_light(levels[finest].light), 2)
    if len(squeezed) == 2 and squeezed[0].score > _DISTINCT * squeezed[1].score:
        circle = squeezed[0].circle * 2.0**finest
        clear = bool(rims) and rims[0].found - _AGREE * rims[0].voting > _CLEAR
        if not (clear and np.abs(rims[0].rim - circle).max() < _SAME * circle[2]):
            rim = _followed(levels[finest::-1], squeezed[0].circle, sphere_at)
            # In clutter it may be led astray by its neighbours.
            return [rim, *(replace(rim, rim=circle * (1.0, 1.0, w)) for w in _WITHIN)]
    return rims if rims and rims[0].merit > 0 and rims[0].found > _FOUND else []


def _followed(levels: list[_Level], circle: Array, sphere_at: Callable[..., Sphere]) -> Rim:
    """The rim near a circle of the first level, by level, each twice as fine, in px of the last."""
    starts = [circle * (1.0, 1.0, within) for within in _WITHIN]
    fits = [_fit_rim(levels[0], start, sphere_at, reach=3.0) for start in starts]
    rim = max(fits, key=attrgetter("agreement"))
    for level in levels[1:]:
        rim = _fit_near(level, 2.0 * rim.rim, sphere_at)
    return rim


def search_rims(
    image: Measured,
    sphere_at: Callable[..., Sphere],
    scale: float = 1.0,
    candidates: int = _CANDIDATES,
) -> list[Rim]:
    """The rims that a sphere may have in an image, found without help, the best first.

    image      (H, W, C)
    sphere_at  of `sphere_maker`
    scale      px of the image per px of the photograph
    candidates circles that are fitted, those first that most edges vote for
    returns    a few, in px of the image, good to a pixel or so
    """
    levels = _pyramid(image, scale)
    coarse = levels[-1]
    fits = [
        _fit_rim(coarse, circle, sphere_at, reach=3.0)
        for circle in _vote_circles(_log_light(coarse.light), candidates)
    ]
    for level in levels[-2::-1]:
        fits = sorted(fits, key=attrgetter("merit"))[-_FOLLOWED:]
        fits = [_fit_near(level, 2.0 * fit.rim, sphere_at) for fit in fits]
    return sorted(fits, key=attrgetter("merit"), reverse=True)


def _log_light(light: Array) -> Array:
    """log of the light, 8 EV below the median at the least; what is not known counts as lamp."""
    known = light[np.isfinite(light)]
    if not known.size or not np.any(known > 0):
        return np.zeros_like(light)
    floor = np.median(known[known > 0]) / 256.0
    return np.log(np.maximum(np.where(np.isfinite(light), light, known.max()), floor))


def _vote_circles(image: Array, count: int) -> list[Array]:
    """Circles (x, y, radius), so many, that many edges of the image (h, w) are tangents of.

    Best first. Each pixel of the strongest quarter of gradients votes for the two centres at each
    radius along its gradient, either sign: a rim is darker than the background here and brighter
    there.
    """
    from scipy.ndimage import gaussian_filter, uniform_filter

    h, w = image.shape
    gy = gaussian_filter(image, 1.0, order=(1, 0))
    gx = gaussian_filter(image, 1.0, order=(0, 1))
    strength = np.hypot(gx, gy)
    cap = np.quantile(strength, 0.9)
    if cap <= 1e-6:
        return []
    row, column = np.nonzero(strength > np.quantile(strength, 0.75))
    size = strength[row, column]
    nx, ny = gx[row, column] / size, gy[row, column] / size
    weight = np.minimum(size / cap, 1.0)
    radii = np.arange(8, int(0.6 * max(h, w)))
    votes = np.zeros((len(radii), h, w), np.float32)
    for k, radius in enumerate(radii):
        for sign in (-radius, radius):
            x, y = np.rint(column + sign * nx).astype(int), np.rint(row + sign * ny).astype(int)
            on = (x >= 0) & (x < w) & (y >= 0) & (y < h)
            votes[k] += np.bincount(
                y[on] * w + x[on], weights=weight[on] / np.sqrt(radius), minlength=h * w
            ).reshape(h, w)
    votes = uniform_filter(votes, 3)
    circles = []
    for _ in range(count):
        k, y, x = (int(i) for i in np.unravel_index(np.argmax(votes), votes.shape))
        circles.append(np.array([x + 0.5, y + 0.5, radii[k]]))
        votes[max(k - 3, 0) : k + 4, max(y - 3, 0) : y + 4, max(x - 3, 0) : x + 4] = 0.0
    return circles


@dataclass(frozen=True)
class Rim:
    """A rim fitted roughly.

    rim          (3,) x, y, rim_px, in px of its level
    found        share of its places that agree
    voting       share of its places that have a say
    residual_px  their spread
    agreement    weight of the places that agree, less twice that of those that lie outside, of 1
    """

    rim: Array
    found: float
    voting: float
    residual_px: float
    agreement: float

    @property
    def merit(self) -> float:
        """Length of rim that agrees, beyond what clutter would; circles within circles lose."""
        return (self.found - _AGREE * self.voting) * float(self.rim[2])


# Profiles across the rim: from 3 px inside to 3 px outside. Further in, more terms would be needed.
_PROFILE = np.arange(-3.0, 3.01, 0.5)
_PLACES = 0.1  # px between the places tried for the kink
_BLUR = 0.55  # px, sigma of pixel, demosaicing and our own interpolation; .45 to .9 does as well
_SAY = 0.2  # the least weight of a vote that is counted
_MODEL_ERROR = 3e-3  # relative, of the profile's model


def _kink_models(reach: float) -> tuple[Array, Array]:
    """Places (S,) of the kink within the reach, and orthonormal bases (S, T, K) of its profiles."""
    places = np.arange(-reach, reach + 1e-9, _PLACES)
    spread = np.linspace(-3.5, 3.5, 71) * _BLUR
    weight = np.exp(-0.5 * (spread / _BLUR) ** 2)
    weight /= weight.sum()
    x = _PROFILE[None, :, None] - places[:, None, None] - spread
    inside, outside = np.maximum(-x, 0.0), np.maximum(x, 0.0)
    terms = (np.ones_like(x), outside, np.sqrt(inside), inside, inside**1.5)
    return places, np.linalg.qr(np.stack([term @ weight for term in terms], axis=-1))[0]


def _fit_near(level: _Level, start: Array, sphere_at: Callable[..., Sphere]) -> Rim:
    """The better of the rims found from a start and from a little outside it.

    From further out the profiles reach less far in, to where edges of things reflected lie.
    """
    fits = [
        _fit_rim(level, np.add(start, (0.0, 0.0, larger)), sphere_at, reach=2.5)
        for larger in (0.0, 1.6)
    ]
    return max(fits, key=lambda fit: fit.agreement)


def _fit_rim(
    level: _Level, start: Array, sphere_at: Callable[..., Sphere], *, reach: float, rounds: int = 3
) -> Rim:
    """The rim near a circle given to within about the reach, in px of the level."""
    places, models = _kink_models(reach)
    rim = np.array(start, np.float64)
    for k in range(rounds):
        sphere = sphere_at(*rim, level.scale)
        count = int(np.clip(2.0 * np.pi * sphere.rim_px, 120, 1440))
        outline = sphere.outline(count)
        offset, weight = _votes(level, outline, sphere.outward(outline), places, models)
        # How far the rim's places move outwards when x, y and size grow by a pixel.
        moves = np.stack(
            [10.0 * sphere_at(*(rim + d), level.scale).inside_px(outline) for d in 0.1 * np.eye(3)],
            axis=-1,
        )
        step, agreeing, agreement = _consensus(offset, weight, moves, polish=k == rounds - 1)
        rim = rim + np.clip(step, -reach, reach)
        if rim[2] < 4.0 or not np.isfinite(rim).all():
            return Rim(np.array(start, np.float64), 0.0, 1.0, np.nan, -np.inf)
    residual = (offset - moves @ step)[agreeing]
    spread = 1.4826 * float(np.median(np.abs(residual))) if residual.size else np.nan
    voting = float(np.mean(weight > _SAY))
    return Rim(rim, float(agreeing.mean()), voting, spread, agreement)


def _votes(
    level: _Level, outline: Array, outward: Array, places: Array, models: Array
) -> tuple[Array, Array]:
    """Where each place of the outline (n, 2) sees the rim: px outwards (n,), and weights (n,)."""
    x, y = np.moveaxis(outline[:, None] + _PROFILE[:, None] * outward[:, None], -1, 0)
    profile = _bilinear(level.light, x, y)
    size = np.mean(np.abs(profile), axis=1)
    size = np.where(size > 0, size, np.nan)
    noise = np.mean(_bilinear(level.noise, x, y), axis=1) / size**2
    usable = np.isfinite(profile).all(axis=1) & np.isfinite(noise)
    profile = np.where(usable[:, None], profile / size[:, None], 0.0)
    explained = np.einsum("snk,snk->sn", *2 * (profile @ models,))
    misfit = np.sum(profile**2, axis=1) - explained
    floor = _MODEL_ERROR**2 + np.where(usable, noise, 0.0)
    misfit = np.log(np.maximum(misfit, 0.0) / len(_PROFILE) + floor)  # (S, n)
    best = np.argmin(misfit, axis=0)
    usable &= (best > 0) & (best < len(places) - 1)
    best = np.clip(best, 1, len(places) - 2)
    n = np.arange(len(best))
    before, here, after = misfit[best - 1, n], misfit[best, n], misfit[best + 1, n]
    bend = before - 2.0 * here + after
    offset = places[best] + _PLACES * 0.5 * (before - after) / np.where(bend > 0, bend, np.inf)
    clear = np.median(misfit, axis=0) - misfit.min(axis=0)
    return offset, np.where(usable, np.clip(clear - 0.3, 0.0, 2.0), 0.0)


def _consensus(
    offset: Array, weight: Array, moves: Array, *, polish: bool
) -> tuple[Array, NDArray[np.bool_], float]:
    """The step (3,) of x, y and size that most votes (n,) agree on, which do (n,), how well.

    A vote agrees by a kernel .2 px wide. One that lies further out counts against, twice: edges
    of things reflected along part of the rim make false maxima, but always inside the true rim,
    which then still shows outside them, while nothing outside a true rim follows it.
    """
    from scipy.optimize import minimize

    def discord(steps: Array) -> Array:
        beyond = offset - steps @ moves.T
        agreeing = np.exp(-0.5 * (beyond / 0.2) ** 2)
        outside = 0.5 + 0.5 * np.tanh((beyond - 0.45) / 0.1)
        return (2.0 * outside - agreeing) @ weight

    # Reweighted least squares with a narrowing kernel, from a grid of starts at once.
    grid = np.array([-0.7, 0.0, 0.7])
    steps = np.stack(np.meshgrid(grid, grid, grid, indexing="ij"), axis=-1).reshape(-1, 3)
    products = (moves[:, :, None] * moves[:, None, :]).reshape(-1, 9)
    for width in (1.0, 0.6, 0.35, 0.25, 0.2):
        w = weight * np.exp(-0.5 * ((offset - steps @ moves.T) / width) ** 2)
        normal = (w @ products).reshape(-1, 3, 3) + 1e-6 * np.eye(3)
        steps = np.linalg.solve(normal, ((w * offset) @ moves)[..., None])[..., 0]
    best = steps[np.argmin(discord(steps))]
    if polish:
        simplex = best + np.concatenate([np.zeros((1, 3)), 0.3 * np.eye(3)])
        best = minimize(
            discord,
            best,
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "xatol": 2e-3, "fatol": 1e-6, "maxfev": 200},
        ).x
    agreeing = (weight > _SAY) & (np.abs(offset - moves @ best) < 0.5)
    return best, agreeing, -float(discord(best)) / max(float(weight.sum()), 1e-9)


def _bilinear(image: Array, x: Array, y: Array) -> Array:
    """The image (h, w) at px positions; NaN outside it."""
    h, w = image.shape
    column, row = np.floor(x - 0.5).astype(int), np.floor(y - 0.5).astype(int)
    inside = (column >= 0) & (column < w - 1) & (row >= 0) & (row < h - 1)
    fx, fy = x - 0.5 - column, y - 0.5 - row
    column, row = np.clip(column, 0, w - 2), np.clip(row, 0, h - 2)
    top = image[row, column] * (1 - fx) + image[row, column + 1] * fx
    bottom = image[row + 1, column] * (1 - fx) + image[row + 1, column + 1] * fx
    return np.where(inside, top * (1 - fy) + bottom * fy, np.nan)
