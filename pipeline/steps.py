"""The steps of `sixlight envmap`, in order: STEPS, at the end, is the architecture.

A step reads files, calls one stage, and writes files. What it is given besides (numbers from the
capture, settings) comes from its `given`, and only from there, so that a result is made again
exactly when something it depends on has changed.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from calibration import metals
from pipeline import digest, io, previews
from pipeline import header as headers
from pipeline.bracket import Bracket, exposure
from pipeline.capture import Capture
from pipeline.compositions import compose
from pipeline.errors import InputError
from pipeline.settings import Settings
from stages import cube
from stages.align import Alignment, align
from stages.assess import assess, shared_noise
from stages.demosaic import demosaic
from stages.export import export, triples
from stages.fill import fill
from stages.locate import locate
from stages.merge import merge
from stages.mirror import Sphere
from stages.normalise import normalise, reflectance_at
from stages.transform import transform
from stages.unwrap import BAYER_NOISE_AREA_PX, default_face_size, unwrap

Learnt = Mapping[str, Any]


@dataclass(frozen=True)
class Step:
    """One step: what it reads and makes, and how.

    name, about  for people
    reads        files of the output folder; "raw" stands for a filter's photographs. A name with
                 {filter} stands for that filter's file, or for those of all filters; one with
                 {triple} for a file every three channels, named by them: 123, 456, 78
    makes        files of the output folder, named likewise
    given        plain values it needs besides, from the capture, the settings and, where it is
                 done for each filter, that filter's index
    run          (paths read, paths to write, **given) -> what it learnt, for the report
    for_each     done once for each filter
    calibrated   left out where the capture has no calibration
    """

    name: str
    about: str
    reads: tuple[str, ...]
    makes: tuple[str, ...]
    run: Callable[..., Learnt]
    given: Callable[[Capture, Settings, int], Mapping[str, Any]] = lambda c, s, i: {}
    for_each: bool = False
    calibrated: bool | None = None


def files_of(name: str, *, filters: Sequence[str], channels: int) -> list[str]:
    """The files a name in `reads` or `makes` stands for.

    filters   whose files {filter} stands for
    channels  how many {triple} deals into threes
    """
    if "{filter}" in name:
        return [name.format(filter=f) for f in filters]
    if "{triple}" in name:
        dealt = ("".join(str(i + 1) for i in triple) for triple in triples(channels))
        return [name.format(triple=numbers) for numbers in dealt]
    return [name]


# ------------------------------------------------------------------- develop and merge a bracket


def _exposures(capture: Capture, settings: Settings, index: int):
    return {"exposures": [exposure(shot) for shot in capture.filters[index].shots]}


def _merge(read, write, *, exposures) -> Learnt:
    try:
        radiance = merge(Bracket(read, exposures))
    except InputError as error:
        raise error.at(read[0].parent) from error
    io.write_radiance(write[0], radiance)
    return {
        "files": [path.name for path in read],
        "light_tagged": radiance.tagged,
        "light_solved": radiance.solved,
        "noise_gain_and_read": radiance.noise,
        "clipped": radiance.clipped,
        "lost": radiance.lost,
    }


def _demosaic(read, write) -> Learnt:
    image = demosaic(io.read_radiance(read[0]))
    io.write_measured(write[0], image, "RGB", _header("demosaic"), compression="none")
    return {}


# ------------------------------------------------------------------------------------- geometry


def _sphere_given(capture: Capture, settings: Settings, index: int):
    sphere = capture.sphere
    return {
        "radius_mm": sphere.radius_mm,
        "distance_mm": sphere.distance_mm,
        "focal_px": capture.focal_px,
        "outline": sphere.outline,
        "yaw_deg": capture.yaw_deg,
    }


def _locate(read, write, **given) -> Learnt:
    sphere = locate([io.read_measured(path)[0] for path in read], **given)
    return _write_fields(write[0], sphere)


def _align(read, write) -> Learnt:
    *images, sphere = read
    alignment = align([io.read_measured(p)[0] for p in images], _read_fields(sphere, Sphere))
    return _write_fields(write[0], alignment)


def _unwrap(read, write, *, face_size, names, header) -> Learnt:
    *images, sphere_file, alignment = read
    sphere = _read_fields(sphere_file, Sphere)
    bands = unwrap(
        [io.read_measured(p)[0] for p in images],
        sphere,
        _read_fields(alignment, Alignment),
        face_size=face_size or default_face_size(sphere),
        noise_area_px=BAYER_NOISE_AREA_PX,
    )
    io.write_measured(write[0], bands, names, header)
    return {"face_size": bands.values.shape[1], "seen": float(bands.valid.mean())}


def _bands_given(capture: Capture, settings: Settings, index: int):
    header = _header("unwrap") | {
        "name": capture.name,
        "unit": "camera signal of the light the sphere reflects, relative",
        "orientation": _ORIENTATION,
    }
    return {"face_size": settings.face_size, "names": capture.bands, "header": header}


# --------------------------------------------------------------------------------------- colour


def _primaries_given(capture: Capture, settings: Settings, index: int):
    t = capture.transform
    assert t is not None
    return {"matrix": t.matrix.tolist(), "header": _light_header(capture)}


def _transform(read, write, *, matrix, header) -> Learnt:
    bands, _ = io.read_measured(read[0], cube=True)
    light = transform(bands, matrix)
    io.write_measured(write[0], light, _channels(len(matrix)), header | {"step": "transform"})
    return {}


def _normalise_given(capture: Capture, settings: Settings, index: int):
    angles = np.linspace(0.0, np.pi / 2, 361)
    measured = capture.sphere.reflectance
    assert capture.primaries is not None
    assert capture.transform is not None
    table = metals.in_primaries(
        capture.primaries,
        angles,
        material=capture.sphere.material,
        curve=None if measured is None else metals.near_normal(measured),
    )
    return {
        "angles_rad": angles.tolist(),
        "reflectance": table.tolist(),
        "matrix": capture.transform.matrix.tolist(),
        "xyz_from_primaries": capture.primaries.xyz_from_primaries.tolist(),
        "header": _light_header(capture),
    }


def _normalise(
    read, write, *, angles_rad, reflectance, matrix, xyz_from_primaries, header
) -> Learnt:
    reflected, names = io.read_measured(read[0], cube=True)
    sphere = _read_fields(read[1], Sphere)
    n = reflected.values.shape[1]
    incidence = sphere.incidence_angle(cube.directions(n))
    of_texel = reflectance_at(incidence, angles_rad, reflectance)
    light = normalise(reflected, of_texel)
    io.write_measured(write[0], light, names, header | {"step": "normalise"})
    # The file keeps the primaries' variances alone; here the bands' are known, and with them all.
    bands, band_names = io.read_measured(read[2], cube=True)
    noise_area_px = [BAYER_NOISE_AREA_PX["RGB".index(name[-1])] for name in band_names]
    common = shared_noise(sphere, n, noise_area_px)
    noise = assess(bands, matrix, of_texel, xyz_from_primaries, common)
    return {
        "near_normal_reflectance": reflectance[0],
        "white_delta_e_noise": dataclasses.asdict(noise),
    }


# ------------------------------------------------------------------------------ maps and pictures


def _export_given(capture: Capture, settings: Settings, index: int):
    return {"header": _light_header(capture)}


def _export(read, write, *, header) -> Learnt:
    light, names = io.read_measured(read[0], cube=True)
    maps = export(light)
    header = header | {"step": "export"}
    dealt = triples(len(names))
    for path, triple, values in zip(write[:-1], dealt, maps.triples, strict=True):
        note = {
            "scale": f"{maps.scale:g}",
            "channels": " ".join(names[i] for i in triple),
            "filled": "holes are filled smoothly; cubemap.exr has only what was measured",
        }
        if len(triple) < 3:
            note["unused"] = " ".join("RGB"[len(triple) :]) + ", 0 everywhere"
        faces = values.reshape(-1, *values.shape[-2:])
        io.write_exr(path, faces, "RGB", header | note, half=True)
    io.write_measured(write[-1], maps.latlong, names, header | {"orientation": _LATLONG})
    return {"half_float_scale": maps.scale}


def _preview_given(capture: Capture, settings: Settings, index: int):
    return {
        "primaries": capture.primaries,
        "width": settings.preview_width,
        "samples": settings.preview_samples,
        "header": _light_header(capture),
    }


def _preview(read, write, *, primaries, width, samples, header) -> Learnt:
    light = fill(io.read_measured(read[0], cube=True)[0])
    rendering = previews.Rendering(width=width, samples=samples)
    drawn = previews.draw(light, primaries, compose("teapot", light, primaries), rendering)
    previews.write(write, drawn, header, rendering)
    return {"exposure_ev": drawn.figures["exposure_ev"]}


# --------------------------------------------------------------------------- small things shared

_ORIENTATION = (
    "faces px nx py ny pz nz stacked top to bottom, each as OpenGL's cube map table has it; +Y up,"
    " +Z from the sphere to the camera, +X right in the photograph; turned about +Y by yaw_deg"
)
_LATLONG = "2:1, row 0 at +Y, centre column at -Z, +X right of the centre"


def _channels(count: int) -> tuple[str, ...]:
    return tuple(f"P{i}" for i in range(1, count + 1))


def _header(step: str) -> dict[str, str]:
    return {"step": step, "version": version("sixlight")}


def _light_header(capture: Capture) -> dict[str, str]:
    """What a reader of the six channels must know, for the header of each EXR."""
    t, p = capture.transform, capture.primaries
    assert t is not None
    assert p is not None
    return headers.of_primaries(p, unit=t.units, quantity="light") | {
        "name": capture.name,
        "calibration": digest.of_values([t.channels, t.matrix.tolist(), t.primaries_digest]),
        "orientation": _ORIENTATION,
        "yaw_deg": f"{capture.yaw_deg:g}",
    }


def _write_fields(path: Path, value) -> Learnt:
    fields = dataclasses.asdict(value)
    io.write_json(path, fields)
    return fields


def _read_fields(path: Path, kind):
    return kind(**json.loads(path.read_text(encoding="utf-8")))


STEPS = (
    Step(
        "merge",
        "raw files of a bracket, developed one by one, to one HDR mosaic with its variance",
        reads=("raw",),
        makes=("work/merged_{filter}.npz",),
        given=_exposures,
        run=_merge,
        for_each=True,
    ),
    Step(
        "demosaic",
        "the mosaic to an image of three colours",
        reads=("work/merged_{filter}.npz",),
        makes=("work/image_{filter}.exr",),
        run=_demosaic,
        for_each=True,
    ),
    Step(
        "locate",
        "the sphere's rim, below a pixel, and with it the camera's place",
        reads=("work/image_{filter}.exr",),
        makes=("work/sphere.json",),
        given=_sphere_given,
        run=_locate,
    ),
    Step(
        "align",
        "the shift of each filter's image against the first",
        reads=("work/image_{filter}.exr", "work/sphere.json"),
        makes=("work/alignment.json",),
        run=_align,
    ),
    Step(
        "unwrap",
        "images straight into a cubemap of the camera's bands: the only resampling there is",
        reads=("work/image_{filter}.exr", "work/sphere.json", "work/alignment.json"),
        makes=("cubemap_bands.exr",),
        given=_bands_given,
        run=_unwrap,
    ),
    Step(
        "transform",
        "camera bands to rendering primaries: M_S",
        reads=("cubemap_bands.exr",),
        makes=("work/reflected.exr",),
        given=_primaries_given,
        run=_transform,
        calibrated=True,
    ),
    Step(
        "normalise",
        "the sphere's reflectance, by angle, divided out",
        reads=("work/reflected.exr", "work/sphere.json", "cubemap_bands.exr"),
        makes=("cubemap.exr",),
        given=_normalise_given,
        run=_normalise,
        calibrated=True,
    ),
    Step(
        "export",
        "RGB maps of three channels each, without holes, for renderers; and the latlong image",
        reads=("cubemap.exr",),
        makes=("cubemap_{triple}.exr", "latlong.exr"),
        given=_export_given,
        run=_export,
        calibrated=True,
    ),
    Step(
        "preview",
        "a teapot lit by the six channels, and by three beside it",
        reads=("cubemap.exr",),
        makes=("preview_teapot.png", "preview_teapot.exr"),
        given=_preview_given,
        run=_preview,
        calibrated=True,
    ),
)
