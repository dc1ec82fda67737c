"""What LibRaw, and a file's own tags, say of a raw file: run by `decoding`, in a process apart."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.errors import fault
from pipeline.files import tiff


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


def recognised(path: Path) -> bool:
    """Whether LibRaw recognises the file."""
    import rawpy

    try:
        with rawpy.imread(utf8(path)):
            return True
    except (rawpy.LibRawError, OSError):
        return False


def read_shot(
    path: Path,
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


@dataclass(frozen=True)
class Samples:
    """What a raw file's samples are, wherever they went.

    size              (height, width) of the visible raw image
    shape             of what was wanted of it
    cfa, black_level, saturation_level
                      (2, 2), as in `stages.types.Frame`
    """

    size: tuple[int, int]
    shape: tuple[int, int]
    cfa: NDArray[np.int_]
    black_level: NDArray[np.float64]
    saturation_level: NDArray[np.float64]


def decode(
    path: Path, part: tuple[slice, slice] | None = None, slot: int = 0, *, file: int
) -> Samples:
    """Decodes a raw file's samples into another file; InputError where it is damaged.

    part  rows and columns of the visible raw image that are wanted; None: all
    slot  where they go: after as many of the same size
    file  descriptor of one that is open for writing; uint16, row by row
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
        visible = raw.raw_image_visible
        samples = np.ascontiguousarray(visible if part is None else visible[part])
        _write(file, samples, slot * samples.nbytes)
        return Samples(visible.shape, samples.shape, cfa, black, white)


def _write(file: int, array: NDArray, offset: int) -> None:
    data = array.data.cast("B")
    while data:
        written = os.pwrite(file, data, offset)
        data, offset = data[written:], offset + written


class _opened:  # noqa: N801 - used as a context manager, like open()
    """A raw file opened by LibRaw; its refusals become InputErrors."""

    def __init__(self, path: Path):
        self.path = path

    def __enter__(self):
        import rawpy

        try:
            self.raw = rawpy.imread(utf8(self.path))
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
        read = {}
        # Makers' notes are undocumented, and followed wherever they lead: else without them.
        for details in (True, False):
            with suppress(Exception):
                read = exifread.process_file(file, details=details, extract_thumbnail=False)
                break
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


def utf8(path: Path) -> str:
    """A path as LibRaw and OpenImageIO take it, whatever the locale; InputError where it is none.

    Python holds bytes of names that the locale has no letters for in a form of its own.
    """
    try:
        return os.fsencode(path).decode()
    except UnicodeDecodeError as error:
        raise fault("its name is not UTF-8", "a name in UTF-8", "rename it", path) from error
