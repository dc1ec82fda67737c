"""The command line: verbs, options, exit status; nothing else.

captures, colour, images   the verbs
shared                     what they share

Exit status 0 done, 1 a fault of ours, 2 the user's input, 130 interrupted. What only one verb
needs is imported inside it, so that `sixlight --help` answers at once.
"""

from __future__ import annotations

import io
import os
import signal
import sys
from typing import Annotated

import typer

from calibration.errors import InputError, legible
from pipeline.cli import captures, colour, images  # noqa: F401 - their verbs
from pipeline.cli.shared import app
from pipeline.errors import of_machine

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
    unheard = False
    for stream in filter(None, (sys.stdout, sys.stderr)):
        try:
            stream.flush()
        except OSError:
            unheard = True
    if unheard or ended == INTERRUPTED:
        # At once: threads of libraries may be in the middle of something, and Python would try
        # to print again.
        os._exit(ended)
    sys.exit(ended)


def _interrupt(*_) -> None:
    raise KeyboardInterrupt


def status(arguments: list[str] | None = None) -> int:
    """Runs the command line, or the arguments given, and returns the exit status."""
    try:
        ended = app(args=arguments, standalone_mode=False) or 0
        print(end="", flush=True)  # what cannot be printed is to be told here, not at the very end
        return ended
    except typer.TyperException as error:
        print(f"sixlight: {legible(error.format_message())}", file=sys.stderr)
        return 2
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED
    except InputError as error:
        for problem in error.problems:
            print(problem, file=sys.stderr)
        return 2
    except BrokenPipeError:  # whoever read has enough, as `head` has; Typer ends so, too
        return 1
    except Exception as error:
        if (told := of_machine(error)) is None:
            raise
        print(told, file=sys.stderr)
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
