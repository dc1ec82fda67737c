"""What the header of an image in primaries says, and reading it again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np

from calibration import primaries as primary_sets
from calibration.primaries import Primaries
from pipeline.errors import fault


def of_primaries(primaries: Primaries, *, unit: str, quantity: str) -> dict[str, str]:
    """What a reader of an image's channels must know.

    unit      of the values, in words
    quantity  "light" or "reflectance"
    """

    def numbers(values) -> str:
        return " ".join(f"{v:.9g}" for v in np.ravel(values))

    return {
        "version": version("sixlight"),
        "quantity": quantity,
        "unit": unit,
        "primaries": primaries.name,
        "peaks_nm": numbers(primaries.peaks_nm),
        "widths_nm": numbers(primaries.widths_nm),
        "xyz_from_primaries": numbers(primaries.xyz_from_primaries),
    }


def primaries_of(file: Path, names: Sequence[str], header: Mapping[str, str]) -> Primaries:
    """The named set that a file's header names, checked by its matrix; InputError without one."""
    name = header.get("primaries", "")
    if name in primary_sets.NAMES:
        primaries = primary_sets.load(name)
        if tuple(names) == primaries.channels and has_matrix(header, primaries):
            return primaries
    raise fault(
        f"an image in the primaries {name!r} with {len(names)} channels",
        f"one of {', '.join(primary_sets.NAMES)}",
        "give a file that this version of sixlight wrote, or name its primaries",
        file,
    )


def has_matrix(header: Mapping[str, str], primaries: Primaries) -> bool:
    """Whether a header's matrix to XYZ is the primaries'."""
    try:
        matrix = np.array(header.get("xyz_from_primaries", "").split(), float)
    except ValueError:
        return False
    wanted = primaries.xyz_from_primaries.ravel()
    return matrix.shape == wanted.shape and bool(np.allclose(matrix, wanted, rtol=1e-6))
