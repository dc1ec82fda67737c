"""Where a render is off, and by how much: one picture of a scene's errors in CIEDE2000.

    python -m benchmarks.error_picture [SCENE] [-o FILE.png] [--width PX]

Rendered in full spectra by Mitsuba, and by the shaders in six channels and in three, under the
bundled room.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from benchmarks import render, worlds
from benchmarks.render import WAYS, Compared
from calibration.adaptation import D65, cat02
from calibration.display import auto_exposure, srgb
from calibration.errors import InputError

SCENES = {"colorchecker": (render.chart, 0.69), "teapot": (render.teapot, 0.83)}
HIGHEST = 6.0  # dE at the top of the scale
VISIBLE = 1.0  # dE: about what an eye can tell apart, side by side
INK, PAPER, FAINT = "#22262b", "#ffffff", "#6b7280"

TITLES = {
    "six": "Six channels",
    "darling2011": "Six, Darling et al. 2011",
    "sharp": "Three, sharpened RGB",
    "xyz": "Three, XYZ",
}


def error_picture(
    found: Compared, path: Path, *, title: str, shading: bool = True, highest: float = HIGHEST
) -> None:
    """The scene in full spectra, and a map of each way's errors beside it, with one scale.

    found    what `benchmarks.render.compare` gave
    path     of the PNG
    title    of the whole
    shading  the shaders' whole errors; False: the channels' alone, all else being exact
    highest  CIEDE2000 at the top of the scale
    """
    from matplotlib import colormaps
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    of = found.errors if shading else found.colour_errors
    maps = {way: of(way) for way in found.pictures}
    height, width = found.things.shape
    across = len(maps) + 1
    panel = 2.7  # inches
    tall = panel * height / width
    figure = Figure(figsize=(panel * across + 1.1, tall + 1.25), dpi=200, facecolor=PAPER)
    FigureCanvasAgg(figure)
    top, bottom = 0.68 / (tall + 1.25), 0.4 / (tall + 1.25)
    grid = figure.add_gridspec(
        1, across + 1, width_ratios=[*[1.0] * across, 0.055],
        left=0.012, right=0.945, top=1 - top, bottom=bottom, wspace=0.045,
    )  # fmt: skip
    scale, colours = Normalize(0.0, highest), colormaps["magma"].with_extremes(bad="#e7e5e4")

    def frame(column: int, heading: str, below: str):
        axes = figure.add_subplot(grid[0, column])
        axes.set_axis_off()
        axes.set_title(heading, fontsize=10.5, color=INK, pad=7, loc="left")
        axes.text(0.0, -0.035, below, transform=axes.transAxes, fontsize=8.5, color=FAINT, va="top")
        return axes

    shown = frame(0, "Full spectra", "36 wavelengths, Mitsuba 3")
    shown.imshow(_as_seen(found, found.truth if shading else found.direct), interpolation="none")
    for column, (way, errors) in enumerate(maps.items(), start=1):
        middle, most = np.nanmean(errors), np.nanpercentile(errors, 95)
        said = f"mean {middle:.2f}, 95 % below {most:.2f}"
        axes = frame(column, TITLES.get(way, way), said)
        image = axes.imshow(errors, norm=scale, cmap=colours, interpolation="none")
    bar = figure.colorbar(image, cax=figure.add_subplot(grid[0, across]), extend="max")
    bar.outline.set_visible(False)
    bar.ax.axhline(VISIBLE, color=PAPER, linewidth=1.2)
    ticks = [0, *range(1, int(highest) + 1)]
    bar.set_ticks(ticks, labels=[str(t) if t != 1 else "1  just visible" for t in ticks])
    bar.ax.tick_params(labelsize=8, colors=INK, length=0, pad=4)
    bar.ax.set_title("ΔE₀₀", fontsize=9, color=INK, pad=7, loc="left")
    figure.text(0.012, 1 - 0.16 / (tall + 1.25), title, fontsize=12.5, color=INK, va="top")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, facecolor=PAPER, bbox_inches="tight", pad_inches=0.12)


def _as_seen(found: Compared, xyz):
    """sRGB (H, W, 3), adapted from the scene's white."""
    adapted = xyz @ cat02(found.white, D65).T
    return srgb(adapted, exposure=auto_exposure(adapted[found.things]))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", default="teapot", choices=SCENES)
    parser.add_argument("-o", "--out", type=Path, help="default build/bench/errors_SCENE.png")
    parser.add_argument("--width", type=int, default=240, help="px of each map")
    parser.add_argument(
        "--channels-alone", action="store_true", help="the channels' errors, all else exact"
    )
    arguments = parser.parse_args()
    scene, aspect = SCENES[arguments.scene]
    out = arguments.out or Path("build/bench") / f"errors_{arguments.scene}.png"
    ways = tuple(way for way in WAYS if way != "darling2011")
    try:
        found = render.compare(
            worlds.room(), scene(), width=arguments.width,
            height=round(arguments.width * aspect), samples=144, ways=ways,
        )  # fmt: skip
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    what = "of the channels alone" if arguments.channels_alone else "against full spectra"
    error_picture(
        found, out, title=f"Colour differences {what}", shading=not arguments.channels_alone
    )
    print(out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
