"""From images to a cubemap of the camera's bands: locate, align, orient, unwrap."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from calibration import metals
from calibration.display import SRGB
from pipeline import io
from pipeline.capture import Capture
from pipeline.errors import InputError
from pipeline.settings import Settings
from pipeline.steps.files import (
    ORIENTATION,
    header_of,
    read_fields,
    read_region,
    read_sphere,
    write_fields,
)
from pipeline.steps.step import Learnt
from stages.align import Alignment, align
from stages.locate import locate
from stages.lost import lost, lost_share
from stages.lost import warnings as warnings_of_lost
from stages.orient import orient
from stages.orient import warnings as warnings_of_views
from stages.overlay import overlay
from stages.room import Room
from stages.scale import Scale
from stages.sensitivity import sensitivity
from stages.types import Measured
from stages.unwrap import BAYER_NOISE_AREA_PX, default_face_size, unwrap


def locate_given(capture: Capture, settings: Settings, index: int):
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


def run_locate(read, write, *, room, reflectance, **given) -> Learnt:
    *files, region_file = read
    images, region = [io.read_measured(path)[0] for path in files], read_region(region_file)
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
    return {**write_fields(write[0], sphere), "directions_move_by_degrees": moved}


def run_align(read, write) -> Learnt:
    *images, sphere, region_file = read
    region = read_region(region_file)
    seen = region.inside(read_sphere(sphere))
    alignment = align([io.read_measured(p)[0] for p in images], seen)
    return write_fields(write[0], alignment.with_shift(region.origin_px))


def run_unwrap(read, write, *, face_size, filters, brackets_before, names, header) -> Learnt:
    count = len(filters)
    images, merged = read[:count], read[count : 2 * count]
    sphere_file, alignment_file, region_file, scale_file = read[2 * count :]
    region = read_region(region_file)
    sphere = region.inside(read_sphere(sphere_file))
    x, y = region.origin_px
    alignment = read_fields(alignment_file, Alignment).with_shift((-x, -y))
    face_size = face_size or default_face_size(sphere)
    bands = unwrap(
        [io.read_measured(p)[0] for p in images],
        sphere,
        alignment,
        face_size=face_size,
        noise_area_px=BAYER_NOISE_AREA_PX,
    )
    factors = read_fields(scale_file, Scale).factors[brackets_before:]
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


def orient_given(capture: Capture, settings: Settings, index: int):
    return {
        "names": [view.name for view in capture.views],
        "places": [view.place for view in capture.views],
        "folders": [
            str(view.filters[0].shots[0].path.parent.relative_to(capture.folder))
            for view in capture.views
        ],
        "reflectance": locate_given(capture, settings, index)["reflectance"],
    }


def run_orient(read, write, *, names, places, folders, reflectance) -> Learnt:
    count = len(names)
    every = len(read) // count - 2  # images of a view; the first filter's is looked at
    images, sphere_files, region_files = (
        read[: every * count : every],
        read[every * count : -count],
        read[-count:],
    )
    spheres = [read_sphere(path) for path in sphere_files]
    seen = [
        read_region(path).inside(sphere) for path, sphere in zip(region_files, spheres, strict=True)
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
        write_fields(path, dataclasses.replace(sphere, turn=view.turn))
    views = dict(zip(names, map(dataclasses.asdict, found.views), strict=True))
    return {
        "views": views,
        "nearness_per_m": found.nearness_per_m,
        "notes": warnings_of_views(found, names),
    }


def unwrap_given(capture: Capture, settings: Settings, index: int):
    header = header_of("unwrap") | {
        "name": capture.name,
        "unit": "camera signal of the light the sphere reflects, relative",
        "orientation": ORIENTATION,
    }
    return {
        "face_size": settings.face_size,
        "filters": [f.name for f in capture.filters],
        "brackets_before": capture.brackets_before,
        "names": capture.bands,
        "header": header,
    }
