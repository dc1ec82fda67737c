"""Photographs of a mirror sphere: is it found, and how near to where it is?

A generator of its own, apart from `stages` and from the tests' tracer: a sphere in a room with
walls at a distance, pinhole, law of reflection, Schlick's chromium; light gathered on a grid much
finer than the pixels where the rim is, blurred by the lens, averaged over pixels, made a Bayer
mosaic with noise, and developed as `sixlight envmap` does. What stands in the way is drawn on top
before the blur. Everything about a case follows from its number. A hundred of them are part of
`make bench ONLY=unwrap`; more by `python -m benchmarks.rims 500`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from benchmarks.figure import Figure
from calibration.errors import InputError
from stages.align import align
from stages.demosaic import demosaic
from stages.locate import locate
from stages.mirror import Sphere
from stages.types import Measured, Radiance

CASES = 100
THEMES = (
    "a furnished room",
    "a stand below",
    "a hand",
    "a dark rim before a dark wall",
    "a clipped lamp at the rim",
    "a busy wall",
    "a wall of one brightness",
    "straight edges",
    "at the edge of the frame",
    "a wall close behind",
)
ALIGNED = 5  # every so many a case has a second filter, shifted, magnified and turned

_RADIUS_MM = 50.0
_FAILED = 2.0  # px; further off, something else was taken for the sphere
_SUB = 5  # samples of light along a pixel's side near the rim
_NEAR = 4.5  # px about the rim so sampled
_SATURATION = 40.0  # times the brighter parts' light: above it, all exposures are clipped
_CFA = np.array([[0, 1], [1, 2]])

Array = NDArray[np.float64]
Light = NDArray[np.float32]


def metal(cosine):
    """Schlick's form of a metal: two thirds in front, everything at grazing incidence."""
    return 0.66 + 0.34 * (1.0 - cosine) ** 5


@dataclass(frozen=True)
class Case:
    """One photograph's truth.

    number       of the case, which all else follows from
    theme        one of THEMES
    x, y, rim    where the sphere's centre is seen, and focal length times tan of the rim's angle
    distance_mm  from the pupil to the sphere's centre
    width, height  of the photograph, px
    blur_px      standard deviation of the lens's point spread; the pixel's square comes on top
    noise        relative, of a sample; photon noise and read noise come on top
    lens_known   whether the focal length is given instead of the distance
    shift, scale, turn_deg  of the second filter's image about the sphere's centre
    """

    number: int
    theme: str
    x: float
    y: float
    rim: float
    distance_mm: float
    width: int
    height: int
    blur_px: float
    noise: float
    lens_known: bool
    shift: tuple[float, float]
    scale: float
    turn_deg: float

    @cached_property
    def focal_px(self) -> float:
        return float(self.rim / np.tan(np.arcsin(_RADIUS_MM / self.distance_mm)))

    @cached_property
    def centre(self) -> Array:
        """Of the sphere, mm; the camera's frame: x right, y down, z ahead."""
        ray = np.array([self.x - self.width / 2, self.y - self.height / 2, self.focal_px])
        return self.distance_mm * ray / np.linalg.norm(ray)

    def to_other(self, points) -> Array:
        """Where the second filter's image shows what the first shows at points (..., 2)."""
        t, about = np.radians(self.turn_deg), np.array([self.x, self.y])
        turn = np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]])
        return np.asarray(self.scale * (points - about) @ turn.T + about + self.shift)

    def to_first(self, points) -> Array:
        """The inverse of `to_other`."""
        t, about = np.radians(self.turn_deg), np.array([self.x, self.y])
        turn = np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]])
        return np.asarray((points - about - self.shift) @ turn / self.scale + about)


def case(number: int) -> Case:
    """The case of that number: themes take turns, all else is drawn."""
    rng = np.random.default_rng([7, number])
    theme = THEMES[number % len(THEMES)]
    rim = float(np.exp(rng.uniform(np.log(45.0), np.log(190.0))))
    distance = float(rng.choice([200.0, 400.0, 800.0, 1500.0, 3000.0]))
    width, height = int(rim * rng.uniform(2.5, 3.3)) + 24, int(rim * rng.uniform(2.3, 2.8)) + 24
    # Half of a rim's height and width: an ellipse, the larger the closer it is.
    reach = rim * (1.0 + 1.5 * (_RADIUS_MM / distance) ** 2) + 4.0
    x = float(rng.uniform(reach, width - reach))
    y = float(rng.uniform(reach, height - reach))
    if theme == "at the edge of the frame":
        x = float(rng.choice([reach, width - reach]))
        if rng.random() < 0.5:
            y = float(rng.choice([reach, height - reach]))
    return Case(
        number=number,
        theme=theme,
        x=x,
        y=y,
        rim=rim,
        distance_mm=distance,
        width=width,
        height=height,
        blur_px=float(rng.uniform(0.4, 1.2)),
        noise=float(10.0 ** rng.uniform(-3.0, -2.0)),
        lens_known=bool(rng.random() < 0.5),
        shift=tuple(rng.uniform(-3.0, 3.0, 2).tolist()),
        scale=float(1.0 + rng.normal() * 1e-3),
        turn_deg=float(rng.normal() * 0.05),
    )


# ------------------------------------------------------------------------------------ the room


def _noise(rng, size: int, grain: int) -> Light:
    """A smooth field (size, size, 1) about 0, of standard deviation about 1."""
    import cv2

    field = rng.normal(size=(grain, grain)).astype(np.float32)
    return np.asarray(cv2.resize(field, (size, size), interpolation=cv2.INTER_CUBIC))[..., None]


def _furnished(rng, size: int, *, panels: int = 14, lamps: int = 0, grain: int = 6) -> Light:
    """A wall (size, size, 3): shades, panels with straight edges at all angles, lamps."""
    import cv2

    colour = 10.0 ** rng.uniform(-0.5, 0.2) * rng.uniform(0.6, 1.3, 3)
    wall = np.exp(0.3 * _noise(rng, size, grain) + 0.1 * _noise(rng, size, 8 * grain)) * colour
    wall = np.ascontiguousarray(wall, np.float32)
    for k in range(panels + lamps):
        lamp = k >= panels
        middle = rng.uniform(0, size, 2)
        half = size * rng.uniform(0.01, 0.03, 2) if lamp else size * rng.uniform(0.02, 0.2, 2)
        t = rng.choice([0.0, rng.uniform(0, np.pi)])
        along, across = np.array([[np.cos(t), np.sin(t)], [-np.sin(t), np.cos(t)]])
        a, b = half[0] * along, half[1] * across
        corners = np.rint(middle + np.array([a + b, a - b, -a - b, b - a])).astype(np.int32)
        level = 10.0 ** (rng.uniform(1.5, 2.5) if lamp else rng.uniform(-1.0, 0.5))
        cv2.fillPoly(wall, [corners], tuple((level * rng.uniform(0.7, 1.3, 3)).tolist()))
    return wall


class Room:
    """A box about the sphere: walls at half[k] mm to either side of it, along the room's axes."""

    def __init__(self, case: Case):
        rng = np.random.default_rng([8, case.number])
        theme = case.theme
        near = theme == "a wall close behind"
        self.half = np.array(
            [
                [rng.uniform(1000, 3000), rng.uniform(1000, 3000)],
                [rng.uniform(900, 1500), rng.uniform(900, 1500)],
                [case.distance_mm + rng.uniform(500, 2000), rng.uniform(*((60, 200), (600, 4000))[
                    not near])],
            ]
        )  # fmt: skip
        # The camera looks at a wall a little askew.
        t, u = rng.normal(size=2) * 0.15
        yaw = np.array([[np.cos(t), 0, np.sin(t)], [0, 1, 0], [-np.sin(t), 0, np.cos(t)]])
        pitch = np.array([[1, 0, 0], [0, np.cos(u), -np.sin(u)], [0, np.sin(u), np.cos(u)]])
        self.axes = yaw @ pitch  # room from camera
        self.centre = case.centre
        # Its walls: left, right, up, down, the camera's, that behind the sphere.
        self.walls = [_furnished(rng, 512, lamps=int(rng.integers(0, 3))) for _ in range(5)]
        self.walls.append(_furnished(rng, 1024, panels=30, lamps=1))
        far = self.walls[-1]
        if theme == "a dark rim before a dark wall":
            self.walls[-1] = np.float32(0.03) * far
        elif theme == "a busy wall":
            fine = np.exp(0.6 * _noise(rng, 1024, 300) + 0.4 * _noise(rng, 1024, 90))
            self.walls[-1] = np.asarray(far * fine, np.float32)
        elif theme == "a wall of one brightness":
            level = np.float32(rng.uniform(0.5, 1.0))
            for k in (0, 1, 2, 3, 5):
                shade = level * np.exp(0.05 * _noise(rng, len(self.walls[k]), 4))
                self.walls[k] = np.repeat(shade, 3, axis=-1).astype(np.float32)
        elif theme == "straight edges":
            for wall in self.walls:
                size, period = len(wall), len(wall) / rng.uniform(8, 30)
                t = rng.choice([0.0, np.pi / 2, rng.uniform(0, np.pi)])
                y, x = np.mgrid[:size, :size]
                stripe = ((x * np.cos(t) + y * np.sin(t)) / period) % 1.0 < 0.5
                wall[stripe] *= np.float32(10.0 ** rng.uniform(-1.0, 0.5))
        elif theme == "a clipped lamp at the rim":
            # Where the line of sight past one place of the rim meets the wall.
            angle, size = rng.uniform(0, 2 * np.pi), len(far)
            at = (case.x + case.rim * np.cos(angle), case.y + case.rim * np.sin(angle))
            ray = np.array([at[0] - case.width / 2, at[1] - case.height / 2, case.focal_px])
            _, place = self._meet(np.zeros((1, 3)), ray[None])
            x, y = place[0] * size
            half = size * rng.uniform(0.008, 0.02, 2)
            top, left = max(0, int(y - half[1])), max(0, int(x - half[0]))
            far[top : int(y + half[1]) + 1, left : int(x + half[0]) + 1] = 300.0

    def _meet(self, origin: Array, direction: Array) -> tuple[NDArray[np.int_], Array]:
        """Which wall rays (n, 3) of the camera's frame meet, and where on it (n, 2), 0..1."""
        o, d = (origin - self.centre) @ self.axes.T, direction @ self.axes.T
        ahead = d > 0
        # On each axis the wall ahead: left, up and the camera's lie at the negative end.
        bound = np.where(ahead, self._bounds[:, 1], -self._bounds[:, 0])
        with np.errstate(divide="ignore"):
            t = np.where(d != 0, (bound - o) / np.where(d != 0, d, 1.0), np.inf)
        axis = np.argmin(t, axis=-1)
        n = np.arange(len(o))
        point = o + t[n, axis, None] * d
        unit = (point + self._bounds[:, 0]) / self._bounds.sum(axis=1)
        place = np.stack([unit[n, (axis + 1) % 3], unit[n, (axis + 2) % 3]], axis=-1)
        return 2 * axis + ahead[n, axis], place

    @property
    def _bounds(self) -> Array:
        return self.half

    def light(self, origin: Array, direction: Array) -> Light:
        """Light (n, 3) that comes along rays (n, 3)."""
        import cv2

        which, place = self._meet(origin, direction)
        light = np.empty((len(which), 3), np.float32)
        for k, wall in enumerate(self.walls):
            on = np.flatnonzero(which == k)
            if not len(on):
                continue
            at = (place[on] * len(wall) - 0.5).astype(np.float32)
            fill = -len(on) % 1024  # OpenCV's images are at most 32767 px wide
            at = np.pad(at, ((0, fill), (0, 0))).reshape(-1, 1024, 2)
            seen = cv2.remap(
                wall, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
            light[on] = seen.reshape(-1, 3)[: len(on)]
        return light


def _seen(case: Case, room: Room, points: Array) -> Light:
    """Light (n, 3) at image positions (n, 2) px, nothing in the way, no lens."""
    ray = np.column_stack([points - (case.width / 2, case.height / 2), np.zeros(len(points))])
    ray[:, 2] = case.focal_px
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    along = ray @ case.centre
    # The miss distance squared by the cross product: differences of squares would cost digits.
    miss = np.sum(np.cross(ray, case.centre) ** 2, axis=1)
    hit = (miss < _RADIUS_MM**2) & (along > 0)
    origin, factor = np.zeros_like(ray), np.ones(len(ray), np.float32)
    depth = np.sqrt(_RADIUS_MM**2 - miss[hit])
    origin[hit] = (along[hit] - depth)[:, None] * ray[hit]
    normal = (origin[hit] - case.centre) / _RADIUS_MM
    cosine = depth / _RADIUS_MM
    ray[hit] += 2.0 * cosine[:, None] * normal
    factor[hit] = metal(cosine)
    return room.light(origin, ray) * factor[:, None]


# ------------------------------------------------------------------------------- the photograph


def photograph(case: Case, *, other: bool = False) -> Measured:
    """The developed photograph, or that through the other filter."""
    rng = np.random.default_rng([9, case.number, other])
    light = _through_lens(case, other)
    # Two filters of a kind, and a camera whose bands overlap.
    glass = np.array([(0.25, 1.0, 0.8), (1.0, 0.9, 0.08)][other])
    mixed = np.array([[0.85, 0.15, 0.0], [0.1, 0.8, 0.1], [0.0, 0.15, 0.85]])
    return _developed((light @ mixed.T.astype(np.float32)) * glass.astype(np.float32), case, rng)


def _through_lens(case: Case, other: bool) -> Light:
    """What falls on each pixel (H, W, 3)."""
    import cv2

    room = Room(case)
    margin = 5
    height, width = case.height + 2 * margin, case.width + 2 * margin
    y, x = (np.mgrid[:height, :width] - margin + 0.5).reshape(2, -1)
    points = np.stack([x, y], axis=-1)
    back = case.to_first if other else np.asarray
    coarse = _seen(case, room, back(points)).reshape(height, width, 3)
    fine: Light = np.repeat(np.repeat(coarse, _SUB, axis=0), _SUB, axis=1)

    ray = np.column_stack([back(points) - (case.width / 2, case.height / 2), np.zeros(len(points))])
    ray[:, 2] = case.focal_px
    sine = np.linalg.norm(np.cross(ray, case.centre), axis=1) / np.linalg.norm(ray, axis=1)
    beyond = (np.arcsin(sine / case.distance_mm) - np.arcsin(_RADIUS_MM / case.distance_mm)) * (
        case.focal_px
    )
    near = points[np.abs(beyond) < _NEAR]
    step = (np.arange(_SUB) + 0.5) / _SUB - 0.5
    for dy in step:
        for dx in step:
            total = np.zeros((len(near), 3), np.float32)
            quarter = 0.25 / _SUB  # four samples a cell, so that none straddles the rim unseen
            for sy, sx in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
                at = near + np.array([dx + sx * quarter, dy + sy * quarter])
                total += _seen(case, room, back(at))
            column, row = np.floor((near + np.array([dx, dy]) + margin) * _SUB).astype(int).T
            fine[row, column] = total / 4.0
    _draw(fine, case, margin, other)
    sigma = case.blur_px * _SUB
    blurred = cv2.GaussianBlur(fine, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
    pixels = cv2.resize(blurred, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(pixels[margin:-margin, margin:-margin])


def _draw(fine: Light, case: Case, margin: int, other: bool) -> None:
    """What stands before the sphere: a stand, or a hand."""
    import cv2

    rng = np.random.default_rng([10, case.number])
    x, y, r = case.x, case.y, case.rim

    def at(points):
        p = np.asarray(points, np.float64)
        p = case.to_other(p) if other else p
        return np.rint((p + margin) * _SUB - 0.5).astype(np.int32)

    level = float(np.percentile(fine[::7, ::7], 70))
    if case.theme == "a stand below":
        half = r * rng.uniform(0.15, 0.45)
        top, foot = y + np.sqrt(r * r - half * half), y + r + case.height
        t = np.linspace(-1.0, 1.0, 41)
        # A cup: its edge cuts off a little of the sphere, lowest in the middle.
        edge = np.stack(
            [x + half * t, top - r * rng.uniform(0.0, 0.06) + 0.04 * r * (1 - t * t)], 1
        )
        shape = np.concatenate([edge, [(x + half, foot), (x - half, foot)]])
        cv2.fillPoly(fine, [at(shape)], tuple((level * rng.uniform(0.02, 1.5, 3)).tolist()))
    elif case.theme == "a hand":
        towards = rng.uniform(0, 2 * np.pi)
        skin = level * rng.uniform(0.3, 1.5) * np.array([1.0, 0.7, 0.55])
        for finger in range(int(rng.integers(2, 5))):
            a = towards + 0.17 * finger
            tip = r * rng.uniform(0.75, 0.95)
            ends = [(x + d * np.cos(a), y + d * np.sin(a)) for d in (tip, 3.0 * r)]
            colour = tuple((skin * rng.uniform(0.85, 1.15)).tolist())
            thick = max(1, int(2 * 0.07 * r * _SUB))
            start, end = at(ends).tolist()
            cv2.line(fine, start, end, colour, thick)
            cv2.circle(fine, at(ends[0]).tolist(), thick // 2, colour, -1)


def _developed(light: Light, case: Case, rng) -> Measured:
    """Bayer samples with noise, clipped, developed as a merged bracket is."""
    height, width = light.shape[:2]
    colour = np.tile(_CFA, (height // 2 + 1, width // 2 + 1))[:height, :width, None]
    mosaic = np.take_along_axis(light, colour, axis=2)[..., 0].astype(np.float64)
    level = float(np.percentile(mosaic, 80))
    # A bracket's noise: relative in all but the darkest parts.
    variance = (case.noise * mosaic) ** 2 + 1e-5 * level * mosaic + (2e-4 * level) ** 2
    mosaic = mosaic + rng.normal(size=mosaic.shape) * np.sqrt(variance)
    lost = mosaic > _SATURATION * level
    return demosaic(
        Radiance(
            mosaic=np.where(lost, np.nan, mosaic).astype(np.float32),
            variance=np.where(lost, np.nan, variance).astype(np.float32),
            valid=~lost,
            lost=lost,
            defective=np.zeros_like(lost),
            moved=np.zeros_like(lost),
            at_least=np.full((2, 2), _SATURATION * level),
            cfa=_CFA,
            tagged=(1.0,),
            solved=(1.0,),
            noise=np.array([[0.0, case.noise]]),
            clipped=(float(lost.mean()),),
        )
    )


# ---------------------------------------------------------------------------------- the figures


def reflectance() -> tuple[Array, Array]:
    """The metal's, as `locate` takes it."""
    cosine = np.linspace(1.0, 0.0, 500) ** 2
    return np.arccos(cosine), metal(cosine)


def found(case: Case, image: Measured) -> Sphere:
    """What `locate` makes of the photograph."""
    return locate(
        [image],
        radius_mm=_RADIUS_MM,
        reflectance=reflectance(),
        distance_mm=None if case.lens_known else case.distance_mm,
        focal_px=case.focal_px if case.lens_known else None,
    )


@dataclass(frozen=True)
class Outcome:
    """What became of a case, px.

    centre, radius       errors; by more than `_FAILED`, something else was taken for the sphere
    centre_sigma, radius_sigma  as told; of the centre along x or y
    shift                root mean square over the sphere of the second filter's places; None where
                         there is none
    shift_sigma          the same as told, along x or y
    """

    centre: float
    radius: float
    centre_sigma: float
    radius_sigma: float
    shift: float | None = None
    shift_sigma: float | None = None

    @property
    def mistaken(self) -> bool:
        return max(self.centre, self.radius) > _FAILED


def outcome(case: Case, image: Measured) -> Outcome | None:
    """What `locate` and `align` make of the photograph; None: refused, as no sphere is found."""
    try:
        sphere = found(case, image)
    except InputError:
        return None
    centre = float(np.hypot(*np.subtract(sphere.centre_px, (case.x, case.y))))
    radius = abs(sphere.rim_px - case.rim)
    told = np.array(sphere.rim_sigma_px)
    sigma = float(np.sqrt(np.mean(told[:2] ** 2))), float(told[2])
    became = Outcome(centre, radius, *sigma)
    if case.number % ALIGNED or became.mistaken:
        return became
    other = photograph(case, other=True)
    alignment = align([image, other], sphere)
    places = case.rim * np.stack(np.meshgrid(*[np.linspace(-1, 1, 21)] * 2), axis=-1)
    places = places[np.hypot(*np.moveaxis(places, -1, 0)) < case.rim] + (case.x, case.y)
    off = alignment.to_image(1, places) - case.to_other(places)
    shift = float(np.sqrt(np.mean(np.sum(off**2, axis=-1))))
    return replace(became, shift=shift, shift_sigma=float(alignment.error_px[1]))


def _became(number: int) -> Outcome | None:
    each = case(number)
    return outcome(each, photograph(each))


def measure(cases: int = CASES) -> Iterator[Figure]:
    """The figures, all together and by theme."""
    by_theme: dict[str, list[Outcome]] = {theme: [] for theme in THEMES}
    refused, mistaken = dict.fromkeys(THEMES, 0), 0
    with ProcessPoolExecutor() as workers:  # 3 s of processor each
        for number, became in enumerate(workers.map(_became, range(cases), chunksize=4)):
            if became is None:
                refused[case(number).theme] += 1
            elif became.mistaken:
                mistaken += 1
            else:
                by_theme[case(number).theme].append(became)
    yield Figure(f"sphere not found, and so said, of {cases}", sum(refused.values()), high=0)
    yield Figure(f"something else taken for it, of {cases}", mistaken, high=0)
    together = [became for of_theme in by_theme.values() for became in of_theme]
    for name in ("centre", "radius"):
        errors = np.array([getattr(became, name) for became in together])
        sigma = np.array([getattr(became, f"{name}_sigma") for became in together])
        along = errors / np.sqrt(2.0) if name == "centre" else errors
        yield Figure(f"{name} of the rim, median error", float(np.median(errors)), "px", high=0.05)
        yield Figure(f"{name} of the rim, 95th percentile", float(np.percentile(errors, 95)), "px")
        yield Figure(f"{name} of the rim, worst", float(errors.max()), "px", high=0.2)
        told = float(np.sqrt(np.mean(np.minimum(along / sigma, 5.0) ** 2)))
        yield Figure(f"{name} of the rim, error over the sigma told, rms", told, "times")
    shifts = [(b.shift, b.shift_sigma) for b in together if b.shift is not None and b.shift_sigma]
    if shifts:
        errors, sigma = np.array(shifts).T
        yield Figure(
            "second filter's places, median error", float(np.median(errors)), "px", high=0.03
        )
        yield Figure("second filter's places, worst", float(errors.max()), "px")
        told = float(np.sqrt(np.mean(np.minimum(errors / sigma, 5.0) ** 2 / 2.0)))
        yield Figure("second filter's places, error over that told, rms", told, "times")
    for theme, of_theme in by_theme.items():
        yield Figure(f"  {theme}: not found", refused[theme])
        for name in ("centre", "radius") if of_theme else ():
            errors = np.array([getattr(became, name) for became in of_theme])
            yield Figure(f"  {theme}: {name}, median", float(np.median(errors)), "px")
            yield Figure(f"  {theme}: {name}, worst", float(errors.max()), "px")


if __name__ == "__main__":
    for figure in measure(int(sys.argv[1]) if len(sys.argv) > 1 else CASES):
        print(figure, flush=True)
