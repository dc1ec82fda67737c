"""Colour: matrices, primaries, and how good they are."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from pipeline.cli.shared import Force, Json, Quiet, app, as_json, say, say_notes


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
    print(as_json(fitting.figures(fitted)) if json else fitting.as_text(fitted, out))
    if plots is not None:
        for path in fit_plots.draw(fitted, plots):
            say(str(path), quiet)
    if report is not None:
        reports.store(report, fit_plots.page(fitted, out.name))
        say(str(report), quiet)


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
            progress=lambda line: say(line, quiet),
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
    print(as_json(rows) if json else evaluation.as_markdown(rows))
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
    print(as_json(rows) if json else evaluation.ranking_as_markdown(rows))


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
    say_notes(figures["notes"], quiet)
    print(as_json(figures) if json else out)
