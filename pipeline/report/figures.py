"""The report's drawings, as SVG to be put into the page; matplotlib draws them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from calibration.spectra import read_spectra
from pipeline.report import STYLE, svg
from stages.layouts import CUBE, LATLONG
from stages.resample import resample
from stages.types import Measured

# Of the palette that colour-blind people can tell apart (Okabe and Ito, 2008).
BLUE, ORANGE, GREEN, PINK, SKY, RED = PALETTE = (
    "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00",
)  # fmt: skip
_WIDE_IN = 9.4
_LATLONG = (-180.0, 180.0, -90.0, 90.0)  # of the picture's edges, degrees from its centre, -Z


def _drawn(width: float, height: float, draw) -> Markup:
    """The SVG of a figure of that size in inches that `draw` fills."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        draw(figure)
    return svg(figure)


def exposures(rows: Sequence[Mapping[str, Any]]) -> Markup:
    """How far each exposure's light, as solved from the overlaps, lies from its tag."""

    def draw(figure):
        axes = figure.subplots()
        ev, off = [r["ev"] for r in rows], [100 * r["off"] for r in rows]
        axes.axhline(0, color="#bbbbbb", linewidth=0.8, zorder=0)
        axes.vlines(ev, 0, off, color=BLUE, linewidth=1.2)
        axes.plot(ev, off, "o", color=BLUE, markersize=5)
        reach = max(2.0, 1.25 * max(abs(v) for v in off))
        axes.set(ylim=(-reach, reach), xlabel="exposure as tagged, EV under the longest")
        axes.set_ylabel("solved light\nover the tag's, %")

    return _drawn(_WIDE_IN / 2, 2.1, draw)


def photon_transfer(brackets: Mapping[str, Mapping[str, Any]]) -> Markup:
    """Variance against signal: the points the noise was measured by, and the model's line."""

    def draw(figure):
        axes = figure.subplots()
        for (name, told), colour in zip(brackets.items(), PALETTE * 9, strict=False):
            points = np.array(told["photon_transfer"], float).reshape(-1, 4)
            mine = points[:, 0] == 0 if len(points) else np.zeros(0, bool)
            signal, variance = points[mine, 1], points[mine, 2]
            seen = (signal > 0) & (variance > 0)
            axes.loglog(signal[seen], variance[seen], ".", color=colour, alpha=0.55, markersize=5)
            gain, read = told["noise_gain_and_read"][0]
            line = np.geomspace(max(read / 10, 1e-6), 1, 100)
            axes.loglog(line, gain * line + read**2, color=colour, linewidth=1.3, label=name)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter("{x:g}")
        axes.set_xlabel("signal, share of full scale")
        axes.set_ylabel("variance of a sample")
        axes.legend(loc="upper left")

    return _drawn(_WIDE_IN / 2, 2.9, draw)


def _latlong_axes(axes, *, short: bool = False) -> None:
    """Degrees from what is behind the sphere, -Z, which is in the middle; to the right is +X."""
    signs = ["+Z", "\N{MINUS SIGN}X", "\N{MINUS SIGN}Z", "+X", "+Z"]
    words = ["camera", "left", "behind", "right", "camera"]
    names = signs if short else [f"{s} {w}" for s, w in zip(signs, words, strict=True)]
    axes.set(xlim=_LATLONG[:2], ylim=_LATLONG[2:], facecolor="#d8dadd")
    axes.set_xticks((-180, -90, 0, 90, 180), names)
    axes.set_yticks((-90, 0, 90), [""] * 3 if short else ["\N{MINUS SIGN}Y", "horizon", "+Y"])
    axes.tick_params(length=0, labelsize=8)
    axes.spines[:].set_visible(True)
    axes.spines[:].set_color("#cccccc")


def _place(direction: Sequence[float]) -> tuple[float, float]:
    """Where a latlong picture shows a direction, in degrees from its centre."""
    x, y, z = direction
    return float(np.degrees(np.arctan2(x, -z))), float(np.degrees(np.arcsin(np.clip(y, -1, 1))))


def environment(picture, lights: Sequence[Mapping[str, Any]]) -> Markup:
    """The latlong map as seen, its lights numbered."""

    def draw(figure):
        axes = figure.subplots()
        axes.imshow(np.clip(picture, 0, 1), extent=_LATLONG, interpolation="antialiased")
        for number, light in enumerate(lights, 1):
            if light["direction"] is None:
                continue
            x, y = _place(light["direction"])
            axes.annotate(
                str(number), (x, y), color="white", ha="center", va="center", fontsize=9,
                bbox={"boxstyle": "circle,pad=0.25", "fc": "#000000aa", "ec": "white", "lw": 0.8},
            )  # fmt: skip
        _latlong_axes(axes)

    return _drawn(_WIDE_IN, _WIDE_IN / 2 + 0.1, draw)


def _map(values, label: str, *, cmap: str, low: float, high: float, log: bool = False) -> Markup:
    from matplotlib.colors import LogNorm, Normalize

    def draw(figure):
        axes = figure.subplots()
        norm = LogNorm(low, high) if log else Normalize(low, high)
        image = axes.imshow(
            np.clip(values, low, high), extent=_LATLONG, cmap=cmap, norm=norm,
            interpolation="nearest",
        )  # fmt: skip
        _latlong_axes(axes, short=True)
        bar = figure.colorbar(image, ax=axes, shrink=0.8, pad=0.02, format="{x:g}")
        bar.set_label(label)
        bar.outline.set_visible(False)

    return _drawn(_WIDE_IN / 2, 2.3, draw)


def valid(share) -> Markup:
    """Where the map knows its light, 0..1."""
    return _map(share, "known", cmap="Greys_r", low=0.0, high=1.0)


def sigma(relative) -> Markup:
    """Standard deviation of a texel's luminance over it; grey where nothing is known."""
    return _map(
        100 * relative, "noise of the luminance, %", cmap="viridis", low=0.1, high=100, log=True
    )


def spectra(file: Path, lights: Sequence[Mapping[str, Any]]) -> Markup:
    """Estimated spectra of the lights, each over its largest value."""
    table = read_spectra(file)

    def draw(figure):
        count = len(lights)
        panels = figure.subplots(1, count, sharey=True, squeeze=False)[0]
        for number, (axes, light) in enumerate(zip(panels, lights, strict=True), 1):
            values = table[light["name"]]
            top = np.abs(values).max() or 1.0
            axes.axhline(0, color="#bbbbbb", linewidth=0.6)
            axes.fill_between(table.wavelengths, values / top, color=SKY, alpha=0.25, linewidth=0)
            axes.plot(table.wavelengths, values / top, color=BLUE, linewidth=1.3)
            axes.set(xlim=(380, 730), xticks=(400, 500, 600, 700), yticks=(0, 1))
            named = "everything else" if light["direction"] is None else f"light {number}"
            axes.set_title(named, fontsize=9)
        panels[0].set_ylabel("relative")
        figure.supxlabel("wavelength, nm", fontsize=9, color="#444444")

    return _drawn(_WIDE_IN, 1.9, draw)


def moved(file: Path) -> Markup:
    """Where in the photograph exposures contradict each other."""
    with np.load(file, allow_pickle=False) as data:
        mask = data["moved"]
    step = max(1, -(-max(mask.shape) // 1000))
    height, width = (length // step * step for length in mask.shape)
    share = mask[:height, :width].reshape(height // step, step, width // step, step).any((1, 3))

    def draw(figure):
        axes = figure.subplots()
        axes.imshow(share, cmap="Greys", vmin=0, vmax=1, interpolation="nearest")
        axes.set(xticks=(), yticks=())
        axes.spines[:].set_visible(True)

    return _drawn(_WIDE_IN / 2, _WIDE_IN / 2 * height / width, draw)


def drift(pixels, names: Sequence[str]) -> list[tuple[str, Markup]]:
    """For each later filter, how much the light changed since the first one's photographs."""
    drawn = []
    for k, name in enumerate(names):
        if not name.endswith(".log_ratio"):
            continue
        faces = pixels[..., k].reshape(6, -1, pixels.shape[1])[..., None]
        known = np.isfinite(faces[..., 0]).astype(np.float32)
        image = resample(Measured(faces, np.full_like(faces, np.nan), known), CUBE, LATLONG, 128)
        share = 100 * np.expm1(image.values[..., 0])
        label = "more or less light, %"
        drawn.append(
            (name.removesuffix(".log_ratio"), _map(share, label, cmap="PuOr_r", low=-30, high=30))
        )
    return drawn


def calibration(figures: Mapping[str, Any]) -> Markup:
    """Error under each light it was fitted with, and noise amplification of each primary."""

    def draw(figure):
        lights = figures.get("light_delta_e") or {}
        panels = figure.subplots(1, 2 if lights else 1, squeeze=False)[0]
        if lights:
            axes = panels[0]
            bars = axes.barh(list(lights), list(lights.values()), color=BLUE, height=0.6)
            axes.bar_label(bars, fmt="%.2f", padding=3, fontsize=8)
            axes.invert_yaxis()
            axes.set_xlabel("CIEDE2000 of the chart, mean")
            axes.tick_params(axis="y", length=0)
        axes = panels[-1]
        amplified = figures["noise_amplification"]
        names = [f"P{i + 1}" for i in range(len(amplified))]
        bars = axes.bar(names, amplified, color=ORANGE, width=0.6)
        axes.bar_label(bars, fmt="%.1f", padding=2, fontsize=8)
        axes.set_ylabel("noise over a band's")
        axes.tick_params(axis="x", length=0)

    return _drawn(_WIDE_IN, 2.3, draw)
