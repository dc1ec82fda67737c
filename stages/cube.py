"""The one authority on directions: which way each texel of a cubemap looks.

Faces are +X -X +Y -Y +Z -Z, each laid out as the table of OpenGL's cube map textures (section
8.13 of the 4.6 core specification) defines it, row 0 first: a cube uploaded as it lies in memory
gives `texture(samplerCube, d)` = the radiance that arrives *from* world direction d. The world is
right-handed with +Y up. `shaders/include/cube.glsl` says the same in GLSL.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

FACES = ("px", "nx", "py", "ny", "pz", "nz")

# Per face the vectors a, b, c of direction = a + u b + v c, with u to the right and v down
# in [-1, 1] over the face.
_FRAMES = np.array(
    [
        [(1, 0, 0), (0, 0, -1), (0, -1, 0)],
        [(-1, 0, 0), (0, 0, 1), (0, -1, 0)],
        [(0, 1, 0), (1, 0, 0), (0, 0, 1)],
        [(0, -1, 0), (1, 0, 0), (0, 0, -1)],
        [(0, 0, 1), (1, 0, 0), (0, -1, 0)],
        [(0, 0, -1), (-1, 0, 0), (0, -1, 0)],
    ],
    dtype=np.float64,
)


def texel_centres(face_size: int) -> NDArray[np.float64]:
    """Positions (N,) of texel centres along a face, in [-1, 1]."""
    return (np.arange(face_size, dtype=np.float64) + 0.5) * (2.0 / face_size) - 1.0


def face_directions(u, v) -> NDArray[np.float64]:
    """Unit directions (6, ..., 3) at the positions u, v (...,) of every face; u right, v down.

    Positions outside [-1, 1] look past the face's edge, into its neighbour.
    """
    u, v = np.broadcast_arrays(np.asarray(u, np.float64), np.asarray(v, np.float64))
    a, b, c = (_FRAMES[:, i].reshape((6,) + (1,) * u.ndim + (3,)) for i in range(3))
    d = a + u[None, ..., None] * b + v[None, ..., None] * c
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


def directions_on(face, u, v) -> NDArray[np.float64]:
    """Unit directions (..., 3) at positions u, v (...,) of the faces numbered `face` (...,)."""
    u, v = np.asarray(u, np.float64)[..., None], np.asarray(v, np.float64)[..., None]
    frame = _FRAMES[face]
    d = frame[..., 0, :] + u * frame[..., 1, :] + v * frame[..., 2, :]
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


def directions(face_size: int) -> NDArray[np.float64]:
    """Unit world directions (6, N, N, 3) of a cubemap's texel centres."""
    t = texel_centres(face_size)
    return face_directions(t[None, :], t[:, None])


def solid_angles(face_size: int) -> NDArray[np.float64]:
    """Solid angle (N, N) of each texel of a face, in sr; the same for all faces, 4 pi over six."""
    edge = np.linspace(-1.0, 1.0, face_size + 1)
    x, y = edge[None, :], edge[:, None]
    corner = np.arctan2(x * y, np.sqrt(x * x + y * y + 1.0))
    return corner[1:, 1:] - corner[:-1, 1:] - corner[1:, :-1] + corner[:-1, :-1]


def face_positions(direction) -> tuple[NDArray[np.int_], NDArray[np.float64], NDArray[np.float64]]:
    """Where directions (..., 3) of any length meet the cube: face, u right, v down, all (...,)."""
    d = np.asarray(direction, np.float64)
    axis = np.argmax(np.abs(d), axis=-1)
    major = np.take_along_axis(d, axis[..., None], axis=-1)[..., 0]
    face = 2 * axis + (major < 0)
    d = d / np.abs(major)[..., None]
    u = np.einsum("...i,...i->...", d, _FRAMES[face, 1])
    v = np.einsum("...i,...i->...", d, _FRAMES[face, 2])
    return face, u, v


def sample(cube, direction):
    """A cubemap's values in any direction: bilinear between texel centres, seamless over edges.

    cube       (6, N, N, C)
    direction  (..., 3), of any length
    returns    (..., C), in the cube's type
    """
    n = cube.shape[1]
    padded = with_border(cube)
    face, u, v = face_positions(direction)
    x = (u + 1.0) * (n / 2) + 0.5  # the border's first texel centre is at 0
    y = (v + 1.0) * (n / 2) + 0.5
    column = np.clip(np.floor(x).astype(np.intp), 0, n)
    row = np.clip(np.floor(y).astype(np.intp), 0, n)
    fx = (x - column).astype(cube.dtype)[..., None]
    fy = (y - row).astype(cube.dtype)[..., None]
    top = padded[face, row, column] * (1 - fx) + padded[face, row, column + 1] * fx
    bottom = padded[face, row + 1, column] * (1 - fx) + padded[face, row + 1, column + 1] * fx
    return top * (1 - fy) + bottom * fy


def with_border(cube):
    """The cubemap (6, N + 2, N + 2, C), each face bordered by one texel of its neighbours."""
    n = cube.shape[1]
    padded = np.empty((6, n + 2, n + 2, *cube.shape[3:]), cube.dtype)
    padded[:, 1:-1, 1:-1] = cube
    rim, beyond = _border(n)
    padded[rim] = cube[beyond]
    return padded


@cache
def _border(n: int):
    """Indices of a bordered cubemap's border texels, and of those in the cubemap they copy."""
    t = (np.arange(-1, n + 1) + 0.5) * (2.0 / n) - 1.0
    rim = np.ones((6, n + 2, n + 2), np.bool_)
    rim[:, 1:-1, 1:-1] = False
    at = np.nonzero(rim)
    face, u, v = face_positions(directions_on(at[0], t[at[2]], t[at[1]]))
    row = np.clip(((v + 1.0) * (n / 2)).astype(np.intp), 0, n - 1)
    column = np.clip(((u + 1.0) * (n / 2)).astype(np.intp), 0, n - 1)
    return at, (face, row, column)


def blurred(cube, sigma: float):
    """The cubemap (6, N, N, C) blurred by about a Gaussian of `sigma` texels, across edges too.

    Wide ones are done on fewer texels, as nothing fine is left of them.
    """
    n = cube.shape[1]
    if sigma > 3.0 and n % 2 == 0 and n > 4:
        fours = cube.reshape(6, n // 2, 2, n // 2, 2, -1).mean(axis=(2, 4))
        # The mean of four and the interpolation back have a variance of about a half together.
        return sample(blurred(fours, np.sqrt(sigma * sigma - 0.5) / 2.0), directions(n))
    passes = int(np.ceil(2.0 * sigma * sigma))
    side = cube.dtype.type(sigma * sigma / (2.0 * max(passes, 1)))
    for _ in range(passes):
        wide = with_border(cube)
        rows = wide[:, 1:-1] + side * (wide[:, :-2] - 2 * wide[:, 1:-1] + wide[:, 2:])
        middle = rows[:, :, 1:-1]
        cube = middle + side * (rows[:, :, :-2] - 2 * middle + rows[:, :, 2:])
    return cube
