"""A small capture of a known world, for the tests of the whole: rays, spectra, sensor, DNG.

The world is a smooth mixture of daylight and tungsten; the photographs are traced ray by ray in
36 wavelengths, through the curves of a Nikon D5100 and of two filters like BG39 and GG475.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import plain_dng
import sphere_tracer

from calibration import metals, sets
from calibration.spectra import WAVELENGTHS, Spectra, write_spectra

SIZE = (240, 300)  # height, width
RADIUS_MM, DISTANCE_MM = 50.0, 1500.0
SHIFTS = {"cyan": (0.0, 0.0), "yellow": (0.6, -0.35)}
TIMES_S = tuple(2.0 ** (k / 3) for k in (-27, -21, -15, -9))
TAGS = ((1, 500), (1, 125), (1, 30), (1, 8))
BLACK, SATURATION = 512, 15800
CAMERA = sphere_tracer.Camera.seeing(157.3, 113.6, 88.0, *SIZE, DISTANCE_MM, RADIUS_MM)


def sensitivities() -> Spectra:
    """R, G, B of a real camera."""
    return sets.camera("nikon5100")


def transmittances() -> Spectra:
    """The two filters."""
    cyan = 0.9 / (1 + np.exp((WAVELENGTHS - 585) / 12))
    yellow = 0.9 / (1 + np.exp((485 - WAVELENGTHS) / 6))
    return Spectra(WAVELENGTHS, ("cyan", "yellow"), np.stack([cyan, yellow], axis=1))


def world(directions):
    """Spectral radiance (n, 36) from directions (n, 3): daylight one way, tungsten the other."""
    lights = sets.lights("darling2011")
    day, lamp = lights["D65"], lights["A"]
    amount = sphere_tracer.smooth_world(seed=5, degree=4.0, channels=2)(directions)
    amount = amount * np.stack([1.2 - directions[:, 0], 1.2 + directions[:, 0]], axis=1)
    return amount @ np.stack([day / day.mean(), lamp / lamp.mean()])


def steel(cosine):
    """Reflectance (n, 36) of the sphere at cosines of incidence (n,)."""
    angles = np.linspace(0.0, np.pi / 2, 181)
    table = metals.reflectance("stainless steel", angles)
    place = np.arccos(np.clip(cosine, 0.0, 1.0)) / (np.pi / 2) * 180
    low = np.minimum(place.astype(int), 179)
    share = (place - low)[:, None]
    return table[low] * (1 - share) + table[low + 1] * share


def samples(colours, time_s: float, rng) -> np.ndarray:
    """Raw RGGB samples of an image (H, W, 3) in full scales per second."""
    mosaic = np.empty(SIZE)
    for row in (0, 1):
        for column in (0, 1):
            mosaic[row::2, column::2] = colours[row::2, column::2, row + column]
    full_well, read_noise = 40000.0, 4.0
    electrons = rng.poisson(mosaic * time_s * full_well) + read_noise * rng.standard_normal(SIZE)
    raw = BLACK + electrons / full_well * (SATURATION - BLACK)
    return np.clip(np.round(raw), 0, SATURATION).astype(np.uint16)


def make(folder: Path) -> Path:
    """Writes the capture: cyan/, yellow/, C.csv, F.csv, capture.toml. Returns the folder."""
    rng = np.random.default_rng(20)
    for name in SHIFTS:
        shoot(folder, name, rng)
    write_spectra(folder / "C.csv", sensitivities())
    write_spectra(folder / "F.csv", transmittances())
    (folder / "capture.toml").write_text(
        f'name = "small"\n[sphere]\nradius_mm = {RADIUS_MM}\ndistance_mm = {DISTANCE_MM}\n'
        'material = "stainless steel"\n[calibration]\ncamera = "C.csv"\nfilters = "F.csv"\n'
    )
    return folder


def shoot(
    folder: Path, name: str, rng, *, world=world, camera=CAMERA, glass=None, level=0.9
) -> None:
    """Writes the bracket of one filter.

    glass  transmittance (36,) in front of the lens; None: that filter's
    level  full scales a second of a light of 1
    """
    transmittance = transmittances()[name] if glass is None else glass
    image = sphere_tracer.photograph(camera, world, steel, SHIFTS[name])
    colours = image @ (sensitivities().values * transmittance[:, None]) * level
    (folder / name).mkdir(parents=True, exist_ok=True)
    for i, (time_s, tag) in enumerate(zip(TIMES_S, TAGS, strict=True)):
        write_shot(folder / name / f"{name}_{i}.dng", samples(colours, time_s, rng), tag)


def write_shot(path: Path, raw, tag=(1, 30), **tags) -> None:
    """One DNG of the tests' camera."""
    plain_dng.write(path, raw, black_level=BLACK, saturation_level=SATURATION, time_s=tag, **tags)
