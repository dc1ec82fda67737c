"""What noise in the camera's bands becomes in primaries, in XYZ and in dE, covariance included.

A matrix makes one band's noise appear in every primary, with signs that partly cancel where the
primaries are summed to XYZ: their variances alone would overstate or understate it. So what is
carried is the bands' variance, and it goes through all the matrices at once.

Everything is to first order ("Guide to the expression of uncertainty in measurement", JCGM
100:2008, 5.2, F.1.2.3): good while noise is small beside the signal.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibration.adaptation import CONES_FROM_XYZ, D65
from calibration.slopes import delta_e_2000_slopes, lab_slopes


def of_primaries(variances, matrix, divisor=1.0) -> NDArray[np.float64]:
    """Covariance (..., P, P) of primaries: M V M' / (r r').

    variances  (..., B) of the camera's bands, whose noise is independent
    matrix     (P, B) M_S or M_R, or (..., P, B) one for each
    divisor    (..., P) what the primaries are divided by afterwards, such as the sphere's
               reflectance; 1: nothing
    """
    m = np.asarray(matrix, np.float64)
    m = m / np.atleast_1d(np.asarray(divisor, np.float64))[..., :, None]
    v = np.asarray(variances, np.float64)[..., None, :]
    result: NDArray[np.float64] = (m * v) @ np.swapaxes(m, -1, -2)
    return result


def of_sum(covariances, weights) -> NDArray[np.float64]:
    """Covariance (K, P, P) of weighted sums of lights that are independent of each other.

    covariances  (n, P, P)
    weights      (K, n), such as cosine times solid angle over pi for the light on a surface, one
                 row a surface; (n,) gives (P, P)
    """
    n, p, _ = np.shape(covariances)
    squares = np.asarray(weights, np.float64) ** 2
    summed: NDArray[np.float64] = squares @ np.reshape(covariances, (n, p * p))
    return summed.reshape(*squares.shape[:-1], p, p)


def of_xyz(covariance, xyz_from_primaries, surface=1.0) -> NDArray[np.float64]:
    """Covariance (..., 3, 3) of XYZ of light on a surface.

    covariance          (..., P, P) of the light in the primaries
    xyz_from_primaries  (3, P)
    surface             (P,) its reflectance, which counts as exactly known; 1: a perfect white
    """
    m = np.asarray(xyz_from_primaries, np.float64) * np.asarray(surface, np.float64)
    result: NDArray[np.float64] = m @ covariance @ m.T
    return result


def delta_e(xyz, covariance, white) -> NDArray[np.float64]:
    """Root of the expected square of CIEDE2000 (...) that noise alone makes.

    xyz         (..., 3) the colour
    covariance  (..., 3, 3) of it
    white       (..., 3) or (3,) what the eye is adapted to, fully, as everywhere here: CAT02 to
                D65; it sets the lightness too
    returns     NaN where the white is no light's colour, or the colour not known
    """
    to_d65 = _to_d65(white)
    lab, by_xyz = lab_slopes(np.einsum("...ij,...j->...i", to_d65, np.asarray(xyz, np.float64)))
    _, by_lab = delta_e_2000_slopes(lab, lab)
    return _rms(by_lab @ by_xyz @ to_d65, covariance)


def white_delta_e(xyz, covariance) -> NDArray[np.float64]:
    """`delta_e` (...) of a white under its own light, whose error is the light's.

    xyz         (..., 3) the light, and the white under it
    covariance  (..., 3, 3) of it

    The eye is adapted to the light as it is, so the white is (100, 0, 0) in CIELAB and what noise
    leaves of that is seen in full: in lightness, and in a cast over the whole picture.
    """
    lab, by_xyz = lab_slopes(D65)
    _, by_lab = delta_e_2000_slopes(lab, lab)
    return _rms(by_lab @ by_xyz @ _to_d65(xyz), covariance)


def _to_d65(white) -> NDArray[np.float64]:
    """CAT02 (..., 3, 3) from whites (..., 3) to D65, and their Y to 1; NaN for what is no light."""
    cones_from_xyz = CONES_FROM_XYZ["cat02"]
    cones = np.asarray(white, np.float64) @ cones_from_xyz.T
    gain = (cones_from_xyz @ D65) / np.where(cones > 0.0, cones, np.nan)
    result: NDArray[np.float64] = np.linalg.inv(cones_from_xyz) @ (
        gain[..., :, None] * cones_from_xyz
    )
    return result


def _rms(slopes, covariance) -> NDArray[np.float64]:
    """Root of the trace of J C J' (...): the expected square of a difference of three parts."""
    square: NDArray[np.float64] = ((slopes @ covariance) * slopes).sum(axis=(-2, -1))
    return np.sqrt(square)
