"""A small capture from three sides: the world of `small_capture`, and in each view who took it.

Camera, tripod and photographer stand before each view's own camera, and nowhere in the truth.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import small_capture as small
import sphere_tracer
from scipy.spatial.transform import Rotation

from calibration import sets
from calibration.spectra import write_spectra
from stages.mirror import Sphere
from stages.types import Measured

# From each view's world to the first's: cameras 120 degrees apart, not quite level, nor upright.
TURNS = {
    "front": np.eye(3),
    "right": Rotation.from_euler("YXZ", [117.0, -4.0, 1.5], degrees=True).as_matrix(),
    "left": Rotation.from_euler("YXZ", [-124.0, 3.0, -1.0], degrees=True).as_matrix(),
}
PLACES = {"front": (157.3, 113.6), "right": (146.2, 121.9), "left": (151.0, 118.4)}  # px
CLOTH = np.array([0.05, 0.02])  # of the two lights, what photographer and camera send back


def amount(directions):
    """Of daylight and of tungsten (n, 2) from directions (n, 3) of the first view's world."""
    light = sphere_tracer.smooth_world(seed=9, degree=10.0, channels=2)(directions)
    return light * np.stack([1.2 - directions[:, 0], 1.2 + directions[:, 0]], axis=1)


def lights():
    """The two lights (2, 36), of mean 1."""
    day, lamp = (sets.lights("darling2011")[name] for name in ("D65", "A"))
    return np.stack([day / day.mean(), lamp / lamp.mean()])


def world(directions):
    """Spectral radiance (n, 36) of the world without photographers."""
    return amount(directions) @ lights()


def someone(directions):
    """Whether camera, tripod or photographer (n,) are in directions of a view's own world."""
    x, y, z = directions.T
    azimuth, height = np.degrees(np.arctan2(x, z)), np.degrees(np.arcsin(np.clip(y, -1, 1)))
    body = (np.abs(azimuth - 11) < 6) & (height > -45) & (height < 9)
    head = np.hypot(azimuth - 11, height - 13) < 5
    camera = (np.abs(azimuth) < 3) & (np.abs(height) < 2.5)
    leg = (np.abs(azimuth) < 0.8) & (height < 0) & (height > -45)
    return body | head | camera | leg


def photographed(camera, world, turn, *, gain=1.0, seed=0, rim_samples=4):
    """What a camera of `sphere_tracer` takes of a world (n, 3) -> (n, C), whoever took it in front.

    turn     (3, 3) from the view's own world to `world`'s
    returns  the image, with .4 % noise, and where the sphere is in it
    """

    def own(directions):
        light = world(directions @ turn.T)
        light[someone(directions)] = 0.1
        return gain * light

    chromium = sphere_tracer.chromium
    image = sphere_tracer.photograph(camera, own, chromium, samples=2, rim_samples=rim_samples)
    variance = (0.004 * image) ** 2 + 1e-7 * image.mean() ** 2
    image = image + np.random.default_rng(seed).normal(size=image.shape) * np.sqrt(variance)
    middle = camera.width / 2, camera.height / 2
    sphere = Sphere(camera.centre, camera.radius, camera.focal_px, middle)
    known = np.ones(image.shape[:2], np.float32)
    return Measured(image.astype(np.float32), variance.astype(np.float32), known), sphere


def seen(turn, signal):
    """What a view's camera has about it (n, 6), each light for each band, in its own world.

    signal  (2, 3) of each band in one of each light
    """

    def own(directions):
        light = amount(directions @ turn.T)
        light[someone(directions)] = CLOTH
        return np.repeat(light, 3, axis=-1) * signal.ravel()

    return own


def _by_angle(angles, table):
    """The function of cosines (n,) that reads a table (K, 2, 3) by angle: (n, 6)."""

    def reflected(cosine):
        at = np.arccos(np.clip(cosine, 0.0, 1.0))
        return np.stack([np.interp(at, angles, t) for t in table.reshape(len(table), -1).T], -1)

    return reflected


def make(folder: Path, *, hints: bool = False, turns=TURNS) -> Path:
    """Writes the capture: front/cyan/ ..., C.csv, F.csv, capture.toml. Returns the folder."""
    rng = np.random.default_rng(21)
    camera, filters = small.sensitivities(), small.transmittances()
    views = ""
    for view, turn in turns.items():
        seeing = sphere_tracer.Camera.seeing(
            *PLACES[view], 88.0, *small.SIZE, small.DISTANCE_MM, small.RADIUS_MM
        )
        for name, shift in small.SHIFTS.items():
            bands = camera.values * filters[name][:, None] * 0.9  # full scales per second
            # Traced for each light and band at once, in place of 36 wavelengths.
            angles = np.linspace(0.0, np.pi / 2, 181)
            by_angle = np.einsum("lw,kw,wc->klc", lights(), small.steel(np.cos(angles)), bands)

            bare = by_angle[-1]  # as everything, steel reflects all of the light that grazes it
            image = sphere_tracer.photograph(
                seeing, seen(turn, bare), _by_angle(angles, by_angle / bare), shift, rim_samples=5
            )
            colours = image.reshape(*image.shape[:2], 2, 3).sum(axis=2)
            (folder / view / name).mkdir(parents=True)
            for i, (time_s, tag) in enumerate(zip(small.TIMES_S, small.TAGS, strict=True)):
                raw = small.samples(colours, time_s, rng)
                small.write_shot(folder / view / name / f"{i}.dng", raw, tag)
        views += f'[[view]]\nname = "{view}"\n'
        if hints and view != "front":
            x, y, z = turn[:, 2]
            views += f"yaw_deg = {np.degrees(np.arctan2(x, z)) + 12:.1f}\n"
            views += f"pitch_deg = {np.degrees(np.arcsin(y)) - 5:.1f}\n"
    write_spectra(folder / "C.csv", camera)
    write_spectra(folder / "F.csv", filters)
    (folder / "capture.toml").write_text(
        f'name = "three sides"\n[sphere]\nradius_mm = {small.RADIUS_MM}\n'
        f'distance_mm = {small.DISTANCE_MM}\nmaterial = "stainless steel"\n'
        f'[calibration]\ncamera = "C.csv"\nfilters = "F.csv"\n{views}'
    )
    return folder
