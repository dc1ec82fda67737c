"""The sphere: its rim found, its world laid out on a cubemap, and how long that takes.

Spheres are traced ray by ray by the tests' own tracer, in worlds with edges and lamps.
"""

from __future__ import annotations

import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks import layouts, rims, views
from benchmarks.figure import Figure
from calibration import metals, primaries, sets
from calibration.fit import fit
from calibration.spectra import WAVELENGTHS, Spectra
from calibration.training import computed
from stages import cube
from stages.align import Alignment
from stages.demosaic import demosaic
from stages.merge import InMemory, merge
from stages.mirror import Sphere
from stages.normalise import normalise
from stages.transform import transform
from stages.types import Frame, Measured
from stages.unwrap import BAYER_NOISE_AREA_PX, BAYER_NOISE_CORRELATION, unwrap

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from sphere_tracer import (  # type: ignore[import-not-found]
    Camera,
    chromium,
    photograph,
    smooth_world,
)


def measure() -> Iterator[Figure]:
    yield from rims.measure()
    yield from _world()
    yield from _sigma()
    yield from _speed()
    yield from layouts.measure()
    yield from views.measure()


def _measured(image, noise: float, seed: int) -> Measured:
    variance = (noise * image) ** 2 + 1e-6 * image.mean() ** 2
    drawn = image + np.random.default_rng(seed).normal(size=image.shape) * np.sqrt(variance)
    known = np.ones(image.shape[:2], np.float32)
    return Measured(drawn.astype(np.float32), variance.astype(np.float32), known)


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


SPEED_PX = 3000  # the rim's diameter
_FACE = 1024


def _speed() -> Iterator[Figure]:
    """A rim 3000 px across to 6 x 1024 x 1024 x 6 with variance; sizes and channels; peers."""
    _unwrapped(300, 64, 1)  # compiled, or read from the cache
    full = _unwrapped(SPEED_PX, _FACE, 2)
    yield Figure("3000 px to 6 x 1024 x 1024 x 6 with variance, CPU", full, "s", high=2.0)
    for diameter, face, filters in ((1500, 512, 2), (750, 256, 2), (SPEED_PX, _FACE, 1)):
        spent = _unwrapped(diameter, face, filters)
        work = (face / _FACE) ** 2 * filters / 2
        name = f"{diameter} px to 6 x {face} x {face} x {3 * filters}, CPU"
        yield Figure(name, spent, "s")
        yield Figure(f"{name}, over its share of the first", spent / (work * full), "times")
    for peer in _peers():
        yield peer
        yield Figure(f"the first, over {peer.name}", full / peer.value, "times")


def _photograph(diameter: int, seed: int = 1):
    size = diameter + 100
    return np.random.default_rng(seed).random((size, size, 3), dtype=np.float32)


def _unwrapped(diameter: int, face_size: int, filters: int) -> float:
    """CPU seconds of all threads, for so many photographs of three colours each."""
    values = _photograph(diameter)
    image = Measured(values, 0.01 * values, np.ones(values.shape[:2], np.float32))
    middle = len(values) / 2
    sphere = Sphere.from_rim(
        middle + 0.3,
        middle - 0.9,
        diameter / 2,
        radius_mm=50.0,
        principal_px=(middle, middle),
        distance_mm=1500.0,
    )
    moved = Alignment(np.array([(0.0, 0.0), (0.75, -0.4)]), np.ones(2), np.zeros(2))
    area = BAYER_NOISE_AREA_PX
    began = time.process_time()
    unwrap([image] * filters, sphere, moved, face_size=face_size, noise_area_px=area)
    return time.process_time() - began


def _peers() -> Iterator[Figure]:
    """Others on the same photograph: three colours, unfiltered, no variance, a distant camera."""
    ball = _photograph(SPEED_PX)[50:-50, 50:-50]
    try:
        from envmap import EnvironmentMap  # type: ignore[import-not-found]
    except ImportError:
        print("skylibs is not installed (pip install skylibs): left out", file=sys.stderr)
    else:
        began = time.process_time()
        EnvironmentMap(ball, "sphere").convertTo("cube", 4 * _FACE)
        yield Figure("skylibs, 3 channels, unfiltered, CPU", time.process_time() - began, "s")
    if not shutil.which("pfspanoramic"):
        print("pfspanoramic is not installed (apt-get install pfstools): left out", file=sys.stderr)
        return
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "ball.pfs"
        height, width = ball.shape[:2]
        with file.open("wb") as out:  # pfs: a text header, then each channel by itself
            out.write(f"PFS1\n{width} {height}\n3\n0\n".encode())
            for name in "XYZ":
                out.write(f"{name}\n0\n".encode())
            out.write(b"ENDH")
            for channel in range(3):
                out.write(np.ascontiguousarray(ball[..., channel]).tobytes())
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        with file.open("rb") as source:
            done = subprocess.run(
                [
                    "pfspanoramic",
                    "mirrorball+polar",
                    "--width",
                    str(4 * _FACE),
                    "--height",
                    str(2 * _FACE),
                ],
                stdin=source,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                check=False,
            )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        print(f"pfspanoramic failed: {done.stderr.decode().strip()}", file=sys.stderr)
        return
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    yield Figure("pfspanoramic, 3 channels, unfiltered, to latlong 4096 x 2048, CPU", spent, "s")


DRAWS = 50
_SIZE, _STOPS = (240, 300), (-27, -21, -15, -9)  # a bracket of four, 2 EV apart


def _sigma() -> Iterator[Figure]:
    """Whether sigma is the spread over 50 captures of one world that differ in noise alone.

    Photon noise of a full well of 40000 electrons and 4 electrons of read noise; through merge,
    demosaic, unwrap, M_S and the sphere's reflectance. 50 draws know a spread to 10 %: of texels
    told exactly right, 14 % would be more than 15 % off.
    """
    camera, filters = sets.camera("nikon5100"), ("cyan", "yellow")
    glass = np.stack(
        [1 / (1 + np.exp((WAVELENGTHS - 585) / 12)), 1 / (1 + np.exp((485 - WAVELENGTHS) / 6))], 1
    )
    glass = Spectra(WAVELENGTHS, filters, 0.9 * glass)
    shifts = np.array([(0.0, 0.0), (0.6, -0.35)])
    seen_by = Camera.seeing(157.3, 113.6, 88.0, *_SIZE)
    world = smooth_world(5, degree=4.0, channels=2)
    day, lamp = (sets.lights("darling2011")[name] for name in ("D65", "A"))
    lights = np.stack([day / day.mean(), lamp / lamp.mean()])
    angles = np.linspace(0.0, np.pi / 2, 181)
    steel = metals.reflectance("stainless steel", angles).mean(axis=1)
    photographs = []
    for shift, name in zip(shifts, filters, strict=True):
        image = photograph(
            seen_by,
            world,
            lambda cosine: np.interp(np.arccos(np.clip(cosine, 0.0, 1.0)), angles, steel),
            tuple(shift),
            samples=1,
            rim_samples=3,
        )
        photographs.append(0.9 * image @ lights @ (camera.values * glass[name][:, None]))
    sphere = Sphere(seen_by.centre, seen_by.radius, seen_by.focal_px, (150.0, 120.0))
    places = Alignment(shifts, np.ones(2), np.zeros(2))
    known = computed(camera, glass, filter_names=list(filters))
    to_primaries = fit(known, primaries.load()).matrix
    n = 64
    reflectance = np.interp(sphere.incidence_angle(cube.directions(n)), angles, steel)
    correlation = np.kron(np.eye(2), BAYER_NOISE_CORRELATION)
    count, mean, square, told = 0, 0.0, 0.0, 0.0
    for seed in range(DRAWS):
        rng = np.random.default_rng(seed)
        images = [demosaic(merge(InMemory(_bracket(image, rng)))) for image in photographs]
        bands = unwrap(images, sphere, places, face_size=n, noise_area_px=BAYER_NOISE_AREA_PX)
        light = normalise(
            transform(bands, to_primaries, correlation),
            reflectance[..., None].astype(np.float32),
        )
        values = light.values.astype(np.float64)
        count += 1
        step = values - mean
        mean = mean + step / count
        square = square + step * (values - mean)
        told = told + light.variance
    known = np.isfinite(mean).all(axis=-1) & (bands.valid > 0.5)
    unbiased = 1.0 - 1.0 / (4.0 * (count - 1))
    ratio = (np.sqrt(square / (count - 1)) / unbiased / np.sqrt(told / count))[known]
    for i, channel in enumerate(ratio.T):
        name = f"sigma.P{i + 1} against the spread of {count} captures"
        yield Figure(f"{name}, median", float(np.median(channel)), "times", low=0.85, high=1.15)
        off = 100.0 * float(np.mean(np.abs(channel - 1.0) > 0.15))
        yield Figure(f"{name}, texels more than 15 % off", off, "%")


def _bracket(colours, rng) -> list[Frame]:
    """Raw RGGB exposures of an image (H, W, 3) in full scales per second."""
    mosaic = np.empty(colours.shape[:2])
    for row, column in np.ndindex(2, 2):
        mosaic[row::2, column::2] = colours[row::2, column::2, row + column]
    black, saturation, well, read = 512, 15800, 40000.0, 4.0
    frames = []
    for stop in _STOPS:
        time_s = 2.0 ** (stop / 3)
        electrons = rng.poisson(mosaic * time_s * well) + read * rng.standard_normal(mosaic.shape)
        raw = np.round(black + electrons / well * (saturation - black))
        levels = np.full((2, 2), float(black)), np.full((2, 2), float(saturation))
        samples = np.clip(raw, 0, saturation).astype(np.uint16)
        frames.append(Frame(samples, np.array([[0, 1], [1, 2]]), *levels, time_s, 100.0, 1.0))
    return frames
