"""A fitted matrix from camera bands to rendering primaries, M_S or M_R, and its TOML file."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.errors import InputError, Problem, fault, read_text
from calibration.primaries import Primaries

LIGHT, REFLECTANCE = QUANTITIES = ("light", "reflectance")
_MATRIX_OF = {LIGHT: "M_S", REFLECTANCE: "M_R"}
MOST_SIGNALS = 240  # rows kept of a chart under its lights: ten times 24 patches, 10 kB of text


@dataclass(frozen=True)
class Transform:
    """A matrix from camera bands to primaries, with what one needs to know before trusting it.

    matrix            (P, B), primaries = matrix @ bands
    channels          (B,) the bands, "<filter>.<R, G or B>"
    primaries         name of the set
    primaries_digest  its sha256
    peaks_nm          (P,) peak wavelengths, nm
    widths_nm         (P,) widths, nm
    units             of the result, in words
    absolute          whether that is W/(sr m2 nm)
    method            one of METHODS
    noise_level       relative noise of a band that the fit expected; 0 for "pinv"
    figures           how good it is: see `fit`
    inputs            name to sha256 of each file it was made from
    quantity          what it gives: one of QUANTITIES. M_S gives light; M_R reflectance, from
                      signals over those of a white in the same light
    signals           (n, B) what the bands saw of the chart's patches under the session's lights,
                      on one scale; None where it was not fitted to a chart, or by an earlier
                      version. Not needed to transform: it shows what light looks like to the bands
    """

    matrix: NDArray[np.float64]
    channels: tuple[str, ...]
    primaries: str
    primaries_digest: str
    peaks_nm: tuple[float, ...]
    widths_nm: tuple[float, ...]
    units: str
    absolute: bool
    method: str
    noise_level: float
    figures: Mapping[str, Any] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)
    quantity: str = LIGHT
    signals: NDArray[np.float64] | None = None


def matched(
    transform: Transform, channels: Sequence[str], primaries: Primaries, quantity: str = LIGHT
) -> Transform:
    """The transform with its columns in the order of these bands.

    quantity  what it is wanted for, one of QUANTITIES
    raises    InputError if it is for other bands, other primaries or the other quantity
    """
    problems = []
    if transform.quantity != quantity:
        problems.append(
            Problem(
                f"a matrix for {transform.quantity} ({_MATRIX_OF[transform.quantity]})",
                f"one for {quantity} ({_MATRIX_OF[quantity]})",
                f"name the {_MATRIX_OF[quantity]} that sixlight fit wrote",
            )
        )
    if sorted(channels) != sorted(transform.channels):
        problems.append(
            Problem(
                f"a matrix for the bands {', '.join(transform.channels)}",
                f"{', '.join(channels)}, as the capture has",
                "fit one for this capture's filters, or rename the filters",
            )
        )
    if transform.primaries_digest != primaries.digest:
        same = " of other numbers" if transform.primaries == primaries.name else ""
        problems.append(
            Problem(
                f"a matrix to the primaries {transform.primaries!r}{same}",
                repr(primaries.name),
                "fit the matrix again, or choose the primaries it was fitted to",
            )
        )
    if problems:
        raise InputError(problems)
    order = [transform.channels.index(channel) for channel in channels]
    return replace(
        transform,
        matrix=transform.matrix[:, order],
        channels=tuple(channels),
        signals=None if transform.signals is None else transform.signals[:, order],
    )


def to_toml(transform: Transform) -> str:
    """The transform as the text of M_S.toml; of its signals MOST_SIGNALS rows, to 4 digits."""
    import tomli_w

    text = tomli_w.dumps(
        {
            "quantity": transform.quantity,
            "channels": list(transform.channels),
            "matrix": transform.matrix.tolist(),
            "units": transform.units,
            "absolute": transform.absolute,
            "method": transform.method,
            "noise_level": transform.noise_level,
            "primaries": {
                "name": transform.primaries,
                "digest": transform.primaries_digest,
                "peaks_nm": list(transform.peaks_nm),
                "widths_nm": list(transform.widths_nm),
            },
            "figures": dict(transform.figures),
            "inputs": dict(transform.inputs),
        }
    )
    if transform.signals is None:
        return text
    rows = transform.signals[:: 1 + (len(transform.signals) - 1) // MOST_SIGNALS]
    lines = ("    [" + ", ".join(f"{v:.4g}" for v in row) + "],\n" for row in rows)
    return f"{text}\n[chart]\nsignals = [\n{''.join(lines)}]\n"  # a line a row, not one a number


def from_toml(text: str) -> Transform:
    """The transform that `to_toml` wrote; raises InputError with every problem found."""
    try:
        table = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise fault(f"not TOML: {error}", "a file that sixlight fit wrote", "fit again") from None
    problems = [
        Problem(f"{'.'.join(path)} is {_kind(value)}", what, "fit the matrix again")
        for path, types, what in _KEYS
        if not _is(value := _at(table, path), types)
    ]
    if problems:
        raise InputError(problems)
    quantity = table.get("quantity", LIGHT)
    if quantity not in QUANTITIES:
        raise fault(f"quantity is {quantity!r}", " or ".join(QUANTITIES), "fit the matrix again")
    channels, head = tuple(map(str, table["channels"])), table["primaries"]
    shape = (len(head["peaks_nm"]), len(channels))
    try:
        matrix = np.array(table["matrix"], np.float64)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.shape != shape or not np.isfinite(matrix).all() or len(set(channels)) != shape[1]:
        raise fault(
            f"a matrix of {' x '.join(map(str, matrix.shape)) if matrix.size else 'gaps or text'}",
            f"{shape[0]} x {shape[1]} finite numbers, a row a primary and a column a channel",
            "fit the matrix again",
        )
    chart = table.get("chart")
    return Transform(
        matrix=matrix,
        channels=channels,
        primaries=head["name"],
        primaries_digest=head["digest"],
        peaks_nm=tuple(map(float, head["peaks_nm"])),
        widths_nm=tuple(map(float, head["widths_nm"])),
        units=table["units"],
        absolute=table["absolute"],
        method=table["method"],
        noise_level=float(table["noise_level"]),
        figures=table["figures"],
        inputs=table["inputs"],
        quantity=quantity,
        signals=None if chart is None else _signals(_at(chart, ("signals",)), len(channels)),
    )


def _signals(rows: Any, bands: int) -> NDArray[np.float64]:
    try:
        signals = np.array(rows, np.float64)
    except (TypeError, ValueError):
        signals = np.empty(0)
    if signals.shape[1:] != (bands,) or not np.isfinite(signals).all():
        raise fault(
            "chart.signals are no table of finite numbers",
            f"rows of {bands}, a column a channel",
            "fit the matrix again, or take [chart] out",
        )
    return signals


def write_transform(path: str | Path, transform: Transform) -> None:
    """Write M_S.toml."""
    Path(path).write_text(to_toml(transform), encoding="utf-8", newline="")


def read_transform(path: str | Path) -> Transform:
    """Read M_S.toml; raises InputError naming the file."""
    path = Path(path)
    if not path.is_file():
        raise fault(
            "no such file", "a file of sixlight fit", "run sixlight fit, or correct the path", path
        )
    try:
        return from_toml(read_text(path, "a file that sixlight fit wrote"))
    except UnicodeDecodeError:
        raise fault("not UTF-8", "a file that sixlight fit wrote", "fit again", path) from None
    except InputError as error:
        raise error.at(path) from None


# What M_S.toml must hold: where, of which type, in words.
_KEYS: tuple[tuple[tuple[str, ...], tuple[type, ...], str], ...] = (
    (("channels",), (list,), "a list of band names"),
    (("matrix",), (list,), "rows of numbers"),
    (("units",), (str,), "text"),
    (("absolute",), (bool,), "true or false"),
    (("method",), (str,), "text"),
    (("noise_level",), (int, float), "a number"),
    (("primaries", "name"), (str,), "text"),
    (("primaries", "digest"), (str,), "text"),
    (("primaries", "peaks_nm"), (list,), "a list of numbers"),
    (("primaries", "widths_nm"), (list,), "a list of numbers"),
    (("figures",), (dict,), "a table"),
    (("inputs",), (dict,), "a table"),
)


def _at(table: Any, path: tuple[str, ...]) -> Any:
    for key in path:
        table = table.get(key) if isinstance(table, dict) else None
    return table


def _is(value: Any, types: tuple[type, ...]) -> bool:
    return isinstance(value, types) and (bool in types or not isinstance(value, bool))


def _kind(value: Any) -> str:
    return "missing" if value is None else repr(value)[:40]
