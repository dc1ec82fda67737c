"""The only file that opens photographs and images, but for spectral ones (`spectral_exr`).

Raw files are read through LibRaw (rawpy), everything else through OpenImageIO. What is written
goes to exactly the path given; moving it into place is the runner's business.
"""

from __future__ import annotations

import json
import math
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from calibration import icc
from calibration.display import SRGB, Display, decode
from pipeline import tiff
from pipeline.errors import InputError, Problem, fault, storing
from stages.lost import Saturated
from stages.scale import Lights
from stages.types import Frame, Measured, Radiance

# ---------------------------------------------------------------------------------------- raw


@dataclass(frozen=True)
class Shot:
    """One raw file as its header describes it.

    size             (height, width) of the visible raw image
    cfa              colours of the 2 x 2 pattern, row by row: "RGGB"
    camera           make and model; "" where the file does not say
    time_s, iso, f_number
                     as tagged, or as given for the file
    focal_length_mm, pixel_pitch_um
                     None where the file does not say
    focus_m          distance focused at, infinity included; None where the file does not say
    """

    path: Path
    size: tuple[int, int]
    cfa: str
    camera: str
    time_s: float
    iso: float
    f_number: float
    focal_length_mm: float | None
    pixel_pitch_um: float | None
    iso_missing: bool = False
    f_number_missing: bool = False
    focus_m: float | None = None

    @property
    def light(self) -> float:
        """What the exposure took in: time_s * ISO/100 / f_number^2."""
        return self.time_s * self.iso / 100.0 / self.f_number**2


_MOST_PIXELS = 400_000_000
_SIDECARS = {".toml", ".csv", ".txt", ".md", ".xmp", ".pp3", ".json", ".thm", ".ini"}


def photographs(paths: Iterable[Path]) -> list[Path]:
    """The files among paths that are meant as photographs, sorted: not hidden, no side-car."""
    return sorted(
        p
        for p in paths
        if p.is_file() and not p.name.startswith(".") and p.suffix.lower() not in _SIDECARS
    )


def _utf8(path: Path) -> str:
    """A path as LibRaw and OpenImageIO take it, whatever the locale; InputError where it is none.

    Python holds bytes of names that the locale has no letters for in a form of its own.
    """
    try:
        return os.fsencode(path).decode()
    except UnicodeDecodeError as error:
        raise fault("its name is not UTF-8", "a name in UTF-8", "rename it", path) from error


def is_raw(path: Path) -> bool:
    """Whether LibRaw recognises the file."""
    import rawpy

    try:
        with rawpy.imread(_utf8(path)):
            return True
    except (rawpy.LibRawError, OSError):
        return False


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

    def read(path: Path, time_s: float | None) -> Shot | InputError:
        like = shots[0] if shots else None
        try:
            return read_shot(path, time_s=time_s, iso=iso, f_number=f_number, like=like)
        except InputError as error:
            return error

    pending = list(zip(paths, times, strict=True))
    with quiet_libraw(), ThreadPoolExecutor() as pool:
        while pending:
            # One at a time until there is one for the others to be like, then those side by side.
            now, pending = (pending, []) if shots else (pending[:1], pending[1:])
            for one in pool.map(read, *zip(*now, strict=True)):
                if isinstance(one, InputError):
                    problems += one.problems
                else:
                    shots.append(one)
    return shots, problems


@contextmanager
def quiet_libraw() -> Iterator[None]:
    """Keeps LibRaw, which prints what it thinks of damaged files itself, off stderr.

    What Python prints there meanwhile, of progress, still comes through.
    """
    ours = sys.stderr
    ours.flush()
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        with os.fdopen(os.dup(kept), "w", encoding=ours.encoding, errors="replace") as sys.stderr:
            yield
    finally:
        sys.stderr = ours
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def read_shot(
    path: Path,
    *,
    time_s: float | None = None,
    iso: float | None = None,
    f_number: float | None = None,
    like: Shot | None = None,
) -> Shot:
    """Reads a raw file's header. Values given take the place of the file's own.

    like    a photograph of the same camera and size, whose CFA pattern this one then has too
    raises  InputError where it is no complete raw file, has no Bayer pattern, or no known exposure
            time

    The pattern, and what tags leave out, LibRaw tells only of samples it has decoded. That takes a
    hundred times as long as all else, so it is done where there is nothing to be like, where tags
    leave something out, and where the file does not say how long it is, or is shorter: such a file
    is found to be damaged here. One whose data are wrong within is found when it is merged.
    """
    with _opened(path) as raw:
        tags = _tags(path)
        size = (raw.sizes.height, raw.sizes.width)
        camera = " ".join(str(tags.get(k, "")) for k in ("Make", "Model")).strip()
        if (
            like is not None
            and (camera, size) == (like.camera, like.size)
            and _says_all(tags, time_s, iso, f_number)
            and _has_all_data(path)
        ):
            cfa, other = like.cfa, None
        else:
            _unpack(raw, path)
            cfa = "".join("RGB"[c] for c in _cfa(raw, path).ravel())
            other = raw.other
        time_s = time_s or _tagged_time(tags, other)
        if time_s is None:
            raise fault(
                "no exposure time in the file",
                "ExposureTime in its metadata",
                "list times_s under [[filter]] in capture.toml",
                path,
            )
        iso = iso or _tagged_iso(tags)
        f_number = f_number or _positive(tags.get("FNumber"))
        focal_length_mm = _positive(tags.get("FocalLength"))
        if other is not None:
            iso = iso or _positive(other.iso_speed)
            focal_length_mm = focal_length_mm or _positive(other.focal_length)
            if "FNumber" not in tags:
                f_number = f_number or _positive(other.aperture)
        return Shot(
            path=path,
            size=size,
            cfa=cfa,
            camera=camera,
            time_s=time_s,
            iso=iso or 100.0,
            f_number=f_number or 1.0,
            focal_length_mm=focal_length_mm,
            pixel_pitch_um=_pixel_pitch_um(tags),
            iso_missing=iso is None,
            f_number_missing=f_number is None,
            focus_m=_focus_m(tags),
        )


@contextmanager
def opened_frame(path: Path, *, time_s: float, iso: float, f_number: float) -> Iterator[Frame]:
    """A decoded raw file, whose exposure is taken as given; InputError where it is damaged.

    Its samples lie in LibRaw's memory and are gone with the context.
    """
    with _opened(path) as raw:
        _unpack(raw, path)
        cfa = _cfa(raw, path)
        # Both levels are numbered as the pattern is, where the second green is colour 3.
        pattern = _visible_pattern(raw)
        black = np.asarray(raw.black_level_per_channel, np.float64)[pattern]
        if np.ptp(black):
            black = _where_libraw_begins(black, path)
        per_channel = raw.camera_white_level_per_channel
        white = np.asarray(per_channel or [raw.white_level] * 4, np.float64)
        white = np.where(white > 0, white, raw.white_level)[pattern]
        if not (white > black).all():
            raise fault(
                f"saturation level {white.min():g} under black level {black.max():g}",
                "a saturation level above black",
                "check the file's metadata",
                path,
            )
        yield Frame(raw.raw_image_visible, cfa, black, white, time_s, iso, f_number)


def read_frame(path: Path, *, time_s: float, iso: float, f_number: float) -> Frame:
    """The same, to keep."""
    with opened_frame(path, time_s=time_s, iso=iso, f_number=f_number) as frame:
        return replace(frame, samples=frame.samples.copy())


class _opened:  # noqa: N801 - used as a context manager, like open()
    """A raw file opened by LibRaw; its refusals become InputErrors."""

    def __init__(self, path: Path):
        self.path = path

    def __enter__(self):
        import rawpy

        try:
            self.raw = rawpy.imread(_utf8(self.path))
        except rawpy.LibRawFileUnsupportedError as error:
            raise fault(
                "not a raw file LibRaw can read",
                "a camera's raw file with a Bayer pattern",
                "remove it or convert it to DNG",
                self.path,
            ) from error
        except (rawpy.LibRawError, OSError) as error:
            raise _damaged(self.path, error) from error
        sizes = self.raw.sizes
        if sizes.raw_width * sizes.raw_height > _MOST_PIXELS:  # before anything that large is held
            self.raw.close()
            raise fault(
                f"claims {sizes.raw_width} x {sizes.raw_height} pixels",
                f"at most {_MOST_PIXELS / 1e6:.0f} million, more than any camera has",
                "copy the file again from the camera",
                self.path,
            )
        return self.raw

    def __exit__(self, *_):
        self.raw.close()


def _unpack(raw, path: Path) -> None:
    """Decodes the samples, as rawpy would by itself at the first look at almost anything."""
    import rawpy

    try:
        raw.unpack()
    except rawpy.LibRawError as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception):
    said = error.args[0] if error.args else ""
    said = said.decode() if isinstance(said, bytes) else str(said)
    found = f"the raw data cannot be decoded ({said})" if said else "the raw data cannot be decoded"
    return fault(found, "a complete raw file", "copy the file again from the camera", path)


def _cfa(raw, path: Path):
    """The (2, 2) CFA pattern with colours 0 1 2; refused where there is no Bayer pattern."""
    pattern = _visible_pattern(raw)
    if pattern is None or raw.raw_type.name != "Flat":
        found = "no colour filter array (linear DNG, Foveon or a rendered image)"
    elif np.shape(pattern) != (2, 2):
        found = f"a {np.shape(pattern)[0]} x {np.shape(pattern)[1]} colour filter array (X-Trans?)"
    else:
        letters = np.array(list(raw.color_desc.decode()))[pattern]
        if sorted(letters.ravel()) == sorted("RGGB"):
            return np.array([["RGB".index(c) for c in row] for row in letters])
        found = f"colour filters {''.join(letters.ravel())}"
    raise fault(
        found,
        "a 2 x 2 Bayer pattern of red, green and blue",
        "use the camera's own raw files from a Bayer sensor",
        path,
    )


def _visible_pattern(raw):
    """LibRaw's numbers of the colours from the first visible pixel on; None where there are none.

    rawpy has them from the first pixel of all, and some cameras have masked borders of odd width.
    """
    try:
        pattern = raw.raw_pattern
    except NotImplementedError:  # what rawpy says of patterns no camera has
        return None
    if pattern is None:
        return None
    margins = raw.sizes.top_margin, raw.sizes.left_margin
    return np.roll(pattern, [-n for n in margins], axis=(0, 1))


def _where_libraw_begins(black, path: Path):
    """Black levels (2, 2) of a DNG that differ by CFA position, from the first visible pixel on.

    They are written down from the active area's first pixel on. Where that is an odd one LibRaw
    leaves it out, but takes the levels as if it had not.
    """
    with path.open("rb") as file:
        begins = tiff.active_area(tiff.directories(file)) or (0, 0)
    return np.roll(black, [n % 2 for n in begins], axis=(0, 1))


def _has_all_data(path: Path) -> bool:
    """Whether the file is as long as its directories say; false also where they do not say."""
    with path.open("rb") as file:
        end = tiff.data_end(tiff.directories(file))
    return end is not None and end <= path.stat().st_size


def _says_all(tags: Mapping[str, Any], time_s, iso, f_number) -> bool:
    """Whether nothing needs to be asked of LibRaw, given what the user has said."""
    return bool(
        (time_s or "ExposureTime" in tags)
        and (iso or _tagged_iso(tags))
        and (f_number or "FNumber" in tags)
    )


def _tags(path: Path) -> dict[str, Any]:
    """EXIF metadata, a number or text a tag; empty where the file has none that is known.

    Tags of the maker's own are named "MakerNote ...".
    """
    import logging

    import exifread

    logging.getLogger("exifread").setLevel(logging.CRITICAL)  # what is no EXIF is not news here
    with path.open("rb") as file:
        try:
            read = exifread.process_file(file, extract_thumbnail=False)
        except (
            Exception
        ):  # of makers' notes, which are undocumented and followed wherever they lead
            read = exifread.process_file(file, details=False)
    tags = {}
    for name, tag in read.items():
        values = getattr(tag, "values", None)
        if isinstance(values, list):
            values = values[0] if values else None
        if name.startswith(("EXIF ", "Image ")):
            tags[name.split(" ", 1)[1]] = values
        elif name.startswith("MakerNote "):
            tags[name] = values
    return tags


def _positive(value: Any) -> float | None:
    """A positive number, or None for anything else."""
    try:
        value = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return value if math.isfinite(value) and value > 0 else None


def _tagged_iso(tags: Mapping[str, Any]) -> float | None:
    """None also for 65535, by which a tag of 16 bits says that it is too small."""
    iso = _positive(tags.get("ISOSpeedRatings"))
    return None if iso == 65535 else iso


def _tagged_time(tags: Mapping[str, Any], other) -> float | None:
    if "ExposureTime" in tags:
        return _positive(tags["ExposureTime"])
    # LibRaw reports 1 s, ISO 0 where a file says nothing.
    if _positive(other.iso_speed) is None and other.shutter_speed == 1.0:
        return None
    return _positive(other.shutter_speed)


def _focus_m(tags: Mapping[str, Any]) -> float | None:
    """SubjectDistance of EXIF, or of Canon's shot information, cm, or Nikon's ManualFocusDistance.

    All are 0 where it is unknown, and the largest number, or nearly, where it is infinity.
    """
    for name, unit_m, infinity in (
        ("SubjectDistance", 1.0, 1e6),
        ("MakerNote SubjectDistance", 0.01, 300.0),
        ("MakerNote ManualFocusDistance", 1.0, 1e6),
    ):
        distance = _positive(tags.get(name))
        if distance is not None:
            return distance * unit_m if distance * unit_m < infinity else math.inf
    return None


def _pixel_pitch_um(tags: Mapping[str, Any]) -> float | None:
    """From FocalPlaneXResolution and its unit (2 inch, 3 cm, 4 mm)."""
    per_unit = _positive(tags.get("FocalPlaneXResolution"))
    unit = {2: 25400.0, 3: 10000.0, 4: 1000.0}.get(tags.get("FocalPlaneResolutionUnit", 2))
    if per_unit is None or unit is None:
        return None
    pitch = unit / per_unit
    return pitch if 0.5 < pitch < 50 else None  # some cameras write nonsense here


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
        out = oiio.ImageOutput.create(_utf8(path))
        assert out is not None, f"OpenImageIO without {path.suffix}"
        if not (out.open(_utf8(path), spec) and out.write_image(pixels) and out.close()):
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

    image = oiio.ImageInput.open(_utf8(path))
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
