"""`sixlight fit`: photographs and spectra to M_S.toml."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration import chart, fit, primaries
from calibration.spectra import read_spectra
from pipeline import digest, io
from pipeline.bracket import Bracket
from pipeline.errors import InputError, Problem, fault, storing
from pipeline.progress import Progress
from pipeline.session import Light, Session, read_session
from stages.demosaic import demosaic
from stages.merge import merge
from stages.types import Measured


def from_session(
    folder: Path,
    wanted: str | None,
    method: str | None,
    *,
    reflectance: bool = False,
    quiet: bool = False,
) -> fit.Transform:
    """M_S, or M_R for reflectance, from a calibration folder (see `pipeline.session`).

    wanted, method  primaries and method; None takes the folder's own choice
    reflectance     M_R: signals and readings over those of the chart's brightest patch

    A patch that clips or is uneven under a light is left out there, and the figures' `left_out`
    names it. InputError lists everything wrong with the folder's files at once.
    """
    session = read_session(folder)
    if wanted is not None:
        session = replace(session, primaries=wanted)
    if method is not None:
        session = replace(session, method=_known(method))
    target = primaries.load(session.primaries)
    shots = _shots(session)
    names = chart.CHARTS[session.chart]
    progress = Progress(len(session.lights), quiet=quiet)
    signals: dict[str, np.ndarray] = {}
    variances: dict[str, np.ndarray] = {}
    left_out: list[str] = []
    for light in session.lights:
        with progress.step(light.name, f"{len(names)} patches"):
            seen = _seen(session, light, shots, left_out)
        signals[light.name], variances[light.name] = seen
    fitted = fit.reflectance_from_chart if reflectance else fit.from_chart
    try:
        transform = fitted(
            signals,
            variances,
            {light.name: light.radiance for light in session.lights},
            patches=names,
            channels=session.channels,
            primaries=target,
            method=session.method,
            inputs=_digests(session),
        )
    except InputError as error:
        raise error.at(folder) from None
    return replace(transform, figures={**transform.figures, "left_out": left_out})


def from_sensitivities(
    camera: Path,
    filters: Path,
    lights: Path | None,
    wanted: str | None,
    method: str | None,
    *,
    surfaces: Path | None = None,
    reflectance: bool = False,
) -> fit.Transform:
    """M_S, or M_R, from known curves of camera and filters.

    lights       to train on; None: those of rooms
    surfaces     to train on; None: of all kinds
    reflectance  M_R
    """
    curves = read_spectra(camera, "power")
    glass = read_spectra(filters, "fraction")
    given = [path for path in (camera, filters, lights, surfaces) if path is not None]
    fitted = fit.reflectance_from_sensitivities if reflectance else fit.from_sensitivities
    try:
        return fitted(
            curves,
            glass,
            primaries=primaries.load(wanted or primaries.DEFAULT),
            lights=read_spectra(lights, "power") if lights else None,
            surfaces=read_spectra(surfaces, "fraction") if surfaces else None,
            method=_known(method or fit.DEFAULT_METHOD),
            inputs={path.name: digest.of_file(path) for path in given},
        )
    except InputError as error:
        raise error.at(filters) from None


def save(transform: fit.Transform, path: Path, *, force: bool) -> None:
    """Writes M_S.toml or M_R.toml, whole or not at all; an earlier transform may be replaced."""
    _refuse_foreign(path, force, _is_transform(path))
    _store(path, fit.to_toml(transform))


def save_primaries(made: primaries.Primaries, folder: Path, *, force: bool) -> list[Path]:
    """Writes a set of primaries as its three files; returns their paths."""
    files = primaries.files(made)
    for file, text in files.items():
        path = folder / file
        same = path.is_file() and path.read_bytes() == text.encode()
        _refuse_foreign(path, force, same)
    with storing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    for file, text in files.items():
        _store(folder / file, text)
    return [folder / file for file in files]


def as_text(transform: fit.Transform, path: Path) -> str:
    """What was fitted and how good it is, for people."""
    figures = transform.figures
    lines = [
        f"{path}: {transform.method}, {len(transform.channels)} bands to {transform.primaries},"
        f" {figures['samples']} samples under {figures['lights']} lights",
    ]
    for key, words in (
        ("training_delta_e", "dE2000 on what it was fitted to"),
        ("leave_one_light_out_delta_e", "dE2000 on lights left out"),
    ):
        if key in figures:
            e = figures[key]
            lines.append(
                f"  {words}: mean {e['mean']:.2f}, 95th percentile {e['p95']:.2f},"
                f" max {e['max']:.2f}"
            )
    if "chosen" in figures:
        chosen = figures["chosen"]
        why = chosen.get("because") or "best on lights left out, noise included: " + ", ".join(
            f"{name} {value:.2f}" for name, value in chosen["rendered_delta_e_left_out"].items()
        )
        strength = f" held near ridge by {chosen['strength']:g}" if "strength" in chosen else ""
        lines.append(f"  chosen: {chosen['method']}{strength}; {why}")
    if len(figures.get("light_delta_e", {})) <= _MOST_LIGHTS_PRINTED:
        by_light = (f"{name} {value:.2f}" for name, value in figures["light_delta_e"].items())
        lines.append(f"  dE2000 by light: {', '.join(by_light)}")
    amplification = ", ".join(f"{v:.1f}" for v in figures["noise_amplification"])
    spectral = ", ".join(f"{100 * v:.1f}" for v in figures["spectral_error"])
    lines.append(f"  error per primary, %: {spectral}")
    lines.append(f"  noise amplification per primary: {amplification}")
    lines.append(f"  condition of the bands: {figures['condition']:.0f}")
    lines += [f"  left out: {what}" for what in figures.get("left_out", [])]
    lines += [f"  to measure again: {what} dE2000" for what in figures.get("remeasure", [])]
    lines.append(f"  unit: {transform.units}")
    return "\n".join(lines)


_MOST_LIGHTS_PRINTED = 12


def _known(method: str) -> str:
    if method not in fit.METHODS:
        raise fault(
            f"method {method!r}", " or ".join(fit.METHODS), "choose one of these", "--method"
        )
    return method


def _shots(session: Session) -> Mapping[tuple[str, ...], Sequence[io.Shot]]:
    """The headers of all photographs, by light and filter, and "white"; every problem at once."""
    problems: list[Problem] = []
    shots: dict[tuple[str, ...], list[io.Shot]] = {}
    for light in session.lights:
        for name, files in light.files.items():
            shots[light.name, name], wrong = io.read_shots(files)
            problems += wrong
        for name, files in light.white.items():
            shots[light.name, name, "white"], wrong = io.read_shots(files)
            problems += wrong
    everything = [shot for some in shots.values() for shot in some]
    for shot in everything[1:]:
        if shot.camera != everything[0].camera:
            problems.append(
                Problem(
                    f"camera {shot.camera!r}",
                    f"{everything[0].camera!r} as in the other photographs",
                    "photograph the chart with one camera",
                    shot.path,
                )
            )
    if problems:
        raise InputError(problems)
    return shots


def _photograph(shots: Sequence[io.Shot]) -> Measured:
    try:
        return demosaic(merge(Bracket.of(shots)))
    except InputError as error:
        raise error.at(shots[0].path.parent) from None


def _found(images: Sequence[Measured], light: Light) -> chart.Patches:
    try:
        return chart.find([image.values for image in images])
    except InputError as error:
        raise error.at(light.radiance_csv.parent) from None


def _seen(session: Session, light: Light, shots, left_out: list[str]):
    """Mean signals (n, B) of the patches under a light, and the variance of those means."""
    try:
        images = [_photograph(shots[light.name, name]) for name in session.filters]
        patches = session.patches or _found(images, light)
        seen = [
            chart.patch_signals(image.values, image.valid, patches, image.variance)
            for image in images
        ]
        signals = np.concatenate([s.mean for s in seen], axis=1)
        variances = np.concatenate([s.mean_variance for s in seen], axis=1)
        for name, of_filter in zip(session.filters, seen, strict=True):
            left_out += _left_out(of_filter, patches.names, f"under {light.name} through {name}")
        if chart.turned(signals, light.radiance.values.T):
            raise fault(
                "the patches look like the readings in reverse: a chart upside down",
                f"patch {patches.names[0]} first, as in {light.radiance_csv.name}",
                "turn the boxes by 180 degrees, or name the readings as the chart hung",
            )
        if light.white:
            whites = [_photograph(shots[light.name, name, "white"]) for name in session.filters]
            shade = [chart.shading(white.values, white.valid, patches) for white in whites]
            shares = np.repeat(np.stack(shade, axis=1), 3, axis=1)
            signals, variances = signals / shares, variances / shares**2
        return signals, variances
    except InputError as error:
        raise error.at(light.radiance_csv.parent) from None


def _left_out(seen: chart.PatchSignals, names: Sequence[str], where: str) -> list[str]:
    """What of the patches cannot be used, in words."""
    said = []
    for why, bad in (("clips", seen.clipped), ("is uneven", seen.uneven)):
        for name, bands in zip(names, bad, strict=True):
            if bands.any():
                colours = ", ".join(c for c, b in zip("RGB", bands, strict=True) if b)
                said.append(f"patch {name} {why} in {colours} {where}")
    return said


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
        fit.read_transform(path)
    except InputError:
        return False
    return True


def _refuse_foreign(path: Path, force: bool, ours: bool) -> None:
    if path.exists() and not ours and not force:
        raise fault(
            "exists and is not ours", "a new file", "choose another with -o, or --force", path
        )


def _store(path: Path, text: str) -> None:
    """Writes a text file beside its place, then moves it there."""
    beside = path.with_name(f".{path.name}.unfinished")
    try:
        io.write_text(beside, text)
        with storing(path):
            os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)
