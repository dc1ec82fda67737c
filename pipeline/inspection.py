"""`sixlight inspect`: what a capture holds, without touching anything."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np

from pipeline import capture as captures
from pipeline import io
from stages.develop import develop


def inspect(folder: Path) -> dict[str, Any]:
    """Exposures, clipping and warnings of a capture, as plain data; InputError where it is wrong.

    Each exposure has its share of clipped samples and the share that stands above a hundredth of
    full scale; advice says what is missing at either end of the bracket.
    """
    loaded = captures.load(folder)
    filters = []
    advice = []
    for f in loaded.filters:
        exposures = []
        for shot in sorted(f.shots, key=lambda s: s.time_s * s.iso / s.f_number**2):
            frame = io.read_frame(
                shot.path, time_s=shot.time_s, iso=shot.iso, f_number=shot.f_number
            )
            exposure = develop(frame)
            exposures.append(
                {
                    "file": shot.path.name,
                    "time_s": shot.time_s,
                    "iso": shot.iso,
                    "f_number": shot.f_number,
                    "clipped": float(1.0 - exposure.usable.mean()),
                    "lit": float(np.mean(exposure.mosaic > 0.01)),
                }
            )
        filters.append({"name": f.name, "exposures": exposures})
        advice += _advice(f.name, exposures)
    first = loaded.shots[0]
    return {
        "name": loaded.name,
        "camera": first.camera or "not named in the files",
        "size": [first.size[1], first.size[0]],
        "cfa": first.cfa,
        "calibration": None if loaded.transform is None else loaded.transform.primaries,
        "filters": filters,
        "notes": list(loaded.notes),
        "advice": advice,
    }


def _advice(name: str, exposures) -> list[str]:
    shortest, longest = exposures[0], exposures[-1]
    advice = []
    if shortest["clipped"] > 0:
        share = shortest["clipped"]
        advice.append(
            f"{name}: {share:.2%} of the shortest exposure clips; "
            f"add one of {_shutter(shortest['time_s'] / 4)}"
        )
    if longest["lit"] < 1 - 0.25:
        advice.append(
            f"{name}: {1 - longest['lit']:.0%} of the longest exposure lies under 1 % of full "
            f"scale; add one of {_shutter(longest['time_s'] * 4)}"
        )
    for a, b in itertools.pairwise(exposures):
        ratio = b["time_s"] * b["iso"] / b["f_number"] ** 2
        ratio /= a["time_s"] * a["iso"] / a["f_number"] ** 2
        if ratio > 17:
            advice.append(
                f"{name}: {a['file']} and {b['file']} lie {np.log2(ratio):.1f} EV apart; "
                "steps of 2 EV overlap well"
            )
    return advice


def _shutter(time_s: float) -> str:
    return f"1/{1 / time_s:.0f} s" if time_s < 0.4 else f"{time_s:.2g} s"


def as_text(report: dict[str, Any]) -> str:
    """The report for people."""
    width, height = report["size"]
    lines = [
        report["name"],
        f"camera {report['camera']}, {width} x {height} px, {report['cfa']}",
        f"calibration {report['calibration'] or 'none: the camera bands will be written'}",
    ]
    for f in report["filters"]:
        lines.append(f"{f['name']}:")
        lines += [
            f"  {e['file']:<24} {_shutter(e['time_s']):>10}  ISO {e['iso']:<5g} "
            f"f/{e['f_number']:<4g} clipped {e['clipped']:7.2%}  lit {e['lit']:7.2%}"
            for e in f["exposures"]
        ]
    lines += [f"note: {note}" for note in report["notes"]]
    lines += [f"advice: {text}" for text in report["advice"]]
    return "\n".join(lines)
