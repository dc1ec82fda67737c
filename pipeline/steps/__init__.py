"""The steps of `sixlight envmap`, in order: STEPS is the architecture.

A step reads files, calls one stage, and writes files. What it is given besides (numbers from the
capture, settings) comes from its `given`, and only from there, so that a result is made again
exactly when something it depends on has changed. What each does lies in the modules beside this
one, in the same order.
"""

from __future__ import annotations

from pipeline.steps import bracket, colour, geometry, maps
from pipeline.steps.step import Learnt, Step, files_of

__all__ = ["STEPS", "Learnt", "Step", "files_of"]

STEPS = (
    Step(
        "find",
        "the part of the photographs that holds the sphere, roughly: only that is merged",
        reads=("raw",),
        makes=("work/region{view}.json",),
        given=bracket.find_given,
        run=bracket.run_find,
        each_view=True,
    ),
    Step(
        "merge",
        "raw files of a bracket, developed one by one, to one HDR mosaic with its variance",
        reads=("raw", "dark", "flat", "work/region{view}.json"),
        makes=("work/merged{view}_{filter}.npz",),
        given=bracket.merge_given,
        run=bracket.run_merge,
        for_each=True,
        each_view=True,
    ),
    Step(
        "scale",
        "one scale for all filters: whether the shutter keeps to its tags or to powers of two",
        reads=("work/merged{view}_{filter}.npz",),
        makes=("work/scale.json",),
        given=bracket.scale_given,
        run=bracket.run_scale,
    ),
    Step(
        "demosaic",
        "the mosaic to an image of three colours",
        reads=("work/merged{view}_{filter}.npz", "work/scale.json", "work/region{view}.json"),
        makes=("work/image{view}_{filter}.exr",),
        given=bracket.demosaic_given,
        run=bracket.run_demosaic,
        for_each=True,
        each_view=True,
    ),
    Step(
        "locate",
        "the sphere's rim, below a pixel, and with it the camera's place",
        reads=("work/image{view}_{filter}.exr", "work/region{view}.json"),
        makes=("work/sphere{view}.json", "sphere{view}.png"),
        given=geometry.locate_given,
        run=geometry.run_locate,
        each_view=True,
    ),
    Step(
        "align",
        "the shift of each filter's image against the first",
        reads=("work/image{view}_{filter}.exr", "work/sphere{view}.json", "work/region{view}.json"),
        makes=("work/alignment{view}.json",),
        run=geometry.run_align,
        each_view=True,
    ),
    Step(
        "orient",
        "how several cameras about the sphere lie to each other: one world for all views",
        reads=("work/image{view}_{filter}.exr", "work/sphere{view}.json", "work/region{view}.json"),
        makes=("work/{sphere}{view}.json",),
        given=geometry.orient_given,
        run=geometry.run_orient,
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
        given=geometry.unwrap_given,
        run=geometry.run_unwrap,
        each_view=True,
    ),
    Step(
        "drift",
        "whether the light changed between one filter's photographs and another's",
        reads=("cubemap_bands{view}.exr", "work/{sphere}{view}.json"),
        makes=("work/drift{view}.exr",),
        given=colour.drift_given,
        run=colour.run_drift,
        each_view=True,
    ),
    Step(
        "transform",
        "camera bands to rendering primaries: M_S",
        reads=("cubemap_bands{view}.exr",),
        makes=("work/reflected{view}.exr",),
        given=colour.transform_given,
        run=colour.run_transform,
        calibrated=True,
        each_view=True,
    ),
    Step(
        "normalise",
        "the sphere's reflectance, by angle, divided out",
        reads=("work/reflected{view}.exr", "work/{sphere}{view}.json", "cubemap_bands{view}.exr"),
        makes=("cubemap{view}.exr",),
        given=colour.normalise_given,
        run=colour.run_normalise,
        calibrated=True,
        each_view=True,
    ),
    Step(
        "join",
        "the views made one map, without what stood before one of the cameras",
        reads=("cubemap{view}.exr", "work/{sphere}{view}.json"),
        makes=("cubemap.exr",),
        given=colour.join_given,
        run=colour.run_join,
        several=True,
        calibrated=True,
    ),
    Step(
        "illuminants",
        "what the light comes from: windows, lamps; their colours and spectra as estimated",
        reads=("cubemap.exr",),
        makes=("illuminants.csv",),
        given=colour.illuminants_given,
        run=colour.run_illuminants,
        calibrated=True,
    ),
    Step(
        "export",
        "RGB maps of three channels each, without holes, for renderers; and the latlong image",
        reads=("cubemap.exr",),
        makes=("cubemap_{triple}.exr", "cubemap_{triple}.ktx2", "latlong.exr"),
        given=maps.export_given,
        run=maps.run_export,
        calibrated=True,
    ),
    Step(
        "preview",
        "a teapot lit by the six channels, and by three beside it",
        reads=("cubemap.exr",),
        makes=("preview_teapot.png", "preview_teapot.exr"),
        given=maps.preview_given,
        run=maps.run_preview,
        calibrated=True,
    ),
    Step(
        "view",
        "one page that renders the capture live in a browser",
        reads=("cubemap.exr",),
        makes=("viewer.html",),
        given=maps.view_given,
        run=maps.run_view,
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
        run=maps.run_report,
    ),
)
