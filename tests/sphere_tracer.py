"""Photographs of a mirror sphere in a distant world, traced ray by ray: the tests' own truth.

Written apart from `stages`, and plainly: pinhole, quadratic equation, law of reflection.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Camera:
    """height, width in px; focal_px; sphere's centre (camera frame: x right, y down) and radius."""

    height: int
    width: int
    focal_px: float
    centre: tuple[float, float, float]
    radius: float

    @classmethod
    def seeing(cls, x, y, radius_px, height, width, distance=1500.0, radius=50.0):
        """The camera that sees the sphere's centre at x, y and a rim of about that radius."""
        focal = radius_px / np.tan(np.arcsin(radius / distance))
        ray = np.array([x - width / 2, y - height / 2, focal])
        centre = distance * ray / np.linalg.norm(ray)
        return cls(height, width, float(focal), tuple(centre.tolist()), radius)

    def world_axes(self):
        """World +X, +Y, +Z as rows, in the camera's frame."""
        z = -np.array(self.centre) / np.linalg.norm(self.centre)
        x = np.cross([0.0, -1.0, 0.0], z)  # right: perpendicular to up and to +Z
        x /= np.linalg.norm(x)
        return np.stack([x, np.cross(z, x), z])

    def radiance(self, world, x, y, reflectance, shift=(0.0, 0.0)):
        """What the camera sees at pixel positions x, y (n,) -> (n, C)."""
        ray = np.stack(
            [
                x - shift[0] - self.width / 2,
                y - shift[1] - self.height / 2,
                np.full_like(x, self.focal_px),
            ],
            axis=-1,
        )
        ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
        c = np.array(self.centre)
        b = ray @ c
        root = b * b - c @ c + self.radius**2
        hit = root > 0
        t = b[hit] - np.sqrt(root[hit])
        normal = (t[:, None] * ray[hit] - c) / self.radius
        cosine = -np.sum(ray[hit] * normal, axis=-1)
        seen = ray.copy()
        seen[hit] = ray[hit] + 2 * cosine[:, None] * normal
        value = world(seen @ self.world_axes().T)
        factor = reflectance(cosine)
        value[hit] *= factor if factor.ndim == 2 else factor[:, None]
        return value


def perfect(cosine):
    return np.ones_like(cosine)


def chromium(cosine):
    """Schlick's form of a metal: two thirds in front, everything at grazing."""
    return 0.66 + 0.34 * (1.0 - cosine) ** 5


def photograph(camera, world, reflectance=perfect, shift=(0.0, 0.0), samples=2, rim_samples=8):
    """The photograph (H, W, C): every pixel the mean over its square, finer where the rim is."""
    rows, columns = np.mgrid[: camera.height, : camera.width]
    rows, columns = rows.ravel(), columns.ravel()

    def mean(rows, columns, count):
        total = 0.0
        for dy in (np.arange(count) + 0.5) / count:
            for dx in (np.arange(count) + 0.5) / count:
                x, y = columns + dx, rows + dy
                total = total + camera.radiance(world, x, y, reflectance, shift)
        return total / count**2

    image = mean(rows, columns, samples)
    # The reflection runs fast near the rim: within 6 px inside and 2 outside, take more rays.
    ray = np.stack(
        [
            columns + 0.5 - shift[0] - camera.width / 2,
            rows + 0.5 - shift[1] - camera.height / 2,
            np.full(rows.shape, camera.focal_px),
        ],
        axis=-1,
    )
    c = np.array(camera.centre)
    angle = np.arccos(ray @ c / np.linalg.norm(ray, axis=-1) / np.linalg.norm(c))
    outside = (angle - np.arcsin(camera.radius / np.linalg.norm(c))) * camera.focal_px
    near = (outside > -6) & (outside < 2)
    image[near] = mean(rows[near], columns[near], rim_samples)
    return image.reshape(camera.height, camera.width, -1)


def smooth_world(seed, degree=8.0, waves=12, channels=1):
    """A positive, band-limited world: a sum of plane waves exp(i k.d), |k| up to `degree`."""
    rng = np.random.default_rng(seed)
    k = rng.normal(size=(waves, 3))
    k *= (degree * rng.uniform(0.3, 1.0, waves) / np.linalg.norm(k, axis=1))[:, None]
    phase = rng.uniform(0, 2 * np.pi, waves)
    amount = rng.normal(size=(waves, channels))
    amount *= 0.8 / np.abs(amount).sum(axis=0)

    def world(d):
        return 1.0 + np.cos(d @ k.T + phase) @ amount

    return world


def busy_world(seed, channels=1):
    """Walls of a room: panels with sharp straight edges of all brightnesses, lamps, a horizon."""
    rng = np.random.default_rng(seed)
    smooth = smooth_world(seed + 1000, degree=25.0, waves=20, channels=channels)
    count = 40
    middle = rng.normal(size=(count, 3))
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    side = np.cross(middle, rng.normal(size=(count, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(middle, side)
    size = rng.uniform(0.05, 0.6, (count, 2))
    level = 10.0 ** rng.uniform(-1.0, 0.7, (count, channels))
    level[-3:] *= 100.0  # lamps
    size[-3:] *= 0.2

    def world(d):
        value = smooth(d) * np.where(d[:, 1:2] > 0.1, 1.0, 0.3)
        for i in range(count):
            m = d @ middle[i]
            on = (m > 0) & (np.abs(d @ side[i]) < size[i, 0] * m)
            on &= np.abs(d @ other[i]) < size[i, 1] * m
            value[on] = level[i]
        return value

    return world
