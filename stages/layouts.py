"""The layouts an environment map comes in: which way each pixel looks, and how faces lie in files.

A projection spreads all directions over one sheet, or six: positions u to the right and v down in
0..1 over the sheet, row 0 first, pixel centres at (i + 0.5) / size. The world is that of
`stages.cube`: right-handed, +Y up.

    cube        six faces, see `stages.cube`
    latlong     2:1; row 0 at +Y, the centre column at -Z, +X right of the centre
    mirrorball  a photograph of a mirror sphere from far away on +Z: the centre shows +Z, the rim
                -Z, +X is right and +Y up. Its pixels have equal solid angles
    angular     the light probe of P. Debevec (1998): distance from the centre is the angle from -Z,
                the rim is +Z; +X right, +Y up, as seen from inside
    octahedral  |x| + |y| + |z| = 1 folded out (T. Engelhardt, C. Dachsbacher 2008): the centre is
                +Y, the corners -Y, +X right, +Z down, as on the cube's face +Y

The packings of a cube (a strip, crosses, six files) only move faces about; nothing is resampled.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages import cube
from stages.mirror import Sphere

Array = NDArray[np.float64]

_PARTS = 8  # along a pixel's side, where a disc's rim cuts through it


class Projection(ABC):
    """All directions on a sheet of pixels.

    name    as users write it
    whole   whether each direction is somewhere on the sheets
    sheets  1, or 6 faces
    aspect  a sheet's width over its height
    rows_per_radian  rows of a sheet that give, in the mean over the sphere or along the equator,
            one pixel a radian: for sizes that match
    """

    name: str
    whole: bool = True
    sheets: int = 1
    aspect: int = 1
    rows_per_radian: float

    @abstractmethod
    def direction(self, sheet, u, v) -> Array:
        """Unit directions (..., 3) at positions of a sheet; NaN where none is looked at.

        Positions a little outside the sheet look on where the neighbouring sheet, or the sheet's
        other end, begins.
        """

    @abstractmethod
    def position(self, d) -> tuple[Any, Array, Array]:
        """Sheet, u and v (...,) of unit directions (..., 3); the inverse of `direction`."""

    @abstractmethod
    def pixels_per_radian(self, d, u, v) -> Array:
        """The most rows of a sheet of one row that a radian spans, at directions d and there u, v.

        Times the number of rows: how fine the pixels lie where they lie finest.
        """

    @abstractmethod
    def density(self, u, v) -> Array:
        """Solid angle per area of the sheet (...,), sr; 0 where nothing is looked at."""

    def shape(self, rows: int) -> tuple[int, int, int]:
        """Sheets, rows and columns of an image with that many rows a sheet."""
        return self.sheets, rows, rows * self.aspect

    def solid_angles(self, rows: int) -> Array:
        """Solid angle (rows, columns) of each pixel of a sheet, sr; they add up to the sphere."""
        return _solid_angles(self, rows)


@lru_cache(maxsize=8)
def _solid_angles(projection: Projection, rows: int) -> Array:
    count = projection.shape(rows)[2] * _PARTS
    u = (np.arange(count) + 0.5) / count
    result = np.empty((rows, count // _PARTS))
    for row in range(rows):
        v = ((np.arange(_PARTS) + 0.5) / _PARTS + row) / rows
        parts = projection.density(u[None, :], v[:, None]).reshape(_PARTS, -1, _PARTS)
        result[row] = parts.sum(axis=(0, 2))
    return result * (4 * np.pi / projection.sheets / result.sum())


class Cube(Projection):
    name, sheets, rows_per_radian = "cube", 6, np.pi / 2

    def direction(self, sheet, u, v):
        return cube.directions_on(sheet, 2.0 * u - 1.0, 2.0 * v - 1.0)

    def position(self, d):
        face, u, v = cube.face_positions(d)
        return face, (u + 1.0) / 2, (v + 1.0) / 2

    def pixels_per_radian(self, d, u, v):
        return (1.0 + (2.0 * u - 1.0) ** 2 + (2.0 * v - 1.0) ** 2) / 2

    def density(self, u, v):
        return 4.0 * (1.0 + (2.0 * u - 1.0) ** 2 + (2.0 * v - 1.0) ** 2) ** -1.5

    def solid_angles(self, rows):
        return cube.solid_angles(rows)


class Latlong(Projection):
    name, aspect, rows_per_radian = "latlong", 2, np.pi

    def direction(self, sheet, u, v):
        polar, azimuth = np.pi * np.asarray(v), 2 * np.pi * (np.asarray(u) - 0.5)
        sin = np.sin(polar)
        return _stacked(sin * np.sin(azimuth), np.cos(polar), -sin * np.cos(azimuth))

    def position(self, d):
        x, y, z = np.moveaxis(d, -1, 0)
        u = np.arctan2(x, -z) / (2 * np.pi) + 0.5
        return 0, u, np.arctan2(np.hypot(x, z), y) / np.pi

    def pixels_per_radian(self, d, u, v):
        return 1 / (np.pi * np.maximum(np.hypot(d[..., 0], d[..., 2]), 1e-6))

    def density(self, u, v):
        return 2 * np.pi**2 * np.sin(np.pi * np.asarray(v)) * np.ones_like(u)

    def solid_angles(self, rows):
        bands = -np.diff(np.cos(np.linspace(0, np.pi, rows + 1)))
        return np.repeat(bands[:, None] * (np.pi / rows), 2 * rows, axis=1)


class MirrorBall(Projection):
    name, rows_per_radian = "mirrorball", 4.0

    def direction(self, sheet, u, v):
        x, y = 2.0 * np.asarray(u) - 1.0, 1.0 - 2.0 * np.asarray(v)
        r2 = x * x + y * y
        # The normal is (x, y, root), and the ray that comes back along +Z came from there.
        root = np.sqrt(np.where(r2 <= 1.0, 1.0 - r2, np.nan))
        return _stacked(2 * root * x, 2 * root * y, 1.0 - 2.0 * r2)

    def position(self, d):
        x, y, z = np.moveaxis(d, -1, 0)
        half = np.sqrt(np.maximum((1.0 + z) / 2, 1e-16))  # cosine of half the angle from +Z
        # r = sin(angle / 2); -Z itself is the whole rim
        size = np.maximum(np.hypot(x, y) / (2 * half), 1.0)
        return 0, (x / (2 * half) / size + 1) / 2, (1 - y / (2 * half) / size) / 2

    def pixels_per_radian(self, d, u, v):
        return 0.25 / np.sqrt(np.maximum((1.0 + d[..., 2]) / 2, 1e-12))

    def density(self, u, v):
        r2 = (2.0 * np.asarray(u) - 1.0) ** 2 + (2.0 * np.asarray(v) - 1.0) ** 2
        return np.where(r2 < 1.0, 16.0, 0.0)


class Angular(Projection):
    name, rows_per_radian = "angular", 2 * np.pi

    def direction(self, sheet, u, v):
        x, y = 2.0 * np.asarray(u) - 1.0, 1.0 - 2.0 * np.asarray(v)
        r = np.hypot(x, y)
        sinc = np.pi * np.sinc(r)  # sin(pi r) / r: past the rim the other side begins
        return _stacked(sinc * x, sinc * y, -np.cos(np.pi * r))

    def position(self, d):
        x, y, z = np.moveaxis(d, -1, 0)
        sin = np.hypot(x, y)
        r = np.arctan2(sin, -z) / np.pi
        scale = np.where(sin > 0, r / np.maximum(sin, 1e-300), 1 / np.pi)
        # +Z itself is the whole rim: (1, 0) stands for it
        right = np.where((sin == 0) & (z > 0), 1.0, x * scale)
        return 0, (right + 1) / 2, (1 - y * scale) / 2

    def pixels_per_radian(self, d, u, v):
        r = np.hypot(2.0 * u - 1.0, 2.0 * v - 1.0)
        return 0.5 * np.maximum(1 / np.pi, r / np.maximum(np.sin(np.pi * r), 1e-6))

    def density(self, u, v):
        r = np.hypot(2.0 * np.asarray(u) - 1.0, 2.0 * np.asarray(v) - 1.0)
        return np.where(r < 1.0, 4 * np.pi**2 * np.sinc(r), 0.0)


class Octahedral(Projection):
    name, rows_per_radian = "octahedral", 2 * np.sqrt(np.pi)

    def direction(self, sheet, u, v):
        x, z = np.broadcast_arrays(2.0 * np.asarray(u) - 1.0, 2.0 * np.asarray(v) - 1.0)
        # Past an edge of the square lies what the other half of that edge has.
        past_x, past_z = np.abs(x) > 1, np.abs(z) > 1
        x, z = np.where(past_z, -x, x), np.where(past_x, -z, z)
        x = np.where(past_x, np.sign(x) * 2 - x, x)
        z = np.where(past_z, np.sign(z) * 2 - z, z)
        y = 1.0 - np.abs(x) - np.abs(z)
        below = y < 0
        folded_x = np.where(below, (1 - np.abs(z)) * _sign(x), x)
        folded_z = np.where(below, (1 - np.abs(x)) * _sign(z), z)
        d = _stacked(folded_x, y, folded_z)
        return d / np.linalg.norm(d, axis=-1, keepdims=True)

    def position(self, d):
        x, y, z = np.moveaxis(d / np.abs(d).sum(axis=-1, keepdims=True), -1, 0)
        below = y < 0
        u = np.where(below, (1 - np.abs(z)) * _sign(x), x)
        v = np.where(below, (1 - np.abs(x)) * _sign(z), z)
        return 0, (u + 1) / 2, (v + 1) / 2

    def pixels_per_radian(self, d, u, v):
        # With s = |x| + |y| + |z| and p = d / s the derivative of p_x is (e_x - p_x signs) / s, of
        # p_z likewise, and of both the largest singular value counts; below y = 0 it is the same.
        s = np.abs(d).sum(axis=-1)
        x, z = np.abs(d[..., 0]) / s, np.abs(d[..., 2]) / s
        xx, zz, xz = 1 - 2 * x + 3 * x * x, 1 - 2 * z + 3 * z * z, 3 * x * z - x - z
        return np.sqrt((xx + zz) / 2 + np.hypot((xx - zz) / 2, xz)) / (2 * s)

    def density(self, u, v):
        x, z = 2.0 * np.asarray(u) - 1.0, 2.0 * np.asarray(v) - 1.0
        x, z = np.broadcast_arrays(np.abs(x), np.abs(z))
        y = 1.0 - x - z
        below = y < 0
        x, z = np.where(below, 1 - z, x), np.where(below, 1 - x, z)
        return 4.0 * (x * x + y * y + z * z) ** -1.5


class BallPhotograph(Projection):
    """A photograph of a mirror sphere, as it was framed; something to read from, not to write.

    What lies less than a pixel inside the rim is not used, since it mixes with what is beside it.
    """

    name, whole = "photograph", False

    def __init__(self, sphere: Sphere, height: int, width: int):
        self.sphere, self.height, self.width = sphere, height, width
        self.rows_per_radian = 2.0 * height / sphere.rim_px

    def shape(self, rows):
        return 1, self.height, self.width

    def direction(self, sheet, u, v):
        return self.sphere.direction_of(_stacked(u * self.width, v * self.height, 0.0)[..., :2])

    def position(self, d):
        pixels, seen = self.sphere.pixel_of(d)
        pixels = np.where(seen[..., None], pixels, -1.0)
        return 0, pixels[..., 0] / self.width, pixels[..., 1] / self.height

    def pixels_per_radian(self, d, u, v):
        # As from far away: r = sin(psi / 2), and round the rim 1 / (2 cos(psi / 2)).
        towards = d @ self.sphere.world_from_camera @ np.asarray(self.sphere.centre_mm)
        cosine = np.sqrt(np.maximum((1.0 - towards / self.sphere.distance_mm) / 2, 1e-4))
        return self.sphere.rim_px / (2 * cosine) / self.height

    def density(self, u, v):
        pixels = _stacked(u * self.width, v * self.height, 0.0)[..., :2]
        return np.where(self.sphere.inside_px(pixels) >= 1.0, 1.0, 0.0)

    def solid_angles(self, rows):
        x, y = np.arange(self.width) + 0.5, np.arange(self.height) + 0.5
        return self.density(x[None, :] / self.width, y[:, None] / self.height)


CUBE, LATLONG = Cube(), Latlong()
PROJECTIONS: dict[str, Projection] = {
    p.name: p for p in (CUBE, LATLONG, MirrorBall(), Angular(), Octahedral())
}


def _sign(a):
    return np.where(a < 0, -1.0, 1.0)


def _stacked(x, y, z) -> Array:
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1)


# --------------------------------------------------------------------- how a cube's faces lie

# Where faces lie, row by row of squares; each as `stages.cube` has it, one that ends in ' turned by
# half, so that along every edge two squares share the picture goes on.
_PACKINGS: dict[str, tuple[tuple[str, ...], ...]] = {
    "cube": tuple((face,) for face in cube.FACES),
    "hcross": (("", "py", "", ""), ("nx", "pz", "px", "nz"), ("", "ny", "", "")),
    "vcross": (("", "py", ""), ("nx", "pz", "px"), ("", "ny", ""), ("", "nz'", "")),
}
PACKINGS = tuple(_PACKINGS)


def packed(faces, packing: str, blank=0.0):
    """An image (H, W, C) of a cube's faces (6, N, N, C) laid out, with `blank` where none lies."""
    n, channels = faces.shape[1], faces.shape[-1]
    plan = _PACKINGS[packing]
    image = np.full((len(plan) * n, len(plan[0]) * n, channels), blank, faces.dtype)
    for square, face in _squares(plan, n):
        lying = faces[cube.FACES.index(face[:2])]
        image[square] = lying[::-1, ::-1] if face.endswith("'") else lying
    return image


def unpacked(image, packing: str):
    """A cube's faces (6, N, N, C) from an image (H, W, C); None where its shape does not fit."""
    plan = _PACKINGS[packing]
    n = image.shape[0] // len(plan)
    if n == 0 or image.shape[:2] != (n * len(plan), n * len(plan[0])):
        return None
    faces = np.empty((6, n, n, image.shape[-1]), image.dtype)
    for square, face in _squares(plan, n):
        lying = image[square]
        faces[cube.FACES.index(face[:2])] = lying[::-1, ::-1] if face.endswith("'") else lying
    return faces


def _squares(plan, n: int):
    for y, line in enumerate(plan):
        for x, face in enumerate(line):
            if face:
                yield np.s_[y * n : (y + 1) * n, x * n : (x + 1) * n], face
