"""Rendering primaries: the few curves that light and surfaces are reduced to, and their matrix.

A spectrum becomes its averages over the curves (equation 1 of Darling et al. 2011); light times
surface is done channel by channel (2), and one matrix brings the products to XYZ (3).
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.errors import InputError, Problem, fault, read_text
from calibration.spectra import STEP_NM, WAVELENGTHS, Spectra, read_spectra, to_csv

DEFAULT = "signed6"
"""The set that measures best end to end, noise included: docs/colour.md. The paper's is
`darling2011`."""
NAMES = (
    "signed6",
    "darling2011",
    "gaussian6",
    "nonnegative6",
    "signed5",
    "signed7",
    "signed8",
)

CURVES_FILE = "curves.csv"
MATRIX_FILE = "xyz_from_primaries.csv"
TRAINED_ON_FILE = "trained_on.txt"

_DATA = Path(__file__).parent / "data" / "primaries"


@dataclass(frozen=True)
class Primaries:
    """A set of N rendering primaries, in order of peak wavelength.

    name                the set's
    curves              (36, N) on WAVELENGTHS, each summing to 1: a perfect reflector is 1
    xyz_from_primaries  (3, N); light of unit spectral radiance at all wavelengths on a perfect
                        white has Y = 1
    trained_on          what the matrix (and the curves) were fitted to, in words
    """

    name: str
    curves: NDArray[np.float64]
    xyz_from_primaries: NDArray[np.float64]
    trained_on: str = ""

    @property
    def channels(self) -> tuple[str, ...]:
        """P1, P2, ..."""
        return tuple(f"P{i + 1}" for i in range(self.curves.shape[1]))

    @property
    def peaks_nm(self) -> NDArray[np.float64]:
        """Peak wavelength (N,) of each curve, nm."""
        return _gaussian_at_top(self.curves)[0]

    @property
    def widths_nm(self) -> NDArray[np.float64]:
        """Width (N,) of each curve as the sigma of a Gaussian, nm."""
        return _gaussian_at_top(self.curves)[1]

    @property
    def digest(self) -> str:
        """sha256 of the numbers, as hex: equal for equal sets wherever they were loaded from."""
        # In .9g so that the last bits of a sum do not make another set of it.
        numbers = (*self.curves.ravel(), *self.xyz_from_primaries.ravel())
        return hashlib.sha256(" ".join(f"{v:.9g}" for v in numbers).encode()).hexdigest()

    def project(self, spectra) -> NDArray[np.float64]:
        """Spectra (..., 36) on WAVELENGTHS in these primaries (..., N): averages over the curves.

        Spectral radiance stays in W/(sr m2 nm), reflectance stays a factor.
        """
        return np.asarray(spectra, np.float64) @ self.curves


def gaussians(peaks_nm, widths_nm) -> NDArray[np.float64]:
    """Gaussian curves (36, N) on WAVELENGTHS, each summing to 1."""
    curves = np.exp(-0.5 * ((WAVELENGTHS[:, None] - peaks_nm) / widths_nm) ** 2)
    return curves / curves.sum(axis=0)


def _gaussian_at_top(curves) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Peak and sigma (N,) of the Gaussian through each curve's highest sample and its neighbours.

    Three samples of a Gaussian give both exactly: their logarithms lie on a parabola.
    """
    top = np.clip(np.argmax(curves, axis=0), 1, len(curves) - 2)
    columns = np.arange(curves.shape[1])
    highest = curves.max(axis=0)
    before, at, after = (
        np.log(np.maximum(curves[top + i, columns], 1e-9 * highest)) for i in (-1, 0, 1)
    )
    bend = np.maximum(2.0 * at - before - after, 1e-9)  # a curve at its top never bends upwards
    return WAVELENGTHS[top] + STEP_NM * (after - before) / (2.0 * bend), STEP_NM / np.sqrt(bend)


def load(name_or_path: str | Path = DEFAULT) -> Primaries:
    """A set of primaries: one of NAMES, or a folder that `write` wrote.

    raises  InputError with every problem found
    """
    if str(name_or_path) in NAMES:
        return _read(_DATA / str(name_or_path), str(name_or_path))
    folder = Path(name_or_path)
    if not folder.is_dir():
        raise fault(
            f"no primaries are called {str(name_or_path)!r}, nor is there such a folder",
            ", ".join(NAMES),
            f"name one, or a folder with {CURVES_FILE} and {MATRIX_FILE}",
        )
    return _read(folder, folder.resolve().name)


def files(primaries: Primaries) -> dict[str, str]:
    """The files of a set, name to text: curves.csv, xyz_from_primaries.csv, trained_on.txt."""
    rows = [",".join(["", *primaries.channels])]
    for axis, row in zip("XYZ", primaries.xyz_from_primaries, strict=True):
        rows.append(",".join([axis, *(repr(float(v)) for v in row)]))
    return {
        CURVES_FILE: to_csv(Spectra(WAVELENGTHS, primaries.channels, primaries.curves)),
        MATRIX_FILE: "\n".join(rows) + "\n",
        TRAINED_ON_FILE: primaries.trained_on.strip() + "\n",
    }


def write(primaries: Primaries, folder: str | Path) -> None:
    """Write a set into a folder, made if missing, as `load` reads it."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files(primaries).items():
        (folder / name).write_text(text, encoding="utf-8", newline="")


def _read(folder: Path, name: str) -> Primaries:
    curves = read_spectra(folder / CURVES_FILE)
    expected = tuple(f"P{i + 1}" for i in range(len(curves)))
    problems = []
    if not np.array_equal(curves.wavelengths, WAVELENGTHS):
        problems.append(Problem("other wavelengths", "380..730/10 nm", "resample the curves"))
    if curves.names != expected:
        problems.append(
            Problem(f"columns {', '.join(curves.names)}", ", ".join(expected), "name them so")
        )
    if len(curves) < 3:
        problems.append(Problem(f"{len(curves)} primaries", "3 or more", "add curves"))
    for channel, total in zip(curves.names, curves.values.sum(axis=0), strict=True):
        if abs(total - 1.0) > 1e-6:
            problems.append(
                Problem(
                    f"{channel} sums to {total:.6g}",
                    "1, so that a perfect white is 1 in every channel",
                    "divide the curve by its sum",
                )
            )
    if problems:
        raise InputError(problems).at(folder / CURVES_FILE)
    matrix = _read_matrix(folder / MATRIX_FILE, expected)
    note = folder / TRAINED_ON_FILE
    trained_on = note.read_text(encoding="utf-8").strip() if note.is_file() else ""
    primaries = Primaries(name, curves.values, matrix, trained_on)
    if np.any(np.diff(primaries.peaks_nm) <= 0.0):
        raise fault(
            "peaks at " + ", ".join(f"{p:.0f}" for p in primaries.peaks_nm) + " nm",
            "ascending peaks",
            "sort the curves, and the matrix with them",
            folder / CURVES_FILE,
        )
    return primaries


def _read_matrix(path: Path, channels: tuple[str, ...]) -> NDArray[np.float64]:
    if not path.is_file():
        raise fault("no such file", "the matrix to XYZ", f"put it beside {CURVES_FILE}", path)
    try:
        lines = read_text(path, "a CSV of three rows").split("\n")
        cells = [[cell.strip() for cell in line.split(",")] for line in lines if line.strip()]
        matrix = np.array([[float(cell) for cell in row[1:]] for row in cells[1:]])
    except InputError as error:
        raise error.at(path) from None
    except ValueError as error:  # text, rows of unequal length, not UTF-8
        raise fault(str(error), "three rows of numbers", "correct the cell", path) from None
    labels = [row[0] for row in cells[1:]]
    if labels != ["X", "Y", "Z"] or tuple(cells[0][1:]) != channels:
        raise fault(
            f"rows {', '.join(labels)}, columns {', '.join(cells[0][1:])}",
            f"rows X, Y, Z, columns {', '.join(channels)}",
            "label rows and columns so",
            path,
        )
    if matrix.shape != (3, len(channels)) or not np.isfinite(matrix).all():
        raise fault("gaps or NaN", "three rows of finite numbers", "fill them", path)
    white = matrix[1].sum()
    if abs(white - 1.0) > 0.05:
        raise fault(
            f"an equal-energy light of unit radiance gets Y = {white:.4g}",
            "1, so that units survive",
            "divide the matrix by that number",
            path,
        )
    return matrix
