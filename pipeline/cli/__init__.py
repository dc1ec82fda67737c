"""The command line: verbs, options, exit status; nothing else.

captures, colour, images   the verbs
shared                     what they share

Exit status 0 done, 1 a fault of ours, 2 the user's input, 130 interrupted. What only one verb
needs is imported inside it, so that `sixlight --help` answers at once.
"""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sys
from typing import Annotated

import typer

from calibration.errors import InputError, Problem, legible
from pipeline.cli import captures, colour, images  # noqa: F401 - their verbs
from pipeline.cli.shared import app
from pipeline.errors import out_of_memory

INTERRUPTED = 130


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
    except Exception as error:
        if not out_of_memory(error):
            raise
        remedy = "end other programs, or give it a larger machine; what is finished stays"
        print(Problem("memory ran out", "", remedy, "sixlight"), file=sys.stderr)
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
