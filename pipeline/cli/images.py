"""What is made of a finished map: pictures, pages, other layouts, spectra."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pipeline.cli.shared import (
    AdaptWord,
    DegreeOfAdaptation,
    DisplayWord,
    ExposureWord,
    Force,
    Json,
    Quiet,
    ToneWord,
    WhiteWord,
    app,
    as_json,
    say_notes,
)


@app.command()
def preview(
    envmap: Annotated[Path, typer.Argument(help="Folder or cubemap.exr `envmap` wrote.")],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="Folder for the pictures [ENVMAP]; or turntable.mp4."),
    ] = None,
    scene: Annotated[
        str,
        typer.Option(
            help="teapot, colorchecker, roughness, metamers, probe, a mesh (.obj, .glb, ...) or "
            "a scene file (.toml)."
        ),
    ] = "teapot",
    channels: Annotated[
        str, typer.Option(help="compare (six beside three), six, sharp or xyz.")
    ] = "compare",
    width: Annotated[int, typer.Option(min=64, max=8192, help="Of the whole, px.")] = 1280,
    facing: Annotated[
        float, typer.Option(help="Where the viewer stands, degrees from +Z towards +X.")
    ] = 0.0,
    turn: Annotated[float, typer.Option(help="Of the environment, degrees, likewise.")] = 0.0,
    turntable: Annotated[
        int, typer.Option(min=0, max=3600, help="Pictures of one turn of the scene.")
    ] = 0,
    lights: Annotated[
        str, typer.Option(help="metamers: match under the first, part under the second.")
    ] = "A,D65",
    seed: Annotated[int, typer.Option(min=0, help="metamers: another pair of paints.")] = 1,
    brdf: Annotated[
        str | None, typer.Option(help="ward, ward1992 or ggx [the materials' own].")
    ] = None,
    quality: Annotated[str, typer.Option(help="draft, good or best.")] = "good",
    samples: Annotated[
        int | None, typer.Option(min=1, max=4096, help="Of the gloss, a pixel [by roughness].")
    ] = None,
    display: DisplayWord = "srgb",
    adapt: AdaptWord = "cat02",
    white: WhiteWord = "map",
    degree: DegreeOfAdaptation = 1.0,
    exposure: ExposureWord = "auto",
    tone: ToneWord = "shoulder",
    bits: Annotated[
        int | None, typer.Option(help="A channel: 8 or 16 [8; 16 for rec2020-pq].")
    ] = None,
    device: Annotated[
        int | None, typer.Option(min=0, help="Number of the GPU [the system's choice].")
    ] = None,
    backend: Annotated[str, typer.Option(help="Of OpenGL: egl.")] = "egl",
    force: Force = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Headless render of a finished map: six channels beside three.

    Example: sixlight preview build/room --scene teapot

    Example: sixlight preview build/room --scene vase.glb --turntable 72 -o vase.mp4
    """
    from calibration import look as looks
    from pipeline import previews

    rendering = previews.Rendering(
        width=width,
        samples=samples,
        quality=quality,
        channels=channels,
        brdf=brdf,
        facing_deg=facing,
        turn_deg=turn,
        device=device,
        backend=backend,
        look=looks.parse(display, adapt, white, exposure, tone, degree),
    )
    made = previews.preview(
        envmap,
        scene,
        out,
        rendering,
        bits=bits,
        frames=turntable,
        lights=lights,
        seed=seed,
        force=force,
    )
    say_notes(made.notes, quiet)
    if json:
        figures = made.figures | {"files": [str(path) for path in made.files]}
        print(as_json(figures))
    else:
        for path in made.files:
            print(path)


@app.command()
def view(
    envmap: Annotated[Path, typer.Argument(help="Folder or cubemap.exr `envmap` wrote.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Page to write [ENVMAP/viewer.html].")
    ] = None,
    force: Force = False,
) -> None:
    """One self-contained page that renders a finished map live in a browser.

    Example: sixlight view build/room -o room.html
    """
    from pipeline.viewer import page

    print(page.view(envmap, out, force=force))


@app.command()
def show(
    image: Annotated[Path, typer.Argument(help="EXR of X, Y, Z, as `preview` writes; or a map.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Picture: .png, .jxl or .tif.")],
    display: DisplayWord = "srgb",
    adapt: AdaptWord = "cat02",
    white: WhiteWord = "map",
    degree: DegreeOfAdaptation = 1.0,
    exposure: ExposureWord = "auto",
    tone: ToneWord = "shoulder",
    bits: Annotated[
        int | None, typer.Option(help="A channel: 8 or 16 [8; 16 for rec2020-pq].")
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """A picture of an XYZ image or a map, for a display: sRGB, wide gamut, HDR, or a measured one.

    Example: sixlight show build/room/preview_teapot.exr -o teapot.jxl --display rec2020-pq

    Example: sixlight show build/room/latlong.exr -o room.png --exposure 11.5
    """
    from calibration import look as looks
    from pipeline import pictures

    look = looks.parse(display, adapt, white, exposure, tone, degree)
    say_notes(pictures.show(image, out, look, bits=bits, force=force), quiet)
    print(out)


@app.command()
def display(
    measured: Annotated[Path, typer.Argument(help="CSV of R,G,B drives and X,Y,Z readings.")],
    json: Json = False,
) -> None:
    """How well a measured display is known: its model's errors, and what to distrust.

    Example: sixlight display monitor.csv
    """
    from pipeline import display_report

    told = display_report.report(measured)
    print(as_json(told) if json else display_report.as_text(told))


@app.command()
def convert(
    source: Annotated[Path, typer.Argument(help="Any image OpenImageIO reads; NAME_{face}.exr.")],
    out: Annotated[Path, typer.Argument(help=".exr, .hdr, .tif; .ktx2, .dds: cubes with mips.")],
    layout: Annotated[
        str | None,
        typer.Option(
            help="cube (faces stacked), hcross, vcross, faces (six files), latlong, mirrorball, "
            "angular, octahedral."
        ),
    ] = None,
    source_layout: Annotated[
        str | None, typer.Option("--from", help="Of IN [its header's, or by its shape].")
    ] = None,
    size: Annotated[
        int | None, typer.Option(help="Rows; of cubes, texels along a face [IN's detail].")
    ] = None,
    turn: Annotated[
        str | None, typer.Option(help="yaw[,pitch[,roll]] in degrees, or nine numbers.")
    ] = None,
    preset: Annotated[
        str | None,
        typer.Option(help="blender, mitsuba, threejs, unreal, unity or filament."),
    ] = None,
    channels: Annotated[str | None, typer.Option(help="Those to keep: P1,P2,P3.")] = None,
    outline: Annotated[
        str | None, typer.Option(help="Of a photographed ball: x,y,radius in px [searched for].")
    ] = None,
    distance: Annotated[
        float | None, typer.Option(help="Of its camera, in the ball's radii [far away].")
    ] = None,
    fill: Annotated[
        bool, typer.Option("--fill", help="Close holes; leave out valid and sigma.")
    ] = False,
    force: Force = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """One layout to another, any channels, any rotation, each pixel filtered over its area.

    Example: sixlight convert build/room/cubemap.exr room.exr --layout octahedral --turn 30

    Example: sixlight convert build/room/cubemap_123.exr room.hdr --preset blender

    Example: sixlight convert ball.hdr cube.exr --from mirrorball --layout cube
    """
    from pipeline import convert as conversion

    done = conversion.convert(
        source,
        out,
        layout=layout,
        source_layout=source_layout,
        size=size,
        turn=turn,
        preset=preset,
        channels=channels,
        outline=outline,
        distance=distance,
        filled=fill,
        force=force,
    )
    say_notes(done["notes"], quiet)
    if json:
        print(as_json(done))
    else:
        for path in done["files"]:
            print(path)


@app.command()
def spectra(
    source: Annotated[Path, typer.Argument(help="EXR of spectra, or of six channels.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="EXR to write.")],
    estimate: Annotated[
        bool, typer.Option("--estimate", help="From channels to estimated spectra.")
    ] = False,
    kind: Annotated[str, typer.Option(help="What spectra are: light or reflectance.")] = "light",
    primaries: Annotated[str | None, typer.Option(help="A named set, or its folder.")] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Spectral images to six channels, or six channels to estimated spectra.

    Spectra are read and written in the OpenEXR layout of Fichet et al. 2021. A map keeps its
    layout: `sixlight convert` makes a latlong image the cube that `sixlight preview` lights with.

    Example: sixlight spectra hyperspectral.exr -o six.exr

    Example: sixlight spectra build/room/latlong.exr --estimate -o spectra.exr
    """
    from calibration.primaries import DEFAULT, load
    from pipeline import spectral

    if estimate:
        wanted = load(primaries) if primaries else None
        notes = spectral.to_spectra(source, out, wanted, force=force)
    else:
        wanted = load(primaries or DEFAULT)
        notes = spectral.to_primaries(source, out, wanted, kind=kind, force=force)
    say_notes(notes, quiet)
    print(out)
