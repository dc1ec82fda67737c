"""Images with a spectrum at each pixel, in OpenEXR files.

Read are the layout of A. Fichet, R. Pacanowski, A. Wilkie, "An OpenEXR Layout for Spectral Images",
JCGT 10(3), 2021 (channels `S0.550,000000nm` for light, `T.550,000000nm` for reflectance), which
renderers and colour-science write, and files whose channels are plain wavelengths (`550nm`,
`w550`, `550.0`). Written is Fichet's layout.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline import io
from pipeline.errors import InputError, Problem, fault
from stages.types import Float

KINDS = ("light", "reflectance")

_LAYER = {"light": "S0", "reflectance": "T"}
# The layout's prefixes of metres and hertz.
_PREFIXES = {"Y": 24, "Z": 21, "E": 18, "P": 15, "T": 12, "G": 9, "M": 6, "k": 3, "h": 2, "da": 1}
_PREFIXES |= {"": 0, "d": -1, "c": -2, "m": -3, "u": -6, "n": -9, "p": -12}
_LIGHT_SPEED = 299792458.0  # m/s
# Of the layout a number has a comma; some programs write a point.
_QUANTITY = r"(\d*[,.]?\d*(?:[eE][-+]?\d+)?)(Y|Z|E|P|T|G|M|k|h|da|d|c|m|u|n|p)?(m|Hz)"
_FICHET = re.compile(rf"^(S[0-3]|T)\.*{_QUANTITY}$")
_BISPECTRAL = re.compile(rf"^T\.*{_QUANTITY}\.+{_QUANTITY}$")
_PLAIN = re.compile(r"^(?:[A-Za-z_]\w*\.)?(?:[wW]|wl_?)?(\d+(?:[.,]\d+)?)(?:_?nm)?$")
_PREVIEW = {"R", "G", "B", "A", "Y"}  # pictures that go along with spectra


@dataclass(frozen=True)
class SpectralImage:
    """A spectrum at each pixel.

    wavelengths  (K,) nm, ascending
    values       (H, W, K) float32: spectral radiance, or reflectance factor; NaN where not known
    kind         "light" or "reflectance"
    unit         in the file's words; "" where it does not say
    header       sixlight's own, where it wrote the file
    notes        what was in the file and is not here
    """

    wavelengths: NDArray[np.float64]
    values: Float
    kind: str
    unit: str
    header: Mapping[str, str]
    notes: tuple[str, ...]


def read(path: str | Path, *, kind: str = "light") -> SpectralImage:
    """The spectra of a file, of that kind.

    kind    "light" or "reflectance": which of Fichet's layers is meant; plain wavelengths are
            taken for either
    raises  InputError where the file has none, or they cannot be what they are taken for
    """
    assert kind in KINDS, kind
    path = Path(path)
    pixels, names, header = io.read_exr(path)
    try:
        wavelengths, places, notes = _channels(names, kind)
        order = np.argsort(wavelengths)
        values = np.ascontiguousarray(pixels[..., np.array(places)[order]])
        values[~np.isfinite(values)] = np.nan
        if "valid" in names:
            values[pixels[..., names.index("valid")] == 0] = np.nan
        _check(wavelengths[order], values, kind)
    except InputError as error:
        raise error.at(path) from None
    unit = _attribute(path, "emissiveUnits") if kind == "light" else "reflectance factor"
    return SpectralImage(wavelengths[order], values, kind, unit, header, notes)


def write(path: Path, image: SpectralImage, *, description: str, preview: Float | None = None):
    """Writes spectra in Fichet's layout.

    path         exactly there
    description  of the picture, for people, in the standard attribute
    preview      (H, W, 3) linear sRGB, for programs that know nothing of spectra
    """
    import OpenImageIO as oiio

    layer = _LAYER[image.kind]
    names = [f"{layer}.{w:.6f}nm".replace(".", ",").replace(",", ".", 1) for w in image.wavelengths]
    valid = np.isfinite(image.values).all(axis=-1, keepdims=True)
    parts = [image.values, valid]
    names.append("valid")
    if preview is not None:
        parts.insert(0, np.where(valid, preview, 0.0))
        names[:0] = "RGB"
    pixels = np.ascontiguousarray(np.concatenate(parts, axis=-1), np.float32)
    height, width, count = pixels.shape
    spec = oiio.ImageSpec(width, height, count, "float")
    spec.channelnames = names
    spec.attribute("compression", "zip")
    spec.attribute("DateTime", "")  # OpenImageIO's own would be now, and no two runs alike
    spec.attribute("ImageDescription", description)
    spec.attribute("spectralLayoutVersion", "1.0")
    if image.kind == "light":
        spec.attribute("emissiveUnits", image.unit)
        spec.attribute("polarisationHandedness", "right")
    for name, text in image.header.items():
        spec.attribute(f"sixlight:{name}", text)
    io.write_image(path, spec, pixels)


def _channels(names, kind: str) -> tuple[NDArray[np.float64], list[int], tuple[str, ...]]:
    """Wavelengths (K,) nm, their places among the channels, and notes of what is left out."""
    layers: dict[str, dict[int, float]] = {}
    unknown = []
    bispectral = 0
    for place, name in enumerate(names):
        if match := _FICHET.match(name):
            layers.setdefault(match[1], {})[place] = _nm(name, *match.groups()[1:])
        elif _BISPECTRAL.match(name):
            bispectral += 1
        elif match := _PLAIN.match(name):
            layers.setdefault("plain", {})[place] = float(match[1].replace(",", "."))
        elif name not in _PREVIEW | {"valid"}:
            unknown.append(name)
    wanted, other = _LAYER[kind], _LAYER["reflectance" if kind == "light" else "light"]
    found = layers.get(wanted) or layers.get("plain")
    if found is None:
        if other in layers:
            is_what = "reflectance" if kind == "light" else "light"
            raise fault(
                f"spectra of {is_what} (channels {other}.…nm)",
                f"{kind} ({wanted}.…nm)",
                f"read it as {is_what}",
            )
        raise fault(
            f"channels {', '.join(names)}"[:200],
            "spectra: channels such as S0.550,000000nm, T.550,000000nm, 550nm or w550",
            "rename the channels by their wavelengths",
        )
    notes = []
    polarised = [layer for layer in ("S1", "S2", "S3") if layer in layers]
    if polarised and kind == "light":
        notes.append(f"polarisation ({', '.join(polarised)}) is not used")
    if bispectral:
        notes.append(f"fluorescence ({bispectral} bispectral channels) is not used")
    if other in layers:
        notes.append(f"the layer {other} is not used")
    if unknown:
        notes.append(f"channels that are no wavelengths are not used: {', '.join(unknown)}"[:200])
    return np.array(list(found.values())), list(found), tuple(notes)


def _nm(name: str, number: str, prefix: str | None, unit: str) -> float:
    """The wavelength that Fichet's number, prefix and unit (m or Hz) say, nm."""
    try:
        value = float(number.replace(",", "."))
    except ValueError:
        value = 0.0
    if value <= 0.0:
        raise fault(f"a channel {name!r}", "a wavelength above 0 in its name", "rename it")
    if prefix == "n" and unit == "m":
        return value
    value *= 10.0 ** _PREFIXES[prefix or ""]
    return (value if unit == "m" else _LIGHT_SPEED / value) * 1e9


def _check(wavelengths: NDArray[np.float64], values: Float, kind: str) -> None:
    problems = []
    if wavelengths[-1] < 10.0:
        problems.append(
            Problem(
                f"wavelengths from {wavelengths[0]:g} to {wavelengths[-1]:g} look like micrometres",
                "nanometres",
                "name the channels in nm",
            )
        )
    elif len(wavelengths) < 4:
        problems.append(
            Problem(f"{len(wavelengths)} wavelengths", "4 or more, of 400 to 700 nm", "add bands")
        )
    again = wavelengths[1:][np.diff(wavelengths) < 1e-6]
    if len(again):
        problems.append(
            Problem(f"two channels of {again[0]:g} nm", "each wavelength once", "remove one")
        )
    finite = np.isfinite(values)
    known = values[finite]
    empty = wavelengths[~finite.any(axis=(0, 1))]
    # Noise around black dips below 0 here and there, but not in every pixel of a band.
    negative = wavelengths[np.where(finite, values, -1.0).max(axis=(0, 1)) < 0.0]
    if not known.size or not known.any():
        problems.append(Problem("no pixel with a value but 0", f"some {kind}", "make it again"))
    elif len(empty):
        problems.append(
            Problem(
                f"no pixel with a value at {_listed(empty)} nm",
                "every band known somewhere",
                "remove the channel or make it again",
            )
        )
    elif float(np.percentile(known, 99)) <= 0.0:
        problems.append(
            Problem(f"hardly any {kind} above 0", f"some {kind}", "check the sign, make it again")
        )
    elif len(negative):
        problems.append(
            Problem(
                f"values below 0 in every pixel at {_listed(negative)} nm",
                f"{kind} of 0 and more, but for noise",
                "check what was subtracted, or remove the channel",
            )
        )
    elif kind == "reflectance":
        # The middle of the bright, not the maximum: gloss and noise may exceed a white.
        high = float(np.percentile(known, 99))
        if high > 1.5:
            problems.append(
                Problem(
                    f"reflectance up to {high:g}",
                    "factors between 0 and 1",
                    "divide by 100 if it is percent; if it is light, read it as light",
                )
            )
    if problems:
        raise InputError(problems)


def _listed(wavelengths: NDArray[np.float64]) -> str:
    more = f" and {len(wavelengths) - 3} more" if len(wavelengths) > 3 else ""
    return ", ".join(f"{w:g}" for w in wavelengths[:3]) + more


def _attribute(path: Path, name: str) -> str:
    """An attribute that is not sixlight's own, as text; "" where the file has none."""
    import OpenImageIO as oiio

    image = oiio.ImageInput.open(str(path))
    assert image is not None, "read a moment ago"
    text = image.spec().getattribute(name)
    image.close()
    return "" if text is None else str(text)
