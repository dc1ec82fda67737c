"""XYZ to what a display is sent.

Every display is a `Display`: its white and primaries, its light without signal, how bright it may
become, and how linear light is encoded. What the eye wants of a picture (tone curve, colours
brought into the gamut) is `show`, the same for all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calibration.adaptation import D65
from calibration.errors import fault

Array = NDArray[np.float64]

_PQ = 16  # the transfer function of SMPTE ST 2084, as Rec. ITU-T H.273 numbers it
SHOULDER = 0.7  # of the peak: the tone curve is the identity below


@dataclass(frozen=True, eq=False)
class Display:
    """What turns XYZ into the numbers a display is sent, and back.

    name           for people
    xyz_from_rgb   (3, 3) light of the three channels, added to black; the white, linear 1 1 1,
                   has Y = 1 together with black
    encoded        linear light, relative to the white, (..., 3) in [0, peak] -> signal in [0, 1]
    decoded        the other way
    black          (3,) XYZ of no signal, in the same unit: leaking light, and the room's on the
                   screen
    white_cd_m2    luminance of the white
    peak           greatest linear value it shows, 1 unless it has room above the white
    cicp           primaries and transfer function as numbered by Rec. ITU-T H.273, for a picture's
                   header; None for a measured display
    """

    name: str
    xyz_from_rgb: Array
    encoded: Callable[[Array], Array]
    decoded: Callable[[Array], Array]
    white_cd_m2: float
    black: Array = field(default_factory=lambda: np.zeros(3))
    peak: float = 1.0
    cicp: tuple[int, int] | None = None

    @property
    def white(self) -> Array:
        """XYZ (3,) of its white, Y = 1: what `calibration.adaptation` adapts to."""
        return np.asarray(self.xyz_from_rgb.sum(axis=1) + self.black)

    @property
    def absolute(self) -> bool:
        """Whether its signal means luminance in cd/m2 (PQ), not a share of the white."""
        return self.cicp is not None and self.cicp[1] == _PQ

    @property
    def primaries(self) -> Array:
        """Chromaticities (3, 2) x, y of red, green and blue, black taken off."""
        return np.asarray(self.xyz_from_rgb[:2] / self.xyz_from_rgb.sum(axis=0)).T

    @cached_property
    def rgb_from_xyz(self) -> Array:
        return np.asarray(np.linalg.inv(self.xyz_from_rgb), np.float64)

    def linear(self, xyz) -> Array:
        """Linear RGB (..., 3) that would show XYZ (..., 3), Y = 1 at the white, in gamut or not."""
        return (np.asarray(xyz, np.float64) - self.black) @ self.rgb_from_xyz.T

    def xyz(self, signal) -> Array:
        """XYZ (..., 3), Y = 1 at the white, that a signal (..., 3) in [0, 1] shows."""
        light = self.decoded(np.asarray(signal, np.float64))
        return light @ self.xyz_from_rgb.T + self.black

    def signal(self, xyz) -> Array:
        """Signal (..., 3) in [0, 1] that shows XYZ (..., 3), Y = 1 at the white.

        The colorimetric inverse: no tone curve, and what is out of range is clipped per channel.
        """
        return self.encoded(np.clip(self.linear(xyz), 0.0, self.peak))


def show(xyz, display: Display, *, exposure=1.0) -> NDArray[np.float32]:
    """The signal 0..1 that shows a picture as well as the display can.

    xyz       (..., 3) adapted to the display's white, Y = 1 there after exposure; may exceed it,
              may be noise about 0
    exposure  factor on xyz
    returns   (..., 3) float32 in [0, 1]

    1. Colours outside the gamut, with a negative component, are mixed with the grey of the same Y
       until that component is 0; what has no light left is black.
    2. The largest component goes through the shoulder and takes the two others along, so that
       brightness is compressed and hue is not turned.
    3. The display's encoding.
    """
    xyz = np.asarray(xyz, np.float64) * exposure
    luminance = (xyz[..., 1:2] - display.black[1]) / display.xyz_from_rgb[1].sum()
    rgb = _into_gamut(display.linear(xyz), np.maximum(luminance, 0.0))
    brightest = _of_three(np.maximum, rgb)[..., None]
    scale = np.divide(
        shoulder(brightest, display.peak),
        brightest,
        out=np.ones_like(brightest),
        where=brightest > SHOULDER * display.peak,
    )
    return display.encoded(np.clip(rgb * scale, 0.0, display.peak)).astype(np.float32)


def srgb(xyz, *, exposure=1.0) -> NDArray[np.float32]:
    """Encoded sRGB 0..1 of XYZ (..., 3) that is already adapted to D65; see `show`."""
    return show(xyz, SRGB, exposure=exposure)


def shoulder(value, peak=1.0):
    """The tone curve: identity below .7 of the peak, then smoothly, with no kink, towards it."""
    knee = SHOULDER * peak
    room = peak - knee
    over = np.maximum(value - knee, 0)
    return np.minimum(value, knee) + room * (1 - np.exp(-over / room))


def auto_exposure(
    xyz, *, percentile=90.0, target=SHOULDER, display: Display | None = None
) -> float:
    """The factor that brings a percentile of a picture to a target.

    xyz         (..., 3) adapted to the display's white, as for `show`
    percentile  of the picture that is to end at `target` or below: as it stands, 90 % of a picture
                is shown without compression, and lamps and highlights share the shoulder. By the
                largest component and not by Y, or a strong red would be driven far into it
    target      relative to the display's white, not to its peak: HDR shows the same picture, with
                more room for its lamps
    display     default sRGB; its black is not looked at
    returns     factor for `show`; 1 for a picture without light
    """
    matrix = (display or SRGB).rgb_from_xyz
    brightest = _of_three(np.maximum, np.asarray(xyz, np.float64) @ matrix.T)
    level = float(np.percentile(brightest, percentile)) if brightest.size else 0.0
    return target / level if level > 0 else 1.0


# ------------------------------------------------------------------------------------- encodings


def encode(linear):
    """The transfer function of sRGB, IEC 61966-2-1, for values in [0, 1]."""
    linear = np.asarray(linear)
    return np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    )


def decode(signal):
    """The inverse of `encode`, as IEC 61966-2-1 writes it."""
    signal = np.asarray(signal)
    return np.where(
        signal <= 0.04045, signal / 12.92, ((np.maximum(signal, 0.0) + 0.055) / 1.055) ** 2.4
    )


# SMPTE ST 2084:2014, the constants as it defines them.
_PQ_M1, _PQ_M2 = 2610 / 16384, 2523 / 4096 * 128
_PQ_C1, _PQ_C2, _PQ_C3 = 3424 / 4096, 2413 / 4096 * 32, 2392 / 4096 * 32
PQ_FULL_CD_M2 = 10000.0


def encode_pq(cd_m2):
    """The inverse EOTF of SMPTE ST 2084: absolute luminance 0..10000 cd/m2 to signal 0..1."""
    power = (np.maximum(cd_m2, 0.0) / PQ_FULL_CD_M2) ** _PQ_M1
    return ((_PQ_C1 + _PQ_C2 * power) / (1.0 + _PQ_C3 * power)) ** _PQ_M2


def decode_pq(signal):
    """The EOTF of SMPTE ST 2084: signal 0..1 to absolute luminance, cd/m2."""
    root = np.asarray(signal, np.float64) ** (1 / _PQ_M2)
    power = np.maximum(root - _PQ_C1, 0.0) / (_PQ_C2 - _PQ_C3 * root)
    return PQ_FULL_CD_M2 * power ** (1 / _PQ_M1)


# -------------------------------------------------------------------------------- named displays


def _additive(primaries, white=D65) -> Array:
    """xyz_from_rgb (3, 3) of primaries (3, 2) x, y that add up to a white, Y = 1.

    Made from the chromaticities rather than from a standard's rounded table, so that the white
    gives 1, 1, 1.
    """
    primaries = np.asarray(primaries, np.float64)
    xyz = np.concatenate([primaries, 1 - primaries.sum(axis=1, keepdims=True)], axis=1).T
    return xyz * np.linalg.solve(xyz, white)


def rec2020_pq(white_cd_m2: float = 203.0, peak_cd_m2: float = 1000.0) -> Display:
    """Rec. ITU-R BT.2020 primaries in PQ: a signal that means absolute luminance.

    white_cd_m2  of the picture's white: 203 is the reference white of Report ITU-R BT.2408
    peak_cd_m2   of the display it is made for; 1000 is common. Lamps are compressed towards it
    """
    assert 0.0 < white_cd_m2 <= peak_cd_m2 <= PQ_FULL_CD_M2
    return Display(
        "Rec.2020 PQ",
        _additive([[0.708, 0.292], [0.170, 0.797], [0.131, 0.046]]),
        encoded=lambda linear: encode_pq(linear * white_cd_m2),
        decoded=lambda signal: decode_pq(signal) / white_cd_m2,
        white_cd_m2=white_cd_m2,
        peak=peak_cd_m2 / white_cd_m2,
        cicp=(9, _PQ),
    )


# IEC 61966-2-1; its reference display has 80 cd/m2.
SRGB = Display(
    "sRGB",
    _additive([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]]),
    encode,
    decode,
    white_cd_m2=80.0,
    cicp=(1, 13),
)
# The primaries of SMPTE RP 431-2 with D65 and sRGB's encoding, as Apple defines Display P3.
DISPLAY_P3 = Display(
    "Display P3",
    _additive([[0.680, 0.320], [0.265, 0.690], [0.150, 0.060]]),
    encode,
    decode,
    white_cd_m2=80.0,
    cicp=(12, 13),
)
REC2020_PQ = rec2020_pq()

DISPLAYS = {"srgb": SRGB, "display-p3": DISPLAY_P3, "rec2020-pq": REC2020_PQ}


def named(name: str) -> Display:
    """One of DISPLAYS; InputError for another name."""
    if name not in DISPLAYS:
        raise fault(
            f"no display is called {name!r}",
            f"{', '.join(DISPLAYS)}, or a CSV of measurements",
            "name one",
        )
    return DISPLAYS[name]


def _into_gamut(rgb, grey):
    """Mixed with grey (..., 1) of the same Y so far that no component is negative."""
    least = _of_three(np.minimum, rgb)[..., None]
    kept = np.divide(grey, grey - least, out=np.ones_like(grey), where=least < 0)
    return grey + kept * (rgb - grey)


def _of_three(largest_or_least, rgb):
    """np.maximum or np.minimum of three channels (..., 3): ten times as fast as along the axis."""
    return largest_or_least(largest_or_least(rgb[..., 0], rgb[..., 1]), rgb[..., 2])
