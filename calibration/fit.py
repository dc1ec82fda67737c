"""M_S and M_R: the matrices from a camera's bands to rendering primaries, fitted.

A capture's bands are the camera's R, G, B through each filter in turn: `cyan.R`, `cyan.G`, ...
For light, `primaries = M_S @ bands`; for a surface the bands are its signals over those of a white
in the same light, and the matrix is M_R. Both are fitted to samples whose bands and spectra are
known: see `calibration.training`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration import merit
from calibration.colour_fit import by_colour
from calibration.linear import Equations, Samples, check_solvable
from calibration.primaries import Primaries
from calibration.training import TrainingSet
from calibration.transform import LIGHT, REFLECTANCE, Transform

METHODS = ("pinv", "ridge", "delta-e")
# From known sensitivities, whose many lights leave ridge little to gain; and from a chart session,
# where what is best depends on the session, and "delta-e" finds it out by leaving lights out.
DEFAULT_METHOD = "ridge"
CHART_METHOD = "delta-e"

# Relative noise of one band of one texel that a fit should expect: about that of a well exposed
# bracket. With four cameras and both good and common filters no primary's noise is amplified more
# than 10 times at it, and a white at half of it stays within 1 dE with cyan and yellow filters;
# at .007 one camera's was amplified 12.5 times.
NOISE_LEVEL = 0.01
# From a chart less is expected, since there it is colour that is short, not light.
CHART_NOISE_LEVEL = 0.004
# The noise of no primary may be amplified more than this: where it is, more noise is expected.
MOST_AMPLIFIED = 12.0

ABSOLUTE_UNITS = "W/(sr m2 nm)"
RELATIVE_UNITS = (
    "relative; 1 is the spectral radiance of an equal-energy light that brings the most sensitive "
    "band to the saturation level in 1 s at ISO 100 and f/1"
)
REFLECTANCE_UNITS = "reflectance factor; 1 is the white that signals are divided by"


def fit(
    training: TrainingSet,
    primaries: Primaries,
    *,
    method: str | None = None,
    noise_level: float | None = None,
    inputs: Mapping[str, str] | None = None,
) -> Transform:
    """The matrix that brings camera signals nearest to the primaries of their spectra.

    "pinv" is the paper's: plain least squares over all samples. "ridge" is the best linear
    estimate when every band of every pixel carries noise, and each light counts alike however
    bright it was (see calibration.linear). "delta-e" is whichever of several leaves the least
    CIEDE2000 of what is rendered on lights left out, ridge among them (see
    calibration.colour_fit); the figures' `chosen` says which.

    But for "pinv", no primary's noise is amplified more than MOST_AMPLIFIED times: where it would
    be, a higher noise level is expected, and the result states it.

    training     samples that are not known in every band are left out
    method       one of METHODS; default CHART_METHOD of photographs, DEFAULT_METHOD of known curves
    noise_level  relative noise of one band of one pixel; the variances expected are at least its.
                 Default CHART_NOISE_LEVEL and NOISE_LEVEL
    inputs       name to sha256 of each file that the samples are from
    returns      M_S or M_R, as the samples' quantity is. In W/(sr m2 nm) if photographed, else in
                 RELATIVE_UNITS. Its figures: `training_delta_e` and, with more than one light,
                 `leave_one_light_out_delta_e` (CIEDE2000 of the samples through the primaries'
                 own matrix against full spectra, each light's brightest sample as its white),
                 `light_delta_e` and `sample_delta_e` (means on the training), `remeasure` (what
                 stands out there), `spectral_error` (rms of each primary over its rms),
                 `noise_amplification` (relative noise of each primary over relative noise of the
                 bands), of M_S `white_noise_delta_e` (rms CIEDE2000 that .5 % of noise in every
                 band gives each light's white), `condition` of the bands, numbers of samples and
                 lights; of "delta-e" `chosen`
    raises       InputError if the samples cannot determine the matrix
    """
    chart = training.photographed
    method = method or (CHART_METHOD if chart else DEFAULT_METHOD)
    assert method in METHODS, method
    if noise_level is None:
        noise_level = CHART_NOISE_LEVEL if chart else NOISE_LEVEL
    samples = Samples.of(training, primaries, noise_level)
    check_solvable(samples, training)

    def solved() -> tuple[NDArray[np.float64], dict[str, Any]]:
        if method == "delta-e":
            curves_noise = noise_level if chart else None
            return by_colour(samples, primaries, training.quantity, curves_noise)
        equations = Equations.of(samples, noise=method != "pinv")
        left_out = merit.leave_one_light_out(equations.solved, samples, primaries)
        return equations.solved(), left_out

    matrix, how = solved()
    while method != "pinv" and (over := _amplified(matrix, samples) / MOST_AMPLIFIED) > 1.0:
        # Amplification falls about with the root of the level.
        noise_level *= max(1.05, over**2)
        samples = Samples.of(training, primaries, noise_level)
        matrix, how = solved()
    absolute = chart and training.quantity == LIGHT
    units = ABSOLUTE_UNITS if absolute else RELATIVE_UNITS
    return Transform(
        matrix=matrix,
        channels=training.channels,
        primaries=primaries.name,
        primaries_digest=primaries.digest,
        peaks_nm=tuple(np.round(primaries.peaks_nm, 3).tolist()),
        widths_nm=tuple(np.round(primaries.widths_nm, 3).tolist()),
        units=REFLECTANCE_UNITS if training.quantity == REFLECTANCE else units,
        absolute=absolute,
        method=method,
        noise_level=0.0 if method == "pinv" else round(noise_level, 6),
        figures={
            **merit.figures(matrix, samples, primaries, training.quantity),
            **how,
            "samples_left_out": training.known.size - len(samples.signals),
        },
        inputs=dict(inputs or {}),
        quantity=training.quantity,
    )


def _amplified(matrix, samples: Samples) -> float:
    return float(merit.noise_amplification(matrix, samples.signals).max())
