"""What is wrong with spectra that a user gave: named, with what to do about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration import sets
from calibration.errors import InputError, Problem
from calibration.spectra import Spectra

# Readings fall this far below 0, as a share of their greatest value, by noise alone.
_DIP = 0.02
_MOST_REFLECTANCE = 1.5  # fluorescent whites exceed 1; more than this is percent
_MOST_PROBLEMS = 10
_MOST_LUMINANCE = 2e5  # cd/m2: white in full sun has 3e4
_ODD_RATIO = 30.0  # exposures are tagged to a few percent, units differ by 100 or 1000


def problems_of_set(spectra: Spectra, what: str) -> list[Problem]:
    """What is wrong with a set to train on: negative, empty, in percent, constant, or twice.

    spectra  as they were given, on any wavelengths
    what     "light" or "surface", for the messages and for what the values may be: of a light
             only the shape counts, so twice the same light is the same light
    """
    assert what in ("light", "surface"), what
    values, names = spectra.values, spectra.names
    problems = []
    for name, column in zip(names, values.T, strict=True):
        top = column.max()
        if column.min() < -_DIP * np.abs(column).max():
            problems.append(
                Problem(f"{what} {name!r} is negative", "0 or more", "correct the readings")
            )
        elif top <= 0.0:
            problems.append(Problem(f"{what} {name!r} is 0 everywhere", "a spectrum", "remove it"))
        elif what == "surface" and top > _MOST_REFLECTANCE:
            problems.append(
                Problem(
                    f"{what} {name!r} reaches {top:.3g}: percent?",
                    "reflectance factors of 0 to 1",
                    "divide it by 100",
                )
            )
    if problems:
        return problems
    if len(names) > 1 and np.all(np.ptp(values, axis=0) <= 1e-9 * values.max(axis=0)):
        return [
            Problem(f"every {what} is the same at all wavelengths", "spectra", "measure real ones")
        ]
    shapes = values / values.sum(axis=0) if what == "light" else values
    for i, name in enumerate(names):
        same = [j for j in range(i) if np.allclose(shapes[:, i], shapes[:, j], rtol=1e-6, atol=0)]
        if same:
            problems.append(
                Problem(
                    f"{what} {name!r} is {names[same[0]]!r} again",
                    f"each {what} once, or it counts twice",
                    "remove one",
                )
            )
    return problems


def check_lights(
    signals: Mapping[str, Any], radiances: Mapping[str, Spectra], patches: Sequence[str]
) -> None:
    """Refuses lights of which photographs or readings lack, wholly or of some patch.

    signals    by light          radiances  by light, spectra named as the patches
    """
    problems = [
        Problem(f"light {light!r} has photographs but no radiance", "both", "measure it")
        for light in signals
        if light not in radiances
    ]
    for light in radiances:
        if light not in signals:
            problems.append(
                Problem(f"light {light!r} has radiance but no photographs", "both", "take them")
            )
            continue
        missing = [patch for patch in patches if patch not in radiances[light].names]
        if missing:
            problems.append(
                Problem(
                    f"light {light!r} has no radiance of patch {', '.join(missing)}",
                    "a column a patch, named as the chart's patches",
                    "measure or rename them",
                )
            )
    if problems:
        raise InputError(problems)


def check_readings(
    signals: Mapping[str, Any],
    spectra: Mapping[str, NDArray[np.float64]],
    patches: Sequence[str],
) -> None:
    """Refuses readings that cannot be of these patches under these lights.

    signals  light -> (n, B)          spectra  light -> (n, 36), W/(sr m2 nm)
    patches  (n,) names
    """
    problems: list[Problem] = []
    for light, rows in spectra.items():
        for patch, row in zip(patches, rows, strict=True):
            if row.min() < -_DIP * np.abs(row).max():
                problems.append(
                    Problem(
                        f"light {light!r}, patch {patch}: a negative radiance",
                        "0 or more",
                        "subtract the dark reading rightly, or measure it again",
                    )
                )
            elif np.ptp(row) <= 1e-9 * row.max():
                problems.append(
                    Problem(
                        f"light {light!r}, patch {patch}: {row[0]:g} at every wavelength",
                        "a measured spectrum",
                        "measure it; this is a stand-in",
                    )
                )
    lights = list(spectra)
    for i, light in enumerate(lights):
        for other in lights[:i]:
            if np.allclose(spectra[light], spectra[other], rtol=1e-9, atol=0):
                problems.append(
                    Problem(
                        f"light {light!r} has the readings of {other!r}",
                        "each light's own",
                        "copy the right file there, or remove one of the two",
                    )
                )
    problems = problems or _odd_units(signals, spectra)
    if len(problems) > _MOST_PROBLEMS:
        more = f"{len(problems) - _MOST_PROBLEMS} more such readings"
        problems = [*problems[:_MOST_PROBLEMS], Problem(more, "", "mend them likewise")]
    if problems:
        raise InputError(problems)


def _odd_units(
    signals: Mapping[str, Any], spectra: Mapping[str, NDArray[np.float64]]
) -> list[Problem]:
    """Lights whose readings are in another unit, by daylight's limits or by the others' signals."""
    problems = []
    per_signal = {}
    for light, rows in spectra.items():
        # 683 lm/W times the integral with V(lambda), which sums to 1 here and to 10.686 per 10 nm.
        brightest = 683.0 * 106.86 * float(sets.xyz(rows)[:, 1].max())
        if brightest > _MOST_LUMINANCE:
            problems.append(
                Problem(
                    f"light {light!r}: the chart shines with {brightest:.2g} cd/m2",
                    "spectral radiance in W/(sr m2 nm)",
                    "convert the unit: mW, um and cm2 are the usual slips",
                )
            )
        per_signal[light] = float(np.nansum(rows) / np.nansum(np.asarray(signals[light])))
    usual = float(np.median(list(per_signal.values())))
    for light, value in per_signal.items():
        if not problems and usual > 0 and not usual / _ODD_RATIO < value < usual * _ODD_RATIO:
            problems.append(
                Problem(
                    f"light {light!r}: {value / usual:.2g} times the radiance per signal of others",
                    "readings of all lights in W/(sr m2 nm)",
                    "convert its unit, or correct the exposure that its photographs state",
                )
            )
    return problems
