"""A world without symmetry, and what programs show of it: six pictures from its middle."""

from __future__ import annotations

import numpy as np

VIEWS = [  # in the glTF world, right-handed with +Y up: where each looks, and what is up
    ((1, 0, 0), (0, 1, 0)),
    ((-1, 0, 0), (0, 1, 0)),
    ((0, 1, 0), (0, 0, -1)),
    ((0, -1, 0), (0, 0, 1)),
    ((0, 0, 1), (0, 1, 0)),
    ((0, 0, -1), (0, 1, 0)),
]


def colours(d):
    """The world (..., 3) in directions (..., 3): three channels, positive."""
    x, y, z = np.moveaxis(np.asarray(d), -1, 0)
    return np.stack([2 + x + 0.3 * y * z, 2 + y - 0.4 * x * z, 2 + z + 0.5 * x * y], axis=-1)


def directions(towards, up, size):
    """Directions (size, size, 3) of a picture with a field of view of 90 degrees."""
    towards, up = np.array(towards, float), np.array(up, float)
    t = (np.arange(size) + 0.5) * 2 / size - 1
    d = towards + t[None, :, None] * np.cross(towards, up) - t[:, None, None] * up
    return d / np.linalg.norm(d, axis=-1, keepdims=True)
