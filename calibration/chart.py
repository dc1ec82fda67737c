"""A ColorChecker in photographs: where its patches are, and what the camera saw of each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.errors import InputError, Problem, fault

COLUMNS, ROWS = 6, 4
PATCHES = tuple(str(i) for i in range(1, COLUMNS * ROWS + 1))
"""The patches' names, row by row from the brown corner."""

_SG_COLUMNS = "ABCDEFGHIJKLMN"

CHARTS = {
    "colorchecker24": PATCHES,
    "colorchecker-sg": tuple(f"{column}{row}" for row in range(1, 11) for column in _SG_COLUMNS),
}
"""The patches of each chart, row by row; the SG's columns have letters and its rows numbers. Only
the 24 patches are found in photographs; the SG's places are given."""

BOXES_HEADER = ("patch", "x0", "y0", "x1", "y1")

CLIPPED_SHARE = 0.02  # of a patch's pixels; more than stray bad ones
_FEWEST_PIXELS = 16

# A patch is uneven when it varies by this much more than its noise: part of another patch, a
# finger, a reflection. Texture and dust stay below, so does the light's own fall over a patch.
_UNEVEN = 0.06  # of its mean ...
_UNEVEN_DARK = 0.004  # ... and of the brightest patch's, so that flare over black is forgiven

# Of a found patch only the middle is read: its edges are blurred by lens and demosaicing.
_MIDDLE = 0.5

# The patch's side over the distance from one patch to the next, on the printed chart.
_PATCH_SHARE = 0.8

_SEARCH_PX = 1000  # the chart is looked for in pictures of this size; it need not be large
_WINDOWS_PX = (31, 61, 121)  # over which "brighter than around it" is judged
_FEWEST_SQUARES = 12  # of the 24 that must be seen as squares
_LEAST_LIKENESS = 0.75  # correlation with the printed chart's patches; wrong ways round reach .5


@dataclass(frozen=True)
class Patches:
    """Where a chart's patches lie in an image.

    names    (n,)
    corners  (n, 4, 2) px (x, y) of each patch's quadrilateral, in order around it; the first
             pixel's centre is (0.5, 0.5)
    """

    names: tuple[str, ...]
    corners: NDArray[np.float64]


@dataclass(frozen=True)
class PatchSignals:
    """What an image holds within each patch.

    mean      (n, C); NaN where clipped or uneven
    variance  (n, C) of one pixel about the patch's mean; NaN where clipped
    noise     (n, C) of one pixel, as the image itself states it; NaN where clipped or not stated
    clipped   (n, C) bool, more than CLIPPED_SHARE of its pixels are not known
    uneven    (n, C) bool, it varies far more than its noise does
    pixels    (n,) number of pixels in the patch
    """

    mean: NDArray[np.float64]
    variance: NDArray[np.float64]
    noise: NDArray[np.float64]
    clipped: NDArray[np.bool_]
    uneven: NDArray[np.bool_]
    pixels: NDArray[np.int_]

    @property
    def mean_variance(self) -> NDArray[np.float64]:
        """Variance (n, C) of the means: of spread and stated noise whichever is more.

        Demosaicing makes about four neighbours one, so a patch has a quarter as many pixels.
        """
        variance: NDArray[np.float64] = np.fmax(self.variance, self.noise)
        return variance / np.maximum(self.pixels / 4.0, 1.0)[:, None]


def patch_signals(values, valid, patches: Patches, variance=None) -> PatchSignals:
    """Mean and variance of an image within each patch.

    values    (H, W, C) linear signal; NaN where not known
    valid     (H, W) 0 not known .. 1 known; a pixel counts from .5
    variance  (H, W, C) of the values as the merge states it; None: the spread is all there is
    raises   InputError if a patch leaves the image or is too small
    """
    height, width, channels = values.shape
    problems, rows = [], []
    for name, quad in zip(patches.names, patches.corners, strict=True):
        (x0, y0), (x1, y1) = np.floor(quad.min(axis=0)), np.ceil(quad.max(axis=0))
        if x0 < 0 or y0 < 0 or x1 > width or y1 > height:
            problems.append(
                Problem(
                    f"patch {name} reaches to ({x0:.0f}, {y0:.0f})..({x1:.0f}, {y1:.0f})",
                    f"boxes inside the image of {width} x {height} px",
                    "correct its box",
                )
            )
            continue
        rows.append((slice(int(y0), int(y1)), slice(int(x0), int(x1))))
    if problems:
        raise InputError(problems)
    mean, spread, noise = np.full((3, len(rows), channels), np.nan)
    clipped, pixels = np.zeros((len(rows), channels), bool), np.zeros(len(rows), int)
    for i, (window, quad) in enumerate(zip(rows, patches.corners, strict=True)):
        inside = _inside(quad, window)
        pixels[i] = inside.sum()
        if pixels[i] < _FEWEST_PIXELS:
            raise fault(
                f"patch {patches.names[i]} covers {pixels[i]} pixels",
                f"{_FEWEST_PIXELS} or more",
                "correct its box, or photograph the chart larger",
            )
        samples = np.asarray(values[window][inside], np.float64)
        known = np.isfinite(samples) & (np.asarray(valid)[window][inside] >= 0.5)[:, None]
        clipped[i] = known.mean(axis=0) < 1.0 - CLIPPED_SHARE
        for c in np.flatnonzero(~clipped[i]):
            mean[i, c] = samples[known[:, c], c].mean()
            spread[i, c] = samples[known[:, c], c].var(ddof=1)
            if variance is not None:
                noise[i, c] = np.mean(variance[window][inside][known[:, c], c], dtype=np.float64)
    uneven = _uneven(mean, spread, noise)
    return PatchSignals(np.where(uneven, np.nan, mean), spread, noise, clipped, uneven, pixels)


def _uneven(mean, spread, noise) -> NDArray[np.bool_]:
    """Which patches (n, C) vary far more than their noise; none where the noise is not stated."""
    allowed = _UNEVEN * mean + _UNEVEN_DARK * np.nanmax(mean, axis=0, initial=0.0)
    # Three times the noise: a stated noise may be a third too low, and small patches scatter.
    return np.sqrt(np.maximum(spread - 9.0 * noise, 0.0)) > allowed


def shading(values, valid, patches: Patches) -> NDArray[np.float64]:
    """How strongly the light falls on each patch (n,), from a photograph of white in its place.

    values   (H, W, C) linear signal of an even white; NaN where not known
    returns  relative to the mean of the patches
    raises   InputError if the white clips, or a patch leaves the image
    """
    white = patch_signals(values, valid, patches)
    if white.clipped.any():
        names = [patches.names[i] for i in np.flatnonzero(white.clipped.any(axis=1))]
        raise fault(
            f"the white clips at patch {', '.join(names)}",
            "a white that is known everywhere",
            "expose it shorter",
        )
    relative = white.mean / white.mean.mean(axis=0)
    shade: NDArray[np.float64] = relative.mean(axis=1)  # one light: the same for all bands
    return shade


def turned(signals, spectra) -> bool:
    """Whether the patches' signals look like the spectra of a chart the other way up.

    Turned by 180 degrees the patches come in reverse. Logarithms are compared, so that light,
    filter and exposure, which multiply, do not count.

    signals  (n, B) of the patches in the order of the spectra, row by row; NaN where not known
    spectra  (n, 36) read of each patch
    """
    assert len(signals) == len(spectra)
    known = np.isfinite(signals).all(axis=1)
    seen = np.log(np.maximum(np.nanmean(signals, axis=1), 1e-30))
    read = np.log(np.maximum(np.mean(spectra, axis=1), 1e-30))

    def likeness(order) -> float:
        used = known & np.isfinite(read[order])
        return float(np.corrcoef(seen[used], read[order][used])[0, 1]) if used.sum() > 2 else 0.0

    here = np.arange(len(seen))
    return likeness(here[::-1]) > max(likeness(here), _LEAST_LIKENESS)


def _inside(quad, window: tuple[slice, slice]) -> NDArray[np.bool_]:
    """Which pixel centres of a window lie in a convex quadrilateral."""
    y = np.arange(window[0].start, window[0].stop)[:, None] + 0.5
    x = np.arange(window[1].start, window[1].stop)[None, :] + 0.5
    after = np.roll(quad, -1, axis=0)
    sides = [
        (bx - ax) * (y - ay) - (by - ay) * (x - ax)
        for (ax, ay), (bx, by) in zip(quad, after, strict=True)
    ]
    return np.all([s >= 0 for s in sides], axis=0) | np.all([s <= 0 for s in sides], axis=0)


def read_boxes(path: str | Path, names: Sequence[str] = PATCHES) -> Patches:
    """Patches from a CSV of patch,x0,y0,x1,y1, in px; raises InputError naming file and line."""
    path = Path(path)
    if not path.is_file():
        raise fault("no such file", "patch,x0,y0,x1,y1", "correct the path", path)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise fault("not UTF-8", "UTF-8 text", "save the file as CSV UTF-8", path) from None
    rows = [[cell.strip() for cell in line.split(",")] for line in lines]
    if not rows or tuple(rows[0]) != BOXES_HEADER:
        found = lines[0] if lines else "nothing"
        raise fault(f"line 1 is {found!r}", ",".join(BOXES_HEADER), "write that line first", path)
    problems: list[Problem] = []
    boxes: dict[str, list[float]] = {}
    for number, row in enumerate(rows[1:], start=2):
        if row == [""]:
            continue
        try:
            x0, y0, x1, y1 = map(float, row[1:])
        except ValueError:
            problems.append(Problem(f"line {number}: {','.join(row)!r}", "a patch, four numbers",
                                    "correct it"))  # fmt: skip
            continue
        if not (x0 < x1 and y0 < y1 and np.isfinite([x0, y0, x1, y1]).all()):
            problems.append(Problem(f"line {number}: an empty box", "x0 < x1 and y0 < y1",
                                    "correct it"))  # fmt: skip
        if row[0] in boxes:
            problems.append(Problem(f"line {number}: patch {row[0]} again", "each patch once",
                                    "take one out"))  # fmt: skip
        boxes[row[0]] = [x0, y0, x1, y1]
    missing = [patch for patch in names if patch not in boxes]
    unknown = [patch for patch in boxes if patch not in names]
    if missing or unknown:
        what = f"no box for patch {', '.join(missing)}" if missing else f"patch {unknown[0]!r}"
        problems.append(
            Problem(what, f"patches {names[0]}..{names[-1]}, each once", "correct the first column")
        )
    if problems:
        raise InputError(problems).at(path)
    corners = [
        [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
        for x0, y0, x1, y1 in (boxes[patch] for patch in names)
    ]
    return Patches(tuple(names), np.array(corners, np.float64))


def find(images: Sequence[NDArray[np.floating]]) -> Patches:
    """The ColorChecker's patches, found in photographs of it from one place.

    Squares brighter than the black around them are looked for in the photographs' bands, the
    grid they lie on is followed, and of all ways to lay the chart on the grid the one whose
    patches look most like the printed ones is taken, whatever the light and filter.

    images   (H, W, 3) linear signal each, one a filter; NaN where not known
    returns  the middles of the patches 1..24
    raises   InputError if there is no chart to be seen
    """
    picture, scale = _picture(images)
    best, likeness = None, _LEAST_LIKENESS
    for squares in _square_sets(picture):
        for lattice, centres in _grids(squares):
            for to_image in _layouts(lattice, centres):
                likely = _likeness(picture, _quads(to_image, _MIDDLE))
                if likely > likeness:
                    best, likeness = to_image, likely
    if best is None:
        raise fault(
            "no ColorChecker found in the photographs",
            "all 24 patches in view and in focus",
            'give their places: patches = "patch_boxes.csv" with patch,x0,y0,x1,y1 in px',
        )
    return Patches(PATCHES, _quads(best, _MIDDLE) / scale)


def _picture(images) -> tuple[NDArray[np.float32], float]:
    """All bands of the photographs as one image (h, w, C) of about _SEARCH_PX, and its scale.

    Each band is divided by its bright end and curved like an eye, so that no coloured light or
    filter leaves a band dark.
    """
    height, width = images[0].shape[:2]
    scale = min(1.0, _SEARCH_PX / max(height, width))
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
        if len(found) >= _FEWEST_SQUARES:
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


def _grids(squares) -> Iterator[tuple[NDArray[np.int_], NDArray[np.float64]]]:
    """Grids the squares lie on: integer places (m, 2) and centres (m, 2), largest first."""
    grids = []
    taken: set[int] = set()
    for i in range(len(squares)):
        if i in taken:
            continue
        place = _followed(squares, i)
        taken.update(place)
        if len(place) >= _FEWEST_SQUARES:
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


def _layouts(lattice, centres) -> Iterator[NDArray[np.float64]]:
    """Homographies from chart places (column 0..5, row 0..3) to the image: every way it may lie."""
    import cv2

    for cos, sin in ((1, 0), (0, 1), (-1, 0), (0, -1)):
        turned = lattice @ np.array([[cos, sin], [-sin, cos]])
        low, high = turned.min(axis=0), turned.max(axis=0)
        for column in range(low[0] - 1, max(low[0], high[0] - COLUMNS + 1) + 2):
            for row in range(low[1] - 1, max(low[1], high[1] - ROWS + 1) + 2):
                local = turned - (column, row)
                inside = np.all((local >= 0) & (local < (COLUMNS, ROWS)), axis=1)
                if inside.sum() < _FEWEST_SQUARES:
                    continue
                to_image, _ = cv2.findHomography(local[inside].astype(float), centres[inside])
                if to_image is not None:
                    yield to_image


def _quads(to_image, share: float) -> NDArray[np.float64]:
    """Corners (24, 4, 2) of the middle `share` of each patch under a homography."""
    half = 0.5 * _PATCH_SHARE * share
    corner = half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    middle = np.array([(c, r) for r in range(ROWS) for c in range(COLUMNS)], np.float64)
    points = middle[:, None, :] + corner
    mapped = np.concatenate([points, np.ones((*points.shape[:2], 1))], axis=-1) @ to_image.T
    return mapped[..., :2] / mapped[..., 2:]


def _likeness(picture, quads) -> float:
    """How much the patches look like a ColorChecker's: mean correlation over the bands.

    Logarithms are compared, so that light and filter, which multiply, do not count; each band is
    compared with the part of the spectrum (red, green, blue) it resembles by its place.
    """
    height, width = picture.shape[:2]
    x, y = np.floor(quads.mean(axis=1)).astype(int).T
    if x.min() < 0 or y.min() < 0 or x.max() >= width or y.max() >= height:
        return 0.0
    seen = 2.0 * np.log(np.maximum(picture[y, x], 0.01))
    printed = _printed()[:, np.arange(picture.shape[-1]) % 3]
    seen, printed = seen - seen.mean(axis=0), printed - printed.mean(axis=0)
    power = np.sum(seen**2, axis=0) * np.sum(printed**2, axis=0)
    correlation = np.sum(seen * printed, axis=0) / np.sqrt(np.maximum(power, 1e-12))
    return float(correlation.mean())


def _printed() -> NDArray[np.float64]:
    """Logarithm of the patches' mean reflectance (24, 3) over red, green and blue."""
    from calibration import sets

    patches = sets.surfaces("colorchecker24")
    parts = [(580.0, 680.0), (490.0, 590.0), (410.0, 510.0)]
    inside = [(patches.wavelengths >= a) & (patches.wavelengths <= b) for a, b in parts]
    return np.log(np.stack([patches.values[rows].mean(axis=0) for rows in inside], axis=1))
