"""Spectra: reading them with care, and bringing them to the one grid all colour is computed on."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calibration.errors import InputError, Problem, fault, read_text

STEP_NM = 10.0
WAVELENGTHS: NDArray[np.float64] = np.arange(380.0, 731.0, STEP_NM)
"""The grid (36,), nm."""

WAVELENGTHS.flags.writeable = False

# A spectrum must reach at least from 400 to 700 nm. Beyond its ends its last value is kept: the
# observer sees .4 % of an equal-energy light's luminance and 3 % of its Z there, and published
# filter and lamp tables often stop at these two wavelengths.
COVER_NM = (400.0, 700.0)

KINDS = ("any", "fraction", "power")

_MOST_PROBLEMS = 10  # of one file; more cells than this say the same thing again


@dataclass(frozen=True)
class Spectra:
    """Named spectra on one list of wavelengths.

    wavelengths  (K,) nm, ascending
    names        (n,)
    values       (K, n), one column a spectrum
    """

    wavelengths: NDArray[np.float64]
    names: tuple[str, ...]
    values: NDArray[np.float64]

    def __post_init__(self) -> None:
        assert self.values.shape == (len(self.wavelengths), len(self.names)), self.values.shape

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """The spectrum (K,) of that name."""
        return self.values[:, self.names.index(name)]

    def only(self, names: Iterable[str]) -> Spectra:
        """The spectra of these names, in this order."""
        names = tuple(names)
        columns = [self.names.index(name) for name in names]
        return Spectra(self.wavelengths, names, self.values[:, columns])

    def resampled(self) -> Spectra:
        """The same spectra band-averaged on WAVELENGTHS; see `resample`."""
        return Spectra(WAVELENGTHS, self.names, resample(self.wavelengths, self.values))


def join(parts: Iterable[Spectra]) -> Spectra:
    """Several sets on the same wavelengths as one."""
    parts = tuple(parts)
    assert all(np.array_equal(p.wavelengths, parts[0].wavelengths) for p in parts)
    return Spectra(
        parts[0].wavelengths,
        tuple(name for p in parts for name in p.names),
        np.concatenate([p.values for p in parts], axis=1),
    )


def resample(wavelengths, values) -> NDArray[np.float64]:
    """Spectra on WAVELENGTHS, each value the average over a triangular band of +-10 nm.

    A sample counts in the band at c with 1 - |its wavelength - c| / 10 nm times the width it
    stands for. So a line between two bands is shared between them with its power and its
    centroid kept, which is what keeps a lamp's colour right: picking values off the curve
    instead loses or doubles mercury's lines (7 to 16 dE for the CIE's fluorescent lamps).
    Data already on the grid come out as they are; steps wider than 10 nm are first divided by
    linear interpolation. Ends that are missing keep the nearest value, see COVER_NM.

    wavelengths  (K,) nm, ascending, any step
    values       (K, n)
    returns      (36, n)
    raises       InputError if the data do not reach from 400 to 700 nm
    """
    w = np.asarray(wavelengths, np.float64)
    if w[0] > COVER_NM[0] or w[-1] < COVER_NM[1]:
        raise fault(
            f"spectra from {w[0]:g} to {w[-1]:g} nm",
            f"at least {COVER_NM[0]:g} to {COVER_NM[1]:g} nm",
            "measure or look up the missing wavelengths",
        )
    dense = _divided(np.concatenate([_before(w), w, -_before(-w[::-1])[::-1]]))
    share = np.clip(1.0 - np.abs(dense - WAVELENGTHS[:, None]) / STEP_NM, 0.0, None)
    share = share * np.gradient(dense)
    share /= share.sum(axis=1, keepdims=True)
    at_dense = [np.interp(dense, w, column) for column in np.asarray(values, np.float64).T]
    return share @ np.stack(at_dense, axis=1)


def _before(w: NDArray[np.float64]) -> NDArray[np.float64]:
    """Wavelengths that continue w downwards at its own first step, a band past the grid's end."""
    end = (WAVELENGTHS[0] if w[0] > 0 else -WAVELENGTHS[-1]) - STEP_NM
    step = min(w[1] - w[0], STEP_NM)
    count = max(0, math.ceil((w[0] - end) / step - 1e-9))
    return w[0] - step * np.arange(count, 0, -1)


def _divided(w: NDArray[np.float64]) -> NDArray[np.float64]:
    """w with every step wider than 10 nm divided evenly into steps of 1 nm or less."""
    step = np.diff(w)
    pieces = np.where(step > STEP_NM * (1.0 + 1e-9), np.ceil(step), 1).astype(int)
    inner = [np.linspace(a, b, n + 1)[:-1] for a, b, n in zip(w[:-1], w[1:], pieces, strict=True)]
    return np.concatenate([*inner, w[-1:]])


def read_spectra(path: str | Path, kind: str = "any") -> Spectra:
    """The spectra of a CSV file as they stand there: `wavelength_nm` first, a column a spectrum.

    path    the file, UTF-8
    kind    "fraction" for reflectance and transmittance: values within 0..1;
            "power" for radiance and sensitivity: no negative values beyond noise, not all 0;
            "any" for what is neither (n and k)
    raises  InputError with every problem found, each naming the file and the cell
    """
    path = Path(path)
    try:
        return _parsed(_text(path), kind)
    except InputError as error:
        raise error.at(path) from None


def write_spectra(path: str | Path, spectra: Spectra) -> None:
    """Write spectra as the CSV that `read_spectra` reads; every number comes back as it was."""
    Path(path).write_text(to_csv(spectra), encoding="utf-8", newline="")


def to_csv(spectra: Spectra) -> str:
    """Spectra as the text of the CSV that `read_spectra` reads."""
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    out.writerow(["wavelength_nm", *spectra.names])
    for wavelength, row in zip(spectra.wavelengths, spectra.values, strict=True):
        out.writerow([f"{wavelength:.10g}", *(repr(float(v)) for v in row)])
    return text.getvalue()


def _text(path: Path) -> str:
    if not path.is_file():
        raise fault("no such file", "a CSV of spectra", "check the path")
    try:
        return read_text(path, "a CSV of spectra")
    except UnicodeDecodeError as error:
        raise fault(
            f"byte {error.start} is not UTF-8", "UTF-8 text", "save the file as CSV UTF-8"
        ) from None


def _parsed(text: str, kind: str) -> Spectra:
    assert kind in KINDS, kind
    lines = _lines(text)
    if not lines:
        raise fault("the file is empty", "wavelength_nm and a column a spectrum", "fill it")
    (_, header), rows = lines[0], lines[1:]
    _raise_any(_header_problems(header))
    if len(rows) < 2:
        raise fault(
            f"{len(rows)} rows of values", "two or more wavelengths", "give one row a wavelength"
        )
    table = np.full((len(rows), len(header)), np.nan)
    _raise_any(_fill(table, header, rows))
    numbers = [number for number, _ in rows]
    _raise_any(_wavelength_problems(table[:, 0], numbers))
    spectra = Spectra(table[:, 0], tuple(header[1:]), table[:, 1:])
    _raise_any(_value_problems(spectra, numbers, kind))
    return spectra


def _lines(text: str) -> list[tuple[int, list[str]]]:
    """Line number and cells of every line that is not blank."""
    try:
        return [
            (number, [cell.strip() for cell in cells])
            for number, cells in enumerate(csv.reader(io.StringIO(text)), start=1)
            if any(cell.strip() for cell in cells)
        ]
    except csv.Error as error:
        raise fault(str(error), "comma-separated values", "save the file as CSV UTF-8") from None


def _raise_any(problems: Iterable[Problem]) -> None:
    found = list(problems)
    if len(found) > _MOST_PROBLEMS:
        more = len(found) - _MOST_PROBLEMS
        found[_MOST_PROBLEMS:] = [Problem(f"{more} more such cells", "", "mend them likewise")]
    if found:
        raise InputError(found)


def _header_problems(header: list[str]) -> Iterator[Problem]:
    if header[0] != "wavelength_nm":
        yield Problem(
            f"the first column is {header[0]!r}",
            "'wavelength_nm', columns separated by commas",
            "put the wavelengths in nm first and name that column so",
        )
        return
    if len(header) < 2:
        yield Problem("no spectrum beside wavelength_nm", "a column a spectrum", "add one")
    for i, name in enumerate(header):
        if not name:
            yield Problem(f"line 1, column {i + 1}: no name", "a name a column", "name the column")
        elif name in header[:i]:
            yield Problem(f"line 1, column {i + 1}: {name!r} again", "each name once", "rename it")


def _fill(table, header: list[str], rows: list[tuple[int, list[str]]]) -> Iterator[Problem]:
    """Put the rows' numbers into the table; what is not a number is a problem."""
    for r, (number, cells) in enumerate(rows):
        if len(cells) != len(header):
            yield Problem(
                f"line {number}: {len(cells)} cells",
                f"{len(header)}, one a column",
                "fill the gap or take the extra cells out",
            )
            continue
        for c, cell in enumerate(cells):
            where = f"line {number}, column {header[c]!r}"
            if not cell:
                yield Problem(f"{where}: empty", "a number", "fill the gap or leave the row out")
                continue
            try:
                value = float(cell)
            except ValueError:
                yield Problem(f"{where}: {cell!r}", "a number", "write it with a decimal point")
                continue
            if not math.isfinite(value):
                yield Problem(
                    f"{where}: {cell!r}", "a finite number", "measure it again or leave the row out"
                )
            table[r, c] = value


def _wavelength_problems(w: NDArray[np.float64], numbers: list[int]) -> Iterator[Problem]:
    if w.max() < 10.0:
        yield Problem(
            f"wavelengths from {w.min():g} to {w.max():g} look like micrometres",
            "nanometres",
            "multiply the first column by 1000",
        )
        return
    if w.min() <= 0.0:
        yield Problem(f"a wavelength of {w.min():g}", "nanometres above 0", "correct it")
    for i in np.flatnonzero(np.diff(w) <= 0.0) + 1:
        says = "again" if w[i] in w[:i] else f"after {w[i - 1]:g} nm"
        yield Problem(
            f"line {numbers[i]}, column 'wavelength_nm': {w[i]:g} nm {says}",
            "ascending wavelengths, each once",
            "sort the rows and take repeats out",
        )


def _value_problems(spectra: Spectra, numbers: list[int], kind: str) -> Iterator[Problem]:
    """What the numbers cannot mean: percent, negative light, nothing at all.

    Fractions get a little room: glossy or fluorescing samples read above 1, noise below 0.
    """
    if kind == "any":
        return
    for name, column in zip(spectra.names, spectra.values.T, strict=True):
        top, low = int(np.argmax(column)), int(np.argmin(column))
        room = 0.01 if kind == "fraction" else 0.02 * np.abs(column).max()
        if kind == "fraction" and column[top] > 1.5:
            percent = "looks like percent" if column[top] <= 150.0 else "is above 1"
            yield Problem(
                f"line {numbers[top]}, column {name!r}: {column[top]:g} {percent}",
                "fractions between 0 and 1",
                "divide the column by 100" if column[top] <= 150.0 else "correct it",
            )
        if column[low] < -room:
            yield Problem(
                f"line {numbers[low]}, column {name!r}: {column[low]:g}",
                "no negative values",
                "subtract the dark reading rightly, or correct it",
            )
        elif column[top] <= 0.0 and kind == "power":
            yield Problem(f"column {name!r}: nothing but 0", "some light", "measure it again")
