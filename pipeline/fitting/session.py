"""A calibration folder: a chart photographed under several lights, with what it sent measured.

calibration.toml                  optional: chart, method, primaries; patches or corners
A/cyan/*.dng  A/yellow/*.dng      the chart under light A, one folder a filter
A/radiance.csv                    spectral radiance of each patch, W/(sr m2 nm)
A/white/cyan/*.dng  ...           optional: an even white in the chart's place, the light unmoved
D65/...

With a white the signals are corrected for how the light falls off over the chart. That is for
readings that do not share the fall-off: taken at one place, or computed from one of the light.
Where each patch was read where it hangs, signals and readings agree already: leave the white out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from calibration import chart as charts
from calibration import primaries
from calibration.fit import CHART_METHOD, METHODS
from calibration.spectra import Spectra, read_spectra
from pipeline import io
from pipeline.errors import InputError, Problem, fault
from pipeline.files.tables import Table, read_toml

SETTINGS_FILE = "calibration.toml"
RADIANCE_FILE = "radiance.csv"
WHITE_FOLDER = "white"
CHARTS = tuple(charts.CHARTS)


@dataclass(frozen=True)
class Light:
    """The chart under one light.

    name          its folder's
    files         filter -> its raw files, sorted; the same filters for every light
    radiance      spectra of the patches, W/(sr m2 nm)
    radiance_csv  where they were read
    white         filter -> raw files of an even white in the chart's place; empty: there is none
    """

    name: str
    files: dict[str, tuple[Path, ...]]
    radiance: Spectra
    radiance_csv: Path
    white: dict[str, tuple[Path, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Session:
    """A calibration folder, read and checked; no photograph has been opened.

    folder       as given
    lights       by name
    filters      their names, in order
    chart        one of calibration.chart.CHARTS
    patches      where the patches lie in the photographs; None: find them
    patches_csv  where that was read; None: by corners, or find them
    primaries    the set to fit to: a name, or a folder's path
    method       one of calibration.fit.METHODS
    """

    folder: Path
    lights: tuple[Light, ...]
    filters: tuple[str, ...]
    chart: str
    patches: charts.Patches | None
    patches_csv: Path | None
    primaries: str
    method: str

    @property
    def channels(self) -> tuple[str, ...]:
        """The bands: cyan.R, cyan.G, ..."""
        return tuple(f"{name}.{colour}" for name in self.filters for colour in "RGB")


def read_session(folder: str | Path) -> Session:
    """A calibration folder as a Session; raises InputError with every problem found."""
    folder = Path(folder)
    if not folder.is_dir():
        raise fault("no such folder", "a folder of chart photographs", "correct the path", folder)
    problems: list[Problem] = []
    settings = _settings(folder / SETTINGS_FILE, problems)
    kind = settings.chart
    names = charts.CHARTS[kind]
    patches, patches_csv = None, None
    try:
        if settings.patches is not None:
            patches_csv = settings.patches
            patches = charts.read_boxes(patches_csv, names)
        elif settings.corners is not None:
            patches = charts.from_corners(settings.corners, kind)
    except InputError as error:
        problems.extend(error.at(folder / SETTINGS_FILE).problems)
    lights = [
        light for sub in _folders(folder) if (light := _light(sub, names, problems)) is not None
    ]
    filters = tuple(sorted({name for light in lights for name in light.files}))
    problems.extend(_unequal(folder, lights, filters))
    if problems:
        raise InputError(problems)
    return Session(
        folder=folder,
        lights=tuple(lights),
        filters=filters,
        chart=kind,
        patches=patches,
        patches_csv=patches_csv,
        primaries=_primaries(folder, settings.primaries),
        method=settings.method,
    )


def _primaries(folder: Path, wanted: str) -> str:
    """A set's name as it is, a folder relative to calibration.toml as a path."""
    return wanted if wanted in primaries.NAMES else str(folder / wanted)


@dataclass(frozen=True)
class _Settings:
    """What calibration.toml says; a wrong value is its default.

    chart      one of CHARTS
    method     one of calibration.fit.METHODS
    primaries  a set's name, or a folder relative to the file
    patches    CSV of the patches' boxes; None: not given
    corners    of the chart, see calibration.chart.from_corners; None: not given
    """

    chart: str = charts.COLORCHECKER24
    method: str = CHART_METHOD
    primaries: str = primaries.DEFAULT
    patches: Path | None = None
    corners: list[tuple[float, float]] | None = None


def _settings(path: Path, problems: list[Problem]) -> _Settings:
    """calibration.toml as far as it is right."""
    default = _Settings()
    if not path.is_file():
        return default
    table = Table(read_toml(path), problems, path)

    def one_of(key: str, allowed: Sequence[str], otherwise: str) -> str:
        value = table.text(key, otherwise) or otherwise
        if value in allowed:
            return value
        table.wrong(key, repr(value), " or ".join(allowed), "correct it")
        return otherwise

    settings = _Settings(
        chart=one_of("chart", CHARTS, default.chart),
        method=one_of("method", METHODS, default.method),
        primaries=table.text("primaries", default.primaries) or default.primaries,
        patches=table.path("patches"),
        corners=table.points("corners", 4),
    )
    if settings.patches is not None and settings.corners is not None:
        table.wrong("corners", "given beside patches", "one of the two", "take one out")
    table.nothing_else()
    return settings


def _folders(folder: Path) -> list[Path]:
    return sorted(p for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))


def _filters(folder: Path) -> dict[str, tuple[Path, ...]]:
    """Raw files by the sub-folder they are in, that of the white apart."""
    return {
        sub.name: found
        for sub in _folders(folder)
        if sub.name != WHITE_FOLDER and (found := tuple(io.photographs(sub.iterdir())))
    }


def _light(folder: Path, names: tuple[str, ...], problems: list[Problem]) -> Light | None:
    files = _filters(folder)
    radiance_csv = folder / RADIANCE_FILE
    if not files and not radiance_csv.is_file():
        return None  # some other folder
    if not files:
        problems.append(
            Problem("no photographs", "a folder of raw files a filter", "add them", folder)
        )
    try:
        radiance = read_spectra(radiance_csv, kind="power").resampled()
    except InputError as error:
        problems.extend(error.at(radiance_csv).problems)
        return None
    missing = [patch for patch in names if patch not in radiance.names]
    if missing:
        unknown = [name for name in radiance.names if name not in names]
        instead = f", but {_listed(unknown)}" if unknown else ""
        problems.append(
            Problem(
                f"no column for patch {_listed(missing)}{instead}",
                f"a column a patch, named {names[0]} to {names[-1]} as on the chart",
                "measure them or rename the columns",
                radiance_csv,
            )
        )
        return None
    white = _filters(folder / WHITE_FOLDER) if (folder / WHITE_FOLDER).is_dir() else {}
    return Light(folder.name, files, radiance.only(names), radiance_csv, white)


def _listed(names: Sequence[str], most: int = 6) -> str:
    """The names with commas; of many the first, and how many more."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _unequal(folder: Path, lights: list[Light], filters: tuple[str, ...]) -> Iterator[Problem]:
    if not lights:
        yield Problem(
            "no lights",
            f"a folder a light with {RADIANCE_FILE} and a folder of raw files a filter",
            "add them",
            folder,
        )
    for light in lights:
        missing = [name for name in filters if name not in light.files]
        if missing and light.files:
            yield Problem(
                f"no photographs through {', '.join(missing)}",
                f"the filters {', '.join(filters)}, as under the other lights",
                "take them, or take this light's folder away",
                folder / light.name,
            )
        missing = [name for name in filters if name not in light.white]
        if missing and light.white:
            yield Problem(
                f"no white through {', '.join(missing)}",
                f"the filters {', '.join(filters)}, as of the chart",
                "take it, or take this light's white away",
                folder / light.name / WHITE_FOLDER,
            )
