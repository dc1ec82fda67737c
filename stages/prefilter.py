"""Filter a cubemap for rendering: ever blurrier mips for gloss, the irradiance for matt surfaces.

Nothing here may be NaN: fill the map first.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from stages import cube as cubes

SIGMA = 0.6  # of the Gaussian mips, in texels of the level itself
_REACH = 4  # texels past a face's edge that a level's kernel sees: 3.3 sigma of the first level


def prefilter(cube):
    """The mips of a cubemap, each a Gaussian of .6 of its own texels, down to one texel a face.

    cube     (6, N, N, C) linear
    returns  tuple of (6, N >> k, N >> k, C) float32; level 0 is the cube as it came

    Kernels cross the edges of faces and heed the texels' solid angles: a constant map stays
    constant, a lamp keeps its light to a few hundredths, and there are no seams. Box mips of a cube
    show their blocks when magnified; these do not, at the price of about one level of sharpness,
    which `sample_level` in shaders/include/cube.glsl takes into account.
    """
    levels = [np.asarray(cube, np.float32)]
    blurred = 0.0  # the blur already in the last level, in its texels
    while levels[-1].shape[1] > 1:
        n = levels[-1].shape[1]
        ratio = n / (n // 2)
        sigma = float(np.sqrt((SIGMA * ratio) ** 2 - blurred**2))
        levels.append(_shrink(levels[-1], n // 2, sigma))
        blurred = SIGMA
    return tuple(levels)


def irradiance(cube, *, size=32, source=64):
    """Irradiance over pi on a surface facing each direction: what a perfect white diffuser returns.

    cube     (6, N, N, C) linear
    size     texels along a face of the result
    source   the map is first brought down to this many texels along a face; cosine and map are
             then integrated texel by texel, with nothing left out
    returns  (6, size, size, C) float32, in the unit of the cube: a constant map gives itself

    32 out of 64 is right to a few hundredths of a CIEDE2000 unit in furnished rooms.
    """
    cube = np.asarray(cube, np.float32)
    if cube.shape[1] > source:
        cube = area_average(cube, source)
    n, channels = cube.shape[1], cube.shape[-1]
    light = cubes.directions(n).reshape(-1, 3).astype(np.float32)
    weight = np.broadcast_to(cubes.solid_angles(n), (6, n, n)).reshape(-1, 1)
    weighted = np.concatenate([cube.reshape(-1, channels), np.ones_like(light[:, :1])], axis=1)
    weighted = (weighted * weight).astype(np.float32)
    facing = cubes.directions(size).reshape(-1, 3).astype(np.float32)
    result = np.empty((len(facing), channels), np.float32)
    for rows in np.array_split(np.arange(len(facing)), max(1, len(facing) // 512)):
        integral = np.maximum(facing[rows] @ light.T, 0) @ weighted
        # the last column is pi, but for the texels being finite: it takes their error out again
        result[rows] = integral[:, :-1] / integral[:, -1:]
    return result.reshape(6, size, size, channels)


def mean(cube):
    """Mean over all directions (C,): the light a small white sphere scatters on the whole."""
    return np.einsum("fyxc,yx->c", cube, cubes.solid_angles(cube.shape[1])) / (4 * np.pi)


def area_average(cube, size):
    """A smaller cubemap (6, size, size, C): means over the solid angle of each texel."""
    n = cube.shape[1]
    fine, coarse = np.linspace(0, 1, n + 1), np.linspace(0, 1, size + 1)
    overlap = np.minimum(coarse[1:, None], fine[1:]) - np.maximum(coarse[:-1, None], fine[:-1])
    overlap = np.maximum(overlap, 0).astype(np.float32)
    weight = cubes.solid_angles(n).astype(np.float32)
    return _separable(cube * weight[..., None], overlap) / (overlap @ weight @ overlap.T)[..., None]


def _shrink(cube, size, sigma):
    """A cubemap of `size` texels a face under a Gaussian of sigma texels of the cube given."""
    n, channels = cube.shape[1], cube.shape[-1]
    kernel, texel = _kernel(n, size, sigma), _bordered(n)
    source, target = _balance(n, size, sigma)
    weighted = (cube * source[..., None]).reshape(-1, channels)[texel]
    return _separable(weighted, kernel) * target[..., None]


@lru_cache(maxsize=32)
def _balance(n, size, sigma):
    """Factors on source (6, n, n) and target texels (6, size, size) that make the blur fair.

    Faces are bent over the sphere, so that a Gaussian on each takes too much from some texels (the
    middles of edges) and too little from others (the corners): a lamp would lose up to two thirds
    of its light there. With these factors each target is a mean, and each source gives away just
    what it has, its radiance times its solid angle (R. Sinkhorn's balancing of a matrix, 1967).
    """
    kernel, texel = _kernel(n, size, sigma), _bordered(n)
    has = np.broadcast_to(cubes.solid_angles(n), (6, n, n)).astype(np.float32)
    takes = np.broadcast_to(cubes.solid_angles(size), (6, size, size)).astype(np.float32)
    source = has
    for _ in range(8):
        target = 1 / _separable(source.reshape(-1, 1)[texel], kernel)[..., 0]
        given = _separable((takes * target)[..., None], kernel.T)
        given = np.bincount(texel.ravel(), given.ravel(), minlength=has.size).reshape(has.shape)
        source = (has / given).astype(np.float32)
    return source, 1 / _separable(source.reshape(-1, 1)[texel], kernel)[..., 0]


def _kernel(n, size, sigma):
    """The Gaussian from n texels, with their border, to size texels: (size, n + 2 reach)."""
    centre = (np.arange(-_REACH, n + _REACH) + 0.5) / n
    target = (np.arange(size) + 0.5) / size
    apart = (target[:, None] - centre) * n
    return np.where(np.abs(apart) <= _REACH, np.exp(-0.5 * (apart / sigma) ** 2), 0).astype(
        np.float32
    )


@lru_cache(maxsize=16)
def _bordered(n):
    """Texel numbers (6, n + 2 reach, n + 2 reach): faces, each continued into its neighbours."""
    t = (np.arange(-_REACH, n + _REACH) + 0.5) * (2.0 / n) - 1.0
    face, u, v = cubes.face_positions(cubes.face_directions(t[None, :], t[:, None]))
    column, row = (
        np.clip(((position + 1) * (n / 2)).astype(np.intp), 0, n - 1) for position in (u, v)
    )
    return (face * n + row) * n + column


def _separable(cube, kernel):
    """A cube (6, K, K, C) under the same kernel (M, K) down and across: (6, M, M, C)."""
    cube = np.einsum("fyxc,Xx->fyXc", cube, kernel, optimize=True)
    return np.einsum("fyXc,Yy->fYXc", cube, kernel, optimize=True)
