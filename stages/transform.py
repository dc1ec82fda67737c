"""From the camera's bands to the rendering primaries: M_S."""

from __future__ import annotations

import numpy as np

from stages.types import Measured


def transform(bands: Measured, matrix) -> Measured:
    """Apply M_S to what the camera measured.

    bands    (..., B) camera signals of all filters, independent in their noise
    matrix   (P, B) M_S: primaries from camera bands
    returns  (..., P) light averaged over each primary, in the unit of M_S. The primaries' noise
             is correlated by M_S; the variance kept is the diagonal of its covariance

    Source: Darling et al., "Framework for Multispectral Rendering", M_S; variance by the linear
    propagation of independent errors.
    """
    matrix = np.asarray(matrix, np.float32)
    assert matrix.shape[1] == bands.values.shape[-1]
    return Measured(bands.values @ matrix.T, bands.variance @ (matrix**2).T, bands.valid)
