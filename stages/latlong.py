"""The cubemap as a latitude-longitude image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages import cube
from stages.types import Measured


def directions(height: int) -> NDArray[np.float64]:
    """World directions (height, 2 height, 3) of a latlong image's pixel centres.

    Row 0 looks at +Y, the centre column at -Z, and +X lies right of the centre.
    """
    polar = (np.arange(height) + 0.5) * (np.pi / height)
    azimuth = (np.arange(2 * height) + 0.5) * (np.pi / height) - np.pi
    sin = np.sin(polar)[:, None]
    return np.stack(
        [
            sin * np.sin(azimuth),
            np.broadcast_to(np.cos(polar)[:, None], (height, 2 * height)),
            -sin * np.cos(azimuth),
        ],
        axis=-1,
    )


def latlong(measured: Measured, height: int) -> Measured:
    """A cubemap resampled to latitude and longitude, bilinear between texel centres.

    measured  (6, N, N, C)
    height    rows of the result; 2 N keeps the cube's resolution at the equator
    returns   (height, 2 height, C); NaN with valid 0 wherever a texel it needs is unknown
    """
    # py360convert is not used here: it puts samples on the image's edges, half a pixel off, and
    # rounds positions to 1/32 texel. A test holds the two together where they agree.
    d = directions(height)
    values = cube.sample(measured.values, d)
    variance = cube.sample(measured.variance, d)
    valid = cube.sample(measured.valid[..., None], d)[..., 0]
    return Measured(values, variance, np.where(np.isnan(values[..., 0]), 0, valid).astype("f4"))
