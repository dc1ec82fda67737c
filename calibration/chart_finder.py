"""Finding a ColorChecker in photographs of it, through any filter and under any light.

Two ways are tried: our own, which follows the grid that bright squares lie on and needs a few of
them in some band; and OpenCV's, which knows charts in natural colours and is given pictures whose
bands are balanced. Each proposes how the chart may lie; the proposal whose patches look most like
the printed ones is taken, if they look alike enough.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration import sets
from calibration.channels import SHARP_FROM_XYZ
from calibration.chart import (
    CHARTS,
    COLORCHECKER24,
    COLORCHECKER_SG,
    GRIDS,
    Patches,
    between,
    mapped,
    outline,
)
from calibration.errors import fault

_WINDOWS_PX = (31, 61, 121)  # over which "brighter than around it" is judged


@dataclass(frozen=True)
class _Search:
    """How a chart is looked for.

    size_px   of the picture it is looked for in, along its longer side; it need not be large
    squares   fewest patches that must be seen as squares
    likeness  least correlation with the printed patches; wrong ways round reach .5, of the SG,
              whose rim is the same all around, .65
    """

    size_px: int
    squares: int
    likeness: float


_SEARCHES = {
    COLORCHECKER24: _Search(1000, 12, 0.75),
    COLORCHECKER_SG: _Search(1600, 40, 0.75),
}

# A likeness that no wrong way to lie reaches: others need not be tried.
_SURE = 0.97

# OpenCV's detector sees a chart at one scale and not at another.
_SCALES = (1.0, 0.6, 1.6)
# Its outline is a few px off. Squares this near to where it puts patches, in places, mend it, then
# those still nearer to where that puts them; so one that is wrong by half a place is not kept.
_NEAR = (0.35, 0.2, 0.1)
_ENOUGH_TO_MEND = 8


def find(images: Sequence[NDArray[np.floating]], kind: str = COLORCHECKER24) -> Patches:
    """The patches of a ColorChecker, found in photographs of it from one place, whichever way up.

    images   (H, W, 3) linear signal each, one a filter; NaN where not known
    kind     one of calibration.chart.CHARTS
    returns  the middles of the patches
    raises   InputError if there is no chart to be seen
    """
    picture, scale = _picture(images, _SEARCHES[kind].size_px)
    for ways in (_by_squares, _by_opencv):
        likeness, to_image = _most_like(picture, ways(picture, kind), kind)
        if likeness > _SEARCHES[kind].likeness:
            found = between(to_image, kind)
            return Patches(found.names, found.corners / scale)
    names = CHARTS[kind]
    raise fault(
        f"no {kind} found in the photographs",
        f"all {len(names)} patches in view and in focus",
        f"give the outer corners of patches {names[0]}, {names[GRIDS[kind][0] - 1]}, {names[-1]} "
        f"and {names[-GRIDS[kind][0]]}: corners = [[x, y], ...] in px, or every patch's place: "
        'patches = "patch_boxes.csv" with patch,x0,y0,x1,y1',
    )


def _most_like(picture, ways, kind: str) -> tuple[float, NDArray[np.float64]]:
    """Of several ways for the chart to lie that which looks most like it, and how much it does."""
    best = -1.0, np.eye(3)
    for to_image in ways:
        likeness = _likeness(picture, to_image, kind)
        if likeness > best[0]:
            best = likeness, to_image
        if likeness > _SURE:
            break
    return best


def _picture(images, size_px: int) -> tuple[NDArray[np.float32], float]:
    """All bands of the photographs as one image (h, w, C) of about that size, and its scale.

    Each band is divided by its bright end and curved like an eye, so that no coloured light or
    filter leaves a band dark.
    """
    height, width = images[0].shape[:2]
    scale = min(1.0, size_px / max(height, width))
    size = (round(width * scale), round(height * scale))
    small = np.concatenate([_reduced(image, size) for image in images], axis=-1)
    bright = np.maximum(np.percentile(small, 97, axis=(0, 1)), np.finfo(np.float32).tiny)
    return np.sqrt(np.clip(small / bright, 0.0, 1.0)), scale


def _reduced(image, size: tuple[int, int]) -> NDArray[np.float32]:
    """An image (H, W, 3) at a smaller size (width, height), its noise smoothed."""
    import cv2

    image = np.asarray(image, np.float32)
    known = np.nan_to_num(image, nan=float(np.nanmax(image)))  # what clipped is bright
    small = cv2.resize(known, size, interpolation=cv2.INTER_AREA)
    return cv2.GaussianBlur(small, (0, 0), 1.0)


def _square_sets(picture) -> Iterator[NDArray[np.float64]]:
    """Squares (k, 3) as x, y, side in px: once from each band, once from the brightest band."""
    import cv2

    bands = [picture.max(axis=-1), picture.mean(axis=-1), *np.moveaxis(picture, -1, 0)]
    for band in bands:
        eight_bit = (band * 255.0 + 0.5).astype(np.uint8)
        found: list[tuple[float, float, float]] = []
        for window in _WINDOWS_PX:
            for offset in (-4, -12):
                mask = cv2.adaptiveThreshold(
                    eight_bit, 255, cv2.ADAPTIVE_THRESH_MEAN_C, cv2.THRESH_BINARY, window, offset
                )
                mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
                outlines, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
                found.extend(square for outline in outlines if (square := _as_square(outline)))
        if found:
            yield _distinct(np.array(found))


def _as_square(outline) -> tuple[float, float, float] | None:
    """Centre and side of an outline that is about a square of 8 px or more."""
    import cv2

    area = cv2.contourArea(outline)
    if area < 64:
        return None
    (x, y), (a, b), _ = cv2.minAreaRect(outline)
    if min(a, b) < 0.65 * max(a, b) or area < 0.75 * a * b:
        return None
    return x, y, float(np.sqrt(a * b))


def _distinct(squares) -> NDArray[np.float64]:
    """The squares, of those about one centre the largest.

    A window smaller than a patch sees only its rim: then there is a square within the square.
    """
    kept = np.empty((0, 3))
    for square in squares[np.argsort(-squares[:, 2])]:
        if np.all(np.hypot(*(kept[:, :2] - square[:2]).T) > 0.4 * square[2]):
            kept = np.concatenate([kept, square[None]])
    return kept


# ---- by squares on a grid


def _by_squares(picture, kind: str) -> Iterator[NDArray[np.float64]]:
    """Homographies from the chart's places to the picture: every way squares may be its patches."""
    for squares in _square_sets(picture):
        for lattice, centres in _grids(squares, _SEARCHES[kind].squares):
            yield from _layouts(lattice, centres, kind)


def _grids(squares, fewest: int) -> Iterator[tuple[NDArray[np.int_], NDArray[np.float64]]]:
    """Grids the squares lie on: integer places (m, 2) and centres (m, 2), largest first."""
    grids = []
    taken: set[int] = set()
    for i in range(len(squares)):
        if i in taken:
            continue
        place = _followed(squares, i)
        taken.update(place)
        if len(place) >= fewest:
            members = list(place)
            grids.append((np.array([place[m] for m in members]), squares[members, :2]))
    yield from sorted(grids, key=lambda grid: -len(grid[0]))


def _followed(squares, start: int) -> dict[int, tuple[int, int]]:
    """Squares reached from one by steps along a grid: index to place (column, row)."""
    centres, sides = squares[:, :2], squares[:, 2]
    offsets = centres - centres[start]
    distance = np.hypot(*offsets.T)
    ratio = sides / sides[start]
    near = (distance > 0.9 * sides[start]) & (distance < 2.0 * sides[start])
    near &= (ratio > 0.7) & (ratio < 1.4)
    if not near.any():
        return {start: (0, 0)}
    step = offsets[np.argmin(np.where(near, distance, np.inf))]
    across = np.array([-step[1], step[0]])  # right-handed, so the chart is never mirrored
    place, steps, queue = {start: (0, 0)}, {start: (step, across)}, [start]
    while queue:
        at = queue.pop(0)
        for way, (column, row) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1))):
            u, v = steps[at]
            target = centres[at] + column * u + row * v
            off = np.hypot(*(centres - target).T)
            j = int(np.argmin(off))
            if j in place or off[j] > 0.25 * np.hypot(*u) or not 0.65 < sides[j] / sides[at] < 1.5:
                continue
            place[j] = (place[at][0] + column, place[at][1] + row)
            # Perspective: each square's own steps follow from the last one taken.
            moved = (centres[j] - centres[at]) * (column + row)
            steps[j] = (0.5 * (u + moved), v) if way < 2 else (u, 0.5 * (v + moved))
            queue.append(j)
    return place


def _layouts(lattice, centres, kind: str) -> Iterator[NDArray[np.float64]]:
    """Homographies from chart places to the picture: every way the chart may lie on a grid."""
    import cv2

    (columns, rows), fewest = GRIDS[kind], _SEARCHES[kind].squares
    for cos, sin in ((1, 0), (0, 1), (-1, 0), (0, -1)):
        turned = lattice @ np.array([[cos, sin], [-sin, cos]])
        low, high = turned.min(axis=0), turned.max(axis=0)
        for column in range(low[0] - 1, max(low[0], high[0] - columns + 1) + 2):
            for row in range(low[1] - 1, max(low[1], high[1] - rows + 1) + 2):
                local = turned - (column, row)
                inside = np.all((local >= 0) & (local < (columns, rows)), axis=1)
                if inside.sum() < fewest:
                    continue
                to_image, _ = cv2.findHomography(local[inside].astype(float), centres[inside])
                if to_image is not None:
                    yield to_image


# ---- by OpenCV


def _by_opencv(picture, kind: str) -> Iterator[NDArray[np.float64]]:
    """Homographies from the chart's places to the picture, from the outlines cv2.mcc finds.

    It is shown each filter's photograph, and their mean, at several scales.
    """
    import cv2

    squares = list(_square_sets(picture))
    parts = np.split(picture, picture.shape[-1] // 3, axis=-1)
    for part in (np.mean(parts, axis=0), *(parts if len(parts) > 1 else ())):
        eight_bit = (part[..., ::-1] * 255.0 + 0.5).astype(np.uint8)  # OpenCV's order is B, G, R
        for scale in _SCALES:
            corners = _opencv_outline(cv2.resize(eight_bit, None, fx=scale, fy=scale), kind)
            if corners is None:
                continue
            for turn in range(4):
                to_image = cv2.getPerspectiveTransform(
                    outline(kind).astype(np.float32),
                    np.roll(corners / scale, turn, axis=0).astype(np.float32),
                )
                mended = _mended(to_image, squares, kind)
                if mended is not None:
                    yield mended


def _opencv_outline(eight_bit, kind: str) -> NDArray[np.float64] | None:
    """Corners (4, 2) in px, clockwise, of the chart that cv2.mcc sees in a picture (h, w, 3).

    eight_bit  B, G, R
    """
    import cv2

    detector = cv2.mcc.CCheckerDetector.create()
    charts = {COLORCHECKER24: cv2.mcc.MCC24, COLORCHECKER_SG: cv2.mcc.SG140}
    picture = np.ascontiguousarray(eight_bit)
    if hasattr(detector, "setColorChartType"):  # from OpenCV 5 on
        detector.setColorChartType(charts[kind])
        seen = detector.process(picture, 1)
    else:
        seen = detector.process(picture, charts[kind], 1)  # type: ignore[call-overload]
    if not seen:
        return None
    corners = np.array(detector.getBestColorChecker().getBox(), np.float64)
    # Anticlockwise the chart would be mirrored.
    return (
        corners if cv2.contourArea(corners.astype(np.float32), oriented=True) > 0 else corners[::-1]
    )


def _mended(to_image, squares, kind: str) -> NDArray[np.float64] | None:
    """The homography through the squares that lie where it puts patches; None if they are few."""
    import cv2

    columns, rows = GRIDS[kind]
    places = np.array([(c, r) for r in range(rows) for c in range(columns)], np.float64)
    best, most = None, _ENOUGH_TO_MEND - 1
    for some in squares:
        mended = to_image
        for least in _NEAR:
            try:
                seen = mapped(np.linalg.inv(mended), some[:, :2])
            except np.linalg.LinAlgError:
                break
            off = np.linalg.norm(seen[:, None] - places, axis=-1)
            near = off.min(axis=1) < least
            if near.sum() < _ENOUGH_TO_MEND:
                break
            mended, _ = cv2.findHomography(places[off.argmin(axis=1)[near]], some[near, :2])
            if mended is None:
                break
        else:
            if near.sum() > most:
                best, most = mended, int(near.sum())
    return best


# ---- which of them is the chart


def _likeness(picture, to_image, kind: str) -> float:
    """How much the patches look like the printed ones: mean correlation over the bands.

    Logarithms are compared, so that light and filter, which multiply, do not count; each band is
    compared with the part of the spectrum (red, green, blue) it resembles by its place.
    """
    height, width = picture.shape[:2]
    x, y = np.floor(between(to_image, kind).corners.mean(axis=1)).astype(int).T
    if x.min() < 0 or y.min() < 0 or x.max() >= width or y.max() >= height:
        return 0.0
    seen = 2.0 * np.log(np.maximum(picture[y, x], 0.01))
    printed = _printed(kind)[:, np.arange(picture.shape[-1]) % 3]
    seen, printed = seen - seen.mean(axis=0), printed - printed.mean(axis=0)
    power = np.sum(seen**2, axis=0) * np.sum(printed**2, axis=0)
    correlation = np.sum(seen * printed, axis=0) / np.sqrt(np.maximum(power, 1e-12))
    return float(correlation.mean())


@functools.cache
def _printed(kind: str) -> NDArray[np.float64]:
    """Logarithm of the patches' reflectance (n, 3) in red, green and blue light."""
    if kind == COLORCHECKER24:
        patches = sets.surfaces("colorchecker24")
        parts = [(580.0, 680.0), (490.0, 590.0), (410.0, 510.0)]
        inside = [(patches.wavelengths >= a) & (patches.wavelengths <= b) for a, b in parts]
        return np.log(np.stack([patches.values[rows].mean(axis=0) for rows in inside], axis=1))
    # Spectra of the SG do not come with colour-science; its colours under D50 do, x, y, Y.
    table = sets._colour().CCS_COLOURCHECKERS["ColorCheckerSG - After November 2014"]
    x, y, luminance = np.array([table.data[name] for name in CHARTS[kind]]).T
    white_x, white_y = table.illuminant
    xyz = np.stack([x, y, 1.0 - x - y], axis=1) * (luminance / y)[:, None]
    white = np.array([white_x, white_y, 1.0 - white_x - white_y]) / white_y
    return np.log(np.maximum((xyz @ SHARP_FROM_XYZ.T) / (SHARP_FROM_XYZ @ white), 0.005))
