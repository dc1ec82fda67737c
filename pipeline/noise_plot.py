"""A picture of the camera's noise: the photon transfer curve a bracket's noise was measured by."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.bracket import Bracket
from pipeline.capture import Capture
from pipeline.errors import fault, storing
from stages.merge import merge


def draw(capture: Capture, path: Path) -> None:
    """Writes variance against signal, both in full scale, of each filter's bracket, as PNG or SVG.

    Points are bins of samples that two exposures have in common, the lines gain signal + read^2.
    Needs matplotlib, of the extra `plots`.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise fault(
            "matplotlib is not installed", "", "pip install 'sixlight[plots]'", path
        ) from error

    figure = Figure(figsize=(7, 5), layout="constrained")
    axes = figure.add_subplot()
    for filter_ in capture.filters:
        radiance = merge(Bracket.of(filter_.shots), capture.known)
        isos = sorted({shot.iso for shot in filter_.shots})
        of, signal, variance, _ = radiance.transfer.T
        for i, iso in enumerate(isos):
            k = next(k for k, shot in enumerate(filter_.shots) if shot.iso == iso)
            gain, read = radiance.noise[k]
            label = f"{filter_.name}, ISO {iso:g}: {1 / gain:.0f} e-, read {read / gain:.1f} e-"
            mine = (of == i) & (signal > 0) & (variance > 0)
            points = axes.loglog(signal[mine], variance[mine], ".", alpha=0.6)[0]
            line = np.geomspace(max(read / 10, 1e-6), 1, 200)
            axes.loglog(line, gain * line + read**2, color=points.get_color(), label=label)
    axes.set_xlabel("signal, share of full scale")
    axes.set_ylabel("variance of a sample, full scale squared")
    axes.legend()
    axes.grid(alpha=0.3)
    with storing(path):
        figure.savefig(path, dpi=120)
