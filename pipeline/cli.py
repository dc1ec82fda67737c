"""The command line: verbs, options, exit status; nothing else.

Exit status 0 done, 1 a fault of ours, 2 the user's input, 130 interrupted. What only one verb
needs is imported inside it, so that `sixlight --help` answers at once.
"""

from __future__ import annotations

import json as jsonlib
import sys
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    name="sixlight",
    add_completion=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Six-channel HDR environment cubemaps from raw photographs of a mirror sphere.",
)

Quiet = Annotated[bool, typer.Option("--quiet", help="Say nothing while it goes.")]
Json = Annotated[bool, typer.Option("--json", help="Print the results as JSON.")]
Force = Annotated[bool, typer.Option("--force", help="Replace what sixlight did not write.")]


def main() -> None:
    """Runs the command line and ends the process with its exit status."""
    sys.exit(status())


def status(arguments: list[str] | None = None) -> int:
    """Runs the command line, or the arguments given, and returns the exit status."""
    try:
        return app(args=arguments, standalone_mode=False) or 0
    except typer.TyperException as error:
        print(f"sixlight: {error.format_message()}", file=sys.stderr)
        return 2
    except (KeyboardInterrupt, typer.Abort):
        return 130
    except ValueError as error:
        from calibration.errors import InputError

        if not isinstance(error, InputError):
            raise
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
    capture: Annotated[Path, typer.Argument(help="Folder of the capture.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Output folder [build/CAPTURE].")
    ] = None,
    face_size: Annotated[
        int, typer.Option(min=0, max=8192, help="Texels along a cube face; 0: as the sphere is.")
    ] = 0,
    preview_width: Annotated[
        int, typer.Option(min=64, max=8192, help="Of the preview picture, px.")
    ] = 1280,
    preview_samples: Annotated[
        int, typer.Option(min=1, max=4096, help="Directions a pixel samples for gloss.")
    ] = 64,
    force: Force = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Raw brackets to six-channel cubemaps and a lit preview.

    Example: sixlight envmap sample_captures/room -o build/room
    """
    from pipeline import capture as captures
    from pipeline import runner
    from pipeline.settings import Settings

    settings = Settings(face_size, preview_width, preview_samples)
    loaded = captures.load(capture)
    for note in loaded.notes:
        _say(f"note: {note}", quiet)
    if loaded.transform is None:
        _say("note: no calibration: the camera's own bands are written, not the primaries", quiet)
    out = out or Path("build") / capture.resolve().name
    result = runner.run(loaded, out, settings, force=force, quiet=quiet)
    if json:
        print(jsonlib.dumps(result, indent=2))
    else:
        for step in result["steps"].values():
            for name in step["made"]:
                if not name.startswith("work/"):
                    print(out / name)


@app.command()
def inspect(
    capture: Annotated[Path, typer.Argument(help="Folder of the capture.")],
    json: Json = False,
) -> None:
    """What a capture holds: exposures, clipping, warnings; touches nothing.

    Example: sixlight inspect sample_captures/room
    """
    from pipeline import inspection

    report = inspection.inspect(capture)
    print(jsonlib.dumps(report, indent=2) if json else inspection.as_text(report))


@app.command()
def fit(
    calibration: Annotated[
        Path | None, typer.Argument(help="Folder of chart photographs and radiance CSVs.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Transform to write [CALIBRATION/M_S.toml].")
    ] = None,
    method: Annotated[str | None, typer.Option(help="pinv (the paper's) or ridge.")] = None,
    primaries: Annotated[str | None, typer.Option(help="A named set, or its folder.")] = None,
    camera: Annotated[
        Path | None, typer.Option(help="Sensitivities R, G, B, in place of a folder.")
    ] = None,
    filters: Annotated[Path | None, typer.Option(help="Transmittances of the filters.")] = None,
    lights: Annotated[Path | None, typer.Option(help="Spectra of lights to train on.")] = None,
    force: Force = False,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """M_S from a chart session, or from known sensitivities.

    Example: sixlight fit sample_captures/room/calibration -o M_S.toml
    """
    from pipeline import fitting

    if calibration is None:
        if camera is None or filters is None:
            raise typer.BadParameter("give a calibration folder, or --camera with --filters")
        transform = fitting.from_sensitivities(camera, filters, lights, primaries, method)
        out = out or Path("M_S.toml")
    else:
        if camera or filters or lights:
            raise typer.BadParameter("a calibration folder, or --camera with --filters; not both")
        transform = fitting.from_session(calibration, primaries, method, quiet=quiet)
        out = out or calibration / "M_S.toml"
    fitting.save(transform, out, force=force)
    print(jsonlib.dumps(transform.figures, indent=2) if json else fitting.as_text(transform, out))


@app.command()
def preview(
    envmap: Annotated[Path, typer.Argument(help="Folder or cubemap.exr `envmap` wrote.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Folder for the pictures [ENVMAP].")
    ] = None,
    scene: Annotated[str, typer.Option(help="What to show: teapot.")] = "teapot",
    width: Annotated[int, typer.Option(min=64, max=8192, help="Of the picture, px.")] = 1280,
    samples: Annotated[
        int, typer.Option(min=1, max=4096, help="Directions a pixel samples for gloss.")
    ] = 64,
    force: Force = False,
) -> None:
    """Headless render of a finished map: six channels beside three.

    Example: sixlight preview build/room --scene teapot
    """
    from pipeline import previews

    for path in previews.preview(envmap, scene, out, width=width, samples=samples, force=force):
        print(path)


@app.command()
def primaries(
    name: Annotated[str, typer.Argument(help="A named set, such as darling2011.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder to write.")],
    force: Force = False,
) -> None:
    """Writes a set of primaries as curves.csv and xyz_from_primaries.csv.

    Example: sixlight primaries darling2011 -o primaries
    """
    from pipeline import fitting

    for path in fitting.save_primaries(name, out, force=force):
        print(path)


@app.command()
def simulate(
    scene: Annotated[str, typer.Argument(help="What to render: room.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Capture folder to write.")],
    quality: Annotated[str, typer.Option(help="draft or full.")] = "full",
    quiet: Quiet = False,
) -> None:
    """A capture with ground truth, rendered by Mitsuba 3.

    Needs pip install 'sixlight[simulate]'.

    Example: sixlight simulate room -o build/sample_room --quality draft
    """
    from pipeline.simulate import simulate as write_capture

    write_capture(scene, out, quality=quality, progress=lambda line: _say(line, quiet))
    print(out)


@app.command()
def steps() -> None:
    """Prints the steps of `envmap`: what each reads and makes.

    Example: sixlight steps
    """
    from pipeline.steps import STEPS

    for number, step in enumerate(STEPS, 1):
        each = ", for each filter" if step.for_each else ""
        print(f"{number}. {step.name}: {step.about}{each}")
        print(f"     reads {', '.join(step.reads)}")
        print(f"     makes {', '.join(step.makes)}")


def _say(text: str, quiet: bool) -> None:
    if not quiet:
        print(text, file=sys.stderr)
