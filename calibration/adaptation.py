"""Chromatic adaptation: the colours that look the same under another white."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# CIE 1931 2 degree XYZ of D65, Y = 1, from its chromaticity x = .3127, y = .3290.
D65 = np.array([0.3127 / 0.3290, 1.0, (1 - 0.3127 - 0.3290) / 0.3290])

# N. Moroney and others, "The CIECAM02 Color Appearance Model" (2002).
_CAT02 = np.array([[0.7328, 0.4296, -0.1624], [-0.7036, 1.6975, 0.0061], [0.0030, 0.0136, 0.9834]])


def cat02(xyz_white_from, xyz_white_to) -> NDArray[np.float64]:
    """The matrix (3, 3) that takes XYZ seen under one white to what looks the same under another.

    xyz_white_from, xyz_white_to  (3,) XYZ of the whites; only their chromaticity counts
    returns                       (3, 3); adaptation is complete, a white's Y stays as it is
    """
    cone_from, cone_to = (
        _CAT02 @ (np.asarray(white, float) / white[1]) for white in (xyz_white_from, xyz_white_to)
    )
    return np.linalg.solve(_CAT02, np.diag(cone_to / cone_from) @ _CAT02)
