"""A ColorChecker in photographs: where its patches are, and what the camera saw of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.errors import InputError, Problem, fault, read_text

COLORCHECKER24, COLORCHECKER_SG = "colorchecker24", "colorchecker-sg"

GRIDS = {COLORCHECKER24: (6, 4), COLORCHECKER_SG: (14, 10)}
"""Columns and rows of each chart."""

PATCHES = tuple(str(i) for i in range(1, 25))
"""The 24 patches' names, row by row from the brown corner."""

CHARTS = {
    COLORCHECKER24: PATCHES,
    COLORCHECKER_SG: tuple(f"{column}{row}" for row in range(1, 11) for column in "ABCDEFGHIJKLMN"),
}
"""The patches of each chart, row by row; the SG's columns have letters and its rows numbers."""

BOXES_HEADER = ("patch", "x0", "y0", "x1", "y1")

CLIPPED_SHARE = 0.02  # of a patch's pixels; more than stray bad ones
_FEWEST_PIXELS = 16

# A patch is uneven when it varies by this much more than its noise: part of another patch, a
# finger, a reflection. Texture and dust stay below, so does the light's own fall over a patch.
_UNEVEN = 0.06  # of its mean ...
_UNEVEN_DARK = 0.004  # ... and of the brightest patch's, so that flare over black is forgiven

# Of a patch between the chart's corners only the middle is read: its edges are blurred by lens and
# demosaicing.
_MIDDLE = 0.5

# The patch's side over the distance from one patch to the next, on the printed charts.
PATCH_SHARE = {COLORCHECKER24: 0.8, COLORCHECKER_SG: 0.85}

# Correlation of signals with the readings of their names, see `_likeness`: .999 where they are
# right, .66 of an SG the other way up, less in any other order.
_LEAST_LIKENESS = 0.85
_ENOUGH_TO_TELL = 12  # patches; more than _PARTS, or any signals could be made
_PARTS = 7  # of the spectrum
_DARKEST = 1e-3  # of the brightest signal; below there is flare and noise


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
    """Whether the patches' signals are those of the spectra in reverse: a chart the other way up.

    signals  (n, B) of the patches in the order of the spectra, row by row; NaN where not known
    spectra  (n, 36) read of each patch
    """
    reverse = _likeness(signals, spectra[::-1])
    return reverse > _LEAST_LIKENESS and reverse > _likeness(signals, spectra)


def unlike(signals, spectra) -> bool:
    """Whether no camera has these signals of these spectra: a name is not its patch's.

    Arguments as of `turned`; a handful of patches cannot tell.
    """
    return _likeness(signals, spectra) < _LEAST_LIKENESS


def _likeness(signals, spectra) -> float:
    """How well signals (n, B) follow from spectra (n, 36); NaN where too little is known.

    Whatever a camera's band and its filter are, no wavelength counts negatively. So each band is
    fitted with what light of a few parts of the spectrum, none negative, gives; the correlation of
    the logarithms of fit and signal is averaged over the bands. Exposure does not count.
    """
    from scipy.optimize import nnls  # .8 s

    assert len(signals) == len(spectra)
    parts = np.stack([p.mean(axis=1) for p in np.array_split(spectra, _PARTS, axis=1)], axis=1)
    found = []
    for band in np.asarray(signals, np.float64).T:
        known = np.isfinite(band)
        top = band.max(where=known, initial=0.0)
        if known.sum() < _ENOUGH_TO_TELL or top <= 0.0:
            continue
        seen = np.maximum(band[known], _DARKEST * top)
        amounts, _ = nnls(parts[known] / seen[:, None], np.ones(len(seen)))  # relative errors
        made = np.maximum(parts[known] @ amounts, _DARKEST * top)
        alike = np.log(made).std() > 0.0 < np.log(seen).std()
        found.append(np.corrcoef(np.log(made), np.log(seen))[0, 1] if alike else 0.0)
    return float(np.mean(found)) if found else float("nan")


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
        lines = read_text(path, "a CSV of boxes").splitlines()
    except InputError as error:
        raise error.at(path) from None
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


def from_corners(corners, kind: str = COLORCHECKER24) -> Patches:
    """The middles of a chart's patches between its corners, as perspective has it.

    corners  (4, 2) px (x, y) of the outer corners of the area of patches, clockwise in the
             photograph from the first patch's (1 or A1)
    kind     one of CHARTS
    raises   InputError if they do not go clockwise around a chart
    """
    import cv2

    corners = np.asarray(corners, np.float64)
    sides = np.roll(corners, -1, axis=0) - corners
    turns = [a[0] * b[1] - a[1] * b[0] for a, b in zip(sides, np.roll(sides, -1, 0), strict=True)]
    if not min(turns) > 0.0:
        names = CHARTS[kind]
        columns = GRIDS[kind][0]
        order = ", ".join((names[0], names[columns - 1], names[-1], names[-columns]))
        raise fault(
            f"corners {[tuple(c) for c in corners.tolist()]} that do not go clockwise",
            f"the outer corners of patches {order} in that order",
            "order them so; a chart is never seen mirrored",
        )
    to_image = cv2.getPerspectiveTransform(
        outline(kind).astype(np.float32), corners.astype(np.float32)
    )
    return between(to_image, kind)


def outline(kind: str) -> NDArray[np.float64]:
    """Outer corners (4, 2) of a chart's patches in places (column, row), clockwise from the first.

    The first patch's centre is (0, 0), the next one's to the right (1, 0).
    """
    columns, rows = GRIDS[kind]
    half = 0.5 * PATCH_SHARE[kind]
    left, right, top, bottom = -half, columns - 1 + half, -half, rows - 1 + half
    return np.array([(left, top), (right, top), (right, bottom), (left, bottom)])


def between(to_image, kind: str = COLORCHECKER24) -> Patches:
    """The middles of the patches of a chart that a homography lays in an image.

    to_image  (3, 3) from places (column, row), see `outline`, to px
    kind      one of CHARTS
    """
    columns, rows = GRIDS[kind]
    half = 0.5 * PATCH_SHARE[kind] * _MIDDLE
    corner = half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    centres = np.array([(c, r) for r in range(rows) for c in range(columns)], np.float64)
    return Patches(CHARTS[kind], mapped(to_image, centres[:, None, :] + corner))


def mapped(to_image, points) -> NDArray[np.float64]:
    """Points (..., 2) under a homography (3, 3)."""
    points = np.asarray(points, np.float64)
    seen = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1) @ to_image.T
    through: NDArray[np.float64] = seen[..., :2] / seen[..., 2:]
    return through
