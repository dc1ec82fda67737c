"""How a picture is shown: on which display, from which white, how bright, and its highlights.

A `Look` says it once, for every picture of a page; `shown` makes the picture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration import adaptation, measured_display
from calibration import display as displays
from calibration.display import SRGB, Array, Display, auto_exposure, show
from calibration.errors import InputError, Problem, fault

TONES = ("shoulder", "clip")
MAP = "map"  # the word for the white that is measured from the light itself
_MOST_EV = 60.0  # stops from 1: beyond, single floats end


@dataclass(frozen=True)
class Look:
    """What is done between the XYZ of a scene and the signal a display is sent.

    display      sRGB, or any of `calibration.display` and `calibration.measured_display`
    adaptation   "cat02", "cat16", or None: shown as measured, colour cast and all
    degree       of adaptation, 0..1; see `calibration.adaptation.adapt`
    white        the white the eye has adapted to: its name or "x,y"; None: the scene's own
    exposure_ev  XYZ is multiplied by 2 to this power, Y = 1 is then the display's white; None: by
                 `calibration.display.auto_exposure`
    tone         "shoulder": highlights are compressed and keep their hue; "clip": each channel is
                 cut off at the display's limits, as the paper did
    """

    display: Display = SRGB
    adaptation: str | None = "cat02"
    degree: float = 1.0
    white: str | None = None
    exposure_ev: float | None = None
    tone: str = "shoulder"


@dataclass(frozen=True, eq=False)
class Shown:
    """A picture ready for its display.

    signal    (..., 3) float32 in [0, 1]
    exposure  the factor on XYZ that it was made with
    unknown   how many pixels had no finite XYZ; they are black
    """

    signal: NDArray[np.float32]
    exposure: float
    unknown: int

    @property
    def exposure_ev(self) -> float:
        return math.log2(self.exposure)


def shown(xyz, look: Look, scene_white=None, *, exposure_of=None) -> Shown:
    """A picture as a look has it.

    xyz          (..., 3) linear, any unit; NaN where it is unknown
    scene_white  (3,) XYZ of the scene's white, any level: what a small white sphere there would
                 scatter. Looked at only where the look measures the white from the scene
    exposure_of  (..., 3) XYZ of the picture that sets the exposure where it is automatic, so that
                 several can be compared; None: this one
    returns      Shown
    raises       InputError where the white is to be the scene's and there is none, or is no light's
    """
    to_display = xyz_to_display(look, scene_white)
    adapted, known = _adapted(xyz, to_display)
    if look.exposure_ev is not None:
        exposure = 2.0**look.exposure_ev
    else:
        judged, seen = adapted, known
        if exposure_of is not None:
            judged, seen = _adapted(exposure_of, to_display)
        exposure = auto_exposure(judged[seen], display=look.display)
    if look.tone == "clip":
        signal = look.display.signal(adapted * exposure).astype(np.float32)
    else:
        assert look.tone == "shoulder", look.tone
        signal = show(adapted, look.display, exposure=exposure)
    signal[~known] = 0.0
    return Shown(signal, exposure, int(np.count_nonzero(~known)))


def xyz_to_display(look: Look, scene_white=None) -> Array:
    """The matrix (3, 3) that adapts XYZ from the look's white to its display's."""
    if look.adaptation is None:
        return np.eye(3)
    if look.white is not None:
        white = adaptation.white(look.white)
    elif scene_white is not None:
        white = np.asarray(scene_white, np.float64)
    else:
        raise fault(
            "the white of the scene is not known",
            "the XYZ of what is white there",
            "name the white, or adapt to none",
        )
    return adaptation.adapt(white, look.display.white, look.adaptation, degree=look.degree)


def parse(
    display: str = "srgb",
    adapt: str = "cat02",
    white: str = MAP,
    exposure: str = "auto",
    tone: str = "shoulder",
    degree: float = 1.0,
) -> Look:
    """A look from words, as a command line has them; InputError with all that is wrong.

    display   a name of `calibration.display.DISPLAYS`, or a CSV of measurements, which is read
    adapt     cat02, cat16 or none
    white     "map": the scene's own; a name of `calibration.adaptation.WHITES`; or "x,y"
    exposure  "auto", or a number of EV
    tone      shoulder or clip
    degree    of adaptation, 0..1
    """
    problems: list[Problem] = []
    look = Look(degree=degree)
    try:
        look = replace(look, display=_display(display))
    except InputError as error:
        problems += error.problems
    if adapt not in (*adaptation.METHODS, "none"):
        problems.append(_choice("adaptation", adapt, (*adaptation.METHODS, "none")))
    if tone not in TONES:
        problems.append(_choice("tone curve", tone, TONES))
    if not 0.0 <= degree <= 1.0:
        problems.append(
            Problem(
                f"a degree of adaptation of {degree:g}",
                "0 to 1; 1 is complete",
                "correct it",
            )
        )
    if white != MAP:
        try:
            adaptation.white(white)
        except InputError as error:
            problems += [replace(p, expected=f"{MAP}, {p.expected}") for p in error.problems]
        if adapt == "none":
            problems.append(
                Problem(
                    f"the white {white} with no adaptation",
                    "one or the other",
                    "choose cat02 or cat16, or leave the white out",
                )
            )
    try:
        ev = _ev(exposure)
    except InputError as error:
        problems += error.problems
    if problems:
        raise InputError(problems)
    return replace(
        look,
        adaptation=None if adapt == "none" else adapt,
        white=None if white == MAP else white,
        exposure_ev=ev,
        tone=tone,
    )


def in_words(look: Look) -> str:
    """A look in one line, for people: "sRGB, cat02 from D50, shoulder"."""
    if look.adaptation is None:
        adapted = "not adapted"
    else:
        degree = "" if look.degree == 1.0 else f" by {look.degree:g}"
        adapted = f"{look.adaptation}{degree} from {look.white or 'the white of the scene'}"
    return f"{look.display.name}, {adapted}, {look.tone}"


def _adapted(xyz, to_display) -> tuple[Array, NDArray[np.bool_]]:
    """XYZ (..., 3) for the display, and which pixels (...) are known; the others are 0."""
    xyz = np.asarray(xyz, np.float64)
    known = np.isfinite(xyz).all(axis=-1)
    return np.where(known[..., None], xyz, 0.0) @ to_display.T, known


def _display(word: str) -> Display:
    if word.lower().endswith(".csv"):
        return measured_display.load(word).display
    return displays.named(word)


def _ev(word: str) -> float | None:
    if word == "auto":
        return None
    try:
        ev = float(word)
    except ValueError:
        ev = math.nan
    if not abs(ev) <= _MOST_EV:
        raise fault(
            f"an exposure of {word!r}",
            f"auto, or EV from {-_MOST_EV:g} to {_MOST_EV:g}",
            "correct it",
        )
    return ev


def _choice(what: str, word: str, choices) -> Problem:
    return Problem(f"no {what} is called {word!r}", ", ".join(choices), "name one")
