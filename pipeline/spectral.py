"""Spectral maps in and out: hyperspectral images to primaries (eq. 1), and primaries to estimates.

A map keeps its shape and orientation: a cubemap of stacked faces stays one, a latlong image too.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from calibration import display, estimate
from calibration.errors import InputError
from calibration.primaries import Primaries
from calibration.spectra import WAVELENGTHS, resample
from pipeline import io
from pipeline.errors import fault, storing
from pipeline.files import header as headers
from pipeline.files import spectral_exr
from pipeline.files.spectral_exr import SpectralImage
from stages.types import Float, Measured

_ABSOLUTE = "W.m^-2.sr^-1.nm^-1"  # as the layout writes W/(sr m2 nm)


def to_primaries(
    source: Path, out: Path, primaries: Primaries, *, kind: str = "light", force: bool = False
) -> tuple[str, ...]:
    """A spectral image as channels P1.. and valid; how sure a spectrum is, is not told: no sigma.

    Six square faces stacked top to bottom, as OpenGL's cube map table has them, make a cubemap.exr
    that `sixlight preview` lights with.

    source   an EXR of spectra, see `spectral_exr`, any wavelengths from 400 to 700 nm on
    out      the EXR to write
    kind     "light" or "reflectance"
    returns  notes: what in the file was not used, or what to distrust
    raises   InputError where the image or the place is wrong
    """
    if kind not in spectral_exr.KINDS:
        raise fault(f"kind {kind!r}", " or ".join(spectral_exr.KINDS), "name one")
    image = spectral_exr.read(source, kind=kind)
    try:
        values = in_primaries(image, primaries)
    except InputError as error:
        raise error.at(source) from None
    valid = np.asarray(np.isfinite(values).all(axis=-1), np.float32)
    measured = Measured(values, np.full_like(values, np.nan), valid)
    about = {
        "orientation": "as in the source",
        **image.header,
        **headers.of_primaries(primaries, unit=_unit(image), quantity=kind),
        "step": "spectra to primaries",
        "source": source.name,
        "wavelengths_nm": " ".join(f"{w:g}" for w in image.wavelengths),
    }
    notes = [*image.notes, *_coarse(image)]
    if "estimate" in image.header:
        if image.header.get("primaries") == primaries.name:
            del about["estimate"]  # which kept these very values
        else:
            notes.append("the spectra are estimates from other primaries, and so is this")
    if kind == "light":
        notes += _no_cubemap(values)
    _in_place(out, force, lambda path: io.write_measured(path, measured, primaries.channels, about))
    return tuple(notes)


def to_spectra(
    source: Path, out: Path, primaries: Primaries | None = None, *, force: bool = False
) -> tuple[str, ...]:
    """An image in primaries as estimated spectra, 380 to 730 nm, in Fichet's layout.

    source     an EXR that sixlight wrote: cubemap.exr, latlong.exr, a reflectance
    out        the EXR to write; its header says that it is an estimate, and how good
    primaries  of the source; default: the named set of its header
    returns    notes
    raises     InputError where the image or the place is wrong
    """
    measured, names = io.read_measured(source)
    header = io.read_exr(source)[2]
    if primaries is None:
        primaries = headers.primaries_of(source, names, header)
    elif names != primaries.channels or not headers.has_matrix(header, primaries):
        raise fault(
            f"an image in the primaries {header.get('primaries', '')!r}, channels "
            f"{', '.join(names)}",
            repr(primaries.name),
            "name the primaries it was made with",
            source,
        )
    kind = header.get("quantity", "light")
    if kind not in estimate.KINDS:
        raise fault(f"quantity {kind!r} in its header", " or ".join(estimate.KINDS), "", source)
    error = estimate.rms_error(primaries, kind)
    about = (
        f"ESTIMATED spectra, not measured: the best linear estimate from {len(names)} channels "
        f"({primaries.name}), whose values they keep; rms error {error:.0%} of a spectrum's size "
        f"over {'lights on surfaces' if kind == 'light' else 'surfaces'} it was made from"
    )
    unit = header.get("unit", "")
    image = SpectralImage(
        WAVELENGTHS,
        estimated(measured, primaries, kind),
        kind,
        (_ABSOLUTE if unit == "W/(sr m2 nm)" else unit or "relative") if kind == "light" else unit,
        {**header, "step": "primaries to spectra", "estimate": about, "source": source.name},
        (),
    )
    picture = measured.values @ (display.SRGB.rgb_from_xyz @ primaries.xyz_from_primaries).T
    _in_place(
        out,
        force,
        lambda path: spectral_exr.write(
            path, image, description=about, preview=picture.astype(np.float32)
        ),
    )
    return (about,)


def in_primaries(image: SpectralImage, primaries: Primaries) -> Float:
    """Values (H, W, P) of an image's spectra, band-averaged to the common grid: eq. 1.

    Resampling and projecting are both linear, so they are one matrix (K, P) for all pixels.
    """
    count = len(image.wavelengths)
    matrix = resample(image.wavelengths, np.eye(count)).T @ primaries.curves
    return np.asarray(image.values @ matrix.astype(np.float32), np.float32)


def estimated(measured: Measured, primaries: Primaries, kind: str) -> Float:
    """Spectra (H, W, 36) whose values in the primaries are the measured ones."""
    matrix = estimate.spectra_from_primaries(primaries, kind)
    return np.asarray(measured.values @ matrix.T.astype(np.float32), np.float32)


def _unit(image: SpectralImage) -> str:
    if image.kind == "reflectance":
        return "reflectance factor"
    # Renderers write W.m^-2.sr^-1 for what is per nm too: the layout's own example leaves it out.
    absolute = image.unit in (_ABSOLUTE, "W.m^-2.sr^-1")
    return "W/(sr m2 nm)" if absolute else image.unit or "relative; the source names no unit"


def _coarse(image: SpectralImage) -> tuple[str, ...]:
    notes = []
    step = float(np.diff(image.wavelengths).max())
    if step > 20.0:
        notes.append(
            f"bands up to {step:g} nm apart: between them spectra are taken as straight, which "
            "lamps with lines are not"
        )
    first, last = image.wavelengths[0], image.wavelengths[-1]
    if first > WAVELENGTHS[0] or last < WAVELENGTHS[-1]:
        notes.append(f"bands from {first:g} to {last:g} nm: beyond, the last value is kept")
    return tuple(notes)


def _no_cubemap(values: Float) -> tuple[str, ...]:
    """What keeps `sixlight preview` from lighting with an environment (H, W, P)."""
    height, width = values.shape[:2]
    if width == 2 * height:
        return (
            "2:1, so a latlong image: `sixlight preview` lights with cubemaps, six square faces "
            "+X -X +Y -Y +Z -Z stacked top to bottom; `sixlight convert --layout cube` makes them",
        )
    if height == 6 * width and width & (width - 1):
        return (
            f"faces of {width} texels: `sixlight preview` lights with powers of two; "
            "`sixlight convert --layout cube --size` makes them",
        )
    return ()


def _in_place(out: Path, force: bool, write: Callable[[Path], None]) -> None:
    """Writes beside the final name and moves into place; refuses what exists without `force`."""
    if out.exists() and not force:
        raise fault("exists", "a new file", "choose another -o, or --force", out)
    with storing(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".unfinished-", dir=out.parent) as folder:
            beside = Path(folder) / out.name
            write(beside)
            os.replace(beside, out)
