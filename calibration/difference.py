"""How different two colours look: CIELAB and CIEDE2000, in plain numpy.

The formula: G. Sharma, W. Wu, E. N. Dalal, "The CIEDE2000 color-difference formula:
implementation notes, supplementary test data, and mathematical observations", Color Research and
Application 30(1), 2005, with k_L = k_C = k_H = 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibration.adaptation import D65


def lab(xyz, white=D65) -> NDArray[np.float64]:
    """CIELAB (..., 3) of tristimulus values.

    xyz    (..., 3), in the scale of the white; may be a little negative
    white  (..., 3), what has L* = 100
    """
    f = _compressed(np.asarray(xyz, np.float64) / np.asarray(white, np.float64))
    fx, fy, fz = f[..., 0], f[..., 1], f[..., 2]
    return np.stack([116.0 * fy - 16.0, 500.0 * (fx - fy), 200.0 * (fy - fz)], axis=-1)


def _compressed(t):
    """The cube root, and its tangent line below (6/29)^3 (CIE 15:2004)."""
    edge = 6.0 / 29.0
    return np.where(t > edge**3, np.cbrt(t), t / (3.0 * edge**2) + 4.0 / 29.0)


def delta_e_2000(lab_1, lab_2) -> NDArray[np.float64]:
    """CIEDE2000 (...) between CIELAB colours (..., 3)."""
    return np.sqrt(np.sum(delta_e_2000_parts(lab_1, lab_2) ** 2, axis=-1))


def delta_e_2000_parts(lab_1, lab_2) -> NDArray[np.float64]:
    """CIEDE2000 as three parts (..., 3) whose squares add up to its square.

    The formula's last term R_T (dC/S_C)(dH/S_H) is completed to squares: lightness dL/S_L,
    chroma dC/S_C + R_T/2 dH/S_H, hue sqrt(1 - R_T^2/4) dH/S_H. They are signed and smooth
    through 0, where the difference itself has a kink, so least-squares solvers want them.
    """
    l1, a1, b1 = np.moveaxis(np.asarray(lab_1, np.float64), -1, 0)
    l2, a2, b2 = np.moveaxis(np.asarray(lab_2, np.float64), -1, 0)
    c_mean = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2.0
    g = 1.0 + 0.5 * (1.0 - _sigmoid_7(c_mean))  # stretches a* near grey
    c1, h1 = np.hypot(g * a1, b1), np.arctan2(b1, g * a1)
    c2, h2 = np.hypot(g * a2, b2), np.arctan2(b2, g * a2)

    hue_step = np.mod(h2 - h1 + np.pi, 2.0 * np.pi) - np.pi
    hue_step = np.where(c1 * c2 == 0.0, 0.0, hue_step)  # grey has no hue
    d_hue = 2.0 * np.sqrt(c1 * c2) * np.sin(hue_step / 2.0)
    # The mean hue lies half-way along the shorter arc; of a grey and a colour, the colour's.
    turn = 2.0 * np.pi
    h_mean = np.where(c1 * c2 == 0.0, h1 + h2, h1 + hue_step / 2.0) % turn

    l_mean, c_mean = (l1 + l2) / 2.0, (c1 + c2) / 2.0
    t = (
        1.0
        - 0.17 * np.cos(h_mean - np.radians(30.0))
        + 0.24 * np.cos(2.0 * h_mean)
        + 0.32 * np.cos(3.0 * h_mean + np.radians(6.0))
        - 0.20 * np.cos(4.0 * h_mean - np.radians(63.0))
    )
    s_l = 1.0 + 0.015 * (l_mean - 50.0) ** 2 / np.sqrt(20.0 + (l_mean - 50.0) ** 2)
    s_c = 1.0 + 0.045 * c_mean
    s_h = 1.0 + 0.015 * c_mean * t
    blue = np.exp(-(((np.degrees(h_mean) - 275.0) / 25.0) ** 2))
    r_t = -2.0 * _sigmoid_7(c_mean) * np.sin(np.radians(60.0) * blue)

    lightness, chroma, hue = (l2 - l1) / s_l, (c2 - c1) / s_c, d_hue / s_h
    return np.stack(
        [lightness, chroma + r_t / 2.0 * hue, np.sqrt(1.0 - (r_t / 2.0) ** 2) * hue], axis=-1
    )


def _sigmoid_7(chroma):
    """The formula's sqrt(C^7 / (C^7 + 25^7))."""
    c7 = chroma**7
    return np.sqrt(c7 / (c7 + 25.0**7))
