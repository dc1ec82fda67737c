"""`sixlight display`: what a measured display is, how well its model fits, and what to distrust."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from calibration import measured_display
from calibration.measured_display import Characterisation, Errors

# CIEDE2000. About 1 is the least an eye tells apart side by side; Day, Taplin and Berns (2004)
# report means well below for displays that are stable.
_SEEN, _PLAIN = 1.0, 3.0
_ADDITIVE = 0.02  # what instruments and warming up may leave
_CONTRAST = 100.0  # below, black itself is lighter than L* = 9
_LEVELS = 9


def report(path: Path) -> dict[str, Any]:
    """All figures of a display's measurements and model; InputError where they are wrong.

    returns  plain data: white_luminance and black_luminance in the file's unit, white_xy, contrast,
             full_drive; of each channel xy, levels, gamma (of a power through half drive);
             additivity; errors fitted, left_out and inverse, each mean, max, count and the worst
             one's drive; distrust, sentences
    """
    found = measured_display.load(path)
    display, samples = found.display, found.samples
    levels = [len(np.unique(samples.drive[samples.ramp(c), c])) for c in range(3)]
    half = display.decoded(np.full(3, 0.5))
    black = float(samples.xyz[samples.black, 1].mean())
    return {
        "name": display.name,
        "file": str(path),
        "measurements": len(samples.drive),
        "full_drive": samples.full,
        "white_luminance": display.white_cd_m2,
        "white_xy": _xy(display.white),
        "black_luminance": black,
        "contrast": display.white_cd_m2 / black if black > 0 else None,
        "channels": {
            name: {
                "xy": display.primaries[c].tolist(),
                "levels": levels[c],
                "gamma": math.log(half[c]) / math.log(0.5) if half[c] > 0 else None,
            }
            for c, name in enumerate(("red", "green", "blue"))
        },
        "additivity": found.additivity,
        "delta_e_2000": {
            "fitted": _errors(found.fitted, samples.full),
            "left_out": _errors(found.left_out, samples.full),
            "inverse": _errors(found.inverse, samples.full),
        },
        "distrust": _distrust(found, min(levels), black),
    }


def as_text(told: dict[str, Any]) -> str:
    """A report for people."""
    contrast = f"{told['contrast']:.0f} : 1" if told["contrast"] else "not measurable"
    lines = [
        f"{told['file']}: {told['measurements']} measurements, full drive {told['full_drive']:g}",
        f"  white   {told['white_luminance']:.4g}, {_place(told['white_xy'])}",
        f"  black   {told['black_luminance']:.4g}, contrast {contrast}",
    ]
    for name, channel in told["channels"].items():
        gamma = f"{channel['gamma']:.2f}" if channel["gamma"] else "none"
        lines.append(
            f"  {name:7} {_place(channel['xy'])}, {channel['levels']} levels,"
            f" gamma {gamma} at half drive"
        )
    lines += [
        f"  red, green and blue together give {told['additivity']:.1%} of the white's light",
        "",
        "  CIEDE2000                          mean    max  at R, G, B",
    ]
    for key, words in (
        ("fitted", "on black, ramps and greys"),
        ("left_out", "on mixed colours, left out"),
        ("inverse", "of colours asked for"),
    ):
        e = told["delta_e_2000"][key]
        if e["count"]:
            worst = ", ".join(f"{v:g}" for v in e["worst"])
            lines.append(f"  {words:32} {e['mean']:6.2f} {e['max']:6.2f}  {worst}")
        else:
            lines.append(f"  {words:32}   none measured")
    doubts = told["distrust"]
    lines += ["", "  What to distrust:" if doubts else "  Nothing here is to be distrusted."]
    return "\n".join(lines + [f"  - {doubt}" for doubt in doubts])


def _distrust(found: Characterisation, levels: int, black: float) -> list[str]:
    """What of a display's model should not be relied on, and what helps."""
    doubts = []
    if _bad(found.fitted):
        doubts.append(
            "the model misses what it was made from: let the display warm up, switch off dynamic"
            " contrast and colour enhancement, measure again"
        )
    if found.left_out.count == 0:
        doubts.append("no mixed colour was measured, so nothing has tested the model: add some")
    elif _bad(found.left_out):
        doubts.append(
            "mixed colours are missed: the channels disturb each other, or the display drifted"
            " while it was measured"
        )
    if abs(found.additivity - 1.0) > _ADDITIVE:
        doubts.append(
            f"the white has {1 / found.additivity:.2f} times the light of red, green and blue one"
            " by one: a matrix cannot hold that; bright colours or the white are off"
        )
    if _bad(found.inverse):
        doubts.append(
            "some measured colours lie outside what the model can show, and come out as others"
        )
    if black > 0 and found.display.white_cd_m2 / black < _CONTRAST:
        doubts.append(
            f"black is {black / found.display.white_cd_m2:.1%} of the white: what is darker"
            " in a picture is lost in it; darken the room"
        )
    if levels < _LEVELS:
        doubts.append(
            f"a ramp has {levels} levels, and its curve is a guess between them: measure"
            f" {_LEVELS} to 18"
        )
    return doubts


def _bad(errors: Errors) -> bool:
    return errors.count > 0 and (errors.mean > _SEEN or errors.max > _PLAIN)


def _errors(errors: Errors, full: float) -> dict[str, Any]:
    some = errors.count > 0
    return {
        "mean": errors.mean if some else None,
        "max": errors.max if some else None,
        "count": errors.count,
        "worst": [v * full for v in errors.worst],
    }


def _xy(xyz) -> list[float]:
    return [float(v) for v in xyz[:2] / xyz.sum()]


def _place(xy) -> str:
    return f"x {xy[0]:.4f} y {xy[1]:.4f}"
