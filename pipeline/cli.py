"""The command line: verbs, options, exit status; nothing else.

Exit status 0 done, 1 a fault of ours, 2 the user's input, 130 interrupted. What only one verb
needs is imported inside it, so that `sixlight --help` answers at once.
"""

from __future__ import annotations

import contextlib
import io
import json as jsonlib
import os
import signal
import sys
from pathlib import Path
from typing import Annotated

import typer

from calibration.errors import InputError, legible

app = typer.Typer(
    name="sixlight",
    add_completion=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Six-channel HDR environment cubemaps from raw photographs of a mirror sphere.",
)

INTERRUPTED = 130

Quiet = Annotated[bool, typer.Option("--quiet", help="Say nothing while it goes.")]
Json = Annotated[bool, typer.Option("--json", help="Print the results as JSON.")]
Force = Annotated[bool, typer.Option("--force", help="Replace what sixlight did not write.")]

# How pictures are shown: the words `calibration.look.parse` reads.
DisplayWord = Annotated[
    str, typer.Option("--display", help="srgb, display-p3, rec2020-pq, or a CSV of measurements.")
]
AdaptWord = Annotated[str, typer.Option("--adapt", help="cat02, cat16 or none.")]
WhiteWord = Annotated[
    str, typer.Option("--white", help="What is adapted from: map (measured), D65, A ... or x,y.")
]
DegreeOfAdaptation = Annotated[
    float, typer.Option("--degree", help="Of adaptation, 0 to 1, complete.")
]
ExposureWord = Annotated[str, typer.Option("--exposure", help="auto, or EV.")]
ToneWord = Annotated[
    str, typer.Option("--tone", help="shoulder keeps hue; clip cuts off, as the paper did.")
]


def main() -> None:
    """Runs the command line and ends the process with its exit status."""
    for stream in (sys.stdout, sys.stderr):  # a name that the terminal has no letters for
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    signal.signal(signal.SIGTERM, _interrupt)
    # OpenBLAS adds up in another order on more threads, and M_S then differs in its last digits;
    # it is read when NumPy is imported, which nothing above does.
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    ended = status()
    if ended == INTERRUPTED:
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError):
                stream.flush()
        os._exit(ended)  # at once: threads of libraries may be in the middle of something
    sys.exit(ended)


def _interrupt(*_) -> None:
    raise KeyboardInterrupt


def status(arguments: list[str] | None = None) -> int:
    """Runs the command line, or the arguments given, and returns the exit status."""
    try:
        return app(args=arguments, standalone_mode=False) or 0
    except typer.TyperException as error:
        print(f"sixlight: {legible(error.format_message())}", file=sys.stderr)
        return 2
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED
    except InputError as error:
        for problem in error.problems:
            print(problem, file=sys.stderr)
        return 2


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        from importlib.metadata import version as installed

        print(f"sixlight {installed('sixlight')}")
    elif context.invoked_subcommand is None:
        print(context.get_help())


@app.command()
def envmap(
    capture: Annotated[str, typer.Argument(help="Folder of the capture, or its URL.")],
    out: Annotated[
        str | None, typer.Option("-o", "--out", help="Output folder or URL [build/CAPTURE].")
    ] = None,
    face_size: Annotated[
        int, typer.Option(min=0, max=8192, help="Texels along a cube face; 0: as the sphere is.")
    ] = 0,
    preview_width: Annotated[
        int, typer.Option(min=64, max=8192, help="Of the preview picture, px.")
    ] = 1280,
    preview_samples: Annotated[
        int | None, typer.Option(min=1, max=4096, help="Of the gloss, a pixel [by roughness].")
    ] = None,
    force: Force = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Raw brackets to six-channel cubemaps and a lit preview.

    Example: sixlight envmap sample_captures/room -o build/room
    """
    from pipeline import capture as captures
    from pipeline import remote, runner, storage
    from pipeline.batch import shoot
    from pipeline.settings import Settings

    settings = Settings(face_size, preview_width, preview_samples)
    given = storage.place(capture)
    place = storage.place(out) if out else Path("build") / shoot.name_of(given)
    with remote.here(given, place, settings, force=force) as (folder, results):
        loaded = captures.load(folder)
        for note in loaded.notes:
            _say(f"note: {note}", quiet)
        if loaded.transform is None:
            what = "the camera's own bands are written, not the primaries"
            _say(f"note: no calibration: {what}", quiet)
        result = runner.run(loaded, results, settings, force=force, quiet=quiet)
        for note in result["notes"][len(loaded.notes) :]:  # what the steps found
            _say(f"note: {note}", quiet)
    if json:
        print(jsonlib.dumps(result, indent=2))
    else:
        for step in result["steps"].values():
            for name in step["made"]:
                if not name.startswith("work/"):
                    print(place / name)
        print(place / "report.html")


@app.command()
def batch(
    folders: Annotated[list[str], typer.Argument(help="Folders or URLs with captures below.")],
    out: Annotated[
        str | None, typer.Option("-o", "--out", help="Output folder or URL [build/NAME of each].")
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, max=1024, help="Captures at once [half the processors].")
    ] = None,
    memory: Annotated[
        float | None, typer.Option(help="GB they may take together [4/5 of what is free].")
    ] = None,
    time_limit: Annotated[float, typer.Option(min=0.01, help="Minutes one may take.")] = 60.0,
    keep_going: Annotated[
        bool, typer.Option("--keep-going/--stop", help="After a capture that failed.")
    ] = True,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be done.")] = False,
    scheduler: Annotated[
        str | None, typer.Option(help="Address of a Dask cluster to do it: tcp://HOST:8786.")
    ] = None,
    face_size: Annotated[int, typer.Option(min=0, max=8192, help="As of envmap.")] = 0,
    preview_width: Annotated[int, typer.Option(min=64, max=8192, help="Likewise.")] = 1280,
    preview_samples: Annotated[int | None, typer.Option(min=1, max=4096, help="Likewise.")] = None,
    force: Force = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Many captures, side by side: each as envmap does it, and none stops another.

    Example: sixlight batch week47 -o build/week47 --jobs 4

    Example: sixlight batch week47 --scheduler tcp://head:8786

    Example: sixlight batch s3://bucket/week47 -o s3://bucket/maps
    """
    from functools import partial

    from pipeline import batch as batches
    from pipeline import storage
    from pipeline.batch import shoot
    from pipeline.settings import Settings

    settings = Settings(face_size, preview_width, preview_samples)
    limits = batches.limits_of(jobs, memory, time_limit)
    places = [storage.place(folder) for folder in folders]
    results = storage.place(out) if out else None
    planned = shoot.plan(places, results, settings)
    if dry_run:
        print(batches.plan_as_text(planned, limits))
        return
    by = batches.here
    if scheduler is not None:
        from pipeline.batch import cluster

        by = partial(cluster.run, scheduler)
    orders = batches.Orders(settings, limits, keep_going, force)
    outcomes = batches.run(planned, orders, by=by, quiet=quiet)
    place = batches.place_of_summary(places, results)
    told = batches.summary(outcomes, limits, place)
    print(jsonlib.dumps(told, indent=2) if json else batches.as_text(outcomes))
    batches.save(told, place)
    raise typer.Exit(batches.status(outcomes.values()))


@app.command()
def inspect(
    capture: Annotated[Path, typer.Argument(help="Folder of the capture.")],
    noise: Annotated[
        Path | None, typer.Option(help="Also draw the camera's noise against signal: FILE.png.")
    ] = None,
    json: Json = False,
) -> None:
    """What a capture holds: exposures, clipping, warnings; touches nothing.

    Example: sixlight inspect sample_captures/room --noise build/noise.png
    """
    from pipeline import inspection

    report = inspection.inspect(capture)
    if noise is not None:
        from pipeline import capture as captures
        from pipeline import noise_plot

        report["noise"] = noise_plot.draw(captures.load(capture), noise)
    if json:
        print(jsonlib.dumps(report, indent=2))
    else:
        from rich.console import Console

        print(inspection.as_text(report, Console() if sys.stdout.isatty() else None))
        if noise is not None:
            print(noise_plot.as_text(report["noise"]))


@app.command()
def fit(
    calibration: Annotated[
        Path | None, typer.Argument(help="Folder of chart photographs and radiance CSVs.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Matrix to write [CALIBRATION/M_S.toml].")
    ] = None,
    method: Annotated[
        str | None, typer.Option(help="pinv (the paper's prototype), ridge, or delta-e.")
    ] = None,
    primaries: Annotated[str | None, typer.Option(help="A named set, or its folder.")] = None,
    reflectance: Annotated[
        bool, typer.Option("--reflectance", help="M_R, for surfaces, in place of M_S.")
    ] = False,
    camera: Annotated[
        Path | None, typer.Option(help="Sensitivities R, G, B, in place of a folder.")
    ] = None,
    filters: Annotated[Path | None, typer.Option(help="Transmittances of the filters.")] = None,
    lights: Annotated[Path | None, typer.Option(help="Spectra of lights to train on.")] = None,
    surfaces: Annotated[Path | None, typer.Option(help="Reflectances to train on.")] = None,
    plots: Annotated[Path | None, typer.Option(help="Folder for pictures of the fit.")] = None,
    report: Annotated[Path | None, typer.Option(help="Page to write: FILE.html.")] = None,
    force: Force = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """M_S, or M_R, from a chart session, or from known sensitivities.

    Example: sixlight fit sample_captures/room/calibration -o M_S.toml --report M_S.html
    """
    from pipeline import fitting
    from pipeline import report as reports
    from pipeline.fitting import plots as fit_plots

    name = "M_R.toml" if reflectance else "M_S.toml"
    if plots is not None:
        fit_plots.check(plots, force=force)
    if report is not None:
        reports.check(report, force=force)
    if calibration is None:
        if camera is None or filters is None:
            raise typer.BadParameter("give a calibration folder, or --camera with --filters")
        fitted = fitting.from_sensitivities(
            camera, filters, lights, primaries, method, surfaces=surfaces, reflectance=reflectance
        )
        out = out or Path(name)
    else:
        if camera or filters or lights or surfaces:
            raise typer.BadParameter("a calibration folder, or --camera with --filters; not both")
        fitted = fitting.from_session(
            calibration, primaries, method, reflectance=reflectance, quiet=quiet
        )
        out = out or calibration / name
    fitting.save(fitted.transform, out, force=force)
    print(
        jsonlib.dumps(fitting.figures(fitted), indent=2) if json else fitting.as_text(fitted, out)
    )
    if plots is not None:
        for path in fit_plots.draw(fitted, plots):
            _say(str(path), quiet)
    if report is not None:
        reports.store(report, fit_plots.page(fitted, out.name))
        _say(str(report), quiet)


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
    for note in made.notes:
        _say(f"note: {note}", quiet)
    if json:
        figures = made.figures | {"files": [str(path) for path in made.files]}
        print(jsonlib.dumps(figures, indent=2))
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
    for note in pictures.show(image, out, look, bits=bits, force=force):
        _say(f"note: {note}", quiet)
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
    print(jsonlib.dumps(told, indent=2) if json else display_report.as_text(told))


@app.command()
def primaries(
    name: Annotated[str, typer.Argument(help="A named set, or `fit` to make a new one.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder to write.")],
    lights: Annotated[Path | None, typer.Option(help="fit: spectra of the lights.")] = None,
    surfaces: Annotated[Path | None, typer.Option(help="fit: spectra of the surfaces.")] = None,
    channels: Annotated[int, typer.Option(min=3, max=12, help="fit: how many.")] = 6,
    kind: Annotated[str, typer.Option(help="fit: signed, nonnegative or gaussian.")] = "signed",
    starts: Annotated[int, typer.Option(min=1, max=1000, help="fit: random starts.")] = 25,
    smoothing: Annotated[
        float | None, typer.Option(min=0, help="fit: weight of smoothness.")
    ] = None,
    seed: Annotated[int, typer.Option(help="fit: of the random starts.")] = 1,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Writes a set of primaries: curves.csv and xyz_from_primaries.csv.

    Example: sixlight primaries signed6 -o primaries

    Example: sixlight primaries fit --lights L.csv --surfaces S.csv --channels 7 -o mine
    """
    from pipeline import fitting
    from pipeline.fitting import primary_fit

    if name == "fit":
        made = primary_fit.new_set(
            out.name,
            lights,
            surfaces,
            channels=channels,
            kind=kind,
            starts=starts,
            smoothing=smoothing,
            seed=seed,
            progress=lambda line: _say(line, quiet),
        )
    else:
        from calibration.primaries import load

        made = load(name)
    for path in fitting.save_primaries(made, out, force=force):
        print(path)


@app.command()
def evaluate(
    surfaces: Annotated[Path | None, typer.Option(help="Reflectances to try.")] = None,
    lights: Annotated[Path | None, typer.Option(help="Lights to try.")] = None,
    primaries: Annotated[
        list[str] | None, typer.Option(help="Named sets or folders; once for each.")
    ] = None,
    camera: Annotated[Path | None, typer.Option(help="Sensitivities R, G, B.")] = None,
    filters: Annotated[Path | None, typer.Option(help="Transmittances, with --camera.")] = None,
    pictures: Annotated[Path | None, typer.Option(help="Folder for heat maps.")] = None,
    report: Annotated[Path | None, typer.Option(help="Page to write: FILE.html.")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """The paper's tables beside ours, and the tables past it.

    Example: sixlight evaluate --json
    """
    from pipeline import evaluation
    from pipeline import report as reports

    if report is not None:
        reports.check(report, force=force)
    given = evaluation.read(
        surfaces=surfaces, lights=lights, primaries=primaries, camera=camera, filters=filters
    )
    rows = evaluation.evaluate(given)
    print(jsonlib.dumps(rows, indent=2) if json else evaluation.as_markdown(rows))
    if pictures is not None:
        for path in evaluation.heat_maps(pictures, given):
            print(path, file=sys.stderr)
    if report is not None:
        reports.store(report, evaluation.page(rows, given))
        print(report, file=sys.stderr)


@app.command()
def filters(
    camera: Annotated[Path, typer.Option(help="Sensitivities R, G, B.")],
    candidates: Annotated[
        list[Path], typer.Option(help="Transmittances of candidates; once for each file.")
    ],
    count: Annotated[int, typer.Option(min=1, max=3, help="Filters in a set.")] = 2,
    beside: Annotated[
        list[str] | None, typer.Option(help="A set to show beside the best: NAME+NAME.")
    ] = None,
    primaries: Annotated[str | None, typer.Option(help="A named set, or its folder.")] = None,
    lights: Annotated[Path | None, typer.Option(help="Lights to judge by.")] = None,
    best: Annotated[int, typer.Option(min=1, help="Sets to show.")] = 10,
    json: Json = False,
) -> None:
    """Which filters to shoot light through: sets ranked by colour error and noise.

    Example: sixlight filters --camera C.csv --candidates F.csv --count 2 --beside cyan+yellow
    """
    from pipeline import evaluation

    rows = evaluation.rank_filters(
        camera,
        candidates,
        count=count,
        primaries=primaries,
        lights=lights,
        best=best,
        beside=[names.split("+") for names in beside or []],
    )
    print(jsonlib.dumps(rows, indent=2) if json else evaluation.ranking_as_markdown(rows))


@app.command()
def reflectance(
    surface: Annotated[Path, typer.Argument(help="Folder of the surface's photographs.")],
    white: Annotated[Path, typer.Option(help="Folder of a white's, in the same light.")],
    transform: Annotated[Path, typer.Option(help="M_R.toml of `fit --reflectance`.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="EXR to write.")],
    primaries: Annotated[str | None, typer.Option(help="What M_R was fitted to.")] = None,
    force: Force = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """A painting's or a sample's reflectance in six channels, from raw brackets.

    Example: sixlight reflectance painting --white card --transform M_R.toml -o painting.exr
    """
    from pipeline import reflectance as captured

    session = captured.load(surface, white, transform, primaries)
    figures = captured.reflectance(session, out, force=force, quiet=quiet)
    for note in figures["notes"]:
        _say(f"note: {note}", quiet)
    print(jsonlib.dumps(figures, indent=2) if json else out)


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
    for note in notes:
        _say(f"note: {note}", quiet)
    print(out)


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
    for note in done["notes"]:
        _say(f"note: {note}", quiet)
    if json:
        print(jsonlib.dumps(done, indent=2))
    else:
        for path in done["files"]:
            print(path)


@app.command()
def simulate(
    scene: Annotated[str, typer.Argument(help="What to render: room.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Capture folder to write.")],
    quality: Annotated[str, typer.Option(help="small, draft or full.")] = "full",
    views: Annotated[
        int, typer.Option(help="Photographed from so many sides; with its photographer in them.")
    ] = 1,
    quiet: Quiet = False,
) -> None:
    """A capture with ground truth, rendered by Mitsuba 3.

    Needs pip install 'sixlight[simulate]'.

    Example: sixlight simulate room -o build/sample_room --quality draft
    """
    from pipeline.simulate import simulate as write_capture

    write_capture(scene, out, quality=quality, views=views, progress=lambda line: _say(line, quiet))
    print(out)


@app.command()
def verify(
    out: Annotated[Path, typer.Argument(help="Folder `envmap` wrote to.")],
    json: Json = False,
) -> None:
    """Whether a capture's photographs and results are still what they were when it was made.

    Exit status 2, and a line for each file, where they are not.

    Example: sixlight verify build/room
    """
    from pipeline import verify as verification

    told = verification.verify(out)
    if json:
        print(jsonlib.dumps(told, indent=2))
    elif not told["problems"]:
        print(f"{out}: all {told['checked']} files are what they were")
    for problem in told["problems"]:
        print(legible(f"{out}: {problem}"), file=sys.stderr)
    if told["problems"]:
        raise typer.Exit(2)


@app.command()
def clean(
    outs: Annotated[list[Path], typer.Argument(help="Folders `envmap` wrote to.")],
    everything: Annotated[
        bool, typer.Option("--all", help="All that sixlight wrote there, results too.")
    ] = False,
    keep: Annotated[
        float | None,
        typer.Option(min=0, help="GB of intermediate files to keep, of what was run last."),
    ] = None,
    json: Json = False,
) -> None:
    """Removes what steps leave each other; results stay, and stay current.

    Example: sixlight clean build/room

    Example: sixlight clean build --keep 20
    """
    from pipeline import clean as cleaning

    if keep is not None and everything:
        raise typer.BadParameter("--all, or --keep; not both")
    cleaned = (
        cleaning.clean(outs, everything=everything)
        if keep is None
        else cleaning.keep(outs, keep * 1e9)
    )
    if json:
        rows = [{"out": str(c.out), "files": c.files, "bytes": c.bytes} for c in cleaned]
        print(jsonlib.dumps(rows, indent=2))
    else:
        for c in cleaned:
            print(f"{legible(str(c.out))}: {c.files} files, {c.bytes / 1e6:.1f} MB removed")


@app.command()
def steps() -> None:
    """Prints the steps of `envmap`: what each reads and makes.

    Example: sixlight steps
    """
    from pipeline.steps import STEPS

    for number, step in enumerate(STEPS, 1):
        each = ", for each filter" if step.for_each else ""
        each += ", of several views only" if step.several else ""
        print(f"{number}. {step.name}: {step.about}{each}")
        print(f"     reads {', '.join(step.reads)}")
        print(f"     makes {', '.join(step.makes)}")
    print("{filter}: each filter's name; {triple}: every three channels, as in 123, 456, 78")
    print("{view}: nothing, or of several views each one's name, in work/; {sphere}: sphere, or")
    print("then oriented")


def _say(text: str, quiet: bool) -> None:
    if not quiet:
        print(legible(text), file=sys.stderr)
