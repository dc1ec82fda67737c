"""`sixlight primaries fit`: a new set of primaries for the user's lights and surfaces."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from calibration import optimise, sets
from calibration.errors import InputError, fault
from calibration.primaries import Primaries
from pipeline.files.spectra import read_set


def new_set(
    name: str,
    lights: Path | None,
    surfaces: Path | None,
    *,
    channels: int,
    kind: str,
    starts: int,
    smoothing: float | None,
    seed: int,
    progress: Callable[[str], None],
) -> Primaries:
    """Curves and matrix with the least colour error; see `calibration.optimise.new_set`.

    lights, surfaces  CSV files; None: what the shipped sets are trained on

    InputError where a file or a choice is wrong.
    """
    if kind not in optimise.KINDS:
        raise fault(f"kind {kind!r}", " or ".join(optimise.KINDS), "choose one", "--kind")
    under = read_set(lights, "light") if lights else sets.lights(optimise.TRAINING_LIGHTS)
    on = read_set(surfaces, "surface") if surfaces else sets.surfaces(optimise.TRAINING_SURFACES)
    try:
        return optimise.new_set(
            under,
            on,
            name=name,
            channels=channels,
            kind=kind,
            starts=starts,
            smoothing=optimise.SMOOTHING if smoothing is None else smoothing,
            seed=seed,
            progress=lambda done, of: progress(f"{done} of {of}"),
        )[0]
    except InputError as error:
        raise error.at(lights or surfaces or "--channels") from None
