"""A calibration session: a 24-patch ColorChecker photographed under five lights, and measured.

The chart hangs a little askew in a dark room, lit a little unevenly. A spectroradiometer reads
the radiance of each patch where it hangs, with half a percent of noise. Each light gets one
photograph a filter, exposed by the patch that comes nearest to saturation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration import primaries
from calibration.spectra import Spectra, write_spectra
from pipeline.simulate.camera import (
    FILTER_SHIFTS,
    FILTERS,
    Camera,
    Shutter,
    expose,
    mosaic,
    responses,
    through_lens,
)  # fmt: skip
from pipeline.simulate.materials import FINE, checker_patches, lamp

# folder: spectrum of colour-science, luminance of the chart's white in cd/m2
LIGHTS = {
    "A": ("A", 210.0),  # tungsten
    "D65": ("D65", 340.0),  # daylight
    "D50": ("D50", 300.0),
    "F2": ("FL2", 240.0),  # cool white fluorescent
    "LED": ("LED-B3", 260.0),  # white, phosphor, 4100 K
}

SIZE = (640, 448)  # px of the photographs: the middle of the sensor is enough
PITCH = 96.0  # px from patch to patch
PATCH = 80.0  # px, side of a patch
TURNED = np.radians(1.8)
BOX = 52.0  # px, side of the box a patch is read in
SUBPIXELS, MARGIN = 4, 6
SURROUND, FRAME = 0.004, 0.035  # reflectances

WriteShot = Callable[[Path, np.ndarray, Camera, Shutter, int], None]


def photograph_chart(folder: Path, camera: Camera, write: WriteShot, *, seed: int) -> None:
    """Write the whole session below `folder`; `write` writes one raw photograph."""
    camera = replace(camera, width=SIZE[0], height=SIZE[1])
    rng = np.random.default_rng(seed)
    which, shade = _drawing()
    folder.mkdir(parents=True)
    (folder / "patch_boxes.csv").write_text(_boxes())
    (folder / "calibration.toml").write_text(
        "# A ColorChecker under five lights, for `sixlight fit`.\n"
        'chart = "colorchecker24"\n'
        'patches = "patch_boxes.csv"\n'
        f'primaries = "{primaries.DEFAULT}"\n'
        'method = "delta-e"\n'
    )
    plain = np.ones((len(FINE), 1))
    reflectances = np.concatenate([checker_patches(), SURROUND * plain, FRAME * plain], axis=1)
    number = 0
    for name, (spectrum, luminance) in LIGHTS.items():
        radiance = luminance / _white_luminance() * lamp(spectrum)[:, None] * reflectances
        measured = radiance[:, :24] * _shade_at(_centres())
        measured = measured * (1 + 0.005 * rng.standard_normal(measured.shape))
        (folder / name).mkdir()
        patches = tuple(str(i + 1) for i in range(24))
        write_spectra(folder / name / "radiance.csv", Spectra(FINE, patches, measured))
        for filter_name in FILTERS:
            electrons = (radiance.T @ responses(camera, filter_name))[which] * shade[..., None]
            image = through_lens(electrons, camera, SUBPIXELS, MARGIN, FILTER_SHIFTS[filter_name])
            shutter = longest_within(image.max(), camera)
            raw = expose(mosaic(image), shutter.time_s, camera, rng)
            (folder / name / filter_name).mkdir()
            write(folder / name / filter_name / "chart.dng", raw, camera, shutter, number)
            number += 1


def longest_within(electrons_per_second: float, camera: Camera, share: float = 0.75) -> Shutter:
    """The longest shutter under which no pixel collects more than `share` of the full well."""
    allowed = share * camera.full_well / electrons_per_second
    return Shutter(int(np.clip(np.floor(3 * np.log2(allowed)), -36, 15)))


def _white_luminance() -> float:
    """Luminance of patch 19, the white, under a light of 1 cd/m2 off a perfect white."""
    return float(checker_patches()[:, 18].mean())  # it is flat within a percent


def _centres() -> np.ndarray:
    """Centres (24, 2) of the patches, px."""
    row, column = np.divmod(np.arange(24), 6)
    across, down = (column - 2.5) * PITCH, (row - 1.5) * PITCH
    cos, sin = np.cos(TURNED), np.sin(TURNED)
    x = SIZE[0] / 2 + 6 + cos * across - sin * down
    y = SIZE[1] / 2 - 4 + sin * across + cos * down
    return np.stack([x, y], axis=1)


def _shade_at(xy):
    """How strongly the light falls there, 1 in the middle: 4 % less toward the lower right."""
    x, y = xy[..., 0] / SIZE[0] - 0.5, xy[..., 1] / SIZE[1] - 0.5
    return 1.0 - 0.05 * x - 0.03 * y - 0.06 * (x * x + y * y)


def _drawing() -> tuple[np.ndarray, np.ndarray]:
    """At subpixels: which patch (0..23), surround (24) or frame (25) it is, and the shading."""
    rows, columns = ((n + 2 * MARGIN) * SUBPIXELS for n in (SIZE[1], SIZE[0]))
    x = (np.arange(columns) + 0.5) / SUBPIXELS - MARGIN
    y = (np.arange(rows) + 0.5) / SUBPIXELS - MARGIN
    xy = np.stack(np.broadcast_arrays(x[None, :], y[:, None]), axis=-1)
    middle = _centres().mean(axis=0)
    cos, sin = np.cos(TURNED), np.sin(TURNED)
    turned = (xy - middle) @ np.array([[cos, -sin], [sin, cos]])
    across, down = turned[..., 0] / PITCH + 3.0, turned[..., 1] / PITCH + 2.0
    which = np.full((rows, columns), 24)
    which[(np.abs(across - 3) < 3.12) & (np.abs(down - 2) < 2.12)] = 25
    column, row = np.floor(across).astype(int), np.floor(down).astype(int)
    half = PATCH / PITCH / 2
    on_patch = (np.abs(across - column - 0.5) < half) & (np.abs(down - row - 0.5) < half)
    on_patch &= (column >= 0) & (column < 6) & (row >= 0) & (row < 4)
    which[on_patch] = (row * 6 + column)[on_patch]
    return which, _shade_at(xy)


def _boxes() -> str:
    lines = ["patch,x0,y0,x1,y1"]
    for i, (x, y) in enumerate(_centres()):
        x0, y0, x1, y1 = (round(v) for v in (x - BOX / 2, y - BOX / 2, x + BOX / 2, y + BOX / 2))
        lines.append(f"{i + 1},{x0},{y0},{x1},{y1}")
    return "\n".join(lines) + "\n"
