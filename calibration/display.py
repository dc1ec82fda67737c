"""XYZ to what a display is sent."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibration.adaptation import D65

# Linear sRGB from XYZ, IEC 61966-2-1: made from its primaries and white rather than from its
# rounded table, so that D65 gives 1, 1, 1.
_PRIMARIES = np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]])

SHOULDER = 0.7  # the tone curve is the identity below


def srgb(xyz, *, exposure=1.0) -> NDArray[np.float32]:
    """Encoded sRGB 0..1 of XYZ that is already adapted to D65.

    xyz       (..., 3), Y = 1 at the display's white after exposure; may exceed it, may be noise
              about 0
    exposure  factor on xyz
    returns   (..., 3) float32 in [0, 1]

    1. Colours outside the gamut, with a negative component, are mixed with the grey of the same Y
       until that component is 0; what has no light left is black.
    2. The largest component goes through the shoulder and takes the two others along, so that
       brightness is compressed and hue is not turned.
    3. The encoding of IEC 61966-2-1.
    """
    rgb = (np.asarray(xyz, np.float64) * exposure) @ _rgb_from_xyz().T
    rgb = _into_gamut(rgb, np.maximum(np.asarray(xyz, np.float64)[..., 1:2] * exposure, 0))
    brightest = rgb.max(axis=-1, keepdims=True)
    scale = np.divide(
        shoulder(brightest), brightest, out=np.ones_like(brightest), where=brightest > SHOULDER
    )
    return encode(np.clip(rgb * scale, 0, 1)).astype(np.float32)


def shoulder(value):
    """The tone curve: identity below .7, then smoothly, with no kink, towards 1."""
    room = 1 - SHOULDER
    over = np.maximum(value - SHOULDER, 0)
    return np.minimum(value, SHOULDER) + room * (1 - np.exp(-over / room))


def encode(linear):
    """The transfer function of sRGB, IEC 61966-2-1, for values in [0, 1]."""
    linear = np.asarray(linear)
    return np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    )


def auto_exposure(xyz, *, percentile=90.0, target=SHOULDER) -> float:
    """The factor that brings a percentile of a picture to a target.

    xyz         (..., 3) adapted to D65, as for `srgb`
    percentile  of the picture that is to end at `target` or below: as it stands, 90 % of a picture
                is shown without compression, and lamps and highlights share the shoulder. By the
                largest component and not by Y, or a strong red would be driven far into it
    returns     factor for `srgb`; 1 for a picture without light
    """
    brightest = (np.asarray(xyz, np.float64) @ _rgb_from_xyz().T).max(axis=-1)
    level = float(np.percentile(brightest, percentile))
    return target / level if level > 0 else 1.0


def _rgb_from_xyz():
    xyz = np.concatenate([_PRIMARIES, 1 - _PRIMARIES.sum(axis=1, keepdims=True)], axis=1).T
    return np.linalg.inv(xyz * np.linalg.solve(xyz, D65))


def _into_gamut(rgb, grey):
    """Mixed with grey (..., 1) of the same Y so far that no component is negative."""
    least = rgb.min(axis=-1, keepdims=True)
    kept = np.divide(grey, grey - least, out=np.ones_like(grey), where=least < 0)
    return grey + kept * (rgb - grey)
