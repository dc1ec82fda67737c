"""`sixlight primaries fit`: a new set of primaries for the user's lights and surfaces."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from calibration import optimise, sets
from calibration.errors import fault
from calibration.primaries import Primaries
from calibration.spectra import Spectra, read_spectra


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
    return optimise.new_set(
        _read(lights, "power") or sets.lights(optimise.TRAINING_LIGHTS),
        _read(surfaces, "fraction") or sets.surfaces(optimise.TRAINING_SURFACES),
        name=name,
        channels=channels,
        kind=kind,
        starts=starts,
        smoothing=optimise.SMOOTHING if smoothing is None else smoothing,
        seed=seed,
        progress=lambda done, of: progress(f"{done} of {of}"),
    )[0]


def _read(path: Path | None, kind: str) -> Spectra | None:
    return None if path is None else read_spectra(path, kind).resampled()
