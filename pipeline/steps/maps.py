"""From light to what people and programs open: export, preview, view, report."""

from __future__ import annotations

import json

from pipeline import io, previews
from pipeline.capture import Capture
from pipeline.compositions import compose
from pipeline.files import ktx2
from pipeline.report import envmap as report
from pipeline.settings import Settings
from pipeline.steps.files import LATLONG, light_header
from pipeline.steps.step import Learnt
from pipeline.viewer import page as viewer
from stages.export import export, triples
from stages.fill import fill
from stages.prefilter import prefilter


def export_given(capture: Capture, settings: Settings, index: int):
    return {"header": light_header(capture)}


def run_export(read, write, *, header) -> Learnt:
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
    io.write_measured(write[-1], maps.latlong, names, header | {"orientation": LATLONG})
    return {"half_float_scale": maps.scale}


def preview_given(capture: Capture, settings: Settings, index: int):
    return {
        "primaries": capture.primaries,
        "width": settings.preview_width,
        "samples": settings.preview_samples,
        "header": light_header(capture),
    }


def run_preview(read, write, *, primaries, width, samples, header) -> Learnt:
    light = fill(io.read_measured(read[0], cube=True)[0])
    rendering = previews.Rendering(width=width, samples=samples)
    drawn = previews.draw(light, primaries, compose("teapot", light, primaries), rendering)
    previews.write(write, drawn, header, rendering)
    return {"exposure_ev": drawn.figures["exposure_ev"]}


def run_report(read, write) -> Learnt:
    told, *_ = read
    result = json.loads(told.read_text(encoding="utf-8"))
    io.write_text(write[0], report.page(told.parent, result))
    return {}


def view_given(capture: Capture, settings: Settings, index: int):
    header = light_header(capture)
    return {"primaries": capture.primaries, "name": header["name"], "unit": header["unit"]}


def run_view(read, write, *, primaries, name, unit) -> Learnt:
    measured, _ = io.read_measured(read[0], cube=True)
    io.write_text(write[0], viewer.page(name, unit, measured, primaries))
    return {}
