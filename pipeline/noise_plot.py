"""The camera's noise: figures in electrons, and the photon transfer curve they were read from.

J. R. Janesick, "Photon Transfer" (SPIE, 2007).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pipeline import io
from pipeline.bracket import Bracket, exposure
from pipeline.capture import Capture
from pipeline.errors import storing
from stages.merge import merge
from stages.noise import Model, uncertainty


def draw(capture: Capture, path: Path) -> list[dict[str, Any]]:
    """Writes noise against signal, both in raw steps, of each filter's bracket, as PNG or SVG.

    Points are bins of samples that two exposures have in common, lines the model: in full, and
    what of it is read noise (dashed) and the pixels' unequal response (dotted), which two
    exposures share, so that no point shows it.

    returns  the figures, one for each filter and sensitivity: filter, iso, electrons_per_step (the
             system gain, e-/DN), full_scale_electrons, read_electrons, read_steps,
             dynamic_range_ev (full scale over read noise), prnu (a share of the signal), and
             gain_sigma and read_sigma, relative standard deviations; None where that ISO's noise
             was not measured but is given, or a typical camera's
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 6), layout="constrained")
    axes = figure.add_subplot()
    told = []
    for filter_ in capture.filters:
        radiance = merge(Bracket.of(filter_.shots), capture.known)
        first = filter_.shots[0]
        frame = io.read_frame(first.path, **exposure(first))
        levels = float(np.mean(frame.saturation_level - frame.black_level))
        isos = sorted({shot.iso for shot in filter_.shots})
        shot_at = [next(k for k, s in enumerate(filter_.shots) if s.iso == iso) for iso in isos]
        noise = radiance.noise[shot_at]
        model = Model(noise[:, 0], noise[:, 1], radiance.transfer)
        for i, iso in enumerate(isos):
            one = _figures(filter_.name, iso, model, i, levels, radiance.prnu)
            if iso in capture.known.noise:
                one["gain_sigma"] = one["read_sigma"] = None
            told.append(one)
            _curve(axes, model, i, levels, one)
    axes.set_xlabel("signal, raw steps (DN) above black")
    axes.set_ylabel("noise of a sample, raw steps rms")
    axes.legend(fontsize="small")
    axes.grid(alpha=0.3)
    with storing(path):
        figure.savefig(path, dpi=120)
    return told


def as_text(told: list[dict[str, Any]]) -> str:
    """The figures for people, a line each."""

    def within(sigma: float | None) -> str:
        return " (not measured)" if sigma is None else f" +-{100 * sigma:.1f} %"

    return "\n".join(
        f"noise of {one['filter']}, ISO {one['iso']:g}:"
        f" {one['electrons_per_step']:.3g} e-/DN{within(one['gain_sigma'])},"
        f" full scale {one['full_scale_electrons']:.0f} e-,"
        f" read {one['read_electrons']:.2g} e- = {one['read_steps']:.2g} DN"
        f"{within(one['read_sigma'])},"
        f" range {one['dynamic_range_ev']:.1f} EV,"
        f" PRNU {100 * one['prnu']:.2f} %"
        for one in told
    )


def _figures(
    name: str, iso: float, model: Model, of: int, levels: float, prnu: float
) -> dict[str, Any]:
    gain, read = float(model.gain[of]), float(model.read[of])
    gain_sigma, read_sigma = uncertainty(model, of)
    known = bool(np.isfinite(gain_sigma))
    return {
        "filter": name,
        "iso": iso,
        "electrons_per_step": 1 / (gain * levels),
        "full_scale_electrons": 1 / gain,
        "read_electrons": read / gain,
        "read_steps": read * levels,
        "dynamic_range_ev": float(-np.log2(read)),
        "prnu": prnu,
        "gain_sigma": gain_sigma / gain if known else None,
        "read_sigma": read_sigma / read if known else None,
    }


def _curve(axes, model: Model, of: int, levels: float, one: dict[str, Any]) -> None:
    """The points of one sensitivity, and its lines."""
    gain, read, prnu = model.gain[of], model.read[of], one["prnu"]
    which, signal, variance, _ = model.transfer.T
    mine = (which == of) & (signal > 0) & (variance > 0)
    seen = levels * signal[mine], levels * np.sqrt(variance[mine])
    colour = axes.loglog(*seen, ".", alpha=0.6)[0].get_color()
    x = np.geomspace(max(read / 10, 1e-6), 1, 200)
    label = (
        f"{one['filter']}, ISO {one['iso']:g}: {one['electrons_per_step']:.3g} e-/DN,"
        f" read {one['read_electrons']:.2g} e-, PRNU {100 * prnu:.2f} %"
    )
    axes.loglog(levels * x, levels * np.sqrt(gain * x + read**2), color=colour, label=label)
    axes.axhline(levels * read, color=colour, linestyle="--", linewidth=0.8)
    if prnu > 0:
        pattern = x > read / prnu  # where it is more than the read noise
        axes.loglog(levels * x[pattern], levels * prnu * x[pattern], ":", color=colour)
