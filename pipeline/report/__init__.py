"""Reports: self-contained pages in one house style, of how things went and what to distrust.

A page holds no script and asks for nothing. Names from captures pass through jinja2, which escapes
them; drawings are SVG of matplotlib, which does likewise.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from calibration.display import SRGB, encode
from pipeline.errors import fault, replacing


def render(template: str, **values: Any) -> str:
    """A page of this folder's templates, escaped wherever a value is put into it."""
    return str(_environment().get_template(template).render(**values))


@cache
def _environment():
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["version"] = version("sixlight")
    environment.filters |= {
        "percent": lambda v, digits=1: f"{100 * v:.{digits}f} %",
        "figure": lambda v, digits=3: "not known" if v is None else f"{v:.{digits}g}",
        "fixed": lambda v, digits=2: "not known" if v is None else f"{v:.{digits}f}",
        "shutter": shutter,
        "azimuth": azimuth_deg,
        "elevation": elevation_deg,
        "swatch": _swatch,
    }
    return environment


def shutter(time_s: float) -> str:
    """An exposure time as photographers write it."""
    return f"1/{1 / time_s:.0f} s" if time_s < 0.4 else f"{time_s:.3g} s"


def azimuth_deg(direction: Sequence[float]) -> float:
    """From the camera, +Z, to the right, +X: -180..180."""
    return math.degrees(math.atan2(direction[0], direction[2]))


def elevation_deg(direction: Sequence[float]) -> float:
    """Above the horizon: -90..90."""
    return math.degrees(math.asin(max(-1.0, min(1.0, direction[1]))))


def _swatch(xyz: Sequence[float]) -> str:
    """A light's colour, as bright as sRGB can show it, as CSS has it."""
    rgb = np.maximum(SRGB.rgb_from_xyz @ np.asarray(xyz, np.float64), 0.0)
    signal = np.clip(encode(rgb / max(rgb.max(), np.finfo(float).tiny)), 0.0, 1.0)
    return "#" + "".join(f"{round(255 * float(v)):02x}" for v in signal)


def check(path: Path, *, force: bool = False) -> None:
    """Before any work: InputError if a page may not be written there, as it is no page of ours."""
    if path.exists() and not force and not (path.is_file() and _OURS in path.read_bytes()[:2000]):
        raise fault("exists and is not ours", "a new file", "choose another, or --force", path)


def store(path: Path, page: str) -> None:
    """Writes a page, whole or not at all."""
    with replacing(path) as beside:
        beside.write_text(page, encoding="utf-8")


_OURS = b'<meta name="generator" content="sixlight">'


def svg(figure):
    """A matplotlib figure as SVG to be put into a page, the same for the same figure."""
    from markupsafe import Markup
    from matplotlib import rc_context

    with rc_context(STYLE):
        file = io.StringIO()
        figure.savefig(file, format="svg", transparent=True, dpi=110, metadata={"Date": None})
    text = file.getvalue()
    return Markup(text[text.index("<svg") :])


STYLE: Any = {
    "svg.fonttype": "none",  # text stays text: it is read, found and copied
    "svg.hashsalt": "sixlight",
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#888888",
    "axes.linewidth": 0.6,
    "axes.labelcolor": "#444444",
    "text.parse_math": False,  # names may hold a dollar
    "xtick.color": "#666666",
    "ytick.color": "#666666",
    "legend.frameon": False,
}
