"""What the verbs share: the program they belong to, options that several have, what they say."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from typing import Annotated, Any

import typer

from calibration.errors import legible

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


def say(text: str, quiet: bool) -> None:
    """To the user, beside the results."""
    if not quiet:
        print(legible(text), file=sys.stderr)


def say_notes(notes: Iterable[str], quiet: bool) -> None:
    for note in notes:
        say(f"note: {note}", quiet)


def as_json(told: Any) -> str:
    return json.dumps(told, indent=2)
