"""Captures whose truth is known: photographs of a rendered room, and the light that was there.

    simulate("room", Path("capture"), quality="draft")

writes a capture folder as a photographer would bring it home - raw brackets through two filters, a
chart session - and beside it, in `truth/`, what a perfect pipeline would make of it.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from calibration.errors import fault
from calibration.spectra import WAVELENGTHS

SCENES = ("room",)

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Quality:
    """How finely a scene is computed.

    spacing        metres between the points on surfaces where light is found
    rays           from each of them, to other surfaces and to the lights
    subpixels      along a pixel's side in the photographs, one ray each
    truth_size     texels along a face of the six-channel truth; the spectral one has half
    truth_samples  rays a texel
    """

    spacing: float
    rays: int
    subpixels: int
    truth_size: int
    truth_samples: int


QUALITIES = {
    "draft": Quality(spacing=0.1, rays=32, subpixels=2, truth_size=128, truth_samples=4),
    "full": Quality(spacing=0.05, rays=192, subpixels=4, truth_size=128, truth_samples=64),
}

MARGIN = 6  # px rendered around the photograph, for what the lens blurs into it


def simulate(
    scene: str,
    out: Path,
    *,
    quality: str | Quality = "full",
    seed: int = 1,
    progress: Progress = lambda line: None,
) -> None:
    """Write a simulated capture into the folder `out`, which must not exist yet.

    scene     one of SCENES
    quality   one of QUALITIES, or a Quality
    progress  called with a line now and then
    """
    if scene not in SCENES:
        raise fault(f"no scene is called {scene}", ", ".join(SCENES), "name one of these")
    if isinstance(quality, str):
        if quality not in QUALITIES:
            raise fault(
                f"no quality is called {quality}", ", ".join(QUALITIES), "name one of these"
            )
        quality = QUALITIES[quality]
    if out.exists():
        raise fault("it is there already", "a new folder", "name another or remove it", out)
    from pipeline.simulate.materials import require
    from pipeline.simulate.render import mitsuba

    require("imagecodecs")  # what is missing is said before the work, not after
    mitsuba()
    partial = out.with_name(f".{out.name}.{os.getpid()}")
    try:
        _room(partial, quality, seed, progress)
        os.replace(partial, out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _room(out: Path, quality: Quality, seed: int, progress: Progress) -> None:
    from pipeline.simulate import camera as cameras
    from pipeline.simulate import room
    from pipeline.simulate.chart import photograph_chart
    from pipeline.simulate.dng import Shot, write_dng
    from pipeline.simulate.light import bake
    from pipeline.simulate.render import cubemap, photograph

    out.mkdir(parents=True)
    camera = cameras.Camera()
    view = room.view(camera)
    start = datetime(2026, 3, 14, 16, 20)
    matrix, neutral = _converter_hints(camera)

    def write(path: Path, raw, by, shutter, number: int) -> None:
        taken_at = start + timedelta(seconds=20 * number)
        write_dng(path, raw, by, Shot(shutter.tag, taken_at, neutral), matrix)

    photograph_chart(out / "calibration", camera, write, seed=seed)
    progress("chart: five lights, two filters")

    lit = bake(
        room.sphere_on_stand(), spacing=quality.spacing, samples=quality.rays, seed=seed,
        progress=progress,
    )  # fmt: skip

    weights = {name: cameras.responses_to_rendered(camera, name) for name in cameras.FILTERS}
    images: dict[str, Any] = dict.fromkeys(cameras.FILTERS, 0.0)
    for first, image in photograph(
        lit, view, subpixels=quality.subpixels, margin=MARGIN, samples=1, seed=seed,
        progress=progress,
    ):  # fmt: skip
        for name, weight in weights.items():
            images[name] = images[name] + image @ weight[first : first + 3].astype(np.float32)
    rng = np.random.default_rng(seed)
    taken = 100  # after the chart
    for name, shift in cameras.FILTER_SHIFTS.items():
        electrons = cameras.through_lens(images[name], camera, quality.subpixels, MARGIN, shift)
        (out / name).mkdir()
        for number, shutter in enumerate(cameras.BRACKET):
            raw = cameras.expose(cameras.mosaic(electrons), shutter.time_s, camera, rng)
            write(out / name / f"{name}_{number + 1:02d}.dng", raw, camera, shutter, taken)
            taken += 1
        progress(f"{name}: {len(cameras.BRACKET)} exposures")

    spectral = cubemap(
        room.without_sphere(lit), np.array(view.sphere), view.world_axes,
        face_size=quality.truth_size, samples=quality.truth_samples, seed=seed, progress=progress,
    )  # fmt: skip
    _write_truth(out / "truth", spectral, view, camera)
    (out / "capture.toml").write_text(CAPTURE_TOML)
    (out / "README.md").write_text(README)


def _converter_hints(camera) -> tuple[np.ndarray, tuple[float, float, float]]:
    """For raw converters: ColorMatrix1 (3, 3), camera from XYZ, and a neutral's signals (3,).

    Through the cyan filter under D65; the photographs are not made to be looked at.
    """
    from pipeline.simulate.camera import responses
    from pipeline.simulate.materials import checker_patches, lamp, xyz

    radiance = (lamp("D65")[:, None] * checker_patches()).T
    signals = radiance @ responses(camera, "cyan")
    white = lamp("D65") @ responses(camera, "cyan")
    matrix, *_ = np.linalg.lstsq(xyz(radiance), signals / white.max(), rcond=None)
    red, green, blue = white / white.max()
    return matrix.T, (float(red), float(green), float(blue))


def _write_truth(folder: Path, spectral, view, camera) -> None:
    """spectral.exr, cubemap.exr and geometry.toml; see README."""
    import tomli_w

    from calibration import primaries
    from pipeline.io import write_exr
    from pipeline.simulate import camera as cameras
    from pipeline.simulate.room import visible

    folder.mkdir()
    known = visible(view, spectral.shape[1]).astype(np.float32)
    named = primaries.load("darling2011")
    units = {"units": "W/(sr m2 nm)", "orientation": ORIENTATION}
    n = spectral.shape[1] // 2
    halved = spectral.reshape(6, n, 2, n, 2, -1).mean(axis=(2, 4))
    names = [f"{w:.0f}nm" for w in WAVELENGTHS]
    write_exr(folder / "spectral.exr", _stacked(halved), names, units, compression="pxr24")
    six = np.concatenate([named.project(spectral), known[..., None]], axis=-1)
    write_exr(
        folder / "cubemap.exr", _stacked(six), [*named.channels, "valid"],
        units | {"primaries": named.name}, compression="pxr24",
    )  # fmt: skip
    x, y, radius = view.rim()
    centre = view.camera_axes @ np.subtract(view.sphere, view.eye)
    geometry: dict[str, Any] = {
        "distance_mm": round(1000 * view.distance, 6),
        "focal_px": view.focal_px,
        "principal_point_px": [view.width / 2, view.height / 2],
        "sphere": {
            "radius_mm": 1000 * view.radius,
            "centre_mm": [float(v) for v in 1000 * centre],
            "image_of_centre_px": list(view.project(view.sphere)),
        },
        "world_from_camera": (view.world_axes @ view.camera_axes.T).tolist(),
        "filter": [
            {
                "name": name,
                "shift_px": list(shift),
                "outline_px": [x + shift[0], y + shift[1], radius],
                "shutters_s": [shutter.time_s for shutter in cameras.BRACKET],
                "tags_s": [shutter.tag[0] / shutter.tag[1] for shutter in cameras.BRACKET],
            }
            for name, shift in cameras.FILTER_SHIFTS.items()
        ],
    }
    (folder / "geometry.toml").write_text(GEOMETRY_HEAD + tomli_w.dumps(geometry))


def _stacked(cube) -> np.ndarray:
    """A cubemap's faces (6, N, N, C) top to bottom (6 N, N, C)."""
    return cube.reshape(-1, *cube.shape[2:])


ORIENTATION = "faces +X -X +Y -Y +Z -Z as OpenGL's; +Z to the camera, +Y up; origin sphere centre"

GEOMETRY_HEAD = """\
# Where everything was. Camera frame: x right, y down, z along the optical axis, millimetres.
# Pixels: the first one's centre is at (0.5, 0.5). outline_px is x, y, radius of the sphere's rim.
# shutters_s is how long the shutter was really open, tags_s what the files say.
"""

CAPTURE_TOML = """\
name = "living room, window and reading lamp (simulated)"

[[filter]]
name = "cyan"
files = "cyan/*"

[[filter]]
name = "yellow"
files = "yellow/*"

[sphere]
radius_mm = 50.0
distance_mm = 1500.0
material = "stainless steel"

[camera]
focal_length_mm = 100.0
pixel_pitch_um = 8.0

[room]                      # by tape, to the nearest 5 cm
size_m = [4.8, 2.6, 5.8]
sphere_m = [2.3, 1.25, 2.6]
camera_m = [2.3, 1.35, 4.1]

[calibration]
transform = "M_S.toml"
"""

README = """\
# A simulated capture

Made by `sixlight simulate room`: nothing in it was photographed.

- `cyan/`, `yellow/`: nine raw exposures each of a steel sphere in a living room, 1/1000 to 10 s at
  f/16.
- `calibration/`: a ColorChecker under five lights through the same filters, with spectroradiometer
  readings.
- `truth/`: `spectral.exr` is the light at the sphere's centre at 36 wavelengths (faces of 64, named
  by wavelength), `cubemap.exr` the same in six channels P1..P6 (faces of 128) with `valid` 0 where
  the sphere cannot show it: behind itself and where its stand is. `geometry.toml` says where things
  were.

Radiance is in W/(sr m2 nm). The room is rendered with Mitsuba 3 from measured reflectances and
lamps of colour-science (New BSD) and n, k of steel of refractiveindex.info (CC0).
"""
