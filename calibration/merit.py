"""Figures of merit of a matrix from camera bands to primaries, over the samples of its fit."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration import sets, uncertainty
from calibration.adaptation import D65, cat02
from calibration.difference import delta_e_2000, lab
from calibration.linear import Samples, condition
from calibration.primaries import Primaries
from calibration.transform import LIGHT

# A patch is worth another measurement from this dE on, and from so many times the median.
_STANDS_OUT_DELTA_E = 2.0
_STANDS_OUT = 4.0
_MOST_TO_REMEASURE = 6
# Relative noise of the bands at which the figures say what becomes of a white.
_BAND_NOISE = 0.005


def figures(matrix, samples: Samples, primaries: Primaries, quantity: str) -> dict[str, Any]:
    """How good a matrix is on its own samples, ready to be written; see `calibration.fit`."""
    off = errors(matrix, samples, primaries)
    made = {
        "training_delta_e": spread(off, samples.weights),
        "light_delta_e": means(off, samples.groups),
        **_by_name(off, samples),
        "spectral_error": rounded(_spectral_error(matrix, samples)),
        "noise_amplification": rounded(noise_amplification(matrix, samples.signals)),
        "condition": rounded(condition(samples.signals)),
        "samples": len(samples.signals),
        "lights": len(set(samples.groups)),
    }
    if quantity == LIGHT:
        made["white_noise_delta_e"] = _white_noise(matrix, samples, primaries)
    return made


def noise_amplification(matrix, signals) -> NDArray[np.float64]:
    """Relative noise of each primary (P,) when every band has relative noise 1, as rms.

    matrix   (P, B)
    signals  (n, B) what the camera sees, not noisy
    """
    noise = (np.asarray(signals) ** 2) @ (np.asarray(matrix) ** 2).T
    value = (np.asarray(signals) @ np.asarray(matrix).T) ** 2
    return np.sqrt(noise.mean(axis=0) / value.mean(axis=0))


def leave_one_light_out(
    solved: Callable[[Collection[str]], NDArray[np.float64]],
    samples: Samples,
    primaries: Primaries,
) -> dict[str, Any]:
    """The figure of that name: each light's colours come from a fit to all the others.

    solved   the matrix (P, B) from all lights but some
    returns  empty, where without a light too few samples are left
    """
    bands = samples.signals.shape[1]
    lights = samples.lights
    if min(np.count_nonzero(samples.groups != light) for light in lights) < bands:
        return {}
    off = np.empty(len(samples.groups))
    for light in lights:
        inside = samples.groups == light
        off[inside] = errors(solved((light,)), samples.only(inside), primaries)
    return {"leave_one_light_out_delta_e": left_out(off, samples)}


def left_out(off, samples: Samples) -> dict[str, Any]:
    """Spread of the errors (n,) of lights left out, and the light that is worst known so."""
    by_light = means(off, samples.groups)
    return {
        **spread(off, samples.weights),
        "worst_light": max(by_light, key=lambda light: by_light[light]),
    }


def errors(matrix, samples: Samples, primaries: Primaries) -> NDArray[np.float64]:
    """CIEDE2000 (n,) of what the matrix makes of the signals against the full spectra.

    Adapted to each light's white. So the error of the primaries themselves is in it, as it will
    be in every picture.
    """
    true = sets.xyz(samples.spectra)
    seen = samples.signals @ (primaries.xyz_from_primaries @ matrix).T
    off = np.empty(len(true))
    for light in samples.lights:
        rows = samples.groups == light
        white = true[rows][np.argmax(true[rows, 1])]
        to_d65 = cat02(white, D65) / white[1]
        off[rows] = delta_e_2000(lab(true[rows] @ to_d65.T), lab(seen[rows] @ to_d65.T))
    return off


def _white_noise(matrix, samples: Samples, primaries: Primaries) -> dict[str, float]:
    """Rms CIEDE2000 that noise of _BAND_NOISE in every band gives each light's white."""
    brightest = np.stack([samples.signals[samples.brightest(light)] for light in samples.lights])
    covariance = uncertainty.of_primaries((_BAND_NOISE * brightest) ** 2, matrix)
    in_xyz = uncertainty.of_xyz(covariance, primaries.xyz_from_primaries)
    whites = brightest @ (primaries.xyz_from_primaries @ matrix).T
    off = [uncertainty.delta_e(w, c, w) for w, c in zip(whites, in_xyz, strict=True)]
    return {"mean": rounded(np.mean(off)), "max": rounded(np.max(off))}


def _spectral_error(matrix, samples: Samples) -> NDArray[np.float64]:
    """Rms error of each primary (P,) over its rms, every light's brightest sample being 1."""
    weights = samples.weights / samples.scale**2
    off = np.average((samples.signals @ matrix.T - samples.targets) ** 2, axis=0, weights=weights)
    size = np.average(samples.targets**2, axis=0, weights=weights)
    error: NDArray[np.float64] = np.sqrt(off / size)
    return error


def _by_name(off, samples: Samples) -> dict[str, Any]:
    """Figures of single patches: their means, and what stands out so far that it may be wrong."""
    if not samples.names.any():
        return {}
    limit = max(_STANDS_OUT_DELTA_E, _STANDS_OUT * float(np.median(off)))
    worst = [i for i in np.argsort(-off)[:_MOST_TO_REMEASURE] if off[i] > limit]
    return {
        "sample_delta_e": means(off, samples.names),
        "remeasure": [
            f"patch {samples.names[i]} under {samples.groups[i]}: {off[i]:.2f}" for i in worst
        ],
    }


def means(off, labels) -> dict[str, float]:
    """Mean error of each label, in the order they first appear."""
    return {key: rounded(off[labels == key].mean()) for key in dict.fromkeys(labels.tolist())}


def spread(off, weights) -> dict[str, float]:
    """Weighted mean and standard deviation, and the plain 95th percentile and maximum."""
    mean = np.average(off, weights=weights)
    return {
        "mean": rounded(mean),
        "sd": rounded(math.sqrt(np.average((off - mean) ** 2, weights=weights))),
        "p95": rounded(np.percentile(off, 95)),
        "max": rounded(off.max()),
    }


def rounded(values) -> Any:
    """Numbers as they are written down: to 4 decimals, in lists."""
    return np.round(values, 4).tolist()
