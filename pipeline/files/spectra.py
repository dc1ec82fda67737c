"""The user's lights and surfaces: files in which every spectrum must tell something."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calibration.checks import problems_of_set
from calibration.errors import InputError, Problem
from calibration.spectra import Spectra, read_spectra

_KINDS = {"light": "power", "surface": "fraction"}


def read_set(path: Path, what: str) -> Spectra:
    """The lights or surfaces of a CSV file, band-averaged on the common grid.

    what    "light" or "surface"
    raises  InputError naming the file and each spectrum that is negative, in percent, constant,
            or there twice
    """
    try:
        spectra = read_spectra(path, _KINDS[what])
        problems = [*_constant(spectra, what)] or problems_of_set(spectra, what)
        if problems:
            raise InputError(problems)
        return spectra.resampled()
    except InputError as error:
        raise error.at(path) from None


def _constant(spectra: Spectra, what: str) -> Iterator[Problem]:
    for name, column in zip(spectra.names, spectra.values.T, strict=True):
        if np.ptp(column) == 0.0:
            yield Problem(
                f"{what} {name!r} is {column[0]:g} at every wavelength",
                "a measured spectrum",
                "measure it, or take it out",
            )
