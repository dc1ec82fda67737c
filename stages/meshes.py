"""Meshes made here: the teapot, spheres, and what a profile sweeps about an axis.

Lengths in metres, +Y up.
"""

from __future__ import annotations

from importlib import resources

import numpy as np

from stages.scene import Mesh


def teapot_mesh(*, segments=32, height=0.15) -> Mesh:
    """The Utah teapot standing on y = 0 about the Y axis, spout to +X.

    segments  quads along each side of a patch
    height    from table to knob, metres

    Martin Newell's 28 bicubic Bezier patches of 1975, with the four of the bottom that were added
    later: a data set in the public domain. It has z up, and its patches are seen from inside.
    """
    control = _control_points()
    t = np.linspace(0.0, 1.0, segments + 1)
    positions = _bezier(control, t, t)
    normals = _bezier_normals(control, t)
    row, column = np.meshgrid(np.arange(segments), np.arange(segments), indexing="ij")
    corner = (row * (segments + 1) + column).ravel()
    below, right = corner + segments + 1, corner + 1
    quads = np.stack([corner, right, below, right, below + 1, below], axis=1).reshape(-1, 3)
    per_patch = (segments + 1) ** 2
    triangles = (np.arange(len(control))[:, None, None] * per_patch + quads).reshape(-1, 3)
    scale = height / control[..., 2].max()
    y_up = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    return Mesh(
        (positions.reshape(-1, 3) @ y_up.T * scale).astype(np.float32),
        (normals.reshape(-1, 3) @ y_up.T).astype(np.float32),
        triangles.astype(np.int32),
    )


def sphere(*, radius=1.0, segments=64) -> Mesh:
    """A sphere about the origin, `segments` quads from pole to pole."""
    angle = np.linspace(0.0, np.pi, segments + 1)
    outline = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    outline[[0, -1], 0] = 0.0
    return revolved((radius * outline, outline), 2 * segments)


def revolved(profile, segments: int) -> Mesh:
    """The surface a profile sweeps about the Y axis.

    profile   ((K, 2) positions, (K, 2) normals): distance from the axis and height; going down
              the outside of the surface
    segments  quads around
    """
    positions, normals = profile
    angle = np.linspace(0.0, 2 * np.pi, segments + 1)
    around = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)

    def turn(plane):
        up = plane[:, 1, None, None] * np.array([0.0, 1.0, 0.0])
        return (plane[:, 0, None, None] * around + up).reshape(-1, 3).astype(np.float32)

    row, column = np.meshgrid(np.arange(len(positions) - 1), np.arange(segments), indexing="ij")
    corner = (row * (segments + 1) + column).ravel()
    below, right = corner + segments + 1, corner + 1
    triangles = np.stack([corner, below, right, right, below, below + 1], axis=1).reshape(-1, 3)
    return Mesh(turn(positions), turn(normals), triangles.astype(np.int32))


def _control_points():
    """(32, 4, 4, 3), z up, as the data set has them."""
    with resources.files(__package__).joinpath("teapot.csv").open(encoding="utf-8") as file:
        rows = np.loadtxt(file, delimiter=",", skiprows=1)
    return rows[:, 3:].reshape(-1, 4, 4, 3)


def _bezier(control, u, v):
    """Points (P, U, V, 3) of bicubic patches (P, 4, 4, 3): u along their rows, v their columns."""
    return np.einsum("ui,vj,pijk->puvk", _bernstein(u), _bernstein(v), control)


def _bezier_normals(control, t):
    """Unit normals (P, T, T, 3).

    Where a row of control points is a single point (knob and bottom) the cross product vanishes;
    the normal there is its limit, taken a hair's breadth inside the patch.
    """
    inside = np.clip(t, 1e-4, 1 - 1e-4)
    along_u = np.einsum("ui,vj,pijk->puvk", _bernstein_slope(inside), _bernstein(inside), control)
    along_v = np.einsum("ui,vj,pijk->puvk", _bernstein(inside), _bernstein_slope(inside), control)
    normal = np.cross(along_v, along_u)
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def _bernstein(t):
    """The cubic Bernstein polynomials (T, 4)."""
    s = 1 - t
    return np.stack([s**3, 3 * t * s**2, 3 * t**2 * s, t**3], axis=1)


def _bernstein_slope(t):
    """Their derivatives (T, 4)."""
    s = 1 - t
    return np.stack([-3 * s**2, 3 * s**2 - 6 * t * s, 6 * t * s - 3 * t**2, 3 * t**2], axis=1)
