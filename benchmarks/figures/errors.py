"""Maps of errors, pixel by pixel: full spectra, rendered by Mitsuba, against few channels.

The light is the true one for all: what the channels and the shading do wrong is seen alone, and not
what the capture did.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks import render
from benchmarks.figures.paper import TEAPOT_CAMERA, Drawn
from benchmarks.figures.setting import Setting
from benchmarks.figures.sheet import GAP, INK, MARGIN, SOFT, WIDTH, Sheet, enlarged
from calibration import look as looks
from calibration.look import Look

WAYS = {"six": "Six channels", "sharp": "Three, sharpened RGB", "xyz": "Three, XYZ"}
HIGHEST = 6.0  # dE at the top of the scale
VISIBLE = 1.0  # dE: about what an eye can tell apart, side by side
_NO_THING = (0.92, 0.92, 0.915)
_BAR = 110  # px, for the scale
_PATHS = 144  # a pixel, to find the light from thing to thing
_TIMES = 2  # px of the sheet along a pixel of the maps


def errors(setting: Setting) -> Drawn:
    """The chart and the teapot: errors of the channels alone, and of the whole render.

    Raises InputError where Mitsuba or its LLVM is missing.
    """
    wide = (WIDTH - 2 * MARGIN - _BAR - len(WAYS) * GAP) // (len(WAYS) + 1)
    size = wide // _TIMES
    wide = size * _TIMES
    rows: list[tuple[str, Any, Any, dict[str, Any]]] = []
    measured: dict[str, dict[str, dict[str, float]]] = {}
    for name, scene, aspect in (
        ("chart", render.chart(), 0.69),
        ("teapot", replace(render.teapot(), camera=TEAPOT_CAMERA), 0.62),
    ):
        found = render.compare(
            setting.world, scene, width=size, height=round(size * aspect), samples=_PATHS,
            ways=tuple(WAYS),
        )  # fmt: skip
        for what, truth, of in (
            ("channels alone", found.direct, found.colour_errors),
            ("everything", found.truth, found.errors),
        ):
            seen = looks.shown(truth, Look(), found.white, exposure_of=truth[found.things])
            maps = {way: of(way) for way in WAYS}
            rows.append((f"{name}, {what}", seen.signal, found.things, maps))
            measured[f"{name}, {what}"] = {way: _told(off) for way, off in maps.items()}
    return Drawn(_sheet(rows, wide), measured)


def _told(off) -> dict[str, float]:
    known = off[np.isfinite(off)]
    return {"mean": float(known.mean()), "p95": float(np.percentile(known, 95))}


def _sheet(rows, wide: int) -> Sheet:
    lefts = [MARGIN + k * (wide + GAP) for k in range(len(WAYS) + 1)]
    line = 34
    heights = [signal.shape[0] * _TIMES for _, signal, _, _ in rows]
    top = MARGIN + 44
    sheet = Sheet(top + sum(heights) + len(rows) * (line + GAP))
    for heading, left in zip(("Full spectra", *WAYS.values()), lefts, strict=True):
        sheet.text(heading, left, MARGIN, size=24)
    y = top
    for (what, signal, things, maps), high in zip(rows, heights, strict=True):
        sheet.picture(enlarged(signal, _TIMES), lefts[0], y)
        sheet.text(what, lefts[0], y + high + 6, size=18, colour=SOFT)
        for (_, off), left in zip(maps.items(), lefts[1:], strict=True):
            sheet.picture(enlarged(coloured(off, things), _TIMES), left, y)
            told = _told(off)
            said = f"mean {told['mean']:.2f}, 95 % below {told['p95']:.2f}"
            sheet.text(said, left, y + high + 6, size=18, colour=SOFT)
        y += high + line + GAP
    _scale(sheet, lefts[-1] + wide + GAP, top, heights[0])
    return sheet


def coloured(off, things):
    """Errors (H, W) as colours (H, W, 3), those above HIGHEST as at it; grey where no thing is."""
    from matplotlib import colormaps

    colours = colormaps["magma"](np.clip(np.nan_to_num(off) / HIGHEST, 0, 1))[..., :3]
    return np.where((things & np.isfinite(off))[..., None], colours, _NO_THING)


def _scale(sheet: Sheet, left: int, top: int, high: int) -> None:
    axes = sheet.axes(left, top, 22, high)
    ramp = np.linspace(HIGHEST, 0, 256)[:, None]
    axes.imshow(coloured(ramp, ramp >= 0), extent=(0, 1, 0, HIGHEST), aspect="auto")
    axes.axhline(VISIBLE, color="white", linewidth=1.5)
    labels = [f"{k}" for k in range(int(HIGHEST) + 1)]
    labels[-1] += "+"
    axes.set_yticks(range(int(HIGHEST) + 1), labels)
    axes.yaxis.tick_right()
    axes.set_xticks([])
    axes.tick_params(labelsize=13, colors=INK, length=0, pad=5)
    for spine in axes.spines.values():
        spine.set_visible(False)
    sheet.text("ΔE", left, top - 28, size=18)
