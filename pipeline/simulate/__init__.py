"""Captures whose truth is known: photographs of a rendered room, and the light that was there.

    simulate("room", Path("capture"), quality="draft")

writes a capture folder as a photographer would bring it home - raw brackets through two filters, a
chart session - and beside it, in `truth/`, what a perfect pipeline would make of it.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
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
    width          px of the photographs; fewer are larger ones, of the same sensor
    """

    spacing: float
    rays: int
    subpixels: int
    truth_size: int
    truth_samples: int
    width: int = 1024


QUALITIES = {
    "small": Quality(0.25, rays=16, subpixels=2, truth_size=64, truth_samples=16, width=384),
    "draft": Quality(spacing=0.1, rays=32, subpixels=2, truth_size=128, truth_samples=4),
    "full": Quality(spacing=0.05, rays=192, subpixels=4, truth_size=128, truth_samples=64),
}

MOST_VIEWS = 12
MARGIN = 6  # px rendered around the photograph, for what the lens blurs into it


def simulate(
    scene: str,
    out: Path,
    *,
    quality: str | Quality = "full",
    views: int = 1,
    seed: int = 1,
    progress: Progress = lambda line: None,
) -> None:
    """Write a simulated capture into the folder `out`, which must not exist yet.

    scene     one of SCENES
    quality   one of QUALITIES, or a Quality
    views     positions the sphere is photographed from, evenly about it; of several, camera and
              photographer are to be seen in each, and M_S comes from known sensitivities
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
    if not 1 <= views <= MOST_VIEWS:
        raise fault(f"{views} views", f"1 to {MOST_VIEWS}", "ask for so many")
    if out.exists():
        raise fault("it is there already", "a new folder", "name another or remove it", out)
    from pipeline.simulate.materials import require
    from pipeline.simulate.render import mitsuba

    require("imagecodecs")  # what is missing is said before the work, not after
    mitsuba()
    partial = out.with_name(f".{out.name}.{os.getpid()}")
    try:
        if views == 1:
            _room(partial, quality, seed, progress)
        else:
            _room_from_all_sides(partial, quality, views, seed, progress)
        os.replace(partial, out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _room(out: Path, quality: Quality, seed: int, progress: Progress) -> None:
    from pipeline.simulate import camera as cameras
    from pipeline.simulate import room
    from pipeline.simulate.chart import photograph_chart
    from pipeline.simulate.light import bake
    from pipeline.simulate.render import cubemap

    out.mkdir(parents=True)
    camera = cameras.Camera.of_width(quality.width)
    view = room.view(camera)
    write = _Writer(camera)
    photograph_chart(out / "calibration", camera, write, seed=seed)
    progress("chart: five lights, two filters")

    lit = bake(
        room.sphere_on_stand(), spacing=quality.spacing, samples=quality.rays, seed=seed,
        progress=progress,
    )  # fmt: skip
    _photograph(out, lit, view, camera, quality, write, 100, seed, progress)
    spectral = cubemap(
        room.without_sphere(lit), np.array(view.sphere), view.world_axes,
        face_size=quality.truth_size, samples=quality.truth_samples, seed=seed, progress=progress,
    )  # fmt: skip
    _write_truth(out / "truth", spectral, [view], camera)
    filters = [f'[[filter]]\nname = "{name}"\nfiles = "{name}/*"\n' for name in cameras.FILTERS]
    (out / "capture.toml").write_text(_capture(camera, filters, 'transform = "M_S.toml"'))
    (out / "README.md").write_text(README)


def _room_from_all_sides(
    out: Path, quality: Quality, count: int, seed: int, progress: Progress
) -> None:
    """The same from several sides: each view a folder, whoever took it in the photographs.

    They cast no shadow on the room, nor colour, so that its truth is one for all views.
    """
    from calibration.spectra import Spectra, write_spectra
    from pipeline.simulate import camera as cameras
    from pipeline.simulate import room
    from pipeline.simulate.light import bake
    from pipeline.simulate.photographer import photographer
    from pipeline.simulate.render import cubemap

    out.mkdir(parents=True)
    camera = cameras.Camera.of_width(quality.width)
    views = [room.view(camera, 360.0 * k / count) for k in range(count)]
    scene = room.sphere_on_stand()
    lit = bake(scene, spacing=quality.spacing, samples=quality.rays, seed=seed, progress=progress)
    people = [photographer(view) for view in views]
    crowded = scene | {"surfaces": [*scene["surfaces"], *(s for one in people for s in one)]}
    # How they look hardly matters: a quarter of the light's detail does.
    with_people = bake(
        crowded, spacing=max(0.25, quality.spacing), samples=16, seed=seed, progress=progress
    )["surfaces"][len(scene["surfaces"]) :]
    write = _Writer(camera)
    for k, view in enumerate(views):
        progress(f"view {k + 1} of {count}")
        own, with_people = with_people[: len(people[k])], with_people[len(people[k]) :]
        _photograph(
            out / f"view{k + 1}", lit | {"surfaces": [*lit["surfaces"], *own]}, view, camera,
            quality, write, 100 * (k + 1), seed + k, progress,
        )  # fmt: skip
    spectral = cubemap(
        room.without_sphere(lit), np.array(views[0].sphere), views[0].world_axes,
        face_size=quality.truth_size, samples=quality.truth_samples, seed=seed, progress=progress,
    )  # fmt: skip
    _write_truth(out / "truth", spectral, views, camera)
    names = tuple("RGB")
    write_spectra(out / "C.csv", Spectra(WAVELENGTHS, names, cameras.sensitivities(WAVELENGTHS)))
    glass = [cameras.transmittance(name, WAVELENGTHS) for name in cameras.FILTERS]
    write_spectra(out / "F.csv", Spectra(WAVELENGTHS, cameras.FILTERS, np.stack(glass, axis=1)))
    tables = [f'[[view]]\nname = "view{k + 1}"\n' for k in range(count)]
    known = 'camera = "C.csv"\nfilters = "F.csv"'
    (out / "capture.toml").write_text(_capture(camera, tables, known))
    (out / "README.md").write_text(README_OF_VIEWS)


def _capture(camera, tables: Sequence[str], calibration: str) -> str:
    """capture.toml, with tables of filters or views, and what is in [calibration]."""
    return CAPTURE_TOML.format(
        tables="\n".join(tables),
        pixel_pitch_um=round(camera.pixel_pitch_um, 4),
        calibration=calibration,
    )


class _Writer:
    """Writes raw files, twenty seconds from one to the next."""

    def __init__(self, camera) -> None:
        self.matrix, self.neutral = _converter_hints(camera)

    def __call__(self, path: Path, raw, by, shutter, number: int) -> None:
        from pipeline.simulate.dng import Shot, write_dng

        taken_at = datetime(2026, 3, 14, 16, 20) + timedelta(seconds=20 * number)
        write_dng(path, raw, by, Shot(shutter.tag, taken_at, self.neutral), self.matrix)


def _photograph(
    out: Path, lit, view, camera, quality: Quality, write, taken: int, seed: int,
    progress: Progress,
) -> None:  # fmt: skip
    """The brackets of one view through all filters: `out`/cyan/cyan_01.dng ...

    taken  photographs taken before
    """
    from pipeline.simulate import camera as cameras
    from pipeline.simulate.render import photograph

    weights = {name: cameras.responses_to_rendered(camera, name) for name in cameras.FILTERS}
    images: dict[str, Any] = dict.fromkeys(cameras.FILTERS, 0.0)
    for first, image in photograph(
        lit, view, subpixels=quality.subpixels, margin=MARGIN, samples=1, seed=seed,
        progress=progress,
    ):  # fmt: skip
        for name, weight in weights.items():
            images[name] = images[name] + image @ weight[first : first + 3].astype(np.float32)
    rng = np.random.default_rng(seed)
    for name, shift in cameras.FILTER_SHIFTS.items():
        electrons = cameras.through_lens(images[name], camera, quality.subpixels, MARGIN, shift)
        (out / name).mkdir(parents=True)
        for number, shutter in enumerate(cameras.BRACKET):
            raw = cameras.expose(cameras.mosaic(electrons), shutter.time_s, camera, rng)
            write(out / name / f"{name}_{number + 1:02d}.dng", raw, camera, shutter, taken)
            taken += 1
        progress(f"{name}: {len(cameras.BRACKET)} exposures")


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


def _write_truth(folder: Path, spectral, views, camera) -> None:
    """spectral.exr, cubemap.exr and geometry.toml; see README.

    views  of which the first one's world is the truth's
    """
    import tomli_w

    from calibration import primaries
    from pipeline.io import write_exr
    from pipeline.simulate.room import visible

    folder.mkdir()
    axes = views[0].world_axes
    known = np.any([visible(view, spectral.shape[1], axes) for view in views], axis=0)
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
    geometry = _geometry(views[0])
    if len(views) > 1:
        geometry["view"] = [
            {"name": f"view{k}"}
            | {"first_from_own": (axes @ view.world_axes.T).tolist()}
            | _geometry(view)
            for k, view in enumerate(views, 1)
        ]
    (folder / "geometry.toml").write_text(GEOMETRY_HEAD + tomli_w.dumps(geometry))


def _geometry(view) -> dict[str, Any]:
    """Where everything was when a view was taken."""
    from pipeline.simulate import camera as cameras

    x, y, radius = view.rim()
    centre = view.camera_axes @ np.subtract(view.sphere, view.eye)
    return {
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


def _stacked(cube) -> np.ndarray:
    """A cubemap's faces (6, N, N, C) top to bottom (6 N, N, C)."""
    return cube.reshape(-1, *cube.shape[2:])


ORIENTATION = "faces +X -X +Y -Y +Z -Z as OpenGL's; +Z to the camera, +Y up; origin sphere centre"

GEOMETRY_HEAD = """\
# Where everything was. Camera frame: x right, y down, z along the optical axis, millimetres.
# Pixels: the first one's centre is at (0.5, 0.5). outline_px is x, y, radius of the sphere's rim.
# first_from_own turns directions of a view's own world into the first view's.
# shutters_s is how long the shutter was really open, tags_s what the files say.
"""

CAPTURE_TOML = """\
name = "living room, window and reading lamp (simulated)"

{tables}
[sphere]
radius_mm = 50.0
distance_mm = 1500.0
material = "stainless steel"

[camera]
focal_length_mm = 100.0
pixel_pitch_um = {pixel_pitch_um}

[room]                      # by tape, to the nearest 5 cm
size_m = [4.8, 2.6, 5.8]
sphere_m = [2.3, 1.25, 2.6]
camera_m = [2.3, 1.35, 4.1]

[calibration]
{calibration}
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

README_OF_VIEWS = """\
# A simulated capture from several sides

Made by `sixlight simulate room --views`: nothing in it was photographed.

- `view1/`, `view2/`, ...: raw exposures of a steel sphere in a living room, each from another side,
  through two filters; camera, tripod and photographer are to be seen in the sphere.
- `C.csv`, `F.csv`: what the camera and the filters are sensitive to.
- `truth/`: the light at the sphere's centre, without anybody, in the first view's world:
  `spectral.exr` at 36 wavelengths, `cubemap.exr` in six channels P1..P6 with `valid` 0 where no
  view can show it. `geometry.toml` says where things were, `first_from_own` how each view lies.

Radiance is in W/(sr m2 nm). The room is rendered with Mitsuba 3 from measured reflectances and
lamps of colour-science (New BSD) and n, k of steel of refractiveindex.info (CC0).
"""
