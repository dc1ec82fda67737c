"""Captures to maps: one, many, and what became of them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from calibration.errors import legible
from pipeline.cli.shared import Force, Json, Quiet, app, as_json, say, say_notes


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
        say_notes(loaded.notes, quiet)
        if loaded.transform is None:
            what = "the camera's own bands are written, not the primaries"
            say_notes([f"no calibration: {what}"], quiet)
        result = runner.run(loaded, results, settings, force=force, quiet=quiet)
        say_notes(result["notes"][len(loaded.notes) :], quiet)
    if json:
        print(as_json(result))
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
    print(as_json(told) if json else batches.as_text(outcomes))
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
        print(as_json(report))
    else:
        from rich.console import Console

        print(inspection.as_text(report, Console() if sys.stdout.isatty() else None))
        if noise is not None:
            print(noise_plot.as_text(report["noise"]))


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
        print(as_json(told))
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
        print(as_json(rows))
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

    write_capture(scene, out, quality=quality, views=views, progress=lambda line: say(line, quiet))
    print(out)
