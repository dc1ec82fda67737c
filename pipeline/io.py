"""The only file that opens photographs and images, but for spectral ones (`spectral_exr`).

Raw files are read through LibRaw (rawpy), in processes of its own (`raw`, `decoding`), everything
else through OpenImageIO. What is written goes to exactly the path given; moving it into place is
the runner's business.
"""

from __future__ import annotations

import json
import math
import mmap
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from calibration import icc
from calibration.display import SRGB, Display, decode
from pipeline.errors import InputError, Problem, fault, storing
from pipeline.files import decoding, raw
from pipeline.files.raw import Shot, utf8
from stages.types import Frame, Lights, Measured, Radiance, Saturated

# ---------------------------------------------------------------------------------------- raw

_SIDECARS = {".toml", ".csv", ".txt", ".md", ".xmp", ".pp3", ".json", ".thm", ".ini"}


def photographs(paths: Iterable[Path]) -> list[Path]:
    """The files among paths that are meant as photographs, sorted: not hidden, no side-car."""
    return sorted(
        p
        for p in paths
        if p.is_file() and not p.name.startswith(".") and p.suffix.lower() not in _SIDECARS
    )


def is_raw(path: Path) -> bool:
    """Whether LibRaw recognises the file."""
    return decoding.run(raw.recognised, path)


def read_shots(
    paths: Sequence[Path],
    *,
    times_s: Sequence[float] | None = None,
    iso: float | None = None,
    f_number: float | None = None,
) -> tuple[list[Shot], list[Problem]]:
    """The headers of several raw files of a kind, and everything that is wrong with any of them.

    Values given, times_s one for each file, take the place of the files' own.
    """
    times: Sequence[float | None] = times_s or [None] * len(paths)
    problems: list[Problem] = []
    shots: list[Shot] = []

    def read(file: tuple[Path, float | None]) -> Shot | InputError:
        path, time_s = file
        like = shots[0] if shots else None
        try:
            return read_shot(path, time_s=time_s, iso=iso, f_number=f_number, like=like)
        except InputError as error:
            return error

    pending = list(zip(paths, times, strict=True))
    while pending:
        # One at a time until there is one for the others to be like, then those side by side.
        now, pending = (pending, []) if shots else (pending[:1], pending[1:])
        for one in decoding.each(read, now):
            if isinstance(one, InputError):
                problems += one.problems
            else:
                shots.append(one)
    return shots, problems


def read_shot(
    path: Path,
    *,
    time_s: float | None = None,
    iso: float | None = None,
    f_number: float | None = None,
    like: Shot | None = None,
) -> Shot:
    """A raw file's header, as `raw.read_shot` reads it, in a process apart."""
    return decoding.run(raw.read_shot, path, time_s, iso, f_number, like)


def read_frame(path: Path, *, time_s: float, iso: float, f_number: float) -> Frame:
    """A decoded raw file, whose exposure is taken as given; InputError where it is damaged."""
    file = os.memfd_create("samples")
    try:
        return decode_into(file, 0, path, time_s=time_s, iso=iso, f_number=f_number)[0]
    finally:
        os.close(file)


def decode_into(
    file: int,
    slot: int,
    path: Path,
    *,
    part: tuple[slice, slice] | None = None,
    **exposure: float,
) -> tuple[Frame, tuple[int, int]]:
    """The same by way of a file: decoded into it, and seen there.

    file     descriptor of one that is open for reading and writing
    slot     where the samples go: after as many of the same size
    part     rows and columns that are wanted; None: all
    returns  the frame, or that part of it; height and width of the whole
    """
    seen = decoding.run(raw.decode, path, part, slot, file=file)
    count = math.prod(seen.shape)
    before = 2 * count * slot % mmap.ALLOCATIONGRANULARITY
    pages = mmap.mmap(
        file, before + 2 * count, access=mmap.ACCESS_COPY, offset=2 * count * slot - before
    )
    samples = np.frombuffer(pages, np.uint16, count, before).reshape(seen.shape)
    return Frame(samples, seen.cfa, seen.black_level, seen.saturation_level, **exposure), seen.size


# ---------------------------------------------------------------------------------------- EXR


def write_exr(
    path: Path,
    pixels,
    channels: Sequence[str],
    header: Mapping[str, str],
    *,
    half: bool = False,
    compression: str = "zip",
) -> None:
    """Writes an OpenEXR file.

    pixels    (H, W, C); stored as float32, or half
    channels  C names
    header    text attributes, stored as sixlight:NAME
    """
    import OpenImageIO as oiio

    pixels = np.ascontiguousarray(pixels, np.float16 if half else np.float32)
    height, width, count = pixels.shape
    assert count == len(channels)
    spec = oiio.ImageSpec(width, height, count, "half" if half else "float")
    spec.channelnames = list(channels)
    spec.attribute("compression", compression)
    spec.attribute("oiio:ColorSpace", "lin")
    spec.attribute("DateTime", "")  # OpenImageIO's own would be now, and no two runs alike
    for name, text in header.items():
        spec.attribute(f"sixlight:{name}", text)
    write_image(path, spec, pixels)


def write_rgb(path: Path, pixels, description: str) -> None:
    """Linear red, green and blue (H, W, 3) in any format of floats that OpenImageIO writes.

    What is below 0 becomes 0 in Radiance's .hdr, whose numbers have no sign.
    """
    import OpenImageIO as oiio

    pixels = np.ascontiguousarray(pixels, np.float32)
    if path.suffix.lower() == ".hdr":
        pixels = np.maximum(pixels, 0.0)
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, "float")
    spec.attribute("oiio:ColorSpace", "lin")
    spec.attribute("DateTime", "")
    spec.attribute("ImageDescription", description)
    write_image(path, spec, pixels)


def write_image(path: Path, spec, pixels) -> None:
    """Writes an image; a place that cannot take it is reported in the system's own words."""
    import OpenImageIO as oiio

    with storing(path):
        path.touch()  # OpenImageIO would say no more than that it failed
        out = oiio.ImageOutput.create(utf8(path))
        assert out is not None, f"OpenImageIO without {path.suffix}"
        if not (out.open(utf8(path), spec) and out.write_image(pixels) and out.close()):
            said = out.geterror()
            with path.open("ab") as file:  # most often the disk is full: this says so again
                file.write(bytes(1 << 20))
                file.flush()
            raise RuntimeError(f"{path}: OpenImageIO cannot write: {said}")


def read_exr(path: Path) -> tuple[np.ndarray, list[str], dict[str, str]]:
    """Pixels (H, W, C) float32, channel names and sixlight's own header of an OpenEXR file.

    InputError where it is none.
    """
    pixels, names, header, _ = read_image(path, "an OpenEXR file")
    return pixels, list(names), header


def read_image(
    path: Path, expected: str = "an image that OpenImageIO reads"
) -> tuple[np.ndarray, tuple[str, ...], dict[str, str], bool]:
    """Any image: linear pixels (H, W, C) float32, channel names, sixlight's own header, and whether
    its integers were decoded from sRGB.

    expected  what InputError says was, where it is none
    """
    import OpenImageIO as oiio

    image = oiio.ImageInput.open(utf8(path))
    if image is None:
        said = _said(oiio.geterror)
        found = "no such file" if not path.exists() else f"not a readable image ({said})"
        raise fault(found, expected, "check the path", path)
    try:
        spec = image.spec()
        _check_claim(path, spec)
        pixels = image.read_image("float")
        if pixels is None:
            found = f"damaged ({_said(image.geterror)})"
            raise fault(found, "a complete file", "make it again", path)
        header = {
            p.name.removeprefix("sixlight:"): str(p.value)
            for p in spec.extra_attribs
            if p.name.startswith("sixlight:")
        }
        pixels = pixels.reshape(spec.height, spec.width, -1)
        encoded = spec.format.basetype not in (oiio.HALF, oiio.FLOAT, oiio.DOUBLE)
        if encoded:
            colours = [i for i in range(pixels.shape[-1]) if i != spec.alpha_channel]
            pixels[..., colours] = decode(pixels[..., colours])
        return pixels, tuple(spec.channelnames), header, encoded
    except UnicodeDecodeError as error:
        raise fault("its header is not text", "UTF-8", "make it again", path) from error
    finally:
        image.close()


def _said(geterror: Callable[[], str]) -> str:
    """What OpenImageIO has to say, which may quote the file's own bytes."""
    try:
        return geterror()
    except UnicodeDecodeError:
        return "its header is not text"


_MOST_COMPRESSED = 1100  # times smaller that deflate can make anything
_ANY_CLAIM_BYTES = 1 << 28


def _check_claim(path: Path, spec) -> None:
    """InputError where a header claims more pixels than the file can hold."""
    claimed = spec.width * spec.height * max(spec.nchannels, 1) * 4
    if claimed > max(_ANY_CLAIM_BYTES, _MOST_COMPRESSED * 4 * path.stat().st_size):
        raise fault(
            f"claims {spec.width} x {spec.height} pixels of {spec.nchannels} channels in"
            f" {path.stat().st_size} bytes",
            "as many as it holds",
            "make it again",
            path,
        )


def write_measured(
    path: Path,
    data: Measured,
    names: Sequence[str],
    header: Mapping[str, str],
    *,
    beside: Mapping[str, np.ndarray] | None = None,
    **how,
) -> None:
    """A Measured image (H, W, C) or cube (6, N, N, C) as EXR: values, `valid`, `sigma.NAME`.

    beside  further channels by name, each of the shape of `valid`

    The faces of a cube are stacked top to bottom. Where no variance is known at all, as of spectra
    that came without, `sigma` is left out.
    """
    assert data.values.shape[-1] == len(names)
    layers = [
        data.values.reshape(-1, *data.values.shape[-2:]),
        data.valid.reshape(-1, data.values.shape[-2], 1),
    ]
    channels = [*names, "valid"]
    if not np.isnan(data.variance).all():
        layers.append(np.sqrt(data.variance).reshape(-1, *data.variance.shape[-2:]))
        channels += [f"sigma.{n}" for n in names]
    for name, values in (beside or {}).items():
        layers.append(values.reshape(-1, values.shape[-1], 1))
        channels.append(name)
    write_exr(path, np.concatenate(layers, axis=-1), channels, header, **how)


def read_measured(path: Path, *, cube: bool = False) -> tuple[Measured, tuple[str, ...]]:
    """What write_measured wrote, and the names of its channels; InputError for another file.

    Without `sigma` the variance is NaN; then the channels must be primaries.
    """
    pixels, channels, _ = read_exr(path)
    sigmas = tuple(c for c in channels if c.startswith("sigma."))
    names = tuple(c.removeprefix("sigma.") for c in sigmas)
    if not sigmas:
        names = tuple(c for c in channels if re.fullmatch(r"P\d+", c))
    if not names or not {"valid", *names} <= set(channels):
        raise fault(
            f"channels {', '.join(channels)}"[:200],
            "P1..P6 and valid, and sigma.P1..sigma.P6 where the error is known",
            "give the folder or cubemap.exr that `sixlight envmap` wrote",
            path,
        )
    if cube and pixels.shape[0] != 6 * pixels.shape[1]:
        raise fault(
            f"{pixels.shape[1]} x {pixels.shape[0]} px",
            "six square faces stacked top to bottom",
            "give the cubemap.exr that `sixlight envmap` wrote",
            path,
        )
    shape = (6, pixels.shape[1], pixels.shape[1]) if cube else pixels.shape[:2]

    def pick(wanted: Sequence[str]) -> np.ndarray:
        return pixels[..., [channels.index(c) for c in wanted]].reshape(*shape, -1)

    values = pick(names)
    variance = pick(sigmas) ** 2 if sigmas else np.full_like(values, np.nan)
    return Measured(values, variance, pick(["valid"])[..., 0]), names


# ------------------------------------------------------------------------- pictures and tables


PICTURES = (".png", ".jxl", ".tif", ".tiff")  # what write_picture can write


def write_picture(
    path: Path, signal, display: Display, *, bits: int = 8, description: str = ""
) -> None:
    """A picture as a display is sent it; the file says by which colours it is to be read.

    path     its suffix chooses the format, one of PICTURES; nothing is lost in any of them
    signal   (H, W, 3) in 0..1
    display  what the signal is for. PNG and JPEG XL carry its numbers of Rec. ITU-T H.273 (CICP),
             PNG an ICC profile beside them unless it has a word for the display itself; TIFF, and a
             measured display in any format, the ICC profile alone
    bits     8 or 16
    """
    import OpenImageIO as oiio

    assert bits in (8, 16), bits
    kind = path.suffix.lower()
    assert kind in PICTURES, path
    depth = np.uint8 if bits == 8 else np.uint16
    pixels = np.rint(np.clip(signal, 0, 1) * np.iinfo(depth).max).astype(depth)
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 3, f"uint{bits}")
    # OpenImageIO writes sRGB beside any other profile where it knows no colour space, and libpng
    # then believes neither.
    spec.attribute("oiio:ColorSpace", "sRGB" if display is SRGB else "unknown")
    numbers = display.cicp if kind in (".png", ".jxl") else None
    if numbers:
        # Full range, and RGB as it is: matrix coefficients 0.
        spec.attribute("CICP", oiio.TypeDesc("int[4]"), [*numbers, 0, 1])
    if not numbers or (kind == ".png" and display is not SRGB and not display.absolute):
        profile = np.frombuffer(icc.profile(display), np.uint8)
        spec.attribute("ICCProfile", oiio.TypeDesc(f"uint8[{len(profile)}]"), profile)
    if kind == ".jxl":
        spec.attribute("compression", "jpegxl:100")  # lossless
    spec.attribute("DateTime", "")  # TIFF's would be now
    if description:
        spec.attribute("ImageDescription", description)
    write_image(path, spec, np.ascontiguousarray(pixels))


def read_thumbnail(path: Path, widest: int) -> bytes:
    """A picture file as the bytes of a JPEG no wider than `widest` px, to be put into a page."""
    import cv2

    pixels = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_COLOR)
    assert pixels is not None, path  # ours
    height, width = pixels.shape[:2]
    if width > widest:
        size = widest, round(height * widest / width)
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    _, jpeg = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 90])
    return bytes(jpeg.tobytes())


def write_radiance(path: Path, radiance: Radiance) -> None:
    """A merged mosaic as NumPy's npz, the runner's own intermediate file."""
    with storing(path), path.open("wb") as file:
        arrays: Any = {k: np.asarray(v) for k, v in vars(radiance).items()}
        np.savez(file, **arrays)


def read_radiance(path: Path) -> Radiance:
    """What write_radiance wrote."""
    with np.load(path, allow_pickle=False) as data:
        fields = {k: data[k] for k in data.files}
    plain = {k: v.tolist() for k, v in fields.items() if v.ndim < 2}
    tuples = {k: tuple(v) if isinstance(v, list) else v for k, v in plain.items()}
    return Radiance(**{**fields, **tuples})


def read_saturated(path: Path) -> Saturated:
    """What was lost of what write_radiance wrote, without the rest of its pixels."""
    with np.load(path, allow_pickle=False) as data:
        return Saturated(**{f.name: data[f.name] for f in fields(Saturated)})


def read_lights(path: Path) -> Lights:
    """The light of the exposures of what write_radiance wrote, without its pixels."""
    with np.load(path, allow_pickle=False) as data:
        return Lights(**{f.name: tuple(data[f.name].tolist()) for f in fields(Lights)})


def write_text(path: Path, text: str) -> None:
    with storing(path):
        path.write_text(text, encoding="utf-8")


def write_json(path: Path, content: Any) -> None:
    """Plain data as readable JSON; NaN and infinity become null, which JSON has words for."""
    write_text(path, json.dumps(_plain(content), indent=2, allow_nan=False) + "\n")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value
