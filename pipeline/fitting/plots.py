"""Pictures of a fit: where colours are off, what the curves became, what noise becomes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration import chart as charts
from calibration import residuals
from calibration.display import SRGB
from calibration.merit import noise_amplification
from calibration.spectra import WAVELENGTHS
from pipeline.errors import InputError, Problem, replacing
from pipeline.fitting import Fitted

DELTA_E, COLOURS, CURVES, NOISE = "delta_e.png", "colours.png", "curves.png", "noise.png"
PICTURES = (DELTA_E, COLOURS, CURVES, NOISE)

# Of the palette that colour-blind people can tell apart (Okabe and Ito, 2008).
_BLUE, _ORANGE = "#0072B2", "#D55E00"
_MADE_BY = "sixlight fit"  # in each picture, so that only our own are replaced
_PANELS_ACROSS = 3
_PANEL_IN = 3.6  # inches, about
_READABLE = 40  # patches; of more, their names are read off the axes and no number is printed
_HEAT_TOP = 2.0  # dE2000 at which the scale of a heat map ends, at least
_ARROW_AB = 8.0  # a*b* units that the arrow of the 95th percentile is drawn long, about
_LENGTHENED = (1, 2, 5, 10, 20, 50, 100)
_GREY_AB = 6.0  # chroma below which a patch is meant to be grey


def check(folder: Path, *, force: bool) -> None:
    """Raises InputError, before any work, if the pictures could not be drawn into the folder."""
    problems = []
    for path in (folder / name for name in PICTURES):
        if path.exists() and not force and not _is_ours(path):
            problems.append(
                Problem("exists and is not ours", "a new file", "choose another, or --force", path)
            )
    if problems:
        raise InputError(problems)


def draw(fitted: Fitted, folder: Path) -> list[Path]:
    """Draws what there is to show of a fit into a folder, as PNG; returns the paths.

    delta_e.png  CIEDE2000 of every patch under every light, patches where they hang
    colours.png  where in a*b* each patch should be, and arrows to where it came out
    curves.png   the primaries' curves, and those that camera and matrix make of them together
    noise.png    noise amplification of each primary, and how well the bands tell apart

    The first two need a chart. The last compares with the pseudo-inverse where there is one.
    """
    drawn = figures(fitted)
    for name, figure in drawn.items():
        with replacing(folder / name) as beside:
            figure.savefig(beside, format="png", dpi=160, metadata={"Software": _MADE_BY})
    return [folder / name for name in drawn]


def figures(fitted: Fitted) -> dict[str, Any]:
    """The same as matplotlib figures, by file name."""
    off = fitted.residuals
    of_chart = {} if off is None else {DELTA_E: _delta_e(fitted, off), COLOURS: _colours(off)}
    return {**of_chart, CURVES: _curves(fitted), NOISE: _noise(fitted)}


def page(fitted: Fitted, title: str) -> str:
    """A report of a fit, its pictures among its figures, as HTML."""
    from pipeline import report

    pictures = [report.svg(figure) for figure in figures(fitted).values()]
    return report.render("fit.html", title=title, fitted=fitted, pictures=pictures)


def _is_ours(path: Path) -> bool:
    with path.open("rb") as file:
        return _MADE_BY.encode() in file.read(1024)  # PNG keeps its texts before the pixels


def _figure(width: float, height: float):
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _panels(
    count: int, width: float, height: float, beside: float = 0.0
) -> tuple[Any, Sequence[Any]]:
    """A figure and `count` axes in rows of up to three, each of about that size in inches.

    beside  inches left for what stands at the right
    """
    across = min(count, _PANELS_ACROSS)
    down = -(-count // across)
    figure = _figure(across * width + beside, down * height + 0.5)
    axes = figure.subplots(down, across, squeeze=False).ravel()
    for unused in axes[count:]:
        unused.set_axis_off()
    return figure, axes[:count]


def _delta_e(fitted: Fitted, off: residuals.Residuals):
    """A chart for each light, its patches as grey as they are wrong, their colour in the middle."""
    columns, rows = _grid(off.patches)
    top = max(_HEAT_TOP, float(np.ceil(np.nanmax(off.delta_e))))
    numbered = len(off.patches) <= _READABLE
    colours = SRGB.signal(off.read_xyz)
    figure, panels = _panels(
        len(off.lights), _PANEL_IN, (_PANEL_IN - 0.4) * rows / columns + 0.4, beside=1.0
    )
    for i, axes in enumerate(panels):
        values = off.delta_e[i].reshape(rows, columns)
        image = axes.imshow(values, vmin=0.0, vmax=top, cmap="Greys")
        for k, (place, value) in enumerate(np.ndenumerate(values)):
            row, column = place
            dark = np.nan_to_num(value) > 0.55 * top
            axes.scatter(
                column,
                row - (0.12 if numbered else 0.0),
                s=95 if numbered else 22,
                color=colours[i, k],
                edgecolor="white" if dark else "black",
                linewidth=0.5,
            )
            if numbered:
                said = f"{value:.1f}" if np.isfinite(value) else "left out"
                ink = "white" if dark else "black"
                axes.text(column, row + 0.36, said, ha="center", va="center", size=6, color=ink)
            elif not np.isfinite(value):
                axes.text(column, row, "x", ha="center", va="center", size=6)
        mean = np.nanmean(off.delta_e[i])
        axes.set_title(f"{off.lights[i]}: mean {mean:.2f}", fontsize=9)
        _name_patches(axes, off.patches, columns, rows)
    bar = figure.colorbar(image, ax=list(panels), aspect=30, pad=0.02)
    bar.set_label("CIEDE2000", fontsize=8)
    bar.ax.tick_params(labelsize=7)
    bar.outline.set_linewidth(0.5)
    transform = fitted.transform
    figure.suptitle(
        f"Error of each patch as fitted ({transform.method}, {len(transform.channels)} bands to "
        f"{transform.primaries})",
        fontsize=10,
    )
    return figure


def _grid(patches: Sequence[str]) -> tuple[int, int]:
    """Columns and rows of the chart with these patches."""
    return next(charts.GRIDS[kind] for kind, names in charts.CHARTS.items() if names == patches)


def _name_patches(axes, patches: Sequence[str], columns: int, rows: int) -> None:
    """Ticks that name the patches: of the SG letters and numbers, else the first of each row."""
    first = [patches[row * columns] for row in range(rows)]
    if first[0].isdigit():
        axes.set_xticks([])
        axes.set_yticks(range(rows), [f"{name}-{int(name) + columns - 1}" for name in first])
    else:
        axes.set_xticks(range(columns), [name[0] for name in patches[:columns]])
        axes.set_yticks(range(rows), [name[1:] for name in first])
        axes.xaxis.tick_top()
    axes.tick_params(length=0, labelsize=6)
    axes.spines[:].set_visible(False)


def _colours(off: residuals.Residuals):
    """The a*b* plane under each light: patches in their own colours, arrows to what was made."""
    shift = (off.made - off.read)[..., 1:]
    long = float(np.nanpercentile(np.hypot(*np.moveaxis(shift, -1, 0)), 95))
    times = min(_LENGTHENED, key=lambda t: abs(np.log(t * max(long, 1e-6) / _ARROW_AB)))
    reach = 1.15 * np.abs(off.read[..., 1:]).max()
    colours = SRGB.signal(off.read_xyz)
    figure, panels = _panels(len(off.lights), _PANEL_IN, _PANEL_IN)
    for i, axes in enumerate(panels):
        a, b = off.read[i, :, 1], off.read[i, :, 2]
        known = np.isfinite(shift[i, :, 0])
        axes.axhline(0.0, color="0.8", linewidth=0.6, zorder=0)
        axes.axvline(0.0, color="0.8", linewidth=0.6, zorder=0)
        axes.scatter(a, b, s=26, color=colours[i], edgecolor="0.3", linewidth=0.4)
        _arrows(axes, off.read[i, known, 1:], shift[i, known], times)
        _near_grey(axes, off.read[i], off.made[i], colours[i])
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
        lightness = np.nanmean(off.made[i, :, 0] - off.read[i, :, 0])
        axes.set_title(f"{off.lights[i]}: lightness off by {lightness:+.2f} L*", fontsize=9)
        axes.set_xlabel("a*", fontsize=8, labelpad=1)
        axes.set_ylabel("b*", fontsize=8, labelpad=-4)
        axes.tick_params(labelsize=7)
        axes.spines[["top", "right"]].set_visible(False)
    lengthened = f", drawn {times} times as long" if times > 1 else ""
    figure.suptitle(
        f"Patches as read, and arrows to what came out{lengthened} (CIELAB under D65)", fontsize=10
    )
    return figure


def _arrows(axes, start, shift, times: float = 1.0) -> None:
    """Arrows from points (n, 2) by shifts (n, 2), so many times as long."""
    axes.quiver(
        *np.transpose(start), *np.transpose(times * shift), angles="xy", scale_units="xy",
        scale=1.0, width=0.006, headwidth=4, color="black", zorder=3,
    )  # fmt: skip


def _near_grey(axes, read, made, colours) -> None:
    """The middle of the a*b* plane, larger, with arrows to scale: greys show a cast first."""
    grey = np.hypot(read[:, 1], read[:, 2]) < _GREY_AB
    known = grey & np.isfinite(made).all(axis=1)
    if not known.any():
        return
    inset = axes.inset_axes((0.04, 0.03, 0.3, 0.3))
    reach = 1.2 * max(1.0, np.abs(read[known, 1:]).max(), np.abs(made[known, 1:]).max())
    inset.axhline(0.0, color="0.8", linewidth=0.6, zorder=0)
    inset.axvline(0.0, color="0.8", linewidth=0.6, zorder=0)
    inset.scatter(
        read[known, 1], read[known, 2], s=14, color=colours[known], edgecolor="0.3", linewidth=0.4
    )
    _arrows(inset, read[known, 1:], (made - read)[known, 1:])
    inset.set(xlim=(-reach, reach), ylim=(-reach, reach), xticks=[], yticks=[], aspect="equal")
    inset.set_title(f"greys to \N{PLUS-MINUS SIGN}{reach:.1f}, to scale", fontsize=6, pad=2)
    inset.spines[:].set_color("0.6")


def _curves(fitted: Fitted):
    """A panel a primary: its own curve, and what the spectra are in truth weighted with."""
    wanted, (got, uncertain) = fitted.primaries.curves, fitted.curves
    channels = fitted.primaries.channels
    known = fitted.bands is not None
    label = "M times the camera's bands" if known else "M times the camera's bands, estimated"
    low = 1.1 * min(0.0, (got / wanted.max(axis=0)).min(), (wanted / wanted.max(axis=0)).min())
    high = 1.1 * max(1.0, (got / wanted.max(axis=0)).max())
    figure, panels = _panels(len(channels), _PANEL_IN, 0.7 * _PANEL_IN)
    for i, axes in enumerate(panels):
        top = wanted[:, i].max()
        axes.axhline(0.0, color="0.8", linewidth=0.6)
        axes.fill_between(
            WAVELENGTHS, wanted[:, i] / top, color=_BLUE, alpha=0.25, linewidth=0, label="primary"
        )
        axes.plot(WAVELENGTHS, got[:, i] / top, color=_ORANGE, linewidth=1.4, label=label)
        if not known:
            low_high = (got[:, i] - uncertain[:, i]) / top, (got[:, i] + uncertain[:, i]) / top
            axes.fill_between(
                WAVELENGTHS, *low_high, color=_ORANGE, alpha=0.2, linewidth=0,
                label="one standard deviation of the estimate",
            )  # fmt: skip
        axes.set(xlim=(WAVELENGTHS[0], WAVELENGTHS[-1]), ylim=(low, high))
        axes.set_title(f"{channels[i]}, {fitted.primaries.peaks_nm[i]:.0f} nm", fontsize=9)
        axes.tick_params(labelsize=7)
        axes.spines[["top", "right"]].set_visible(False)
    for axes in panels[-_PANELS_ACROSS:]:
        axes.set_xlabel("wavelength, nm", fontsize=8)
    for axes in panels[::_PANELS_ACROSS]:
        axes.set_ylabel("weight over\nthe primary's peak", fontsize=8)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3,
                  fontsize=8, frameon=False)  # fmt: skip
    figure.suptitle(
        f"What {fitted.transform.quantity} is weighted with, beside the primaries", fontsize=10
    )
    return figure


def _noise(fitted: Fitted):
    """Noise amplification of each primary; and beside it the bands' singular values."""
    transform, chart = fitted.transform, fitted.chart
    figure = _figure(7.6 if chart is not None else 4.6, 3.4)
    axes, *others = np.atleast_1d(figure.subplots(1, 1 if chart is None else 2))
    bars = [(transform.method, transform.figures["noise_amplification"], _BLUE)]
    if chart is not None:
        signals = chart.signals[chart.known]
        if transform.method != "pinv":
            plain = np.linalg.lstsq(signals, fitted.primaries.project(chart.spectra[chart.known]))
            amplified = noise_amplification(plain[0].T, signals)
            bars.append(("pseudo-inverse", amplified, _ORANGE))
        _singular_values(others[0], signals, transform.noise_level)
    width = 0.8 / len(bars)
    for k, (label, values, colour) in enumerate(bars):
        at = np.arange(len(values)) + (k - (len(bars) - 1) / 2) * width
        drawn = axes.bar(at, values, width, color=colour, label=label)
        axes.bar_label(drawn, fmt="{:.1f}", fontsize=7)
    axes.set_yscale("log")
    axes.set_ylim(0.5, 2.5 * max(max(values) for _, values, _ in bars))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_xticks(
        range(len(fitted.primaries.channels)),
        [f"{name}\n{nm:.0f} nm" for name, nm in
         zip(fitted.primaries.channels, transform.peaks_nm, strict=True)],
    )  # fmt: skip
    axes.set_ylabel("relative noise over that of a band", fontsize=8)
    axes.set_title("Noise amplification", fontsize=10)
    axes.tick_params(labelsize=7)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize=8, frameon=False, loc="upper right")
    return figure


def _singular_values(axes, signals: NDArray[np.float64], noise_level: float) -> None:
    """How much independent colour the bands hold, beside the noise that would hide it."""
    scaled = signals / np.sqrt(np.mean(signals**2, axis=0))
    values = np.linalg.svd(scaled, compute_uv=False) / np.sqrt(len(scaled))
    axes.semilogy(range(1, len(values) + 1), values, "o-", color=_BLUE, linewidth=1, markersize=5)
    if noise_level > 0.0:
        axes.axhline(noise_level, color=_ORANGE, linewidth=1.2, linestyle="--")
        axes.text(
            1.0, 0.85 * noise_level, f"noise that the fit expects, {100 * noise_level:g} %",
            fontsize=7, va="top",
        )  # fmt: skip
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_xticks(range(1, len(values) + 1))
    axes.set_xlabel("direction in the bands, strongest first", fontsize=8)
    axes.set_ylabel("rms signal along it (each band 1)", fontsize=8)
    axes.set_title(f"What the bands tell apart: condition {values[0] / values[-1]:.0f}",
                   fontsize=10)  # fmt: skip
    axes.tick_params(labelsize=7)
    axes.spines[["top", "right"]].set_visible(False)
