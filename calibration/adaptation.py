"""Chromatic adaptation: the colours that look the same under another white."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibration.errors import fault

# CIE 1931 2 degree XYZ of D65, Y = 1, from its chromaticity x = .3127, y = .3290.
D65 = np.array([0.3127 / 0.3290, 1.0, (1 - 0.3127 - 0.3290) / 0.3290])

WHITES = {
    "A": (0.44758, 0.40745),
    "C": (0.31006, 0.31616),
    "D50": (0.34567, 0.35851),
    "D55": (0.33243, 0.34744),
    "D65": (0.3127, 0.3290),
    "D75": (0.29903, 0.31488),
    "E": (1 / 3, 1 / 3),
    "F2": (0.3721, 0.3751),
    "F11": (0.3805, 0.3769),
}
"""Chromaticities x, y of named whites, CIE 15:2004, 2 degree observer (D65 as sRGB rounds it)."""

METHODS = ("cat02", "cat16")

CONES_FROM_XYZ = {
    # N. Moroney and others, "The CIECAM02 Color Appearance Model" (2002).
    "cat02": np.array(
        [[0.7328, 0.4296, -0.1624], [-0.7036, 1.6975, 0.0061], [0.0030, 0.0136, 0.9834]]
    ),
    # C. Li and others, "Comprehensive color solutions: CAM16, CAT16, and CAM16-UCS" (2017).
    "cat16": np.array(
        [
            [0.401288, 0.650173, -0.051461],
            [-0.250268, 1.204414, 0.045854],
            [-0.002079, 0.048952, 0.953127],
        ]
    ),
}


def adapt(
    xyz_white_from, xyz_white_to, method: str | None = "cat02", *, degree: float = 1.0
) -> NDArray[np.float64]:
    """The matrix (3, 3) that takes XYZ seen under one white to what looks the same under another.

    xyz_white_from, xyz_white_to  (3,) XYZ of the whites; only their chromaticity counts
    method   "cat02", "cat16", or None for an eye that does not adapt: the identity
    degree   0..1, how far the eye has adapted to the first white; 1 is completely, and a white
             then goes to the white. CIECAM02 puts 1 at a bright surround and about .9 in a dim one
    returns  (3, 3); a white's Y stays as it is
    raises   InputError for a white without positive cone responses: no light has such a colour

    Source: the von Kries rule in the space of the method, with the degree D of CIECAM02:
    a cone's gain is D white_to / white_from + 1 - D, both whites at Y = 1.
    """
    if method is None:
        return np.eye(3)
    assert method in METHODS, method
    assert 0.0 <= degree <= 1.0, degree
    cones_from_xyz = CONES_FROM_XYZ[method]
    cone_from, cone_to = (
        _white_cones(cones_from_xyz, white) for white in (xyz_white_from, xyz_white_to)
    )
    gain = degree * cone_to / cone_from + 1.0 - degree
    return np.linalg.solve(cones_from_xyz, gain[:, None] * cones_from_xyz)


def cat02(xyz_white_from, xyz_white_to) -> NDArray[np.float64]:
    """`adapt` by CAT02, completely: the matrix (3, 3) from one white to another."""
    return adapt(xyz_white_from, xyz_white_to, "cat02")


def white(name: str) -> NDArray[np.float64]:
    """XYZ (3,), Y = 1, of one of WHITES, or of a chromaticity written "x,y".

    raises  InputError for another name, or a chromaticity that is no light's
    """
    if name in WHITES:
        x, y = WHITES[name]
    else:
        try:
            x, y = map(float, name.split(","))
        except ValueError:
            raise fault(
                f"no white is called {name!r}",
                f"{', '.join(WHITES)}, or a chromaticity such as .3127,.3290",
                "name one",
            ) from None
        if not (x > 0.0 and y > 0.0 and x + y < 1.0):
            raise fault(
                f"the chromaticity {name}", "x and y above 0, below 1 together", "correct it"
            )
    return np.array([x / y, 1.0, (1.0 - x - y) / y])


def _white_cones(cones_from_xyz, xyz_white) -> NDArray[np.float64]:
    xyz = np.asarray(xyz_white, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        cones = cones_from_xyz @ (xyz / xyz[1])
    if not (xyz[1] > 0.0 and (cones > 0.0).all()):
        raise fault(
            f"an adapting white of XYZ {' '.join(f'{v:.4g}' for v in xyz)}",
            "the colour of a light",
            "measure or name another white, or adapt to none",
        )
    return cones
