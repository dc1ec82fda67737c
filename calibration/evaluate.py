"""How far colours rendered in a few channels are from full spectra: the paper's tables, and more.

Tables 1 and 2 are those of Darling, Ferwerda, Berns and Chen, "Real-Time Multispectral Rendering
with Complex Illumination" (CIC 19, 2011), with their figures beside ours. Table 3 has every set of
primaries under lamps of all kinds, table 4 on surfaces nothing was trained on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration import channels, optimise, primaries, sets
from calibration.bands import sensitivities
from calibration.channels import SHARP_FROM_XYZ, Channels
from calibration.primaries import Primaries
from calibration.spectra import WAVELENGTHS, Spectra, join

FULL, REFLECTANCE, LIGHTING, BOTH = "FS-Both", "MSI-Reflectance", "MSI-Lighting", "MSI-Both"
"""What is photographed rather than known as full spectra, in the paper's words."""

SHARP_RGB, XYZ = "Sharp RGB", "XYZ"
REFITTED = ", matrix refitted"
"""Added to a method whose matrix to XYZ was fitted to the very colours it is tried on: a check of
the curves, not a result."""

Figures = Mapping[str, float]
FIGURES = ("mean", "sd", "max", "p90")


@dataclass(frozen=True)
class Row:
    """One cell of a table: CIEDE2000 of a method over all surfaces under all lights of a set.

    table      1, 2: the paper's; 3: more lights; 4: more surfaces
    input      FULL, REFLECTANCE, LIGHTING or BOTH
    method     "6-channel" or any other number of channels, SHARP_RGB, XYZ
    primaries  name of the set; None where the method has none
    surfaces, lights  names of the sets, and what they stand in for
    n          number of colours
    mean, sd, max, p90  of their CIEDE2000
    paper      the paper's mean, sd, max and p90, where it has them for the same
    """

    table: int
    input: str
    method: str
    primaries: str | None
    surfaces: str
    lights: str
    n: int
    mean: float
    sd: float
    max: float
    p90: float
    paper: Figures | None = None


@dataclass(frozen=True)
class Method:
    """A way to render, with the names its rows have.

    refit  fits the matrix to each test's own colours before it is tried there
    """

    name: str
    channels: Channels
    primaries: str | None = None
    refit: bool = False


@dataclass(frozen=True)
class Trial:
    """A set of spectra to try methods on: the name in tables, and the paper's for its own."""

    name: str
    spectra: Spectra
    paper: str | None = None


def paper_surfaces() -> list[Trial]:
    """The paper's three sets of surfaces; what is not public is stood in for."""
    return [
        Trial("ces99, standing in for S100", sets.surfaces("ces99"), "S100"),
        Trial("colorchecker24", sets.surfaces("colorchecker24"), "CC"),
        Trial("rawtoaces190, standing in for CCDC", sets.surfaces("rawtoaces190"), "CCDC"),
    ]


def paper_lights() -> list[Trial]:
    """The paper's two sets of lights; the five places are stood in for."""
    return [
        Trial("darling2011", sets.lights("darling2011"), "19"),
        Trial("places5, standing in for five places", sets.lights("places5"), "5"),
    ]


@dataclass(frozen=True)
class Given:
    """What tables and pictures are made of; None: of their own.

    surfaces, lights  to try the methods on, in place of the sets of each table
    primaries         for every table; default: the program's own and the paper's in tables 1 and
                      2, all that ship in the others
    camera, filters   for table 2: see `bands.sensitivities`; default `default_camera`
    """

    surfaces: Sequence[Trial] | None = None
    lights: Sequence[Trial] | None = None
    primaries: Sequence[Primaries] | None = None
    camera: Spectra | None = None
    filters: Spectra | None = None

    @property
    def few(self) -> Sequence[Primaries]:
        """The sets of tables 1 and 2."""
        names = dict.fromkeys((primaries.DEFAULT, "darling2011"))
        return self.primaries or [primaries.load(name) for name in names]

    @property
    def every(self) -> Sequence[Primaries]:
        """The sets of the other tables."""
        return self.primaries or [primaries.load(name) for name in primaries.NAMES]

    @property
    def bands(self) -> NDArray[np.float64]:
        """The curves (36, B) of the camera's bands."""
        camera, filters = default_camera()
        return sensitivities(self.camera or camera, self.filters or filters)[1]


def tables(given: Given) -> list[Row]:
    """All rows of all tables."""
    lights_1, surfaces_1 = given.lights or paper_lights(), given.surfaces or paper_surfaces()
    rows = table_1(given.few, surfaces_1, lights_1)
    rows += table_2(given.few, surfaces_1, lights_1, given.bands)
    rows += table_3(given.every, given.surfaces or [_checker()], given.lights or _all_lamps())
    rows += table_4(given.every, given.surfaces or _other_surfaces(), given.lights or _test_lamps())
    return rows


def table_1(
    sets_of_primaries: Iterable[Primaries], surfaces: Sequence[Trial], lights: Sequence[Trial]
) -> list[Row]:
    """Full spectra rendered in primaries, in sharpened RGB and in XYZ."""
    ours = [in_primaries(one) for one in sets_of_primaries]
    methods = [each for one in ours for each in (one, replace(one, refit=True))]
    methods += [three_channels(SHARP_RGB), three_channels(XYZ)]
    return [
        _row(1, FULL, method, on, under)
        for method, on, under in _every(surfaces, lights, methods)
        if not method.refit or (on.paper and under.paper)
    ]


def table_2(
    sets_of_primaries: Iterable[Primaries],
    surfaces: Sequence[Trial],
    lights: Sequence[Trial],
    bands: NDArray[np.float64],
) -> list[Row]:
    """The same through a camera's bands (36, B), for surfaces, for light and for both; sharpened
    RGB beside it."""
    methods = [*map(in_primaries, sets_of_primaries), three_channels(SHARP_RGB)]
    rows = []
    for kind in (FULL, REFLECTANCE, LIGHTING, BOTH):
        seen = [through_camera(method, bands, kind) for method in methods]
        rows += [_row(2, kind, *test) for test in _every(surfaces, lights, seen)]
    return rows


def table_3(
    sets_of_primaries: Iterable[Primaries], surfaces: Sequence[Trial], lights: Sequence[Trial]
) -> list[Row]:
    """Every set of primaries under many kinds of lamps."""
    methods = [*map(in_primaries, sets_of_primaries), three_channels(SHARP_RGB)]
    return [_row(3, FULL, *test) for test in _every(surfaces, lights, methods)]


def table_4(
    sets_of_primaries: Iterable[Primaries], surfaces: Sequence[Trial], lights: Sequence[Trial]
) -> list[Row]:
    """Every set of primaries on surfaces that nothing was trained on."""
    return [replace(row, table=4) for row in table_3(sets_of_primaries, surfaces, lights)]


def in_primaries(one: Primaries) -> Method:
    """Rendering full spectra in a set of primaries."""
    return Method(f"{len(one.channels)}-channel", channels.of_primaries(one), one.name)


def three_channels(name: str) -> Method:
    """A comparator of the paper's: SHARP_RGB or XYZ."""
    from_xyz = {SHARP_RGB: SHARP_FROM_XYZ, XYZ: np.eye(3)}[name]
    return Method(name, channels.of_colour_space(from_xyz))


def through_camera(method: Method, bands: NDArray[np.float64], kind: str) -> Method:
    """The method with its light, its surfaces or both photographed.

    M_S and M_R are fitted as the paper's were: to the least CIEDE2000 of the rendered colours, on
    the surfaces that stand in for its artists' paints, without noise. For the paper's primaries
    and for three channels that is done under its 19 lights; for other sets under those that
    `training.computed` takes, of which more are incandescent.
    """
    if kind == FULL:
        return method
    papers = method.primaries in (None, "darling2011")
    photographed = channels.photographed(
        method.channels,
        bands,
        light=kind in (LIGHTING, BOTH),
        surface=kind in (REFLECTANCE, BOTH),
        lights=sets.lights("darling2011" if papers else "room"),
        surfaces=sets.surfaces("ces99"),
    )
    return replace(method, channels=photographed)


def default_camera() -> tuple[Spectra, Spectra]:
    """A camera that ships, and cyan and yellow filters of smooth curves shaped like glass."""
    edges = {"cyan": (600.0, -22.0), "yellow": (485.0, 9.0)}
    glass = [
        0.9 / (1.0 + np.exp(-(WAVELENGTHS - middle) / width)) for middle, width in edges.values()
    ]
    return sets.camera("nikon5100"), Spectra(WAVELENGTHS, tuple(edges), np.stack(glass, axis=1))


@dataclass(frozen=True)
class Picture:
    """Mean CIEDE2000 (methods, lights), to be drawn."""

    title: str
    methods: tuple[str, ...]
    lights: tuple[str, ...]
    means: NDArray[np.float64]


def pictures(given: Given) -> tuple[Picture, Picture]:
    """Every method under every single light: from full spectra, and through a camera.

    The lights are those of table 4, the surfaces the first of table 3.
    """
    on = (given.surfaces or [_checker()])[0]
    under = join(trial.spectra for trial in given.lights or _test_lamps())
    comparators = [three_channels(SHARP_RGB), three_channels(XYZ)]
    full = [*map(in_primaries, given.every), *comparators]
    few = [*map(in_primaries, given.few), comparators[0]]
    bands = given.bands
    inputs = (FULL, REFLECTANCE, LIGHTING, BOTH)
    seen = {f"{kind}, {_label(m)}": through_camera(m, bands, kind) for m in few for kind in inputs}
    return (
        _picture(
            f"Full spectra: {on.name}", dict(zip(map(_label, full), full, strict=True)), on, under
        ),
        _picture(f"Through a camera: {on.name}", seen, on, under),
    )


def _picture(title: str, methods: Mapping[str, Method], surfaces: Trial, lights: Spectra):
    means = [m.channels.errors(lights, surfaces.spectra).mean(axis=1) for m in methods.values()]
    return Picture(title, tuple(methods), lights.names, np.stack(means))


def _label(method: Method | Row) -> str:
    name = method.name if isinstance(method, Method) else method.method
    return name if method.primaries is None else f"{name}, {method.primaries}"


# ---- what methods are tried on


def _checker() -> Trial:
    return Trial("colorchecker24", sets.surfaces("colorchecker24"))


def _all_lamps() -> list[Trial]:
    """Lamps of every kind. Of measured lamps, those the shipped sets are not trained on apart."""
    trained = sets.lights("training").names
    measured = sets.lights("cie-fl3+cie-hp+lamps")
    kept = [name for name in dict.fromkeys(measured.names) if name not in trained]
    names = ("darling2011", "cie-fl3", "cie-hp", "cie-led", "lamps", "daylight", "planckian")
    left_out = [
        Trial("places5, not trained on", sets.lights("places5")),
        Trial("leds8, not trained on", sets.lights("leds8")),
        Trial("other lamps, not trained on", measured.only(kept)),
    ]
    return [Trial(name, sets.lights(name)) for name in names] + left_out


def _test_lamps() -> list[Trial]:
    return [Trial(name, sets.lights(name)) for name in ("darling2011", "places5", "leds8")]


def _other_surfaces() -> list[Trial]:
    """The samples of the colour rendering index and of NIST's colour quality scale."""
    return [Trial(name, sets.surfaces(name)) for name in ("cri14", "cqs15")]


# ---- rows


def _every(surfaces, lights, methods) -> Iterable[tuple[Method, Trial, Trial]]:
    return ((m, s, li) for s in surfaces for m in methods for li in lights)


def _row(table: int, kind: str, method: Method, surfaces: Trial, lights: Trial) -> Row:
    if method.refit:
        method = _refitted(method, surfaces.spectra, lights.spectra)
    errors = method.channels.errors(lights.spectra, surfaces.spectra)
    return Row(
        table,
        kind,
        method.name,
        method.primaries,
        surfaces.name,
        lights.name,
        errors.size,
        **figures(errors),
        paper=None if table > 2 else _paper(table, kind, method.name, surfaces, lights),
    )


def _refitted(method: Method, surfaces: Spectra, lights: Spectra) -> Method:
    matrix = optimise.fit_matrix(method.channels.light, lights, surfaces, white_share=0.0)
    new = replace(method.channels, xyz_from_channels=matrix)
    return Method(method.name + REFITTED, new, method.primaries)


def figures(errors) -> dict[str, float]:
    """Mean, standard deviation, maximum and 90th percentile, to 4 decimals."""
    values = (np.mean(errors), np.std(errors), np.max(errors), np.percentile(errors, 90))
    return {key: round(float(value), 4) for key, value in zip(FIGURES, values, strict=True)}


def _paper(table: int, kind: str, method: str, surfaces: Trial, lights: Trial) -> Figures | None:
    key = (surfaces.paper, kind if table == 2 else FULL, method.removesuffix(REFITTED))
    if lights.paper is None or key not in PAPER:
        return None
    at = 0 if lights.paper == "19" else 4
    return dict(zip(FIGURES, PAPER[key][at : at + 4], strict=True))


# ---- what the paper prints: mean, s.d., max, 90th percentile under 19 lights, then under 5

PAPER: dict[tuple[str | None, str, str], tuple[float, ...]] = {
    ("S100", FULL, "6-channel"): (0.5, 0.5, 3.6, 0.9, 0.9, 0.7, 5.0, 1.7),
    ("S100", FULL, SHARP_RGB): (1.9, 2.1, 14.9, 4.8, 2.0, 1.9, 9.8, 4.7),
    ("S100", FULL, XYZ): (2.4, 2.1, 13.8, 5.3, 3.2, 3.0, 15.5, 7.2),
    ("CC", FULL, "6-channel"): (0.6, 0.6, 3.1, 1.2, 0.8, 0.6, 2.8, 1.5),
    ("CC", FULL, SHARP_RGB): (1.7, 2.0, 13.3, 4.4, 1.7, 1.6, 7.5, 3.9),
    ("CC", FULL, XYZ): (2.3, 2.2, 12.1, 5.4, 3.2, 3.1, 13.5, 7.8),
    ("CCDC", FULL, "6-channel"): (0.5, 0.5, 4.9, 1.0, 0.8, 0.5, 4.4, 1.4),
    ("CCDC", FULL, SHARP_RGB): (1.6, 2.1, 15.9, 4.5, 1.6, 1.8, 12.5, 4.1),
    ("CCDC", FULL, XYZ): (1.9, 2.1, 14.0, 4.6, 2.5, 2.6, 13.4, 6.2),
    ("S100", REFLECTANCE, "6-channel"): (0.7, 0.4, 3.4, 1.2, 0.9, 0.5, 2.9, 1.7),
    ("S100", REFLECTANCE, SHARP_RGB): (1.7, 1.4, 9.9, 3.7, 1.9, 1.5, 9.2, 4.0),
    ("S100", LIGHTING, "6-channel"): (0.8, 0.6, 3.4, 1.6, 1.4, 0.9, 5.2, 2.7),
    ("S100", LIGHTING, SHARP_RGB): (2.0, 1.9, 13.4, 4.8, 2.1, 1.7, 8.7, 4.6),
    ("S100", BOTH, "6-channel"): (0.9, 0.6, 3.7, 1.7, 1.4, 0.9, 5.7, 2.7),
    ("S100", BOTH, SHARP_RGB): (2.6, 1.2, 10.3, 4.2, 2.6, 1.2, 8.9, 4.1),
    ("CC", REFLECTANCE, "6-channel"): (0.6, 0.4, 2.3, 1.1, 0.9, 0.5, 2.7, 1.5),
    ("CC", REFLECTANCE, SHARP_RGB): (1.6, 1.3, 9.1, 3.6, 1.8, 1.4, 6.8, 4.0),
    ("CC", LIGHTING, "6-channel"): (0.9, 0.7, 3.4, 1.9, 1.5, 1.0, 5.1, 2.7),
    ("CC", LIGHTING, SHARP_RGB): (2.0, 1.8, 12.8, 4.3, 2.1, 1.4, 7.5, 3.6),
    ("CC", BOTH, "6-channel"): (1.0, 0.6, 3.5, 1.7, 1.5, 1.1, 5.5, 3.0),
    ("CC", BOTH, SHARP_RGB): (2.6, 1.2, 8.6, 3.9, 2.8, 1.0, 6.6, 4.2),
    ("CCDC", REFLECTANCE, "6-channel"): (0.7, 0.5, 6.0, 1.2, 0.8, 0.5, 4.3, 1.5),
    ("CCDC", REFLECTANCE, SHARP_RGB): (1.6, 1.4, 10.6, 3.4, 1.6, 1.3, 11.9, 3.4),
    ("CCDC", LIGHTING, "6-channel"): (0.9, 0.7, 4.4, 1.9, 1.7, 1.1, 5.2, 3.2),
    ("CCDC", LIGHTING, SHARP_RGB): (2.0, 1.9, 15.4, 4.5, 2.1, 1.6, 12.5, 4.1),
    ("CCDC", BOTH, "6-channel"): (1.0, 0.7, 5.3, 2.0, 1.7, 1.2, 5.7, 3.5),
    ("CCDC", BOTH, SHARP_RGB): (2.6, 1.2, 9.9, 4.0, 2.6, 1.2, 12.0, 4.1),
}


# ---- Markdown


@dataclass(frozen=True)
class Section:
    """A table for people: what it is, and its cells as text; the first row heads the columns."""

    title: str
    text: str
    cells: list[list[str]]


def sections(rows: Iterable[Row]) -> list[Section]:
    """The tables, each with the paper's figures where it has them."""
    rows = list(rows)
    found = []
    for number, (title, text) in _TITLES.items():
        chosen = [row for row in rows if row.table == number]
        if chosen:
            write = _with_paper if number <= 2 else _means
            found.append(Section(f"Table {number}. {title}", text, write(chosen)))
    return found


def as_markdown(rows: Iterable[Row]) -> str:
    """The tables as Markdown, for the terminal and the docs."""
    parts = []
    for section in sections(rows):
        head, *lines = ("| " + " | ".join(cells) + " |" for cells in section.cells)
        rule = "|" + "---|" * len(section.cells[0])
        parts.append("\n".join([f"### {section.title}", "", section.text, "", head, rule, *lines]))
    return "\n\n".join(parts) + "\n"


_TITLES = {
    1: ("Full spectra", "CIEDE2000, mean / s.d. / max / 90th percentile."),
    2: ("Full spectra and camera", "CIEDE2000, mean / s.d. / max / 90th percentile."),
    3: ("Lights past the paper", "CIEDE2000, mean / max."),
    4: ("Surfaces never trained on", "CIEDE2000, mean / max."),
}


def _with_paper(rows: Sequence[Row]) -> list[list[str]]:
    """A line a method and surfaces, two columns a set of lights: ours and the paper's."""
    lights = tuple(dict.fromkeys(row.lights for row in rows))

    def cell(row: Row) -> list[str]:
        paper = " / ".join(f"{row.paper[key]:.1f}" for key in FIGURES) if row.paper else ""
        return [" / ".join(f"{getattr(row, key):.2f}" for key in FIGURES), paper]

    head = [title for light in lights for title in (light, "paper")]
    return _table(rows, ("surfaces", "input", "method"), head, lights, cell)


def _means(rows: Sequence[Row]) -> list[list[str]]:
    """A line a method and surfaces, a column a set of lights."""
    lights = tuple(dict.fromkeys(row.lights for row in rows))
    heads = [f"{light} ({_count(rows, light)})" for light in lights]
    return _table(
        rows,
        ("surfaces", "method"),
        heads,
        lights,
        lambda row: [f"{row.mean:.2f} / {row.max:.1f}"],
    )


def _count(rows: Sequence[Row], lights: str) -> str:
    counts = sorted({row.n for row in rows if row.lights == lights})
    return ", ".join(map(str, counts))


def _table(
    rows: Sequence[Row],
    keys: Sequence[str],
    heads: Sequence[str],
    lights: Sequence[str],
    cell: Callable[[Row], list[str]],
) -> list[list[str]]:
    lines: dict[tuple[str, ...], dict[str, list[str]]] = {}
    for row in rows:
        label = {"surfaces": row.surfaces, "input": row.input, "method": _label(row)}
        lines.setdefault(tuple(label[key] for key in keys), {})[row.lights] = cell(row)
    out = [[*keys, *heads]]
    out += [
        [*label, *(c for light in lights for c in cells[light])] for label, cells in lines.items()
    ]
    return out
