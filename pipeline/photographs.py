"""A folder of photographs, a sub-folder of raw files a filter: a sphere's, a surface's, a white's.

A capture.toml may name the filters and their files, and give what EXIF lacks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from calibration.errors import Problem, fault
from pipeline import io
from pipeline.files.tables import Table


@dataclass(frozen=True)
class Filter:
    """The photographs taken through one filter, by name of file."""

    name: str
    shots: tuple[io.Shot, ...]


_OF_SENSOR = ("dark", "flat")  # folders of frames that show the sensor, not the scene


@dataclass(frozen=True)
class OfSensor:
    """Photographs that show what the sensor adds of itself; empty where there are none.

    dark  with the cap on
    flat  of something even, by name of filter
    """

    dark: tuple[io.Shot, ...] = ()
    flat: Mapping[str, tuple[io.Shot, ...]] = field(default_factory=dict)


def check_folder(folder: Path) -> None:
    """InputError where it is no folder."""
    if not folder.is_dir():
        found = "is not a folder" if folder.exists() else "no such folder"
        raise fault(found, "a folder of raw photographs", "check the path", folder)


def find(folder: Path, root: Table, camera: Table, problems: list[Problem]) -> tuple[Filter, ...]:
    """The filters' photographs, their headers read and checked to belong together.

    folder    as [[filter]] says, or its sub-folders that hold raw files
    root      capture.toml, empty where there is none
    camera    its [camera], for what EXIF lacks
    problems  gains whatever is wrong
    raises    InputError where there is no photograph at all
    """
    iso, f_number = _given(camera)
    filters = tuple(
        Filter(name, _shots(files, times, iso, f_number, folder / name, problems))
        for name, files, times in _named(root, folder, problems)
    )
    _check_counts(filters, problems)
    check_alike([shot for f in filters for shot in f.shots], problems)
    return filters


def find_of_sensor(
    folder: Path, filters: Sequence[Filter], camera: Table, problems: list[Problem]
) -> OfSensor:
    """Dark frames, dark/*, and flat ones, flat/FILTER/* or, for all filters, flat/*.

    problems  gains whatever is wrong: they must be of the photographs' camera and size
    """
    iso, f_number = _given(camera)

    def shots(place: Path) -> tuple[io.Shot, ...]:
        files = io.photographs(place.iterdir()) if place.is_dir() else []
        found = _shots(files, None, iso, f_number, place, problems)
        scene = [shot for f in filters for shot in f.shots[:1]][:1]
        check_alike([*scene, *found], problems)
        return found

    every = shots(folder / "flat")
    flats = {f.name: shots(folder / "flat" / f.name) or every for f in filters}
    for place in {flat[0].path.parent for flat in flats.values() if len(flat) == 1}:
        problems.append(
            Problem(
                "one flat frame",
                "two or more, since one does not tell its noise from the pixels' response",
                "take eight or so",
                place,
            )
        )
    return OfSensor(shots(folder / "dark"), {name: flat for name, flat in flats.items() if flat})


def notes_of_sensor(of: OfSensor, filters: Sequence[Filter]) -> list[str]:
    """What dark frames cannot tell, a sentence each."""
    if not of.dark:
        return []
    notes = []
    photographs = [shot for f in filters for shot in f.shots]
    isos = {shot.iso for shot in photographs}
    if not isos <= {shot.iso for shot in of.dark}:
        notes.append(
            f"no dark frames at ISO {', '.join(f'{iso:g}' for iso in sorted(isos))}: their current"
            " is taken to grow as ISO does"
        )
    longest, dark_s = (max(s.time_s for s in some) for some in (photographs, of.dark))
    if dark_s < longest / 4:
        notes.append(
            f"dark frames of {dark_s:g} s tell little of an exposure of {longest:g} s;"
            " take them as long as the longest photograph"
        )
    return notes


def _given(camera: Table) -> tuple[float | None, float | None]:
    """ISO and f-number of all photographs, where EXIF lacks them."""
    return (
        camera.number("iso", "ISO", low=1, high=1e7),
        camera.number("f_number", "f/", low=0.5, high=1000),
    )


def _named(
    root: Table, folder: Path, problems: list[Problem]
) -> list[tuple[str, list[Path], tuple[float, ...] | None]]:
    """Name, files and times, where given, of each filter."""
    named: list[tuple[str, list[Path], tuple[float, ...] | None]] = []
    tables = root.tables("filter")
    for table in tables:
        name = table.text("name")
        pattern = table.text("files", f"{name}/*")
        times = table.numbers("times_s", "seconds")
        table.nothing_else()
        if name is None:
            table.wrong("name", "missing", "the filter's name", 'add name = "cyan"')
        elif name in (n for n, _, _ in named):
            table.wrong("name", f"{name!r} again", "each filter once", "merge or rename them")
        elif any(c in name for c in "./\\ "):
            table.wrong("name", repr(name), "a name without dots, slashes or spaces", "rename it")
        else:
            named.append((name, _matching(table, folder, pattern or ""), times))
    if not tables:
        for sub in sorted(p for p in folder.iterdir() if p.is_dir() and p.name not in _OF_SENSOR):
            files = io.photographs(sub.iterdir())
            if any(io.is_raw(p) for p in files):
                named.append((sub.name, files, None))
        if not named and not problems:
            raise fault(
                "no raw files found",
                "a sub-folder of raw files for each filter, such as cyan/ and yellow/",
                "copy the photographs there or name them in capture.toml",
                folder,
            )
    if len(named) == 1:
        problems.append(
            Problem(
                f"only one filter, {named[0][0]!r}",
                "photographs through two filters or more",
                "add the other filter's folder",
                folder,
            )
        )
    return named


def _matching(table: Table, folder: Path, pattern: str) -> list[Path]:
    """Files a pattern names, inside the folder only."""
    try:
        found = io.photographs(folder.glob(pattern))
    except (ValueError, NotImplementedError):
        found = []
    base = folder.resolve()
    if ".." in Path(pattern).parts or any(not p.resolve().is_relative_to(base) for p in found):
        table.wrong("files", repr(pattern), "files inside the capture's folder", "move them there")
        return []
    if not found:
        table.wrong("files", f"{pattern!r}, which matches no file", "raw files", "correct it")
    return found


def _shots(files, times, iso, f_number, place, problems) -> tuple[io.Shot, ...]:
    if times is not None and len(times) != len(files):
        problems.append(
            Problem(
                f"{len(files)} photographs but {len(times)} times_s",
                "one time per photograph, in order of the file names",
                "correct times_s",
                place,
            )
        )
        times = None
    shots, wrong = io.read_shots(files, times_s=times, iso=iso, f_number=f_number)
    problems += wrong
    return tuple(shots)


def _check_counts(filters: tuple[Filter, ...], problems: list[Problem]) -> None:
    """As many exposures through each filter."""
    counts = {f.name: len(f.shots) for f in filters}
    if len(set(counts.values())) > 1 and not problems:
        listed = ", ".join(f"{n} {name}" for name, n in counts.items())
        problems.append(
            Problem(
                f"filters have unequal numbers of photographs: {listed}",
                "the same bracket through each filter",
                "add the missing photographs or remove the surplus",
                filters[0].shots[0].path.parent.parent if filters[0].shots else None,
            )
        )


def check_alike(shots: Sequence[io.Shot], problems: list[Problem]) -> None:
    """One camera, one size, one CFA pattern: those of the first."""
    for shot in shots[1:]:
        first = shots[0]
        for what, mine, others in (
            ("camera", shot.camera, first.camera),
            ("size", shot.size, first.size),
            ("CFA pattern", shot.cfa, first.cfa),
        ):
            if mine != others:
                problems.append(
                    Problem(
                        f"{what} {_said(mine)}",
                        f"{_said(others)} as in {first.path}",
                        "keep photographs of one camera and setting only",
                        shot.path,
                    )
                )


def _said(value) -> str:
    return " x ".join(map(str, value[::-1])) if isinstance(value, tuple) else repr(value)


def notes_of(shots) -> list[str]:
    """What was taken for granted, for the user to see."""
    notes = []
    if any(shot.iso_missing for shot in shots):
        notes.append("no ISO in the files: 100 is assumed for all")
    if any(shot.f_number_missing for shot in shots):
        notes.append("no aperture in the files: f/1 is assumed for all")
    return notes


def changes(filters: Sequence[Filter]) -> list[str]:
    """What the camera did not hold within a bracket, or focus between them, by its tags, a sentence
    each.

    A change of sensitivity is reckoned with, one of aperture as far as f-numbers are exact; either
    leaves something behind that no overlap of exposures can tell from the light.
    """
    notes = []
    for f in filters:
        for what, values, remedy in (
            (
                "ISO",
                [f"{shot.iso:g}" for shot in f.shots],
                "amplifiers are not quite what they are called: switch auto-ISO off",
            ),
            (
                "aperture",
                [f"f/{shot.f_number:g}" for shot in f.shots],
                "vignetting and sharpness change with it: vary the shutter alone",
            ),
            (
                "focal length",
                [f"{shot.focal_length_mm:g} mm" for shot in f.shots if shot.focal_length_mm],
                "the pictures do not lie on each other: leave the zoom alone",
            ),
            (
                "focus",
                _focused(f.shots),
                "the picture grows or shrinks with it: focus by hand",
            ),
        ):
            found = _different(values)
            if len(found) > 1:
                notes.append(
                    f"{f.name}: {what} changes within the bracket ({', '.join(found)}); {remedy}"
                )
    focused = {
        f.name: found[0] for f in filters if len(found := _different(_focused(f.shots))) == 1
    }
    if len(set(focused.values())) > 1:
        listed = ", ".join(f"{name} {distance}" for name, distance in focused.items())
        notes.append(
            f"focus changes between the filters ({listed}); their pictures differ in size: focus by"
            " hand, once"
        )
    return notes


def _different(values: Sequence[str]) -> list[str]:
    return list(dict.fromkeys(values))


def _focused(shots: Sequence[io.Shot]) -> list[str]:
    """The distances focused at, in words, where they are known."""
    return [
        "infinity" if shot.focus_m == math.inf else f"{shot.focus_m:.3g} m"
        for shot in shots
        if shot.focus_m
    ]
