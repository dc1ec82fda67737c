"""`sixlight reflectance`: a surface photographed through the filters, as reflectance in primaries.

SURFACE and WHITE are folders of photographs like a capture's, one sub-folder of raw files a filter
(a capture.toml may name them, and give what EXIF lacks). The white is an even white card in the
surface's place and light: the one whose signals M_R was fitted with, for its own reflectance is
part of M_R.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration import primaries as primary_sets
from calibration import sets, uncertainty
from calibration.errors import InputError, Problem
from calibration.primaries import Primaries
from calibration.transform import REFLECTANCE, Transform, matched, read_transform
from pipeline import digest, io, photographs
from pipeline.bracket import Bracket
from pipeline.errors import fault, storing
from pipeline.files import header as headers
from pipeline.files.tables import Table, read_toml
from pipeline.photographs import Filter
from pipeline.progress import Progress
from stages.demosaic import demosaic
from stages.merge import merge
from stages.reflect import reflect
from stages.register import Registered, register
from stages.scale import scale
from stages.scale import warnings as warnings_of_scale
from stages.transform import transform
from stages.types import Lights, Measured

# M_R takes signals over the white's to reflectance, so 1 in all bands is the white's: of any card,
# and of a fit that leans to small values for the sake of noise.
_WHITE = (0.5, 1.5)
_SEEN_IN = "D65"  # the light that a surface's colour is judged in


@dataclass(frozen=True)
class Session:
    """What a reflectance is made from, read and checked; nothing has been written.

    surface, white  the photographs; the same filters in the same order
    transform       M_R, its columns in the order of the bands
    primaries       what it gives
    notes           what was taken for granted
    """

    surface_folder: Path
    white_folder: Path
    surface: tuple[Filter, ...]
    white: tuple[Filter, ...]
    transform: Transform
    primaries: Primaries
    notes: tuple[str, ...]


def load(
    surface: Path, white: Path, transform: Path, primaries: str | Path | None = None
) -> Session:
    """Reads and checks everything; InputError lists all that is wrong.

    surface, white  folders of photographs
    transform       M_R.toml of `sixlight fit --reflectance`
    primaries       what M_R was fitted to: a name or a folder; default: the name M_R gives
    """
    surface, white, transform = Path(surface), Path(white), Path(transform)
    problems: list[Problem] = []
    found = {folder: _photographs(folder, problems) for folder in dict.fromkeys((surface, white))}
    if surface.resolve() == white.resolve():
        problems.append(
            Problem(
                "surface and white are the same folder",
                "photographs of each",
                "name two folders",
                surface,
            )
        )
    if not problems:
        _check_pair(surface, white, found, problems)
    filters = found[surface]
    bands = tuple(f"{f.name}.{c}" for f in filters for c in "RGB")
    m_r, wanted = _transform(transform, primaries, bands if not problems else None, problems)
    if problems:
        raise InputError(problems)
    assert m_r is not None
    assert wanted is not None
    whites = {f.name: f for f in found[white]}
    found[white] = tuple(whites[f.name] for f in filters)
    notes = photographs.notes_of(
        [shot for group in found.values() for f in group for shot in f.shots]
    )
    notes += _unlike(filters, found[white])
    return Session(surface, white, filters, found[white], m_r, wanted, tuple(notes))


def reflectance(
    session: Session, out: Path, *, force: bool = False, quiet: bool = False
) -> dict[str, Any]:
    """Writes the surface's reflectance: an EXR of P1.., valid, sigma.P1..; returns the figures.

    out      the EXR
    returns  shifts_px, shift_error_px, correlation of the filters (None where there is no texture);
             shading of the white (5th over 95th percentile, per band); known, the share of pixels;
             reflectance, the median per primary; noise, the median sigma per primary;
             noise_delta_e, what noise alone does to a pixel's colour in D65: CIEDE2000, root
             mean square, median and p95 over the pixels; notes
    raises   InputError where the photographs do not match, or for the place
    """
    if out.exists() and not force:
        raise fault("exists", "a new file", "choose another -o, or --force", out)
    progress = Progress(len(session.surface) + 2, quiet=quiet)
    ratios, shading, exposed = [], [], []
    for surface, white in zip(session.surface, session.white, strict=True):
        with progress.step("reflect", surface.name):
            light, of_white = _image(session.white_folder, white)
            shading += _evenness(light)
            image, of_surface = _image(session.surface_folder, surface)
            exposed += [of_surface, of_white]
            ratios.append(reflect(image, light))
            if not ratios[-1].valid.any():
                raise fault(
                    f"no pixel of {surface.name} is known in surface and white both",
                    "photographs of both that do not clip in the shortest exposure",
                    "photograph them again with shorter exposures",
                    session.surface_folder,
                )
            del light, image
    ratios, notes = _on_one_scale(ratios, exposed, [f.name for f in session.surface])
    with progress.step("register", "the filters' images"):
        try:
            registered = register(ratios)
        except InputError as error:
            raise error.at(session.surface_folder) from None
        ratios.clear()
    with progress.step("transform", str(out)):
        result = transform(registered.bands, session.transform.matrix)
        _write(session, result, out)
    return _figures(session, registered, result, shading, notes)


def _photographs(folder: Path, problems: list[Problem]) -> tuple[Filter, ...]:
    file = folder / "capture.toml"
    mine: list[Problem] = []
    filters: tuple[Filter, ...] = ()
    try:
        photographs.check_folder(folder)
        root = Table(read_toml(file) if file.is_file() else {}, mine, file)
        filters = photographs.find(folder, root, root.table("camera"), mine)
    except InputError as error:
        mine += error.problems
    problems += mine
    return filters


def _check_pair(surface: Path, white: Path, found, problems: list[Problem]) -> None:
    """The same filters, camera and size in both folders."""
    mine, others = ([f.name for f in found[folder]] for folder in (surface, white))
    if sorted(mine) != sorted(others):
        problems.append(
            Problem(
                f"the filters {', '.join(others)}",
                f"{', '.join(mine)}, as the surface has",
                "photograph the white through the same filters, or rename the folders",
                white,
            )
        )
        return
    photographs.check_alike([found[folder][0].shots[0] for folder in (surface, white)], problems)


def _unlike(surface: Sequence[Filter], white: Sequence[Filter]) -> list[str]:
    """What differs between the two that should not, though the signals allow for it."""
    notes = []
    pairs = [(f.shots, w.shots) for f, w in zip(surface, white, strict=True)]
    if any({s.f_number for s in f} != {s.f_number for s in w} for f, w in pairs):
        notes.append("surface and white differ in aperture: the lens shades them differently")
    if any({s.time_s for s in f} != {s.time_s for s in w} for f, w in pairs):
        notes.append(
            "surface and white differ in exposure times: what shutters stray from their tags, "
            "some percent, is then in the reflectance"
        )
    return notes


def _transform(path: Path, wanted, bands, problems: list[Problem]):
    """M_R and its primaries; as far as they can be checked without `bands` where that is None."""
    try:
        m_r = read_transform(path)
        if wanted is None and m_r.primaries not in primary_sets.NAMES:
            raise fault(
                f"the primaries {m_r.primaries!r} are not a named set",
                ", ".join(primary_sets.NAMES),
                "give their folder with --primaries",
            )
        primaries = primary_sets.load(m_r.primaries if wanted is None else wanted)
        m_r = matched(m_r, m_r.channels if bands is None else bands, primaries, REFLECTANCE)
        white = m_r.matrix.sum(axis=1)
        if not ((white > _WHITE[0]) & (white < _WHITE[1])).all():
            raise fault(
                f"M_R makes {', '.join(f'{v:.2f}' for v in white)} of a white",
                "about 1 in each primary",
                "fit it from signals over those of a white: sixlight fit --reflectance",
            )
    except InputError as error:
        problems += error.at(path).problems
        return None, None
    return m_r, primaries


def _image(folder: Path, filtered: Filter) -> tuple[Measured, Lights]:
    """One filter's bracket as an image of three colours, and the light of its exposures."""
    try:
        merged = merge(Bracket.of(filtered.shots))
        return demosaic(merged), Lights.of(merged)
    except InputError as error:
        raise error.at(folder / filtered.name) from None


def _on_one_scale(
    ratios: Sequence[Measured], exposed: Sequence[Lights], filters: Sequence[str]
) -> tuple[list[Measured], list[str]]:
    """Surface over white of each filter, both brackets on one scale; and what of it is in doubt.

    exposed  of each filter's surface and white, in turn: one shutter, judged by all of them
    """
    found = scale(exposed)
    factors = np.divide(found.factors[::2], found.factors[1::2])
    scaled = [
        Measured(r.values * np.float32(f), r.variance * np.float32(f**2), r.valid)
        for r, f in zip(ratios, factors, strict=True)
    ]
    names = [f"{what} through {name}" for name in filters for what in ("surface", "white")]
    remedy = "use the same shutter times for both, or three of them through one filter"
    return scaled, warnings_of_scale(found, names, remedy)


def _evenness(white: Measured) -> list[float]:
    """Signal (C,) of the white's darker parts over its brighter ones: percentiles 5 and 95."""
    thin = max(1, int(np.sqrt(white.valid.size / 1e6)))
    known = white.values[::thin, ::thin][white.valid[::thin, ::thin] > 0]
    if not len(known):
        return [float("nan")] * white.values.shape[-1]
    low, high = np.percentile(known, [5, 95], axis=0)
    return [float(v) for v in low / np.maximum(high, 1e-30)]


def _figures(
    session: Session,
    registered: Registered,
    result: Measured,
    shading: list[float],
    notes: Sequence[str],
) -> dict[str, Any]:
    known = result.valid > 0
    some = known.any()
    return {
        "shifts_px": registered.shifts.tolist(),
        "shift_error_px": _known(registered.error_px),
        "correlation": _known(registered.correlation),
        "shading": dict(zip(session.transform.channels, shading, strict=True)),
        "known": float(known.mean()),
        "reflectance": np.median(result.values[known], axis=0).tolist() if some else [],
        "noise": np.sqrt(np.median(result.variance[known], axis=0)).tolist() if some else [],
        "noise_delta_e": _noise_delta_e(session, registered) if some else None,
        "notes": [*session.notes, *notes, *_register_notes(session, registered)],
    }


def _noise_delta_e(session: Session, registered: Registered) -> dict[str, Any]:
    """What noise alone does to the colour of a pixel of the surface, the eye adapted to D65.

    CIEDE2000, root of its expected square, with the primaries' covariance in full; of a large
    image some 100,000 pixels evenly spread are looked at.
    """
    bands, m_r = registered.bands, session.transform.matrix
    thin = max(1, int(np.sqrt(bands.valid.size / 1e5)))
    known = bands.valid[::thin, ::thin] > 0
    if not known.any():
        thin, known = 1, bands.valid > 0
    signals, variances = (a[::thin, ::thin][known] for a in (bands.values, bands.variance))
    to_xyz = session.primaries.xyz_from_primaries
    light = session.primaries.project(sets.lights("darling2011")[_SEEN_IN])
    xyz = (signals @ m_r.T * light) @ to_xyz.T
    covariance = uncertainty.of_xyz(uncertainty.of_primaries(variances, m_r), to_xyz, light)
    noise = uncertainty.delta_e(xyz, covariance, to_xyz @ light)
    median, p95 = np.percentile(noise, [50, 95])
    return {"light": _SEEN_IN, "median": float(median), "p95": float(p95)}


def _known(values) -> list[float | None]:
    """Numbers, None for NaN, which JSON has no word for."""
    return [None if np.isnan(v) else float(v) for v in values]


def _register_notes(session: Session, registered: Registered) -> list[str]:
    plain = [
        f.name for f, c in zip(session.surface, registered.correlation, strict=True) if np.isnan(c)
    ]
    if not plain:
        return []
    return [f"a surface without texture: {', '.join(plain)} is taken as it lies, not registered"]


def _write(session: Session, result: Measured, out: Path) -> None:
    about = headers.of_primaries(
        session.primaries, unit=session.transform.units, quantity=REFLECTANCE
    ) | {
        "step": "reflectance",
        "name": session.surface_folder.resolve().name,
        "white": session.white_folder.resolve().name,
        "calibration": digest.of_values(
            [
                session.transform.channels,
                session.transform.matrix.tolist(),
                session.transform.primaries_digest,
            ]
        ),
        "orientation": "as in the photograph, row 0 at the top",
    }
    with storing(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".unfinished-", dir=out.parent) as folder:
            beside = Path(folder) / out.name
            io.write_measured(beside, result, session.primaries.channels, about)
            os.replace(beside, out)
