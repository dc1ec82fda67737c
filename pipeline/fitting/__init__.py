"""`sixlight fit`: photographs and spectra to M_S.toml."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration import chart as charts
from calibration import primaries, residuals
from calibration.bands import sensitivities
from calibration.fit import METHODS, fit
from calibration.spectra import read_spectra
from calibration.training import TrainingSet, computed, photographed
from calibration.transform import LIGHT, REFLECTANCE, Transform, read_transform, to_toml
from pipeline import digest, io
from pipeline.errors import InputError, fault, replacing
from pipeline.fitting.chart import chart_signals
from pipeline.fitting.session import Session, read_session


@dataclass(frozen=True)
class Fitted:
    """A transform, and what it was fitted to.

    transform  M_S or M_R
    primaries  the set it gives
    chart      signals and readings, of M_R over the white's; None: fitted to known curves
    bands      (36, B) known curves of the camera behind its filters; None: fitted to a chart
    """

    transform: Transform
    primaries: primaries.Primaries
    chart: TrainingSet | None = None
    bands: NDArray[np.float64] | None = None

    @property
    def residuals(self) -> residuals.Residuals | None:
        """Colours of the chart's patches; None where there was no chart."""
        if self.chart is None:
            return None
        return residuals.residuals(self.transform.matrix, self.chart, self.primaries)

    @property
    def curves(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """What the transform weights spectra with (36, P), and how uncertain that is (36, P)."""
        if self.bands is not None:
            known = self.bands @ self.transform.matrix.T
            return known, np.zeros_like(known)
        assert self.chart is not None
        return residuals.made_curves(self.transform.matrix, self.chart)


def from_session(
    folder: Path,
    wanted: str | None,
    method: str | None,
    *,
    reflectance: bool = False,
    quiet: bool = False,
) -> Fitted:
    """M_S, or M_R for reflectance, from a calibration folder (see `session`).

    wanted, method  primaries and method; None takes the folder's own choice
    reflectance     M_R: signals and readings over those of the chart's brightest patch

    The figures' `left_out` and `notes` are those of `chart_signals`. InputError lists everything
    wrong with the folder's files at once.
    """
    session = read_session(folder)
    if wanted is not None:
        session = replace(session, primaries=wanted)
    if method is not None:
        session = replace(session, method=_known(method))
    target = primaries.load(session.primaries)
    seen = chart_signals(session, quiet=quiet)
    try:
        chart = photographed(
            seen.signals,
            seen.variances,
            {light.name: light.radiance for light in session.lights},
            patches=charts.CHARTS[session.chart],
            channels=session.channels,
            quantity=REFLECTANCE if reflectance else LIGHT,
        )
        transform = fit(chart, target, method=session.method, inputs=_digests(session))
    except InputError as error:
        problems = error.at(folder).problems
        raise InputError(
            replace(problem, remedy="; ".join([problem.remedy, *seen.left_out]))
            for problem in problems
        ) from None
    transform = replace(
        transform,
        figures={**transform.figures, "left_out": seen.left_out, "notes": seen.notes},
        signals=None if reflectance else chart.signals[chart.known],
    )
    return Fitted(transform, target, chart=chart)


def from_sensitivities(
    camera: Path,
    filters: Path,
    lights: Path | None,
    wanted: str | None,
    method: str | None,
    *,
    surfaces: Path | None = None,
    reflectance: bool = False,
) -> Fitted:
    """M_S, or M_R, from known curves of camera and filters.

    lights       to train on; None: those of rooms
    surfaces     to train on; None: of all kinds
    reflectance  M_R
    """
    curves = read_spectra(camera, "power")
    glass = read_spectra(filters, "fraction")
    target = primaries.load(wanted or primaries.DEFAULT)
    given = [path for path in (camera, filters, lights, surfaces) if path is not None]
    try:
        training = computed(
            curves,
            glass,
            lights=read_spectra(lights, "power") if lights else None,
            surfaces=read_spectra(surfaces, "fraction") if surfaces else None,
            quantity=REFLECTANCE if reflectance else LIGHT,
        )
        transform = fit(
            training,
            target,
            method=method and _known(method),
            inputs={path.name: digest.of_file(path) for path in given},
        )
        _, bands = sensitivities(curves, glass)
    except InputError as error:
        raise error.at(filters) from None
    return Fitted(transform, target, bands=bands)


def save(transform: Transform, path: Path, *, force: bool) -> None:
    """Writes M_S.toml or M_R.toml, whole or not at all; an earlier transform may be replaced."""
    _refuse_foreign(path, force, _is_transform(path))
    with replacing(path) as beside:
        io.write_text(beside, to_toml(transform))


def save_primaries(made: primaries.Primaries, folder: Path, *, force: bool) -> list[Path]:
    """Writes a set of primaries as its three files; returns their paths."""
    files = primaries.files(made)
    for file, text in files.items():
        path = folder / file
        same = path.is_file() and path.read_bytes() == text.encode()
        _refuse_foreign(path, force, same)
    for file, text in files.items():
        with replacing(folder / file) as beside:
            io.write_text(beside, text)
    return [folder / file for file in files]


def figures(fitted: Fitted) -> dict[str, Any]:
    """Everything that is known of a fit, for scripts: the transform with its figures.

    With a chart also `delta_e`: light -> patch -> CIEDE2000, None where the patch was left out.
    """
    transform = fitted.transform
    said: dict[str, Any] = {
        "quantity": transform.quantity,
        "method": transform.method,
        "primaries": transform.primaries,
        "channels": list(transform.channels),
        "matrix": transform.matrix.tolist(),
        "units": transform.units,
        "noise_level": transform.noise_level,
        **transform.figures,
    }
    off = fitted.residuals
    if off is not None:
        said["delta_e"] = {
            light: {
                patch: None if np.isnan(value) else round(float(value), 4)
                for patch, value in zip(off.patches, row, strict=True)
            }
            for light, row in zip(off.lights, off.delta_e, strict=True)
        }
    return said


def as_text(fitted: Fitted, path: Path) -> str:
    """What was fitted and how good it is, for people."""
    transform, figures = fitted.transform, fitted.transform.figures
    lines = [
        f"{path}: {transform.method}, {len(transform.channels)} bands to {transform.primaries},"
        f" {figures['samples']} samples under {figures['lights']} lights",
        f"  gives {transform.quantity}, {transform.units}",
        "",
        "  CIEDE2000                mean   95th    max",
    ]
    for key, words in (
        ("training_delta_e", "as fitted"),
        ("leave_one_light_out_delta_e", "lights left out"),
    ):
        if key in figures:
            e = figures[key]
            worst = f"  worst: {e['worst_light']}" if "worst_light" in e else ""
            lines.append(
                f"    {words:<18}  {e['mean']:>6.2f} {e['p95']:>6.2f} {e['max']:>6.2f}{worst}"
            )
    off = fitted.residuals
    if off is not None:
        lines += _by_light(off)
    lines += ["", *_by_primary(fitted), ""]
    if "chosen" in figures:
        lines += _choice(figures["chosen"])
    lines.append(f"  condition of the bands: {figures['condition']:.0f}")
    lines += [f"  left out: {what}" for what in figures.get("left_out", [])]
    lines += [f"  note: {what}" for what in figures.get("notes", [])]
    lines += [f"  to measure again: {what} dE2000" for what in figures.get("remeasure", [])]
    return "\n".join(lines)


def _by_light(off: residuals.Residuals) -> list[str]:
    """Each light's errors as fitted, and the patches that are furthest off."""
    width = max(18, *(len(light) for light in off.lights))
    lines = [""]
    for i, light in enumerate(off.lights):
        e = off.delta_e[i][np.isfinite(off.delta_e[i])]
        worst = ", ".join(f"{patch} {value:.2f}" for patch, value in off.worst(i, 3))
        lines.append(
            f"    {light:<{width}}  {e.mean():>6.2f} {np.percentile(e, 95):>6.2f} {e.max():>6.2f}"
            f"  patches {worst}"
        )
    means = np.nanmean(off.delta_e, axis=0)  # a light without a whole sample is refused
    order = [i for i in np.argsort(-means) if np.isfinite(means[i])]
    worst = ", ".join(f"{off.patches[i]} {means[i]:.2f}" for i in order[:6])
    return [*lines, "", f"  patches furthest off, mean over the lights: {worst}"]


def _by_primary(fitted: Fitted) -> list[str]:
    """A table of the primaries: where they lie, how far off they are, what they do to noise."""
    transform, figures = fitted.transform, fitted.transform.figures
    rows = (
        ("  primary", [f"P{i + 1}" for i in range(len(transform.matrix))]),
        ("    peak, nm", [f"{v:.0f}" for v in transform.peaks_nm]),
        ("    error, %", [f"{100 * v:.1f}" for v in figures["spectral_error"]]),
        ("    noise, times that of a band", [f"{v:.1f}" for v in figures["noise_amplification"]]),
    )
    return [f"{head:<32}" + "".join(f"{cell:>7}" for cell in cells) for head, cells in rows]


def _choice(chosen: Mapping[str, Any]) -> list[str]:
    """Which method "delta-e" came to, and why."""
    strength = f" held near ridge by {chosen['strength']:g}" if "strength" in chosen else ""
    if "because" in chosen:
        return [f"  chosen: {chosen['method']}{strength}; {chosen['because']}"]
    tried = ", ".join(
        f"{f'held by {name}' if name.isdigit() else name} {value:.2f}"
        for name, value in chosen["rendered_delta_e_left_out"].items()
    )
    return [
        f"  chosen: {chosen['method']}{strength}, the least dE2000 of rendered colours on lights",
        f"    left out, noise included: {tried}",
    ]


def _known(method: str) -> str:
    if method not in METHODS:
        raise fault(f"method {method!r}", " or ".join(METHODS), "choose one of these", "--method")
    return method


def _digests(session: Session) -> dict[str, str]:
    """Every file the transform was made from, relative to the session's folder."""
    files = [
        file
        for light in session.lights
        for some in (*light.files.values(), *light.white.values())
        for file in some
    ]
    files += [light.radiance_csv for light in session.lights]
    if session.patches_csv is not None:
        files.append(session.patches_csv)
    return {str(f.relative_to(session.folder)): digest.of_file(f) for f in sorted(files)}


def _is_transform(path: Path) -> bool:
    try:
        read_transform(path)
    except InputError:
        return False
    return True


def _refuse_foreign(path: Path, force: bool, ours: bool) -> None:
    if path.exists() and not ours and not force:
        raise fault(
            "exists and is not ours", "a new file", "choose another with -o, or --force", path
        )
