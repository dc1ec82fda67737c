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
    folder: Path, wanted: str | None, method: str | None, *, quiet: bool = False
) -> fit.Transform:
    """M_S from a calibration folder (see `calibration.session`).

    wanted, method  primaries and method; None takes the folder's own choice

    InputError lists everything wrong with the folder's files at once.
    """
    session = read_session(folder)
    if wanted is not None:
        session = replace(session, primaries=wanted)
    if method is not None:
        session = replace(session, method=_known(method))
    target = primaries.load(session.primaries)
    shots = _shots(session)
    progress = Progress(len(session.lights), quiet=quiet)
    signals: dict[str, np.ndarray] = {}
    variances: dict[str, np.ndarray] = {}
    for light in session.lights:
        with progress.step(light.name, "24 patches"):
            images = [_photograph(shots[light.name, name]) for name in session.filters]
            patches = session.patches or _found(images, light)
            seen = [_patch_signals(image, patches, light) for image in images]
        signals[light.name] = np.concatenate([s.mean for s in seen], axis=1)
        variances[light.name] = np.concatenate([s.variance for s in seen], axis=1)
    try:
        return fit.from_chart(
            signals,
            variances,
            {light.name: light.radiance for light in session.lights},
            patches=chart.PATCHES,
            channels=session.channels,
            primaries=target,
            method=session.method,
            inputs=_digests(session),
        )
    except InputError as error:
        raise error.at(folder) from None


def from_sensitivities(
    camera: Path,
    filters: Path,
    lights: Path | None,
    wanted: str | None,
    method: str | None,
) -> fit.Transform:
    """M_S from known curves of camera and filters; trained on `lights`, or on room lights."""
    curves = read_spectra(camera, "power")
    glass = read_spectra(filters, "fraction")
    given = [camera, filters] + ([lights] if lights else [])
    try:
        return fit.from_sensitivities(
            curves,
            glass,
            primaries=primaries.load(wanted or primaries.DEFAULT),
            lights=read_spectra(lights, "power") if lights else None,
            method=_known(method or fit.DEFAULT_METHOD),
            inputs={path.name: digest.of_file(path) for path in given},
        )
    except InputError as error:
        raise error.at(filters) from None


def save(transform: fit.Transform, path: Path, *, force: bool) -> None:
    """Writes M_S.toml, whole or not at all; an earlier transform may be replaced."""
    _refuse_foreign(path, force, _is_transform(path))
    _store(path, fit.to_toml(transform))


def save_primaries(name: str, folder: Path, *, force: bool) -> list[Path]:
    """Writes a set of primaries as its three files; returns their paths."""
    files = primaries.files(primaries.load(name))
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
    amplification = ", ".join(f"{v:.1f}" for v in figures["noise_amplification"])
    lines.append(f"  noise amplification per primary: {amplification}")
    lines.append(f"  condition of the bands: {figures['condition']:.0f}")
    lines.append(f"  unit: {transform.units}")
    return "\n".join(lines)


def _known(method: str) -> str:
    if method not in fit.METHODS:
        raise fault(
            f"method {method!r}", " or ".join(fit.METHODS), "choose one of these", "--method"
        )
    return method


def _shots(session: Session) -> Mapping[tuple[str, str], Sequence[io.Shot]]:
    """The headers of all photographs, by light and filter; every problem at once."""
    problems: list[Problem] = []
    shots: dict[tuple[str, str], list[io.Shot]] = {}
    for light in session.lights:
        for name, files in light.files.items():
            shots[light.name, name], wrong = io.read_shots(files)
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


def _patch_signals(image: Measured, patches: chart.Patches, light: Light) -> chart.PatchSignals:
    try:
        return chart.patch_signals(image.values, image.valid, patches)
    except InputError as error:
        raise error.at(light.radiance_csv.parent) from None


def _digests(session: Session) -> dict[str, str]:
    """Every file the transform was made from, relative to the session's folder."""
    files = [f for light in session.lights for some in light.files.values() for f in some]
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
