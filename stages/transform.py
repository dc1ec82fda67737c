"""From the camera's bands to the rendering primaries: M_S."""

from __future__ import annotations

import numpy as np

from stages.types import Measured


def transform(bands: Measured, matrix, correlation=None) -> Measured:
    """Apply M_S to what the camera measured.

    bands    (..., B) camera signals of all filters
    matrix   (P, B) M_S: primaries from camera bands
    correlation  (B, B) of the bands' noise; None: they are independent
    returns  (..., P) light averaged over each primary, in the unit of M_S. The primaries' noise
             is correlated by M_S; the variance kept is the diagonal of its covariance

    Source: Darling et al., "Framework for Multispectral Rendering", M_S; variance by the linear
    propagation of errors.
    """
    matrix = np.asarray(matrix, np.float32)
    assert matrix.shape[1] == bands.values.shape[-1]
    variance = bands.variance @ (matrix**2).T
    if correlation is not None:
        sigma = np.sqrt(bands.variance)
        for i, j in np.argwhere(np.triu(correlation, 1)):
            both = np.float32(2.0 * correlation[i, j]) * matrix[:, i] * matrix[:, j]
            variance += (sigma[..., i] * sigma[..., j])[..., None] * both
    return Measured(bands.values @ matrix.T, variance, bands.valid)
