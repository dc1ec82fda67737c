"""The slopes of CIELAB and CIEDE2000: what least squares follows downhill.

The same formulas as in `calibration.difference`, differentiated by hand, and checked against it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibration.adaptation import D65


def lab_slopes(xyz) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """CIELAB under D65 (..., 3) of XYZ (..., 3), and its slopes d Lab / d XYZ (..., 3, 3)."""
    t = np.asarray(xyz, np.float64) / D65
    edge = 6.0 / 29.0
    root = np.cbrt(t)
    curved = t > edge**3
    f = np.where(curved, root, t / (3.0 * edge**2) + 4.0 / 29.0)
    # The slope of a cube root is 1/3 of the root's inverse square; divided by the white, as t is.
    df = np.where(curved, 1.0 / (3.0 * np.where(curved, root, 1.0) ** 2), 1.0 / (3.0 * edge**2))
    df = df / D65
    slopes = np.zeros((*t.shape, 3))
    slopes[..., 0, 1] = 116.0 * df[..., 1]
    slopes[..., 1, 0] = 500.0 * df[..., 0]
    slopes[..., 1, 1] = -500.0 * df[..., 1]
    slopes[..., 2, 1] = 200.0 * df[..., 1]
    slopes[..., 2, 2] = -200.0 * df[..., 2]
    fx, fy, fz = f[..., 0], f[..., 1], f[..., 2]
    return np.stack([116.0 * fy - 16.0, 500.0 * (fx - fy), 200.0 * (fy - fz)], axis=-1), slopes


def delta_e_2000_slopes(lab_1, lab_2) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """CIEDE2000's three parts (..., 3) and their slopes d parts / d lab_2 (..., 3, 3).

    The parts are those of `difference.delta_e_2000_parts`, but where lab_1 is grey: there chroma
    and hue give way to a* and b*, whose squares have the same sum and which have slopes at zero.
    """
    l1, a1, b1 = np.moveaxis(np.asarray(lab_1, np.float64), -1, 0)
    l2, a2, b2 = np.moveaxis(np.asarray(lab_2, np.float64), -1, 0)
    shape = np.broadcast_shapes(l1.shape, l2.shape)

    # In what follows `x_a`, `x_b` are the slopes of x by a2 and b2.
    plain_1 = np.hypot(a1, b1)
    plain_2, plain_2_a, plain_2_b = _radius(a2, b2)
    sigma, sigma_slope = _sigmoid_7((plain_1 + plain_2) / 2.0)
    g = 1.5 - 0.5 * sigma
    g_by_chroma = -0.25 * sigma_slope  # by plain_2, of which the mean has half
    g_a, g_b = g_by_chroma * plain_2_a, g_by_chroma * plain_2_b

    stretched_1, stretched_2 = g * a1, g * a2
    c1, c1_s, c1_y = _radius(stretched_1, b1)
    c2, c2_s, c2_y = _radius(stretched_2, b2)
    stretched_2_a, stretched_2_b = g + a2 * g_a, a2 * g_b
    c1_a, c1_b = c1_s * a1 * g_a, c1_s * a1 * g_b
    c2_a, c2_b = c2_s * stretched_2_a, c2_s * stretched_2_b + c2_y
    # A hue is the direction of (stretched a*, b*); its slopes are across that, over the radius.
    h1, h2 = np.arctan2(b1, stretched_1), np.arctan2(b2, stretched_2)
    h1_a, h1_b = -c1_y / c1 * a1 * g_a, -c1_y / c1 * a1 * g_b
    h2_a = -c2_y / c2 * stretched_2_a
    h2_b = (c2_s - c2_y * stretched_2_b) / c2

    grey = plain_1 < 1e-6
    step = np.mod(h2 - h1 + np.pi, 2.0 * np.pi) - np.pi
    mean_h = np.where(grey, h2, h1 + step / 2.0) % (2.0 * np.pi)
    mean_h_a = np.where(grey, h2_a, (h1_a + h2_a) / 2.0)
    mean_h_b = np.where(grey, h2_b, (h1_b + h2_b) / 2.0)
    mean_c, mean_c_a, mean_c_b = (c1 + c2) / 2.0, (c1_a + c2_a) / 2.0, (c1_b + c2_b) / 2.0

    root = np.sqrt(c1 * c2)
    sine, cosine = np.sin(step / 2.0), np.cos(step / 2.0)
    d_hue = 2.0 * root * sine
    d_hue_a = sine / root * (c1_a * c2 + c1 * c2_a) + root * cosine * (h2_a - h1_a)
    d_hue_b = sine / root * (c1_b * c2 + c1 * c2_b) + root * cosine * (h2_b - h1_b)

    mean_l = (l1 + l2) / 2.0 - 50.0
    under = 20.0 + mean_l**2
    s_l = 1.0 + 0.015 * mean_l**2 / np.sqrt(under)
    s_l_slope = 0.0075 * (2.0 * mean_l / np.sqrt(under) - mean_l**3 / under**1.5)
    lightness = (l2 - l1) / s_l

    s_c = 1.0 + 0.045 * mean_c
    t, t_slope = _hue_weight(mean_h)
    s_h = 1.0 + 0.015 * mean_c * t
    s_h_a = 0.015 * (mean_c_a * t + mean_c * t_slope * mean_h_a)
    s_h_b = 0.015 * (mean_c_b * t + mean_c * t_slope * mean_h_b)
    hue = d_hue / s_h
    hue_a, hue_b = (d_hue_a - hue * s_h_a) / s_h, (d_hue_b - hue * s_h_b) / s_h
    chroma = (c2 - c1) / s_c
    chroma_a = (c2_a - c1_a - 0.045 * chroma * mean_c_a) / s_c
    chroma_b = (c2_b - c1_b - 0.045 * chroma * mean_c_b) / s_c

    half, half_c, half_h = _half_rotation(mean_c, mean_h)
    half_a, half_b = half_c * mean_c_a + half_h * mean_h_a, half_c * mean_c_b + half_h * mean_h_b
    rest = np.sqrt(1.0 - half**2)

    parts = np.empty((*shape, 3))
    slopes = np.zeros((*shape, 3, 3))
    parts[..., 0] = lightness
    slopes[..., 0, 0] = (1.0 - lightness * s_l_slope) / s_l
    parts[..., 1] = np.where(grey, stretched_2 / s_c, chroma + half * hue)
    parts[..., 2] = np.where(grey, b2 / s_c, rest * hue)
    slopes[..., 1, 1] = np.where(
        grey,
        (stretched_2_a - 0.045 * stretched_2 / s_c * mean_c_a) / s_c,
        chroma_a + half_a * hue + half * hue_a,
    )
    slopes[..., 1, 2] = np.where(
        grey,
        (stretched_2_b - 0.045 * stretched_2 / s_c * mean_c_b) / s_c,
        chroma_b + half_b * hue + half * hue_b,
    )
    slopes[..., 2, 1] = np.where(
        grey, -0.045 * b2 / s_c * mean_c_a / s_c, rest * hue_a - half / rest * half_a * hue
    )
    slopes[..., 2, 2] = np.where(
        grey,
        (1.0 - 0.045 * b2 / s_c * mean_c_b) / s_c,
        rest * hue_b - half / rest * half_b * hue,
    )
    return parts, slopes


def _radius(x, y):
    """A vector's length, kept off zero, and its slopes by x and y."""
    length = np.maximum(np.hypot(x, y), 1e-12)
    return length, x / length, y / length


def _sigmoid_7(chroma):
    """sqrt(C^7 / (C^7 + 25^7)) and its slope."""
    ratio = chroma**7 / (chroma**7 + 25.0**7)
    value = np.sqrt(ratio)
    return value, 3.5 * value * (1.0 - ratio) / np.maximum(chroma, 1e-12)


def _hue_weight(h):
    """The formula's T and its slope."""
    value, slope = 1.0, 0.0
    for amount, times, degrees in (
        (-0.17, 1.0, -30.0),
        (0.24, 2.0, 0.0),
        (0.32, 3.0, 6.0),
        (-0.20, 4.0, -63.0),
    ):
        angle = times * h + np.radians(degrees)
        value = value + amount * np.cos(angle)
        slope = slope - amount * times * np.sin(angle)
    return value, slope


def _half_rotation(c, h):
    """R_T / 2 and its slopes by mean chroma and mean hue."""
    sigma, sigma_slope = _sigmoid_7(c)
    from_blue = (np.degrees(h) - 275.0) / 25.0
    angle = np.radians(60.0) * np.exp(-(from_blue**2))
    angle_h = angle * -2.0 * from_blue * (180.0 / np.pi / 25.0)
    return -sigma * np.sin(angle), -sigma_slope * np.sin(angle), -sigma * np.cos(angle) * angle_h
