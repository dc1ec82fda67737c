"""The sphere: its rim found, its world laid out on a cubemap, and how long that takes.

Spheres are traced ray by ray by the tests' own tracer, in worlds with edges and lamps.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.figure import Figure
from calibration.errors import InputError
from stages import cube
from stages.align import Alignment
from stages.locate import locate
from stages.mirror import Sphere
from stages.types import Measured
from stages.unwrap import BAYER_NOISE_AREA_PX, unwrap

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from sphere_tracer import (  # type: ignore[import-not-found]
    Camera,
    busy_world,
    chromium,
    photograph,
    smooth_world,
)

SPHERES = 24  # photographs of the grid: sizes, places, distances and worlds drawn by number


def measure() -> Iterator[Figure]:
    yield from _rims()
    yield from _world()
    yield from _speed()


def _measured(image, noise: float, seed: int) -> Measured:
    variance = (noise * image) ** 2 + 1e-6 * image.mean() ** 2
    drawn = image + np.random.default_rng(seed).normal(size=image.shape) * np.sqrt(variance)
    known = np.ones(image.shape[:2], np.float32)
    return Measured(drawn.astype(np.float32), variance.astype(np.float32), known)


def _rims() -> Iterator[Figure]:
    """Centre and radius against the tracer's, the metal's reflectance known."""
    cosine = np.linspace(1.0, 0.0, 500) ** 2
    reflectance = np.arccos(cosine), chromium(cosine)
    rng = np.random.default_rng(1)
    centre, radius, failed = [], [], 0
    for number in range(SPHERES):
        rim = float(rng.uniform(80, 200))
        height, width = int(2.7 * rim), int(3.6 * rim)
        x = float(rng.uniform(rim + 6, width - rim - 6))
        y = float(rng.uniform(rim + 6, height - rim - 6))
        distance = float(rng.choice([300.0, 600.0, 1500.0]))
        camera = Camera.seeing(x, y, rim, height, width, distance=distance)
        world = (smooth_world, busy_world)[number % 2](100 + number)
        image = photograph(camera, world, chromium, samples=1, rim_samples=5)
        if number % 3 == 2:  # a stand
            columns, rows = np.arange(width) + 0.5, (np.arange(height) + 0.5)[:, None]
            image[(np.abs(columns - x) < 0.25 * rim) & (rows > y + 0.94 * rim)] = 0.05
        try:
            found = locate(
                [_measured(image, 0.003, number)],
                radius_mm=camera.radius,
                distance_mm=distance,
                reflectance=reflectance,
            )
        except InputError:
            failed += 1
            continue
        centre.append(float(np.hypot(*np.subtract(found.centre_px, (x, y)))))
        radius.append(abs(found.rim_px - rim))
    yield Figure(f"rim not found, of {SPHERES}", failed, high=0)
    for name, errors in (("centre", centre), ("radius", radius)):
        yield Figure(f"{name} of the rim, median error", float(np.median(errors)), "px", high=0.05)
        yield Figure(f"{name} of the rim, worst", float(np.max(errors)), "px", high=0.2)
        off = 100.0 * float(np.mean(np.array(errors) > 0.3))
        yield Figure(f"{name} of the rim, off by more than .3 px", off, "%")


def _world() -> Iterator[Figure]:
    """A distant asymmetric world, band-limited, noise-free, reflectance exact, to 160 degrees."""
    camera = Camera.seeing(420.3, 381.7, 350.0, 780, 840)
    world = smooth_world(6, degree=8.0, channels=3)
    image = photograph(camera, world, chromium, samples=3, rim_samples=8)
    sphere = Sphere(camera.centre, camera.radius, camera.focal_px, (420.0, 390.0))
    n = 256
    still = Alignment(np.zeros((1, 2)), np.ones(1), np.zeros(1))
    cubemap = unwrap([_measured(image, 0.0, 0)], sphere, still, face_size=n)
    d = cube.directions(n)
    reflectance = chromium(np.cos(sphere.incidence_angle(d)))[..., None]
    within = (d[..., 2] > np.cos(np.radians(160.0))) & (cubemap.valid > 0)
    error = np.abs(cubemap.values / reflectance / world(d.reshape(-1, 3)).reshape(d.shape) - 1.0)
    median, p95 = np.percentile(100.0 * error[within], [50, 95])
    yield Figure("a smooth world within 160 degrees, median error", float(median), "%", high=0.3)
    yield Figure("a smooth world within 160 degrees, 95th percentile", float(p95), "%", high=4.0)


def _speed() -> Iterator[Figure]:
    """A rim 3000 px across to 6 x 1024 x 1024 x 6 with variance, on one thread."""
    import cv2

    rng = np.random.default_rng(1)
    values = rng.random((3100, 3100, 3), dtype=np.float32)
    image = Measured(values, 0.01 * values, np.ones(values.shape[:2], np.float32))
    sphere = Sphere.from_rim(
        1550.3, 1549.1, 1500.0, radius_mm=50.0, principal_px=(1550.0, 1550.0), distance_mm=1500.0
    )
    moved = Alignment(np.array([(0.0, 0.0), (0.75, -0.4)]), np.ones(2), np.zeros(2))
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    began = time.process_time()
    unwrap([image, image], sphere, moved, face_size=1024, noise_area_px=BAYER_NOISE_AREA_PX)
    spent = time.process_time() - began
    cv2.setNumThreads(threads)
    yield Figure("3000 px to 6 x 1024 x 1024 x 6 with variance, CPU", spent, "s", high=2.0)
