"""The ICC profile of a display: by it another program shows its pictures in their true colours.

No library this project depends on makes one of given primaries and curves, and the smallest kind,
three primaries and three curves, is a table of numbers: ICC.1:2022 (profile version 4.4), whose
sections are named below.
"""

from __future__ import annotations

import struct
from itertools import accumulate

import numpy as np

from calibration import display as displays
from calibration.display import Array, Display

# The profile connection space' white, section 7.2.16.
D50 = np.array([0.9642, 1.0, 0.8249])
# The cones in which profiles adapt, annex E: K. M. Lam's Bradford transform, linear.
_BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)
_CURVE_STEPS = 1024  # of a measured curve: four to an 8-bit step


def profile(display: Display) -> bytes:
    """The display as an ICC profile: matrix and curves, class `mntr`, XYZ.

    display  whose signal is a share of its white; absolute luminance, as PQ means it, no profile
             of this kind says
    returns  the file; equal displays give equal bytes

    Light without signal has no place of its own in such a profile. It is shared out to the
    curves, which then begin above 0: M (rgb + M^-1 black) is M rgb + black, the same to a rounding
    where black is a colour the primaries can mix; a channel it would need less than none of
    begins at 0.
    """
    assert not display.absolute, display.name
    adapted = _to_d50(display.white)
    black = np.maximum(display.rgb_from_xyz @ display.black, 0.0)
    colorants = adapted @ display.xyz_from_rgb * (1.0 + black)
    curves = _curves(display, black)
    tags = {
        b"desc": _text(display.name),
        b"cprt": _text("No copyright, use freely"),
        b"wtpt": _xyz(D50),
        b"chad": b"sf32\0\0\0\0" + _fixed(adapted),
    }
    for letter, colorant, curve in zip("rgb", colorants.T, curves, strict=True):
        tags[f"{letter}XYZ".encode()] = _xyz(colorant)
        tags[f"{letter}TRC".encode()] = curve
    return _file(tags)


def _to_d50(white) -> Array:
    """The matrix (3, 3) from the display's white to D50, annex E."""
    gain = (_BRADFORD @ D50) / (_BRADFORD @ white)
    return np.linalg.solve(_BRADFORD, gain[:, None] * _BRADFORD)


def _curves(display: Display, black) -> list[bytes]:
    """Signal to linear light of each channel, as tags."""
    if display.decoded is displays.decode and not black.any():
        # Section 10.18, function type 3: (a x + b)^g from d on, c x below.
        numbers = [2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045]
        return [b"para\0\0\0\0" + struct.pack(">HH", 3, 0) + _fixed(numbers)] * 3
    ramp = np.linspace(0.0, 1.0, _CURVE_STEPS)[:, None].repeat(3, axis=1)
    light = (display.decoded(ramp) + black) / (1.0 + black)
    steps = np.rint(np.clip(light, 0.0, 1.0) * 65535).astype(">u2")
    return [b"curv\0\0\0\0" + struct.pack(">I", _CURVE_STEPS) + c.tobytes() for c in steps.T]


def _file(tags: dict[bytes, bytes]) -> bytes:
    """Header, table and tags, sections 7.2 to 7.4; tags of equal content share their place."""
    contents = list(dict.fromkeys(tags.values()))
    padded = [content + bytes(-len(content) % 4) for content in contents]
    first = 128 + 4 + 12 * len(tags)
    starts = dict(zip(contents, accumulate(map(len, padded), initial=first), strict=False))
    table = b"".join(
        name + struct.pack(">II", starts[content], len(content)) for name, content in tags.items()
    )
    header = b"".join(
        [
            struct.pack(">I", first + sum(map(len, padded))),
            bytes(4),  # no preferred colour engine
            struct.pack(">I", 0x04400000),  # version 4.4
            b"mntrRGB XYZ ",
            struct.pack(">6H", 2022, 5, 1, 0, 0, 0),  # of the specification: no clock is read
            b"acsp",
            bytes(24),  # platform, flags, manufacturer, model, attributes
            struct.pack(">I", 1),  # media-relative colorimetric
            _fixed(D50),
        ]
    )
    return header.ljust(128, b"\0") + struct.pack(">I", len(tags)) + table + b"".join(padded)


def _fixed(numbers) -> bytes:
    """s15Fixed16Number, section 4.6."""
    return np.rint(np.ravel(numbers) * 65536).astype(">i4").tobytes()


def _xyz(xyz) -> bytes:
    return b"XYZ \0\0\0\0" + _fixed(xyz)


def _text(text: str) -> bytes:
    """multiLocalizedUnicodeType, section 10.15, in one language."""
    letters = text.encode("utf-16-be")
    return (
        b"mluc\0\0\0\0" + struct.pack(">II2s2sII", 1, 12, b"en", b"US", len(letters), 28) + letters
    )
