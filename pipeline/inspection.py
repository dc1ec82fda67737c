"""`sixlight inspect`: what a capture holds, without touching anything."""

from __future__ import annotations

import itertools
from io import StringIO
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline import capture as captures
from pipeline import io
from pipeline.bracket import exposure
from pipeline.files import decoding
from pipeline.report import shutter
from stages.develop import develop

if TYPE_CHECKING:
    from rich.console import Console


def inspect(folder: Path) -> dict[str, Any]:
    """Exposures, clipping and warnings of a capture, as plain data; InputError where it is wrong.

    Each exposure has its share of clipped samples and the share that stands above a hundredth of
    full scale; advice says what is missing at either end of the bracket.
    """
    loaded = captures.load(folder)
    filters = []
    advice = []
    for f in loaded.filters:
        exposures = decoding.each(_exposure, sorted(f.shots, key=attrgetter("light")))
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


def _exposure(shot: io.Shot) -> dict[str, Any]:
    given = exposure(shot)
    developed = develop(io.read_frame(shot.path, **given))
    return {
        "file": shot.path.name,
        **given,
        "clipped": float(1.0 - developed.usable.mean()),
        "lit": float(np.mean(developed.mosaic > 0.01)),
    }


def _advice(name: str, exposures) -> list[str]:
    shortest, longest = exposures[0], exposures[-1]
    advice = []
    if shortest["clipped"] > 0:
        share = shortest["clipped"]
        advice.append(
            f"{name}: the shortest exposure, {shutter(shortest['time_s'])}, still clips {share:.2%}"
            f" of the picture: add {shutter(shortest['time_s'] / 4)}"
        )
    if longest["lit"] < 1 - 0.25:
        advice.append(
            f"{name}: {1 - longest['lit']:.0%} of the longest exposure,"
            f" {shutter(longest['time_s'])}, lies under 1 % of full scale:"
            f" add {shutter(longest['time_s'] * 4)}"
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


def as_text(report: dict[str, Any], console: Console | None = None) -> str:
    """The report for people, as wide as their terminal, in colours where there is one.

    console  that the text is for; None: a plain one of a hundred characters
    """
    from rich.console import Console, Group
    from rich.table import Table
    from rich.text import Text

    console = console or Console(width=100, no_color=True, file=StringIO())
    width, height = report["size"]
    calibration = report["calibration"] or "none: the camera's bands will be written, not light"
    parts: list[Any] = [
        Text(report["name"], style="bold"),
        Text(
            f"{report['camera']}, {width} x {height} px, {report['cfa']}; calibration {calibration}"
        ),
    ]
    for f in report["filters"]:
        table = Table(title=Text(f["name"], style="bold"), title_justify="left", box=None)
        table.add_column("file", overflow="fold")
        for head in ("time", "ISO", "f/", "clipped", "lit"):
            table.add_column(head, justify="right")
        for k, e in enumerate(f["exposures"]):
            lost = k == 0 and e["clipped"] > 0
            table.add_row(
                Text(e["file"]),
                shutter(e["time_s"]),
                f"{e['iso']:g}",
                f"{e['f_number']:g}",
                Text(f"{e['clipped']:.2%}", style="yellow" if lost else ""),
                f"{e['lit']:.2%}",
            )
        parts += ["", table]
    parts.append(Text("clipped: saturated; lit: above a hundredth of full scale", style="dim"))
    parts += [Text(f"note: {note}", style="yellow") for note in report["notes"]]
    parts += [Text(f"advice: {text}", style="yellow") for text in report["advice"]]
    if not report["notes"] and not report["advice"]:
        parts.append(Text("nothing is missing", style="green"))
    with console.capture() as captured:
        console.print(Group(*parts))
    return captured.get().rstrip("\n")
