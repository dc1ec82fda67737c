"""From raw files to one image a filter: find, merge, scale, demosaic."""

from __future__ import annotations

import dataclasses
from contextlib import closing

from pipeline import io
from pipeline.bracket import Bracket, exposure, frames
from pipeline.capture import Capture
from pipeline.errors import InputError
from pipeline.settings import Settings
from pipeline.steps.files import header_of, read_fields, read_region, write_fields
from pipeline.steps.step import Learnt
from stages.dark import dark_current, subtract
from stages.demosaic import demosaic
from stages.find import find
from stages.flat import flatten, response
from stages.mask import Mask, leave_out
from stages.merge import merge, warnings
from stages.scale import Scale, scale, scaled
from stages.scale import warnings as warnings_of_scale

_BRIGHT = 0.7  # of the way from the shortest exposure to the longest: the sphere's rim shows there


def find_given(capture: Capture, settings: Settings, index: int):
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


def run_find(read, write, *, look_at, **given) -> Learnt:
    photographs = frames([read[i] for i in look_at], list(look_at.values()))
    with closing(photographs):
        found = find(photographs, **given)
    write_fields(write[0], found.region)
    return {"rim": found.rim, "photographs": found.tried, "share": found.region.share}


def merge_given(capture: Capture, settings: Settings, index: int):
    f, of = capture.filters[index], capture.of_sensor
    return {
        "exposures": [exposure(shot) for shot in f.shots],
        "dark": [exposure(shot) for shot in of.dark],
        "flat": [exposure(shot) for shot in of.flat.get(f.name, ())],
        "known": capture.known,
    }


def run_merge(read, write, *, exposures, dark, flat, known) -> Learnt:
    files = iter(read)
    read, dark_files, flat_files = ([next(files) for _ in some] for some in (exposures, dark, flat))
    folder, region = write[0].parent, read_region(next(files))

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


def scale_given(capture: Capture, settings: Settings, index: int):
    return {"filters": [name for name, _ in capture.brackets]}


def run_scale(read, write, *, filters) -> Learnt:
    found = scale([io.read_lights(path) for path in read])
    return {**write_fields(write[0], found), "notes": warnings_of_scale(found, filters)}


def demosaic_given(capture: Capture, settings: Settings, index: int):
    return {"index": capture.brackets_before + index, "mask": dataclasses.asdict(capture.mask)}


def run_demosaic(read, write, *, index, mask) -> Learnt:
    factor = read_fields(read[1], Scale).factors[index]
    image = demosaic(scaled(io.read_radiance(read[0]), factor))
    image = leave_out(image, Mask(**mask), read_region(read[2]))
    io.write_measured(write[0], image, "RGB", header_of("demosaic"), compression="none")
    return {}
