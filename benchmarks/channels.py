"""Colour: rendering in few channels against full spectra, CIEDE2000.

The sets of primaries on surfaces and lights they were not trained on, the paper's comparators,
and how long a new set takes. `sixlight evaluate` prints all of it, in tables.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from benchmarks.figure import Figure
from calibration import optimise, primaries, sets
from pipeline import evaluation

# Means on the ColorChecker, which no set is trained on: 19 lights, five places, eight LEDs.
LIGHTS = ("darling2011", "places5", "leds8")
MOST = {
    "signed6": (0.24, 0.32, 0.55),
    "nonnegative6": (0.57, 0.75, None),
    "signed7": (0.13, 0.13, None),
    "signed8": (0.12, 0.12, None),
    "darling2011": (None, None, None),
}
# The paper's Table 1 at its 19 lights: mean, s.d., 90th percentile, and the maximum.
PAPER = {"Sharp RGB": (1.7, 2.0, 4.4, 13.3), "XYZ": (2.3, 2.2, 5.4, 12.1)}


def measure() -> Iterator[Figure]:
    yield from _sets()
    yield from _comparators()
    yield from _training()


def _sets() -> Iterator[Figure]:
    surfaces = sets.surfaces("colorchecker24")
    for name, bounds in MOST.items():
        one = primaries.load(name)
        for lights, high in zip(LIGHTS, bounds, strict=True):
            errors = optimise.rendering_errors(one, sets.lights(lights), surfaces)
            yield Figure(f"{name}, ColorChecker, {lights}", float(np.mean(errors)), "dE", high=high)


def _comparators() -> Iterator[Figure]:
    rows = evaluation.evaluate(evaluation.read(primaries=["darling2011"]))
    for row in rows:
        at_19 = row["table"] == 1 and row["lights"].startswith("darling2011")
        if at_19 and row["surfaces"] == "colorchecker24" and row["method"] in PAPER:
            mean, sd, p90, most = PAPER[row["method"]]
            for what, paper, within in (
                ("mean", mean, 0.1),
                ("sd", sd, 0.1),
                ("p90", p90, 0.1),
                ("max", most, 2.0),
            ):
                yield Figure(
                    f"{row['method']}, ColorChecker, 19 lights, {what}",
                    row[what],
                    "dE",
                    paper - within,
                    paper + within,
                )


def _training() -> Iterator[Figure]:
    """Thirty parameters (six Gaussians' matrix and shape), 1900 colours, 25 starts."""
    lights, surfaces = sets.lights("darling2011"), sets.surfaces("ces99")
    began = time.process_time()
    optimise.new_set(lights, surfaces, kind="gaussian", starts=25, seed=1)
    yield Figure("a new set, 30 parameters, 25 starts, CPU", time.process_time() - began, "s")
