"""The steps of `sixlight envmap`, in order: STEPS, at the end, is the architecture.

A step reads files, calls one stage, and writes files. What it is given besides (numbers from the
capture, settings) comes from its `given`, and only from there, so that a result is made again
exactly when something it depends on has changed.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from calibration import bands as camera_bands
from calibration import chromaticity, estimate, metals, spectra, training
from calibration.display import SRGB
from pipeline import digest, io, ktx2, previews
from pipeline import header as headers
from pipeline.bracket import Bracket, exposure, frames
from pipeline.capture import Capture
from pipeline.compositions import compose
from pipeline.errors import InputError
from pipeline.report import envmap as report
from pipeline.settings import Settings
from pipeline.viewer import page as viewer
from stages import cube
from stages.align import Alignment, align
from stages.assess import assess, shared_noise
from stages.dark import dark_current, subtract
from stages.demosaic import demosaic
from stages.drift import drift, worth_telling
from stages.export import export, triples
from stages.fill import fill
from stages.find import find
from stages.flat import flatten, response
from stages.illuminants import Illuminant, illuminants, impossible
from stages.join import join
from stages.locate import locate
from stages.lost import lost, lost_share
from stages.lost import warnings as warnings_of_lost
from stages.mask import Mask, leave_out
from stages.merge import merge, warnings
from stages.mirror import Sphere
from stages.normalise import normalise, reflectance_at
from stages.orient import orient
from stages.orient import warnings as warnings_of_views
from stages.overlay import overlay
from stages.prefilter import prefilter
from stages.region import Region
from stages.room import Room
from stages.scale import Scale, scale, scaled
from stages.scale import warnings as warnings_of_scale
from stages.sensitivity import sensitivity
from stages.transform import transform
from stages.types import Measured
from stages.unwrap import (
    BAYER_NOISE_AREA_PX,
    BAYER_NOISE_CORRELATION,
    default_face_size,
    unwrap,
)

Learnt = Mapping[str, Any]


@dataclass(frozen=True)
class Step:
    """One step: what it reads and makes, and how.

    name, about  for people
    reads        files of the output folder; "raw" stands for a filter's photographs, "dark" and
                 "flat" for those that show the sensor. A name with {filter} stands for that
                 filter's file, or for those of all filters; one with {view} likewise, see
                 `files_of`; one with {triple} for a file every three channels, named by them: 123,
                 456, 78
    makes        files of the output folder, named likewise
    given        plain values it needs besides, from the capture, the settings and, where it is
                 done for each filter, that filter's index
    run          (paths read, paths to write, **given) -> what it learnt, for the report
    for_each     done once for each filter
    each_view    done once for each view, with what the capture is of that view alone
    several      left out where there is but one view
    calibrated   left out where the capture has no calibration
    """

    name: str
    about: str
    reads: tuple[str, ...]
    makes: tuple[str, ...]
    run: Callable[..., Learnt]
    given: Callable[[Capture, Settings, int], Mapping[str, Any]] = lambda c, s, i: {}
    for_each: bool = False
    each_view: bool = False
    several: bool = False
    calibrated: bool | None = None


def files_of(
    name: str, *, filters: Sequence[str], channels: int, views: Sequence[str | None] = (None,)
) -> list[str]:
    """The files a name in `reads` or `makes` stands for.

    filters   whose files {filter} stands for
    channels  how many {triple} deals into threes
    views     whose files {view} stands for; None alone where there is but one view, which files
              are not named by. Files of one view among several all lie in work/. {sphere} is what
              tells where the sphere is: as `locate` found it, or turned by `orient` to the others
    """
    if "{view}" in name:
        of_views = []
        for view in views:
            one = name.replace("{sphere}", "sphere" if view is None else "oriented")
            one = one.replace("{view}", "" if view is None else f"_{view}")
            one = one if view is None else f"work/{one.removeprefix('work/')}"
            of_views += files_of(one, filters=filters, channels=channels)
        return of_views
    if "{filter}" in name:
        return [name.format(filter=f) for f in filters]
    if "{triple}" in name:
        dealt = ("".join(str(i + 1) for i in triple) for triple in triples(channels))
        return [name.format(triple=numbers) for numbers in dealt]
    return [name]


# ------------------------------------------------------------------- develop and merge a bracket

_BRIGHT = 0.7  # of the way from the shortest exposure to the longest: the sphere's rim shows there


def _find_given(capture: Capture, settings: Settings, index: int):
    """The photographs to look at, by their place among all: a bright one through each filter."""
    look_at, first = {}, 0
    for f in capture.filters:
        by_light = sorted(range(len(f.shots)), key=[shot.light for shot in f.shots].__getitem__)
        bright = by_light[round(_BRIGHT * (len(by_light) - 1))]
        look_at[first + bright] = exposure(f.shots[bright])
        first += len(f.shots)
    sphere = capture.sphere
    return {
        "look_at": look_at,
        "frame_size": capture.shots[0].size,
        "radius_mm": sphere.radius_mm,
        "distance_mm": sphere.distance_mm,
        "focal_px": capture.focal_px,
        "outline": sphere.outline,
    }


def _find(read, write, *, look_at, **given) -> Learnt:
    photographs = frames([read[i] for i in look_at], list(look_at.values()))
    with closing(photographs):
        found = find(photographs, **given)
    _write_fields(write[0], found.region)
    return {"rim": found.rim, "photographs": found.tried, "share": found.region.share}


def _exposures(capture: Capture, settings: Settings, index: int):
    f, of = capture.filters[index], capture.of_sensor
    return {
        "exposures": [exposure(shot) for shot in f.shots],
        "dark": [exposure(shot) for shot in of.dark],
        "flat": [exposure(shot) for shot in of.flat.get(f.name, ())],
        "known": capture.known,
    }


def _merge(read, write, *, exposures, dark, flat, known) -> Learnt:
    files = iter(read)
    read, dark_files, flat_files = ([next(files) for _ in some] for some in (exposures, dark, flat))
    folder, region = write[0].parent, _read_region(next(files))

    def merged(files, given):
        try:
            return merge(Bracket(files, given, folder, region), known)
        except InputError as error:
            raise error.at(files[0].parent) from error

    radiance = merged(read, exposures)
    if dark:
        longest = max(range(len(exposures)), key=lambda k: exposures[k]["time_s"])
        gain = radiance.noise[longest][0] * 100 / exposures[longest]["iso"]
        current = dark_current(Bracket(dark_files, dark, folder, region), gain)
        radiance = subtract(radiance, current, exposures[longest]["f_number"])
    if flat:
        radiance = flatten(radiance, response(merged(flat_files, flat)))
    io.write_radiance(write[0], radiance)
    names = [path.name for path in read]
    return {
        "files": names,
        "dark_frames": len(dark),
        "flat_frames": len(flat),
        "light_tagged": radiance.tagged,
        "light_solved": radiance.solved,
        "noise_gain_and_read": radiance.noise,
        "prnu": radiance.prnu,
        "photon_transfer": radiance.transfer,
        "clipped": radiance.clipped,
        "lost": radiance.lost.mean(),
        "lost_is_at_least": radiance.at_least,
        "defective": radiance.defective.mean(),
        "moved": radiance.moved.mean(),
        "notes": warnings(radiance, names),
    }


def _scale_given(capture: Capture, settings: Settings, index: int):
    return {"filters": [name for name, _ in capture.brackets]}


def _scale(read, write, *, filters) -> Learnt:
    found = scale([io.read_lights(path) for path in read])
    return {**_write_fields(write[0], found), "notes": warnings_of_scale(found, filters)}


def _demosaic_given(capture: Capture, settings: Settings, index: int):
    return {"index": capture.brackets_before + index, "mask": dataclasses.asdict(capture.mask)}


def _demosaic(read, write, *, index, mask) -> Learnt:
    factor = _read_fields(read[1], Scale).factors[index]
    image = demosaic(scaled(io.read_radiance(read[0]), factor))
    image = leave_out(image, Mask(**mask), _read_region(read[2]))
    io.write_measured(write[0], image, "RGB", _header("demosaic"), compression="none")
    return {}


# ------------------------------------------------------------------------------------- geometry


def _sphere_given(capture: Capture, settings: Settings, index: int):
    sphere = capture.sphere
    angles = np.pi / 2 * (1.0 - np.linspace(1.0, 0.0, 181) ** 3)  # densest where the rim is
    by_wavelength = metals.of_sphere(sphere.material, sphere.reflectance, angles)
    return {
        "reflectance": (angles.tolist(), by_wavelength.mean(axis=1).tolist()),
        "radius_mm": sphere.radius_mm,
        "distance_mm": sphere.distance_mm,
        "focal_px": capture.focal_px,
        "outline": sphere.outline,
        "distortion": capture.distortion,
        "yaw_deg": capture.yaw_deg,
        "room": None if capture.room is None else dataclasses.asdict(capture.room),
    }


def _locate(read, write, *, room, reflectance, **given) -> Learnt:
    *files, region_file = read
    images, region = [io.read_measured(path)[0] for path in files], _read_region(region_file)
    angles, factors = (np.array(v) for v in reflectance)
    sphere = locate(
        images,
        room=None if room is None else Room(**room),
        reflectance=(angles, factors),
        region=region,
        **given,
    )
    io.write_picture(write[1], overlay(images[0], sphere, region), SRGB)
    moved = sensitivity(sphere, distance_known=given["distance_mm"] is not None)
    return {**_write_fields(write[0], sphere), "directions_move_by_degrees": moved}


def _align(read, write) -> Learnt:
    *images, sphere, region_file = read
    region = _read_region(region_file)
    seen = region.inside(_read_sphere(sphere))
    alignment = align([io.read_measured(p)[0] for p in images], seen)
    return _write_fields(write[0], alignment.with_shift(region.origin_px))


def _unwrap(read, write, *, face_size, filters, brackets_before, names, header) -> Learnt:
    count = len(filters)
    images, merged = read[:count], read[count : 2 * count]
    sphere_file, alignment_file, region_file, scale_file = read[2 * count :]
    region = _read_region(region_file)
    sphere = region.inside(_read_sphere(sphere_file))
    x, y = region.origin_px
    alignment = _read_fields(alignment_file, Alignment).with_shift((-x, -y))
    face_size = face_size or default_face_size(sphere)
    bands = unwrap(
        [io.read_measured(p)[0] for p in images],
        sphere,
        alignment,
        face_size=face_size,
        noise_area_px=BAYER_NOISE_AREA_PX,
    )
    factors = _read_fields(scale_file, Scale).factors[brackets_before:]
    saturated = [io.read_saturated(p) for p in merged]
    found = []
    for i, one in enumerate(saturated):
        scaled_one = dataclasses.replace(one, at_least=one.at_least * factors[i])
        own = slice(3 * i, 3 * i + 3)
        known = Measured(bands.values[..., own], bands.variance[..., own], bands.valid)
        found.append(lost(scaled_one, sphere, alignment, i, known))
    share = lost_share(saturated, sphere, alignment, face_size=face_size)
    io.write_measured(write[0], bands, names, header, beside={"lost": share})
    return {
        "face_size": face_size,
        "seen": float(bands.valid.mean()),
        "lost": {name: dataclasses.asdict(one) for name, one in zip(filters, found, strict=True)},
        "notes": warnings_of_lost(found, filters),
    }


def _orient_given(capture: Capture, settings: Settings, index: int):
    return {
        "names": [view.name for view in capture.views],
        "places": [view.place for view in capture.views],
        "folders": [
            str(view.filters[0].shots[0].path.parent.relative_to(capture.folder))
            for view in capture.views
        ],
        "reflectance": _sphere_given(capture, settings, index)["reflectance"],
    }


def _orient(read, write, *, names, places, folders, reflectance) -> Learnt:
    count = len(names)
    every = len(read) // count - 2  # images of a view; the first filter's is looked at
    images, sphere_files, region_files = (
        read[: every * count : every],
        read[every * count : -count],
        read[-count:],
    )
    spheres = [_read_sphere(path) for path in sphere_files]
    seen = [
        _read_region(path).inside(sphere)
        for path, sphere in zip(region_files, spheres, strict=True)
    ]
    angles, factors = (np.array(v) for v in reflectance)
    try:
        found = orient(
            [io.read_measured(path)[0] for path in images],
            seen,
            names=names,
            places=places,
            reflectance=(angles, factors),
        )
    except InputError as error:
        raise error.at(Path(folders[0]).parent) from error
    for path, sphere, view in zip(write, spheres, found.views, strict=True):
        _write_fields(path, dataclasses.replace(sphere, turn=view.turn))
    views = dict(zip(names, map(dataclasses.asdict, found.views), strict=True))
    return {
        "views": views,
        "nearness_per_m": found.nearness_per_m,
        "notes": warnings_of_views(found, names),
    }


def _bands_given(capture: Capture, settings: Settings, index: int):
    header = _header("unwrap") | {
        "name": capture.name,
        "unit": "camera signal of the light the sphere reflects, relative",
        "orientation": _ORIENTATION,
    }
    return {
        "face_size": settings.face_size,
        "filters": [f.name for f in capture.filters],
        "brackets_before": capture.brackets_before,
        "names": capture.bands,
        "header": header,
    }


def _drift_given(capture: Capture, settings: Settings, index: int):
    c, filters = capture.calibration, [f.name for f in capture.filters]
    sensitivities = None
    if c.camera is not None and c.filters is not None:
        camera = spectra.read_spectra(c.camera, "power")
        glass = spectra.read_spectra(c.filters, "fraction")
        sensitivities = camera_bands.sensitivities(camera, glass, filters)[1].tolist()
    t = capture.transform
    signals = None if t is None or t.signals is None else t.signals.tolist()
    return {"filters": filters, "sensitivities": sensitivities, "signals": signals}


def _drift(read, write, *, filters, sensitivities, signals) -> Learnt:
    """sensitivities, or signals of a chart: what light looks like to the bands, None if unknown."""
    bands, names = io.read_measured(read[0], cube=True)
    noise_area_px = [BAYER_NOISE_AREA_PX["RGB".index(name[-1])] for name in names]
    common = shared_noise(_read_sphere(read[1]), bands.values.shape[1], noise_area_px)
    known = None
    if sensitivities is not None:
        lights, surfaces = training.checked(None, None)
        known = training.lit(lights.values.T, training.with_white(surfaces)[0]) @ sensitivities
    elif signals is not None:
        known = np.array(signals)
    changes = drift(bands, common=common, known=known)
    later = filters[1:]
    header = _header("drift") | {
        "orientation": _ORIENTATION,
        "unit": f"log_ratio: ln of the light in this filter's photographs over {filters[0]}'s;"
        " significance: that in standard deviations",
    }
    maps = [m for c in changes for m in (c.log_ratio, c.log_ratio / c.sigma)]
    channels = [f"{name}.{what}" for name in later for what in ("log_ratio", "significance")]
    faces = np.stack(maps, axis=-1)
    io.write_exr(write[0], faces.reshape(-1, *faces.shape[-2:]), channels, header)
    return {
        "against": filters[0],
        "absolute": any(change.overall is not None for change in changes),
        "filters": {
            name: {
                "share_of_light": change.share,
                "largest_ratio": change.largest,
                "direction": change.direction,
                "overall_ratio": change.overall,
                "overall_log_sigma": change.overall_log_sigma,
            }
            for name, change in zip(later, changes, strict=True)
        },
        "notes": worth_telling(changes, filters),
    }


# --------------------------------------------------------------------------------------- colour


def _primaries_given(capture: Capture, settings: Settings, index: int):
    t = capture.transform
    assert t is not None
    return {"matrix": t.matrix.tolist(), "header": _light_header(capture)}


def _transform(read, write, *, matrix, header) -> Learnt:
    bands, _ = io.read_measured(read[0], cube=True)
    # Each filter's photographs have noise of their own.
    correlation = np.kron(np.eye(bands.values.shape[-1] // 3), BAYER_NOISE_CORRELATION)
    light = transform(bands, matrix, correlation)
    io.write_measured(write[0], light, _channels(len(matrix)), header | {"step": "transform"})
    return {}


def _normalise_given(capture: Capture, settings: Settings, index: int):
    angles = np.linspace(0.0, np.pi / 2, 361)
    sphere = capture.sphere
    assert capture.primaries is not None
    assert capture.transform is not None
    table = metals.in_primaries(
        capture.primaries, angles, material=sphere.material, known=sphere.reflectance
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
    sphere = _read_sphere(read[1])
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


def _join_given(capture: Capture, settings: Settings, index: int):
    return {"names": [view.name for view in capture.views], "header": _light_header(capture)}


def _join(read, write, *, names, header) -> Learnt:
    lights, spheres = read[: len(names)], read[len(names) :]
    views = [io.read_measured(path, cube=True) for path in lights]
    joined = join([light for light, _ in views], [_read_sphere(path) for path in spheres])
    io.write_measured(write[0], joined.light, views[0][1], header | {"step": "join"})
    return {
        "share_of_directions": dict(zip(names, joined.shares, strict=True)),
        "removed": dict(zip(names, joined.removed, strict=True)),
        "seen": float(joined.light.valid.mean()),
    }


def _illuminants_given(capture: Capture, settings: Settings, index: int):
    return {"primaries": capture.primaries}


def _illuminants(read, write, *, primaries) -> Learnt:
    light, _ = io.read_measured(read[0], cube=True)
    found = illuminants(light, primaries.xyz_from_primaries[1])
    names = *(f"light {i}" for i in range(1, len(found))), "everything else"
    spectrum_of = estimate.spectra_from_primaries(primaries)
    estimated = np.stack([spectrum_of @ f.light for f in found], axis=1)
    spectra.write_spectra(write[0], spectra.Spectra(spectra.WAVELENGTHS, names, estimated))
    return {
        "lights": [
            {"name": name, **dataclasses.asdict(f), **_colour_of(primaries.xyz_from_primaries, f)}
            for name, f in zip(names, found, strict=True)
        ],
        "share_of_impossible_colour": impossible(light, primaries.xyz_from_primaries),
    }


def _colour_of(xyz_from_primaries, light: Illuminant) -> Learnt:
    xyz = xyz_from_primaries @ light.light
    white = chromaticity.temperature(xyz)
    return {
        "xyz": xyz,
        "xy": chromaticity.chromaticity(xyz),
        "temperature_k": None if white is None else white.kelvin,
        "duv": None if white is None else white.duv,
    }


# ------------------------------------------------------------------------------ maps and pictures


def _export_given(capture: Capture, settings: Settings, index: int):
    return {"header": _light_header(capture)}


def _export(read, write, *, header) -> Learnt:
    light, names = io.read_measured(read[0], cube=True)
    maps = export(light)
    header = header | {"step": "export"}
    dealt = triples(len(names))
    images, textures = write[: len(dealt)], write[len(dealt) : -1]
    for path, texture, triple, values in zip(images, textures, dealt, maps.triples, strict=True):
        note = {
            "scale": f"{maps.scale:g}",
            "channels": " ".join(names[i] for i in triple),
            "filled": "holes are filled smoothly; cubemap.exr has only what was measured",
        }
        if len(triple) < 3:
            note["unused"] = " ".join("RGB"[len(triple) :]) + ", 0 everywhere"
        faces = values.reshape(-1, *values.shape[-2:])
        io.write_exr(path, faces, "RGB", header | note, half=True)
        ktx2.write(texture, prefilter(values), header | note)
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


def _report(read, write) -> Learnt:
    told, *_ = read
    result = json.loads(told.read_text(encoding="utf-8"))
    io.write_text(write[0], report.page(told.parent, result))
    return {}


def _view_given(capture: Capture, settings: Settings, index: int):
    header = _light_header(capture)
    return {"primaries": capture.primaries, "name": header["name"], "unit": header["unit"]}


def _view(read, write, *, primaries, name, unit) -> Learnt:
    measured, _ = io.read_measured(read[0], cube=True)
    io.write_text(write[0], viewer.page(name, unit, measured, primaries))
    return {}


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


def _read_sphere(path: Path) -> Sphere:
    sphere = _read_fields(path, Sphere)
    room: Any = sphere.room  # as JSON has it
    return sphere if room is None else dataclasses.replace(sphere, room=Room(**room))


def _read_region(path: Path) -> Region:
    region = _read_fields(path, Region)
    return dataclasses.replace(region, frame=tuple(region.frame))  # a list, as JSON has it


STEPS = (
    Step(
        "find",
        "the part of the photographs that holds the sphere, roughly: only that is merged",
        reads=("raw",),
        makes=("work/region{view}.json",),
        given=_find_given,
        run=_find,
        each_view=True,
    ),
    Step(
        "merge",
        "raw files of a bracket, developed one by one, to one HDR mosaic with its variance",
        reads=("raw", "dark", "flat", "work/region{view}.json"),
        makes=("work/merged{view}_{filter}.npz",),
        given=_exposures,
        run=_merge,
        for_each=True,
        each_view=True,
    ),
    Step(
        "scale",
        "one scale for all filters: whether the shutter keeps to its tags or to powers of two",
        reads=("work/merged{view}_{filter}.npz",),
        makes=("work/scale.json",),
        given=_scale_given,
        run=_scale,
    ),
    Step(
        "demosaic",
        "the mosaic to an image of three colours",
        reads=("work/merged{view}_{filter}.npz", "work/scale.json", "work/region{view}.json"),
        makes=("work/image{view}_{filter}.exr",),
        given=_demosaic_given,
        run=_demosaic,
        for_each=True,
        each_view=True,
    ),
    Step(
        "locate",
        "the sphere's rim, below a pixel, and with it the camera's place",
        reads=("work/image{view}_{filter}.exr", "work/region{view}.json"),
        makes=("work/sphere{view}.json", "sphere{view}.png"),
        given=_sphere_given,
        run=_locate,
        each_view=True,
    ),
    Step(
        "align",
        "the shift of each filter's image against the first",
        reads=("work/image{view}_{filter}.exr", "work/sphere{view}.json", "work/region{view}.json"),
        makes=("work/alignment{view}.json",),
        run=_align,
        each_view=True,
    ),
    Step(
        "orient",
        "how several cameras about the sphere lie to each other: one world for all views",
        reads=("work/image{view}_{filter}.exr", "work/sphere{view}.json", "work/region{view}.json"),
        makes=("work/{sphere}{view}.json",),
        given=_orient_given,
        run=_orient,
        several=True,
    ),
    Step(
        "unwrap",
        "images straight into a cubemap of the camera's bands: the only resampling there is",
        reads=(
            "work/image{view}_{filter}.exr",
            "work/merged{view}_{filter}.npz",
            "work/{sphere}{view}.json",
            "work/alignment{view}.json",
            "work/region{view}.json",
            "work/scale.json",
        ),
        makes=("cubemap_bands{view}.exr",),
        given=_bands_given,
        run=_unwrap,
        each_view=True,
    ),
    Step(
        "drift",
        "whether the light changed between one filter's photographs and another's",
        reads=("cubemap_bands{view}.exr", "work/{sphere}{view}.json"),
        makes=("work/drift{view}.exr",),
        given=_drift_given,
        run=_drift,
        each_view=True,
    ),
    Step(
        "transform",
        "camera bands to rendering primaries: M_S",
        reads=("cubemap_bands{view}.exr",),
        makes=("work/reflected{view}.exr",),
        given=_primaries_given,
        run=_transform,
        calibrated=True,
        each_view=True,
    ),
    Step(
        "normalise",
        "the sphere's reflectance, by angle, divided out",
        reads=("work/reflected{view}.exr", "work/{sphere}{view}.json", "cubemap_bands{view}.exr"),
        makes=("cubemap{view}.exr",),
        given=_normalise_given,
        run=_normalise,
        calibrated=True,
        each_view=True,
    ),
    Step(
        "join",
        "the views made one map, without what stood before one of the cameras",
        reads=("cubemap{view}.exr", "work/{sphere}{view}.json"),
        makes=("cubemap.exr",),
        given=_join_given,
        run=_join,
        several=True,
        calibrated=True,
    ),
    Step(
        "illuminants",
        "what the light comes from: windows, lamps; their colours and spectra as estimated",
        reads=("cubemap.exr",),
        makes=("illuminants.csv",),
        given=_illuminants_given,
        run=_illuminants,
        calibrated=True,
    ),
    Step(
        "export",
        "RGB maps of three channels each, without holes, for renderers; and the latlong image",
        reads=("cubemap.exr",),
        makes=("cubemap_{triple}.exr", "cubemap_{triple}.ktx2", "latlong.exr"),
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
    Step(
        "view",
        "one page that renders the capture live in a browser",
        reads=("cubemap.exr",),
        makes=("viewer.html",),
        given=_view_given,
        run=_view,
        calibrated=True,
    ),
    Step(
        "report",
        "one page of what was read, how it went, and what to distrust",
        reads=(
            "result.json",
            "sphere{view}.png",
            "work/drift{view}.exr",
            "work/merged{view}_{filter}.npz",
        ),
        makes=("report.html",),
        run=_report,
    ),
)
