"""The chart of a calibration session: from its photographs, the signals of its patches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration import chart as charts
from calibration import chart_finder
from pipeline import io
from pipeline.bracket import Bracket
from pipeline.errors import InputError, Problem, fault
from pipeline.fitting.session import Light, Session
from pipeline.progress import Progress
from stages.demosaic import demosaic
from stages.merge import merge
from stages.scale import scale
from stages.scale import warnings as warnings_of_scale
from stages.types import Lights, Measured


@dataclass(frozen=True)
class ChartSignals:
    """What the camera saw of a chart's patches, all lights and filters on one scale.

    signals    light -> (n, B) mean of each patch in each band; NaN where it clipped or is uneven
    variances  light -> (n, B) of these means
    left_out   patches that clip or are uneven, and where, in words
    notes      where the exposures leave in doubt what the shutter's tags stand for, in words
    """

    signals: Mapping[str, NDArray[np.float64]]
    variances: Mapping[str, NDArray[np.float64]]
    left_out: Sequence[str]
    notes: Sequence[str]


def chart_signals(session: Session, *, quiet: bool = False) -> ChartSignals:
    """A session's photographs merged, demosaiced and averaged over the patches.

    What the shutter's tags stand for is judged once, by the brackets of all lights and filters.

    raises  InputError of everything wrong with the headers of the photographs at once; then of a
            light whose chart is not found, or does not follow its readings
    """
    shots = _shots(session)
    progress = Progress(len(session.lights), quiet=quiet)
    seen: dict[str, _Seen] = {}
    left_out: list[str] = []
    for light in session.lights:
        with progress.step(light.name, f"{len(charts.CHARTS[session.chart])} patches"):
            seen[light.name] = _seen(session, light, shots, left_out)
    scaled, notes = _on_one_scale(seen, session.filters)
    return ChartSignals(
        {light: one.signals for light, one in scaled.items()},
        {light: one.variances for light, one in scaled.items()},
        left_out,
        notes,
    )


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


def _photograph(shots: Sequence[io.Shot]) -> tuple[Measured, Lights]:
    """One bracket as an image of three colours, and the light of its exposures."""
    try:
        merged = merge(Bracket.of(shots))
        return demosaic(merged), Lights.of(merged)
    except InputError as error:
        raise error.at(shots[0].path.parent) from None


def _found(images: Sequence[Measured], light: Light, kind: str) -> charts.Patches:
    try:
        return chart_finder.find([image.values for image in images], kind)
    except InputError as error:
        raise error.at(light.radiance_csv.parent) from None


@dataclass(frozen=True)
class _Seen:
    """The chart under a light, each bracket on a scale of its own.

    signals, variances  (n, B) means of the patches, and variances of those means
    exposed             of the chart's bracket through each filter
    of_white            of the white's; empty where there is none
    """

    signals: NDArray[np.float64]
    variances: NDArray[np.float64]
    exposed: tuple[Lights, ...]
    of_white: tuple[Lights, ...]


def _on_one_scale(
    seen: Mapping[str, _Seen], filters: Sequence[str]
) -> tuple[dict[str, _Seen], list[str]]:
    """The same on one scale for the camera, and what of it is in doubt.

    A white has no scale, as only its shading counts; but its exposures tell of the shutter too.
    """
    names = [f"{light} through {name}" for light in seen for name in filters]
    names += [
        f"the white of {light} through {name}"
        for light, of in seen.items()
        if of.of_white
        for name in filters
    ]
    charts_of = [one for of in seen.values() for one in of.exposed]
    found = scale([*charts_of, *(one for of in seen.values() for one in of.of_white)])
    factors = np.reshape(found.factors[: len(charts_of)], (len(seen), len(filters)))
    scaled = {
        light: replace(of, signals=of.signals * factor, variances=of.variances * factor**2)
        for (light, of), factor in zip(seen.items(), np.repeat(factors, 3, axis=1), strict=True)
    }
    remedy = "use the same shutter times for all, or three of them through one filter"
    return scaled, warnings_of_scale(found, names, remedy)


def _seen(session: Session, light: Light, shots, left_out: list[str]) -> _Seen:
    try:
        images, exposed = zip(
            *(_photograph(shots[light.name, name]) for name in session.filters), strict=True
        )
        of_white: tuple[Lights, ...] = ()
        patches = session.patches or _found(images, light, session.chart)
        seen = [
            charts.patch_signals(image.values, image.valid, patches, image.variance)
            for image in images
        ]
        signals = np.concatenate([s.mean for s in seen], axis=1)
        variances = np.concatenate([s.mean_variance for s in seen], axis=1)
        for name, of_filter in zip(session.filters, seen, strict=True):
            left_out += _left_out(of_filter, patches.names, f"under {light.name} through {name}")
        _check_order(signals, patches, light, by_itself=session.patches is None)
        if light.white:
            whites, of_white = zip(
                *(_photograph(shots[light.name, name, "white"]) for name in session.filters),
                strict=True,
            )
            shade = [charts.shading(white.values, white.valid, patches) for white in whites]
            shares = np.repeat(np.stack(shade, axis=1), 3, axis=1)
            signals, variances = signals / shares, variances / shares**2
        return _Seen(signals, variances, exposed, of_white)
    except InputError as error:
        raise error.at(light.radiance_csv.parent) from None


def _check_order(signals, patches: charts.Patches, light: Light, *, by_itself: bool) -> None:
    """Refuses patches whose signals do not follow the readings of their names."""
    first, readings = patches.names[0], light.radiance.values.T
    if charts.turned(signals, readings):
        name = "name the readings from the chart's first patch on"
        raise fault(
            "the patches look like the readings in reverse: a chart upside down",
            f"patch {first} first, as in {light.radiance_csv.name}",
            name if by_itself else f"turn the places given by 180 degrees, or {name}",
        )
    if charts.unlike(signals, readings):
        raise fault(
            "the patches' signals do not follow the readings of their names",
            f"{light.radiance_csv.name} of the same patches, under the same light",
            "name each reading as its patch, or correct the places given",
        )


def _left_out(seen: charts.PatchSignals, names: Sequence[str], where: str) -> list[str]:
    """What of the patches cannot be used, in words: patches with one fault in one sentence."""
    said: dict[tuple[str, str], list[str]] = {}
    for why, bad in (("clip", seen.clipped), ("are uneven", seen.uneven)):
        for name, bands in zip(names, bad, strict=True):
            if bands.any():
                colours = ", ".join(c for c, b in zip("RGB", bands, strict=True) if b)
                said.setdefault((why, colours), []).append(name)
    one = {"clip": "clips", "are uneven": "is uneven"}
    return [
        f"patch {some[0]} {one[why]} in {colours} {where}"
        if len(some) == 1
        else f"patches {', '.join(some)} {why} in {colours} {where}"
        for (why, colours), some in said.items()
    ]
