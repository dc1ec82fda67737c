"""`sixlight evaluate` and `sixlight filters`: the user's spectra in, tables and pictures out."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calibration import evaluate as tables
from calibration import filters as choice
from calibration import primaries as known
from calibration import sets
from calibration.spectra import Spectra, join, read_spectra
from pipeline.errors import InputError, fault, replacing
from pipeline.files.spectra import read_set

PICTURES = ("full_spectra.png", "camera.png")


def read(
    *,
    surfaces: Path | None = None,
    lights: Path | None = None,
    primaries: Sequence[str] | None = None,
    camera: Path | None = None,
    filters: Path | None = None,
) -> tables.Given:
    """What the tables are made of, from the user's files; None: of their own.

    surfaces, lights  CSV files to try methods on, in place of the tables' own sets
    primaries         names or folders of sets
    camera, filters   CSV files of what table 2 is photographed with; both or neither
    raises            InputError naming the file
    """
    if (camera is None) != (filters is None):
        raise fault(
            f"only {'--filters' if camera is None else '--camera'}",
            "--camera and --filters",
            "give both, or neither",
            camera or filters,
        )
    return tables.Given(
        surfaces=[tables.Trial(surfaces.stem, read_set(surfaces, "surface"))] if surfaces else None,
        lights=[tables.Trial(lights.stem, _lights(lights))] if lights else None,
        primaries=[known.load(name) for name in primaries] if primaries else None,
        camera=_camera(camera) if camera else None,
        filters=_at(filters, lambda: read_spectra(filters, "fraction")) if filters else None,
    )


def evaluate(given: tables.Given) -> list[dict[str, Any]]:
    """All tables, one dictionary a row (see `calibration.evaluate.Row`)."""
    return [dataclasses.asdict(row) for row in tables.tables(given)]


def as_markdown(rows: Iterable[Mapping[str, Any]]) -> str:
    """The tables for people."""
    return tables.as_markdown(tables.Row(**row) for row in rows)


def heat_maps(folder: Path, given: tables.Given) -> list[Path]:
    """Pictures of the mean CIEDE2000 of each method under each light; returns their paths.

    The folder is made. Where several sets of surfaces would be tried, the ColorChecker is.
    """
    pictures = tables.pictures(given)
    for name, picture in zip(PICTURES, pictures, strict=True):
        with replacing(folder / name) as beside:
            heat_map(picture).savefig(beside, format="png", dpi=150)
    return [folder / name for name in PICTURES]


def page(rows: Iterable[Mapping[str, Any]], given: tables.Given) -> str:
    """The tables and their heat maps as one HTML page."""
    from pipeline import report

    return report.render(
        "tables.html",
        title="Colour accuracy",
        sections=tables.sections(tables.Row(**row) for row in rows),
        pictures=[report.svg(heat_map(p)) for p in tables.pictures(given)],
    )


def rank_filters(
    camera: Path,
    candidates: Sequence[Path],
    *,
    count: int,
    primaries: str | None = None,
    lights: Path | None = None,
    best: int = 10,
    beside: Iterable[Sequence[str]] = (),
) -> list[dict[str, Any]]:
    """Combinations of filters, best first, one dictionary a row: see `calibration.filters.rank`.

    camera      CSV of sensitivities R, G, B
    candidates  CSVs of transmittances
    count       filters in a combination: 1, 2 or 3
    lights      CSV of lights, one left out at a time; default: what lights rooms
    beside      combinations to judge beside the best, by names
    """
    curves = _camera(camera)
    glass = _joined(candidates)
    rows = choice.rank(
        curves,
        glass,
        count=count,
        primaries=known.load(primaries or known.DEFAULT),
        lights=_lights(lights) if lights else None,
        best=best,
        beside=beside,
    )
    return [dataclasses.asdict(row) for row in rows]


def ranking_as_markdown(rows: Iterable[Mapping[str, Any]]) -> str:
    """The ranking for people."""
    lines = [
        "| rank | filters | dE, lights left out | dE of noise on white | both | amplification "
        "| stops lost |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {row['rank'] or '-'} | {' + '.join(row['filters'])} | {row['delta_e']:.2f} "
        f"| {row['noise_delta_e']:.2f} | {row['expected_delta_e']:.2f} "
        f"| {row['amplification']:.1f} | {abs(row['stops']):.1f} |"
        for row in rows
    ]
    return "\n".join(lines) + "\n"


# ---- the user's files


def _lights(path: Path) -> Spectra:
    lights = read_set(path, "light")
    return dataclasses.replace(lights, values=sets.scaled_to_unit_luminance(lights.values))


def _camera(path: Path) -> Spectra:
    camera = read_spectra(path, "power")
    if sorted(camera.names) != ["B", "G", "R"]:
        raise fault(
            f"the curves {', '.join(camera.names)}",
            "wavelength_nm,R,G,B",
            "name the columns so",
            path,
        )
    return camera


def _joined(paths: Sequence[Path]) -> Spectra:
    """Filters of several files; a name that comes twice gets its file's before it."""
    read = [_at(path, lambda p=path: read_spectra(p, "fraction").resampled()) for path in paths]
    names = [name for spectra in read for name in spectra.names]
    parts = [
        dataclasses.replace(
            spectra,
            names=tuple(n if names.count(n) == 1 else f"{path.stem} {n}" for n in spectra.names),
        )
        for path, spectra in zip(paths, read, strict=True)
    ]
    return join(parts)


def _at(path: Path, read):
    try:
        return read()
    except InputError as error:
        raise error.at(path) from None


# ---- pictures


def heat_map(picture: tables.Picture):
    """A matplotlib figure of the mean CIEDE2000 of each method, a row, under each light."""
    from matplotlib.figure import Figure

    rows, columns = picture.means.shape
    figure = Figure(figsize=(3.5 + 0.32 * columns, 2.2 + 0.3 * rows), layout="constrained")
    axes = figure.subplots()
    # Above 3 everything is bad; below, a tenth should show.
    image = axes.imshow(picture.means, vmin=0.0, vmax=3.0, cmap="viridis_r", aspect="auto")
    axes.set_xticks(range(columns), picture.lights, rotation=60, ha="right", fontsize=7)
    axes.set_yticks(range(rows), picture.methods, fontsize=7)
    for (row, column), value in np.ndenumerate(picture.means):
        shade = "white" if value > 1.5 else "black"
        axes.text(column, row, f"{value:.1f}", ha="center", va="center", fontsize=6, color=shade)
    axes.set_title(picture.title, fontsize=9)
    figure.colorbar(image, label="mean CIEDE2000", extend="max")
    return figure
