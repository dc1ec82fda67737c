"""What noise in the camera's bands becomes in primaries, in XYZ and in dE, covariance included.

A matrix makes one band's noise appear in every primary, with signs that partly cancel where the
primaries are summed to XYZ: their variances alone would overstate or understate it. So what is
carried is the bands' variance, and it goes through all the matrices at once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibration.adaptation import D65, cat02
from calibration.slopes import delta_e_2000_slopes, lab_slopes


def of_primaries(variances, matrix, reflectance=1.0) -> NDArray[np.float64]:
    """Covariance (..., P, P) of the primaries of light: M V M' / (r r').

    variances    (..., B) of the camera's bands, whose noise is independent
    matrix       (P, B) M_S
    reflectance  (..., P) what the primaries are divided by afterwards; 1: nothing
    """
    m = np.asarray(matrix, np.float64)
    r = np.broadcast_to(np.asarray(reflectance, np.float64), (*np.shape(variances)[:-1], len(m)))
    covariance: NDArray[np.float64] = np.einsum(
        "pb,...b,qb->...pq", m, np.asarray(variances, np.float64), m
    )
    return covariance / (r[..., :, None] * r[..., None, :])


def of_sum(covariances, weights) -> NDArray[np.float64]:
    """Covariance (P, P) of a weighted sum of independent lights, as of a patch's irradiance.

    covariances  (n, P, P)
    weights      (n,), such as cosine times solid angle over pi
    """
    summed: NDArray[np.float64] = np.tensordot(np.asarray(weights, np.float64) ** 2, covariances, 1)
    return summed


def of_xyz(covariance, xyz_from_primaries, surface=1.0) -> NDArray[np.float64]:
    """Covariance (..., 3, 3) of XYZ of light on a surface (P,) of that reflectance."""
    m = np.asarray(xyz_from_primaries, np.float64) * np.asarray(surface, np.float64)
    result: NDArray[np.float64] = m @ covariance @ m.T
    return result


def delta_e(xyz, covariance, white) -> NDArray[np.float64]:
    """Root of the expected square of CIEDE2000 (...) that noise alone makes, to first order.

    xyz         (..., 3) the colour
    covariance  (..., 3, 3) of it
    white       (3,) what the eye is adapted to, fully, as everywhere here: CAT02 to D65
    """
    to_d65 = cat02(white, D65) / white[1]
    lab, by_xyz = lab_slopes(np.asarray(xyz, np.float64) @ to_d65.T)
    _, by_lab = delta_e_2000_slopes(lab, lab)
    slopes = by_lab @ by_xyz @ to_d65
    square: NDArray[np.float64] = np.einsum("...ki,...ij,...kj->...", slopes, covariance, slopes)
    return np.sqrt(square)
