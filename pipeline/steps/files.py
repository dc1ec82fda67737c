"""What the files that steps leave have in common: headers, and small records as JSON."""

from __future__ import annotations

import dataclasses
import json
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pipeline import digest, io
from pipeline.capture import Capture
from pipeline.files import header as headers
from pipeline.steps.step import Learnt
from stages.mirror import Sphere
from stages.region import Region
from stages.room import Room

ORIENTATION = (
    "faces px nx py ny pz nz stacked top to bottom, each as OpenGL's cube map table has it; +Y up,"
    " +Z from the sphere to the camera, +X right in the photograph; turned about +Y by yaw_deg"
)
LATLONG = "2:1, row 0 at +Y, centre column at -Z, +X right of the centre"


def channels(count: int) -> tuple[str, ...]:
    return tuple(f"P{i}" for i in range(1, count + 1))


def header_of(step: str) -> dict[str, str]:
    return {"step": step, "version": version("sixlight")}


def light_header(capture: Capture) -> dict[str, str]:
    """What a reader of the six channels must know, for the header of each EXR."""
    t, p = capture.transform, capture.primaries
    assert t is not None
    assert p is not None
    return headers.of_primaries(p, unit=t.units, quantity="light") | {
        "name": capture.name,
        "calibration": digest.of_values([t.channels, t.matrix.tolist(), t.primaries_digest]),
        "orientation": ORIENTATION,
        "yaw_deg": f"{capture.yaw_deg:g}",
    }


def write_fields(path: Path, value) -> Learnt:
    fields = dataclasses.asdict(value)
    io.write_json(path, fields)
    return fields


def read_fields(path: Path, kind):
    return kind(**json.loads(path.read_text(encoding="utf-8")))


def read_sphere(path: Path) -> Sphere:
    sphere = read_fields(path, Sphere)
    room: Any = sphere.room  # as JSON has it
    return sphere if room is None else dataclasses.replace(sphere, room=Room(**room))


def read_region(path: Path) -> Region:
    region = read_fields(path, Region)
    return dataclasses.replace(region, frame=tuple(region.frame))  # a list, as JSON has it
