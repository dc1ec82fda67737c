"""M_S and M_R: the matrices from a camera's bands to rendering primaries, fitted and written down.

A capture's bands are the camera's R, G, B through each filter in turn: `cyan.R`, `cyan.G`, ...
For light, `primaries = M_S @ bands`; for a surface the bands are its signals over those of a white
in the same light, and the matrix is M_R. They are fitted to samples whose bands and spectra are
both known: chart patches under several lights, or known spectra seen by known curves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration import merit, sets, training
from calibration.bands import sensitivities
from calibration.checks import check_lights, check_readings
from calibration.colour_fit import STRENGTHS, by_colour
from calibration.errors import InputError, Problem
from calibration.linear import Equations, Samples, check_solvable
from calibration.merit import noise_amplification
from calibration.primaries import Primaries
from calibration.rendering import Rendered, Side, fitted
from calibration.spectra import Spectra
from calibration.training import (
    COPY_LIGHTS,
    COPY_SET,
    ROOM_LIGHTS,
    ROOM_SURFACES,
    WHITE_SHARE,
)
from calibration.transform import (
    LIGHT,
    QUANTITIES,
    REFLECTANCE,
    Transform,
    from_toml,
    matched,
    read_transform,
    to_toml,
    write_transform,
)

__all__ = [
    "COPY_LIGHTS",
    "COPY_SET",
    "LIGHT",
    "QUANTITIES",
    "REFLECTANCE",
    "ROOM_LIGHTS",
    "ROOM_SURFACES",
    "STRENGTHS",
    "WHITE_SHARE",
    "Transform",
    "fit",
    "from_chart",
    "from_sensitivities",
    "from_toml",
    "joint_from_sensitivities",
    "matched",
    "noise_amplification",
    "read_transform",
    "reflectance_from_chart",
    "reflectance_from_sensitivities",
    "sensitivities",
    "to_toml",
    "write_transform",
]

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

# Below 10 the whites gain nothing more, and the primaries' own errors rise from 4 % to over 10 %.
JOINT_STRENGTH = 1.0


def fit(
    signals,
    radiances,
    *,
    primaries: Primaries,
    channels: Sequence[str],
    groups: Sequence[str],
    variances=None,
    weights=None,
    method: str = DEFAULT_METHOD,
    noise_level: float = NOISE_LEVEL,
    absolute: bool = True,
    quantity: str = LIGHT,
    names: Sequence[str] | None = None,
    photographed: bool = True,
    inputs: Mapping[str, str] | None = None,
) -> Transform:
    """The matrix that brings camera signals nearest to the radiances' primaries.

    "pinv" is the paper's: plain least squares over all samples. "ridge" is the best linear
    estimate when every band of every pixel carries noise, and each light counts alike however
    bright it was (see calibration.linear). "delta-e" is whichever of several leaves the least
    CIEDE2000 of what is rendered on lights left out, ridge among them (see
    calibration.colour_fit); the figures' `chosen` says which.

    But for "pinv", no primary's noise is amplified more than MOST_AMPLIFIED times: where it would
    be, a higher noise level is expected, and the result states it.

    signals      (n, B) camera signals, one row a sample; rows with NaN are left out
    radiances    (n, 36) their spectral radiance on WAVELENGTHS; for M_R spectral reflectance
    channels     (B,) names of the bands
    groups       (n,) the light of each sample, for balance and cross-validation
    variances    (n, B) of the signals as given; the noise expected is noise_level at least
    weights      (n,) how often a sample counts; default 1
    noise_level  relative noise of one band of one pixel
    absolute     whether the radiances are W/(sr m2 nm)
    quantity     LIGHT for M_S, REFLECTANCE for M_R: signals over those of a white
    names        (n,) of the samples (patches), for the figures; default: none
    photographed whether the signals are readings, from which "delta-e" may estimate the camera's
                 curves, rather than computed from known ones
    returns      the Transform. Its figures: `training_delta_e` and, with more than one light,
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
    assert method in METHODS, method
    assert quantity in QUANTITIES, quantity

    def expecting(level: float) -> Samples:
        return Samples.of(
            signals,
            radiances,
            primaries,
            groups,
            noise_level=level,
            variances=variances,
            weights=weights,
            names=names,
        )

    samples = expecting(noise_level)
    check_solvable(samples, tuple(channels), groups)

    def solved() -> tuple[NDArray[np.float64], dict[str, Any]]:
        if method == "delta-e":
            return by_colour(samples, primaries, quantity, noise_level if photographed else None)
        equations = Equations.of(samples, noise=method != "pinv")
        left_out = merit.leave_one_light_out(equations.solved, samples, primaries)
        return equations.solved(), left_out

    matrix, how = solved()
    while method != "pinv" and (over := _amplified(matrix, samples) / MOST_AMPLIFIED) > 1.0:
        # Amplification falls about with the root of the level.
        noise_level *= max(1.05, over**2)
        samples = expecting(noise_level)
        matrix, how = solved()
    figures = {
        **merit.figures(matrix, samples, primaries, quantity),
        **how,
        "samples_left_out": len(np.asarray(signals)) - len(samples.signals),
    }
    units = ABSOLUTE_UNITS if absolute else RELATIVE_UNITS
    return Transform(
        matrix=matrix,
        channels=tuple(channels),
        primaries=primaries.name,
        primaries_digest=primaries.digest,
        peaks_nm=tuple(np.round(primaries.peaks_nm, 3).tolist()),
        widths_nm=tuple(np.round(primaries.widths_nm, 3).tolist()),
        units=REFLECTANCE_UNITS if quantity == REFLECTANCE else units,
        absolute=absolute and quantity == LIGHT,
        method=method,
        noise_level=0.0 if method == "pinv" else round(noise_level, 6),
        figures=figures,
        inputs=dict(inputs or {}),
        quantity=quantity,
    )


def _amplified(matrix, samples: Samples) -> float:
    return float(noise_amplification(matrix, samples.signals).max())


# ---- from photographs of a chart


def from_chart(
    signals: Mapping[str, NDArray[np.floating]],
    variances: Mapping[str, NDArray[np.floating]],
    radiances: Mapping[str, Spectra],
    *,
    patches: Sequence[str],
    channels: Sequence[str],
    primaries: Primaries,
    method: str = CHART_METHOD,
    noise_level: float = CHART_NOISE_LEVEL,
    inputs: Mapping[str, str] | None = None,
) -> Transform:
    """M_S from chart photographs and spectroradiometer readings under several lights.

    signals    light -> (n, B) mean signal of each patch in each band, NaN where it clipped
    variances  light -> (n, B) variance of these means
    radiances  light -> spectra named as the patches, W/(sr m2 nm)
    patches    (n,) names, in the order of the rows
    the rest   as in `fit`
    raises     InputError if lights or patches do not match, or determine no matrix
    """
    spectra = _readings(signals, radiances, patches)
    return _from_rows(
        {light: np.asarray(rows, np.float64) for light, rows in signals.items()},
        variances,
        spectra,
        names=patches,
        channels=channels,
        primaries=primaries,
        method=method,
        noise_level=noise_level,
        inputs=inputs,
    )


def reflectance_from_chart(
    signals: Mapping[str, NDArray[np.floating]],
    variances: Mapping[str, NDArray[np.floating]],
    radiances: Mapping[str, Spectra],
    *,
    patches: Sequence[str],
    channels: Sequence[str],
    primaries: Primaries,
    method: str = CHART_METHOD,
    noise_level: float = CHART_NOISE_LEVEL,
    inputs: Mapping[str, str] | None = None,
) -> Transform:
    """M_R from the same session: signals over the brightest patch's, readings likewise.

    That patch is the white; it counts as WHITE_SHARE of all, so that white comes out white.
    Arguments and errors are those of `from_chart`; a light whose white clips is an error.
    """
    spectra = _readings(signals, radiances, patches)
    problems, ratios, spreads, factors = [], {}, {}, {}
    white_counts = np.ones(len(patches))
    for light, rows in signals.items():
        values = np.asarray(rows, np.float64)
        white = int(np.argmax(sets.xyz(spectra[light])[:, 1]))
        if not np.all(values[white] > 0.0):
            problems.append(
                Problem(
                    f"light {light!r}: the white, patch {patches[white]}, is not known everywhere",
                    "a white that does not clip through any filter",
                    "add shorter exposures, or leave this light out",
                )
            )
            continue
        white_counts[white] = max(1.0, WHITE_SHARE * len(patches))
        ratios[light] = values / values[white]
        spreads[light] = np.asarray(variances[light], np.float64) / values[white] ** 2
        factors[light] = spectra[light] / spectra[light][white]
    if problems:
        raise InputError(problems)
    return _from_rows(
        ratios,
        spreads,
        factors,
        counts=white_counts,
        names=patches,
        channels=channels,
        primaries=primaries,
        method=method,
        noise_level=noise_level,
        quantity=REFLECTANCE,
        inputs=inputs,
    )


def _readings(
    signals: Mapping[str, Any], radiances: Mapping[str, Spectra], patches: Sequence[str]
) -> dict[str, NDArray[np.float64]]:
    """Each light's readings (n, 36) of the patches, checked."""
    check_lights(signals, radiances, patches)
    spectra = {light: radiances[light].resampled().only(patches).values.T for light in signals}
    check_readings(signals, spectra, patches)
    return spectra


# ---- from known curves


def from_sensitivities(
    camera: Spectra,
    filters: Spectra,
    *,
    primaries: Primaries,
    filter_names: Sequence[str] | None = None,
    lights: Spectra | None = None,
    surfaces: Spectra | None = None,
    method: str = DEFAULT_METHOD,
    noise_level: float = NOISE_LEVEL,
    inputs: Mapping[str, str] | None = None,
) -> Transform:
    """M_S from known curves: what the camera would see of room lights on all kinds of surfaces.

    The curves are relative, so the result is: see RELATIVE_UNITS. Light is trained as it comes
    back from walls, not only as lamps send it, since most of a room is walls.

    camera        spectral sensitivities R, G, B
    filters       transmittance, named as the capture's filters
    filter_names  the capture's filters, in its order; default: all, in the file's
    lights        to train on; default ROOM_LIGHTS
    surfaces      to train on; default ROOM_SURFACES. White is added
    the rest      as in `fit`
    """
    channels, bands = sensitivities(camera, filters, filter_names)
    lights, surfaces = training.checked(lights, surfaces)
    rows, counts = training.with_white(surfaces)
    spectra = {name: rows * lights[name] for name in lights.names}
    return _from_rows(
        {name: lit @ bands for name, lit in spectra.items()},
        None,
        spectra,
        counts=counts,
        channels=channels,
        primaries=primaries,
        method=method,
        noise_level=noise_level,
        absolute=False,
        inputs=inputs,
    )


def reflectance_from_sensitivities(
    camera: Spectra,
    filters: Spectra,
    *,
    primaries: Primaries,
    filter_names: Sequence[str] | None = None,
    lights: Spectra | None = None,
    surfaces: Spectra | None = None,
    method: str = DEFAULT_METHOD,
    noise_level: float = NOISE_LEVEL,
    inputs: Mapping[str, str] | None = None,
) -> Transform:
    """M_R from known curves: signals of surfaces over those of a perfect white in the same light.

    lights    that surfaces may be photographed in; default COPY_LIGHTS
    the rest  as in `from_sensitivities`
    """
    channels, bands = sensitivities(camera, filters, filter_names)
    lights, surfaces = training.checked(
        training.copy_lights() if lights is None else lights, surfaces
    )
    rows, counts = training.with_white(surfaces)
    return _from_rows(
        {name: _beside_white(rows, lights[name], bands) for name in lights.names},
        None,
        dict.fromkeys(lights.names, rows),
        counts=counts,
        channels=channels,
        primaries=primaries,
        method=method,
        noise_level=noise_level,
        quantity=REFLECTANCE,
        inputs=inputs,
    )


def _from_rows(
    signals: Mapping[str, NDArray[np.float64]],
    variances: Mapping[str, NDArray[np.floating]] | None,
    spectra: Mapping[str, NDArray[np.float64]],
    *,
    counts: NDArray[np.float64] | None = None,
    names: Sequence[str] | None = None,
    **others: Any,
) -> Transform:
    """`fit` to the same n samples under each light.

    signals, variances  light -> (n, B); None for the variances: computed, not photographed
    spectra             light -> (n, 36)
    counts              (n,) how often a sample counts
    names               (n,) of the samples
    """
    return fit(
        np.concatenate(list(signals.values())),
        np.concatenate(list(spectra.values())),
        groups=[light for light, rows in signals.items() for _ in rows],
        variances=None if variances is None else np.concatenate([variances[k] for k in signals]),
        weights=None if counts is None else np.tile(counts, len(signals)),
        names=None if names is None else list(names) * len(signals),
        photographed=variances is not None,
        **others,
    )


def _beside_white(reflectances, light, bands) -> NDArray[np.float64]:
    """Signals (n, B) of surfaces (n, 36) in a light (36,) over those of a perfect white in it."""
    ratios: NDArray[np.float64] = (reflectances * light) @ bands / (light @ bands)
    return ratios


def joint_from_sensitivities(
    camera: Spectra,
    filters: Spectra,
    *,
    primaries: Primaries,
    filter_names: Sequence[str] | None = None,
    lights: Spectra | None = None,
    surfaces: Spectra | None = None,
    copy_light: str = COPY_LIGHTS[0],
    noise_level: float = NOISE_LEVEL,
    strength: float = JOINT_STRENGTH,
    inputs: Mapping[str, str] | None = None,
) -> tuple[Transform, Transform]:
    """M_S and M_R fitted together to the least CIEDE2000 of photographed surfaces in photographed
    light, as the paper's simulation did: what one gets wrong the other makes good.

    They belong together: either alone is no better than its own fit. All of the lights, as they
    come from lamps, are trained on, each with all of the surfaces and white.

    copy_light  of COPY_SET, in which the surfaces are photographed
    strength    of staying near ridge, see calibration.rendering
    returns     M_S, M_R; both have `joint_delta_e` in their figures
    the rest    as in `from_sensitivities`
    """
    channels, bands = sensitivities(camera, filters, filter_names)
    lights, surfaces = training.checked(lights, surfaces)
    rows, counts = training.with_white(surfaces)
    spectra = lights.values.T
    seen_rows = _beside_white(rows, sets.lights(COPY_SET)[copy_light], bands)
    sides, alone = [], []
    for seen, true, weights, groups, quantity in (
        (spectra @ bands, spectra, np.ones(len(spectra)), lights.names, LIGHT),
        (seen_rows, rows, counts, [copy_light] * len(rows), REFLECTANCE),
    ):
        transform = fit(
            seen,
            true,
            primaries=primaries,
            channels=channels,
            groups=groups,
            weights=weights,
            method="ridge",
            noise_level=noise_level,
            absolute=False,
            quantity=quantity,
            inputs=inputs,
        )
        variances = (noise_level * seen) ** 2
        metric = (seen * weights[:, None]).T @ seen + np.diag(weights @ variances)
        alone.append(transform)
        sides.append(
            Side(primaries.project(true), seen, variances, transform.matrix, metric / weights.sum())
        )
    xyz = np.einsum("lw,sw,wi->lsi", spectra, rows, sets.observer(), optimize=True)
    weights = np.ones((len(spectra), 1)) * counts
    colours = Rendered.of(
        sides[0], sides[1], xyz, sets.xyz(spectra), primaries.xyz_from_primaries, weights
    )
    found = fitted(colours, strength)
    joint = merit.spread(colours.errors(*found).ravel(), colours.weights.ravel())
    kept = ("condition", "samples", "lights")
    m_s, m_r = (
        replace(
            transform,
            matrix=matrix,
            method="delta-e",
            figures={
                "joint_delta_e": joint,
                "noise_amplification": merit.rounded(noise_amplification(matrix, side.signals)),
                **{key: transform.figures[key] for key in kept},
            },
        )
        for transform, matrix, side in zip(alone, found, sides, strict=True)
    )
    return m_s, m_r
