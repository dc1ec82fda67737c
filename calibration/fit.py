"""M_S: the matrix from a camera's bands to rendering primaries, fitted and written down.

A capture's bands are the camera's R, G, B through each filter in turn: `cyan.R`, `cyan.G`, ...
For light, `primaries = matrix @ bands`. The fit is linear, from samples whose bands and spectral
radiance are both known: chart patches under several lights, or known spectra seen by known
sensitivities.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration import sets
from calibration.adaptation import D65, cat02
from calibration.difference import delta_e_2000, lab
from calibration.errors import InputError, Problem, fault
from calibration.primaries import Primaries
from calibration.rendering import Rendered, Side, fitted
from calibration.spectra import WAVELENGTHS, Spectra
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
    "LIGHT",
    "QUANTITIES",
    "REFLECTANCE",
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
# where leaving lights out favours "delta-e" with every camera tried, and it falls back by itself.
DEFAULT_METHOD = "ridge"
CHART_METHOD = "delta-e"

# Relative noise of one band of one texel that a fit should expect: about that of a well exposed
# bracket. At it the cameras tried amplify 5 times, one 12.5; at .005 some reach 15.
NOISE_LEVEL = 0.007

ABSOLUTE_UNITS = "W/(sr m2 nm)"
RELATIVE_UNITS = (
    "relative; 1 is the spectral radiance of an equal-energy light that brings the most sensitive "
    "band to the saturation level in 1 s at ISO 100 and f/1"
)

REFLECTANCE_UNITS = "reflectance factor; 1 is the white that signals are divided by"

# What a fit from sensitivities is trained on; the white share keeps what is white neutral.
ROOM_LIGHTS = "room"
ROOM_SURFACES = "ces99+rawtoaces190"
WHITE_SHARE = 0.2

# The lights of copy stands and booths, in which surfaces are photographed beside a white.
COPY_SET = "darling2011"
COPY_LIGHTS = ("D50", "A", "D65", "F40/C50 (Broadband FL)")

# Ratio of the least to the greatest singular value of the bands, each scaled to rms 1, below
# which some band tells nothing that the others do not: no exposure separates it from noise.
_SINGULAR = 1e-5

# "delta-e" tries these strengths of staying near ridge (see calibration.rendering), in dE per unit
# of a primary; leave-one-light-out chooses, and ridge itself is among what it chooses from.
STRENGTHS = (100.0, 30.0, 10.0)
# Below 10 the whites gain nothing more, and the primaries' own errors rise from 4 % to over 10 %.
JOINT_STRENGTH = 1.0
_WHITES = 0.5  # how often white counts among the known surfaces, as a share of the others
_WHITE_STAYS = 1e4  # how much dearer M_R's error of white is than that of the mean sample
_FOLDS = 8  # more lights than this are left out in neighbouring groups, not one by one
_MOST_COLOURS = 4_000  # of lights times surfaces that "delta-e" looks at; more say the same
_EVERY = 12  # of ROOM_SURFACES, what known light falls on; of ROOM_LIGHTS, a third of that


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
    inputs: Mapping[str, str] | None = None,
) -> Transform:
    """The matrix that brings camera signals nearest to the radiances' primaries.

    "pinv" is the paper's: plain least squares over all samples. "ridge" is the best linear
    estimate when every band of every pixel carries noise, M = T S' (S S' + N)^-1 with T the
    primaries, S the signals and N the noise's covariance summed over the samples; and each light
    counts alike however bright it was.

    "delta-e" is the least CIEDE2000 of what is rendered with the primaries, held near ridge as
    strongly as leaves the least on lights left out (see calibration.rendering): light on surfaces
    of all kinds, or surfaces in light of all kinds. Where ridge itself does best there, or where
    there are too few lights to tell, it is kept, and the figures' `chosen` says so.

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
    returns      the Transform. Its figures: `training_delta_e` and, with more than one light,
                 `leave_one_light_out_delta_e` (CIEDE2000 of the samples through the primaries'
                 own matrix against full spectra, each light's brightest sample as its white),
                 `light_delta_e` and `sample_delta_e` (means on the training), `remeasure` (what
                 stands out there), `spectral_error` (rms of each primary over its rms),
                 `noise_amplification` (relative noise of each primary over relative noise of the
                 bands), `condition` of the bands, numbers of samples and lights; of "delta-e"
                 `chosen`
    raises       InputError if the samples cannot determine the matrix
    """
    assert method in METHODS, method
    assert quantity in QUANTITIES, quantity
    samples = _Samples.of(
        signals, radiances, primaries, groups, variances, weights, noise_level, names
    )
    _check_lights_left(set(groups), samples)
    _check_solvable(samples, tuple(channels))
    equations = _Equations.of(samples, method)
    matrix = equations.solved()
    if method == "delta-e":
        matrix, chosen = _by_colour(samples, equations, primaries, quantity)
    else:
        chosen = _leave_one_light_out(equations, samples, primaries)
    errors = _errors(matrix, samples, primaries)
    figures = {
        "training_delta_e": _spread(errors, samples.weights),
        **chosen,
        "light_delta_e": _means(errors, samples.groups),
        **_by_name(errors, samples),
        "spectral_error": _round(_spectral_error(matrix, samples)),
        "noise_amplification": _round(noise_amplification(matrix, samples.signals)),
        "condition": _round(_condition(samples.signals)),
        "samples": len(samples.signals),
        "samples_left_out": len(np.asarray(signals)) - len(samples.signals),
        "lights": len(set(samples.groups)),
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
        noise_level=0.0 if method == "pinv" else noise_level,
        figures=figures,
        inputs=dict(inputs or {}),
        quantity=quantity,
    )


def from_chart(
    signals: Mapping[str, NDArray[np.floating]],
    variances: Mapping[str, NDArray[np.floating]],
    radiances: Mapping[str, Spectra],
    *,
    patches: Sequence[str],
    channels: Sequence[str],
    primaries: Primaries,
    method: str = CHART_METHOD,
    noise_level: float = NOISE_LEVEL,
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
    _check_lights(signals, radiances, patches)
    spectra = {light: radiances[light].resampled().only(patches).values.T for light in signals}
    _check_readings(signals, spectra, patches)
    return fit(
        np.concatenate([np.asarray(signals[light], np.float64) for light in signals]),
        np.concatenate(list(spectra.values())),
        primaries=primaries,
        channels=channels,
        groups=[light for light in signals for _ in patches],
        variances=np.concatenate([variances[light] for light in signals]),
        names=[patch for _ in signals for patch in patches],
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
    noise_level: float = NOISE_LEVEL,
    inputs: Mapping[str, str] | None = None,
) -> Transform:
    """M_R from the same session: signals over the brightest patch's, readings likewise.

    That patch is the white; it counts as WHITE_SHARE of all, so that white comes out white.
    Arguments and errors are those of `from_chart`; a light whose white clips is an error.
    """
    _check_lights(signals, radiances, patches)
    spectra = {light: radiances[light].resampled().only(patches).values.T for light in signals}
    _check_readings(signals, spectra, patches)
    problems, ratios, spreads, factors = [], [], [], []
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
        ratios.append(values / values[white])
        spreads.append(np.asarray(variances[light], np.float64) / values[white] ** 2)
        factors.append(spectra[light] / spectra[light][white])
    if problems:
        raise InputError(problems)
    return fit(
        np.concatenate(ratios),
        np.concatenate(factors),
        primaries=primaries,
        channels=channels,
        groups=[light for light in signals for _ in patches],
        variances=np.concatenate(spreads),
        weights=np.tile(white_counts, len(signals)),
        names=[patch for _ in signals for patch in patches],
        method=method,
        noise_level=noise_level,
        quantity=REFLECTANCE,
        inputs=inputs,
    )


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
    lights, surfaces = _training(lights, surfaces)
    walls, weights = _with_white(surfaces)
    radiances = np.einsum("wl,sw->lsw", lights.values, walls).reshape(-1, len(WAVELENGTHS))
    return fit(
        radiances @ bands,
        radiances,
        primaries=primaries,
        channels=channels,
        groups=[name for name in lights.names for _ in weights],
        weights=np.tile(weights, len(lights)),
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
    lights = sets.lights(COPY_SET).only(COPY_LIGHTS) if lights is None else lights
    lights, surfaces = _training(lights, surfaces)
    rows, weights = _with_white(surfaces)
    ratios = [(rows * light) @ bands / (light @ bands) for light in lights.values.T]
    return fit(
        np.concatenate(ratios),
        np.tile(rows, (len(lights), 1)),
        primaries=primaries,
        channels=channels,
        groups=[name for name in lights.names for _ in weights],
        weights=np.tile(weights, len(lights)),
        method=method,
        noise_level=noise_level,
        quantity=REFLECTANCE,
        inputs=inputs,
    )


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
    lights, surfaces = _training(lights, surfaces)
    rows, shares = _with_white(surfaces)
    spectra = lights.values.T
    by_copy = sets.lights(COPY_SET)[copy_light]
    sides, alone = [], []
    for seen, true, weights, quantity in (
        (spectra @ bands, spectra, np.ones(len(spectra)), LIGHT),
        ((rows * by_copy) @ bands / (by_copy @ bands), rows, shares, REFLECTANCE),
    ):
        groups = lights.names if quantity == LIGHT else [copy_light] * len(rows)
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
    counted = np.ones((len(spectra), 1)) * shares
    whites = sets.xyz(spectra)
    colours = Rendered.of(sides[0], sides[1], xyz, whites, primaries.xyz_from_primaries, counted)
    found = fitted(colours, strength)
    errors = colours.errors(*found)
    figures = {"joint_delta_e": _spread(errors.ravel(), colours.weights.ravel())}
    m_s, m_r = (
        replace(
            transform,
            matrix=matrix,
            method="delta-e",
            figures=figures
            | {
                "noise_amplification": _round(noise_amplification(matrix, side.signals)),
                "condition": transform.figures["condition"],
                "samples": transform.figures["samples"],
                "lights": transform.figures["lights"],
            },
        )
        for transform, matrix, side in zip(alone, found, sides, strict=True)
    )
    return m_s, m_r


def _training(lights: Spectra | None, surfaces: Spectra | None) -> tuple[Spectra, Spectra]:
    """Lights, Y = 1 on white, and surfaces to train on, those given checked."""
    given = _check_set(lights, "light") + _check_set(surfaces, "surface")
    if given:
        raise InputError(given)
    lights = sets.lights(ROOM_LIGHTS) if lights is None else lights.resampled()
    surfaces = sets.surfaces(ROOM_SURFACES) if surfaces is None else surfaces.resampled()
    scaled = sets.scaled_to_unit_luminance(lights.values)
    return Spectra(WAVELENGTHS, lights.names, scaled), surfaces


def _with_white(surfaces: Spectra) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The surfaces and white (n, 36), and how much each counts (n,)."""
    rows = np.concatenate([surfaces.values.T, np.ones((1, len(WAVELENGTHS)))])
    return rows, np.append(np.ones(len(surfaces)), max(1.0, WHITE_SHARE * len(surfaces)))


def sensitivities(
    camera: Spectra, filters: Spectra, filter_names: Sequence[str] | None = None
) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    """Bands of a camera behind filters: their names (B,) and curves (36, B).

    Scaled as RELATIVE_UNITS says: equal-energy light of radiance 1 gives a signal of 1 in the
    band that sees most of it.
    """
    if sorted(camera.names) != ["B", "G", "R"]:
        raise fault(
            f"a camera with the curves {', '.join(camera.names)}",
            "wavelength_nm,R,G,B",
            "name the columns so",
        )
    names = tuple(filters.names if filter_names is None else filter_names)
    missing = [name for name in names if name not in filters.names]
    if missing:
        raise fault(
            f"no transmittance for the filter {missing[0]!r}, only {', '.join(filters.names)}",
            "a column named as each filter of the capture",
            "add or rename the column",
        )
    rgb = camera.only("RGB").resampled().values
    glass = filters.only(names).resampled().values
    bands = (glass[:, :, None] * rgb[:, None, :]).reshape(len(WAVELENGTHS), -1)
    channels = tuple(f"{name}.{colour}" for name in names for colour in "RGB")
    most = bands.sum(axis=0).max()
    if most <= 0.0:
        raise fault("camera and filters pass no light together", "", "check both files")
    return channels, bands / most


def noise_amplification(matrix, signals) -> NDArray[np.float64]:
    """Relative noise of each primary (P,) when every band has relative noise 1, as rms.

    matrix   (P, B)
    signals  (n, B) what the camera sees, not noisy
    """
    noise = (np.asarray(signals) ** 2) @ (np.asarray(matrix) ** 2).T
    value = (np.asarray(signals) @ np.asarray(matrix).T) ** 2
    return np.sqrt(noise.mean(axis=0) / value.mean(axis=0))


# ---- samples, and the solution


@dataclass(frozen=True)
class _Samples:
    """What a fit is made from, all rows whole; T, S, N of the formula before weighting.

    signals    (n, B)        spectra    (n, 36)
    targets    (n, P) the spectra in primaries
    variances  (n, B)        groups     (n,) light of each row
    weights    (n,) how often a row counts
    scale      (n,) what its light's brightest sample, by luminance, is divided by to become 1
    names      (n,) of the rows, "" where they have none
    """

    signals: NDArray[np.float64]
    spectra: NDArray[np.float64]
    targets: NDArray[np.float64]
    variances: NDArray[np.float64]
    groups: NDArray[np.str_]
    weights: NDArray[np.float64]
    scale: NDArray[np.float64]
    names: NDArray[np.str_]

    @classmethod
    def of(cls, signals, spectra, primaries, groups, variances, weights, noise_level, names):
        signals, spectra = np.asarray(signals, np.float64), np.asarray(spectra, np.float64)
        targets = primaries.project(spectra)
        assert len(signals) == len(targets) == len(groups), (len(signals), len(targets))
        expected = (noise_level * signals) ** 2
        measured = expected if variances is None else np.asarray(variances, np.float64)
        groups = np.asarray(groups, np.str_)
        luminance = targets @ primaries.xyz_from_primaries[1]
        scale = np.empty(len(groups))
        for light in set(groups.tolist()):
            scale[groups == light] = luminance[groups == light].max()
        samples = cls(
            signals,
            spectra,
            targets,
            np.fmax(expected, measured),
            groups,
            np.ones(len(signals)) if weights is None else np.asarray(weights, np.float64),
            scale,
            np.full(len(signals), "") if names is None else np.asarray(names, np.str_),
        )
        return samples.only(np.isfinite(signals).all(axis=1) & np.isfinite(targets).all(axis=1))

    def only(self, rows) -> _Samples:
        return _Samples(*(values[rows] for values in vars(self).values()))

    def thinned(self, most: int) -> _Samples:
        """About `most` rows of each light: its brightest, and evenly some others, for all."""
        kept, weights = [], self.weights.copy()
        for light in dict.fromkeys(self.groups.tolist()):
            rows = np.flatnonzero(self.groups == light)
            brightest = rows[np.argmax(self.spectra[rows] @ sets.observer()[:, 1])]
            others = rows[rows != brightest]
            step = -(-len(others) // max(1, most - 1)) if len(others) else 1
            some = others[::step]
            weights[some] *= weights[others].sum() / max(weights[some].sum(), 1e-300)
            kept += [brightest, *some]
        samples = replace(self, weights=weights)
        return samples.only(np.sort(kept))


@dataclass(frozen=True)
class _Equations:
    """Each light's share of the normal equations: M (S S' + N) = T S', summed over the lights.

    lights   (L,) names           weights  (L,) their samples' weights, summed
    left     (L, B, B) S S' + N   right    (L, B, P) S T'
    """

    lights: tuple[str, ...]
    weights: NDArray[np.float64]
    left: NDArray[np.float64]
    right: NDArray[np.float64]

    @classmethod
    def of(cls, samples: _Samples, method: str) -> _Equations:
        lights = tuple(dict.fromkeys(samples.groups.tolist()))
        left, right, counts = [], [], []
        for light in lights:
            rows = samples.only(samples.groups == light)
            weights = rows.weights if method == "pinv" else rows.weights / rows.scale**2
            weighted = rows.signals * weights[:, None]
            noise = 0.0 if method == "pinv" else np.diag(weights @ rows.variances)
            left.append(weighted.T @ rows.signals + noise)
            right.append(weighted.T @ rows.targets)
            counts.append(rows.weights.sum())
        return cls(lights, np.array(counts), np.stack(left), np.stack(right))

    def solved(self, without: Collection[str] = ()) -> NDArray[np.float64]:
        """The matrix (P, B) from all lights, or from all but some."""
        used = [light not in without for light in self.lights]
        return np.linalg.lstsq(self.left[used].sum(axis=0), self.right[used].sum(axis=0))[0].T

    def metric(self, without: Collection[str] = ()) -> NDArray[np.float64]:
        """What moving the matrix away from `solved` adds to the mean sample's squared error."""
        used = [light not in without for light in self.lights]
        mean: NDArray[np.float64] = self.left[used].sum(axis=0) / self.weights[used].sum()
        return mean


def _by_colour(
    samples: _Samples, equations: _Equations, primaries: Primaries, quantity: str
) -> tuple[NDArray[np.float64], dict[str, Any]]:
    """The matrix of "delta-e", and the figures of how it was chosen."""
    folds = _folds(equations.lights)
    ridge = equations.solved()
    fewest = min(np.count_nonzero(~np.isin(samples.groups, fold)) for fold in folds)
    if len(equations.lights) < 3 or fewest < samples.signals.shape[1]:
        figures = _leave_one_light_out(equations, samples, primaries)
        return ridge, {**figures, "chosen": {"method": "ridge", "because": _TOO_FEW}}
    rendered, thin = _rendered(samples, primaries, quantity)
    side = "light" if quantity == LIGHT else "surface"

    def ready(without: Collection[str]) -> Rendered:
        """All but some lights' colours, tied to the ridge that comes of the same samples."""
        used = ~np.isin(thin.groups, list(without))
        some = rendered.only(used, "lights" if quantity == LIGHT else "surfaces")
        metric = equations.metric(without)
        if quantity == REFLECTANCE:
            metric = metric + _WHITE_STAYS  # the white is 1 in every primary, not just to the eye
        tied = replace(getattr(some, side), ridge=equations.solved(without), metric=metric)
        return replace(some, **{side: tied})

    def matrix_of(colours: Rendered, strength: float, start) -> NDArray[np.float64]:
        (found,) = (m for m in fitted(colours, strength, [start]) if m is not None)
        return found

    def seen(colours: Rendered, matrix) -> float:
        return colours.mean_error(**{"m_s" if quantity == LIGHT else "m_r": matrix})

    scores = np.zeros(1 + len(STRENGTHS))
    held_out = np.zeros((1 + len(STRENGTHS), len(samples.groups)))
    for fold in folds:
        inside = np.isin(samples.groups, fold)
        rest = ready(fold)
        held = rendered.only(
            np.isin(thin.groups, fold), "lights" if quantity == LIGHT else "surfaces"
        )
        matrix = equations.solved(without=fold)
        for i, strength in enumerate((math.inf, *STRENGTHS)):
            if i:
                matrix = matrix_of(rest, strength, matrix)
            scores[i] += seen(held, matrix) / len(folds)
            held_out[i, inside] = _errors(matrix, samples.only(inside), primaries)
    best = int(np.argmin(scores))
    matrix = ridge
    for strength in STRENGTHS[:best]:
        matrix = matrix_of(ready(()), strength, matrix)
    table = dict(zip(["ridge", *(f"{k:g}" for k in STRENGTHS)], _round(scores), strict=True))
    chosen: dict[str, Any] = {
        "method": "delta-e" if best else "ridge",
        "rendered_delta_e_left_out": table,
    }
    if best:
        chosen["strength"] = STRENGTHS[best - 1]
    means = _means(held_out[best], samples.groups)
    spread = _spread(held_out[best], samples.weights)
    worst = max(means, key=lambda light: means[light])
    return matrix, {
        "leave_one_light_out_delta_e": {**spread, "worst_light": worst},
        "chosen": chosen,
    }


_TOO_FEW = "too few lights or samples to leave one out: photograph three lights or more"


def _folds(lights: Sequence[str]) -> list[tuple[str, ...]]:
    """The lights one by one, or where they are many in groups of neighbours."""
    ends = np.linspace(0, len(lights), min(_FOLDS, len(lights)) + 1).round().astype(int)
    return [tuple(lights[a:b]) for a, b in itertools.pairwise(ends)]


def _rendered(samples: _Samples, primaries: Primaries, quantity: str) -> tuple[Rendered, _Samples]:
    """The colours "delta-e" looks at, and the samples they are made of.

    For M_S: each sample's light, on surfaces of all kinds and white, seen by an eye adapted to
    the brightest sample of its lamp. For M_R: each sample as a surface, in light of all kinds.
    """
    if quantity == LIGHT:
        others, shares = _known_surfaces()
    else:
        others, shares = _known_lights()
    lights = len(set(samples.groups.tolist()))
    thin = samples.thinned(max(2, _MOST_COLOURS // (len(others) * lights)))
    scale = thin.scale[:, None] if quantity == LIGHT else np.ones((len(thin.scale), 1))
    sought = Side(thin.targets / scale, thin.signals / scale, thin.variances / scale**2)
    known = Side(primaries.project(others))
    spectra = thin.spectra / scale
    if quantity == LIGHT:
        xyz = np.einsum("lw,sw,wi->lsi", spectra, others, sets.observer(), optimize=True)
        white_of = {}
        for light in set(thin.groups.tolist()):
            of_light = sets.xyz(spectra[thin.groups == light])
            white_of[light] = of_light[np.argmax(of_light[:, 1])]
        whites = np.stack([white_of[light] for light in thin.groups])
        weights = thin.weights[:, None] * shares
        sides = (sought, known)
    else:
        xyz = np.einsum("lw,sw,wi->lsi", others, spectra, sets.observer(), optimize=True)
        whites = sets.xyz(others)
        weights = shares[:, None] * thin.weights
        sides = (known, sought)
    return Rendered.of(*sides, xyz, whites, primaries.xyz_from_primaries, weights), thin


def _known_surfaces() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Spectral reflectances (S, 36) of all kinds with white, and how much each counts (S,)."""
    some = sets.surfaces(ROOM_SURFACES).values.T[::_EVERY]
    white = np.ones((1, some.shape[1]))
    return np.concatenate([some, white]), np.append(np.ones(len(some)), _WHITES * len(some))


def _known_lights() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Spectra (L, 36) of lamps of all kinds, Y = 1 on white, and how much each counts (L,)."""
    some = sets.lights(ROOM_LIGHTS).values.T[:: _EVERY // 3]
    return some, np.ones(len(some))


def _leave_one_light_out(
    equations: _Equations, samples: _Samples, primaries: Primaries
) -> dict[str, Any]:
    """The figure of that name: each light's colours come from a fit to all the others."""
    bands = samples.signals.shape[1]
    counts = {light: np.count_nonzero(samples.groups == light) for light in equations.lights}
    if len(samples.signals) - max(counts.values()) < bands:
        return {}  # the others do not determine a matrix
    errors = np.empty(len(samples.groups))
    for light in equations.lights:
        inside = samples.groups == light
        matrix = equations.solved(without=(light,))
        errors[inside] = _errors(matrix, samples.only(inside), primaries)
    worst = max(counts, key=lambda light: errors[samples.groups == light].mean())
    spread = _spread(errors, samples.weights)
    return {"leave_one_light_out_delta_e": {**spread, "worst_light": worst}}


def _errors(matrix, samples: _Samples, primaries: Primaries) -> NDArray[np.float64]:
    """CIEDE2000 (n,) of what the matrix makes of the signals against the full spectra.

    Adapted to each light's white. So the error of the primaries themselves is in it, as it will
    be in every picture.
    """
    true = sets.xyz(samples.spectra)
    seen = samples.signals @ (primaries.xyz_from_primaries @ matrix).T
    errors = np.empty(len(true))
    for light in set(samples.groups.tolist()):
        rows = samples.groups == light
        white = true[rows][np.argmax(true[rows, 1])]
        to_d65 = cat02(white, D65) / white[1]
        errors[rows] = delta_e_2000(lab(true[rows] @ to_d65.T), lab(seen[rows] @ to_d65.T))
    return errors


def _spectral_error(matrix, samples: _Samples) -> NDArray[np.float64]:
    """Rms error of each primary (P,) over its rms, every light's brightest sample being 1."""
    weights = samples.weights / samples.scale**2
    off = np.average((samples.signals @ matrix.T - samples.targets) ** 2, axis=0, weights=weights)
    size = np.average(samples.targets**2, axis=0, weights=weights)
    error: NDArray[np.float64] = np.sqrt(off / size)
    return error


def _means(errors, labels) -> dict[str, float]:
    """Mean error of each label, in the order they first appear."""
    return {key: _round(errors[labels == key].mean()) for key in dict.fromkeys(labels.tolist())}


def _by_name(errors, samples: _Samples) -> dict[str, Any]:
    """Figures of single patches: their means, and what stands out so far that it may be wrong."""
    if not samples.names.any():
        return {}
    limit = max(_STANDS_OUT_DELTA_E, _STANDS_OUT * float(np.median(errors)))
    worst = [i for i in np.argsort(-errors)[:_MOST_TO_REMEASURE] if errors[i] > limit]
    return {
        "sample_delta_e": _means(errors, samples.names),
        "remeasure": [
            f"patch {samples.names[i]} under {samples.groups[i]}: {errors[i]:.2f}" for i in worst
        ],
    }


# A patch is worth another measurement from this dE on, and from so many times the median.
_STANDS_OUT_DELTA_E = 2.0
_STANDS_OUT = 4.0
_MOST_TO_REMEASURE = 6


def _condition(signals) -> float:
    singular = np.linalg.svd(signals / _rms(signals), compute_uv=False)
    return float(singular[0] / max(singular[-1], np.finfo(float).tiny))


def _rms(signals) -> NDArray[np.float64]:
    rms: NDArray[np.float64] = np.sqrt(np.mean(signals**2, axis=0))
    return rms


def _spread(errors, weights) -> dict[str, float]:
    mean = np.average(errors, weights=weights)
    return {
        "mean": _round(mean),
        "sd": _round(math.sqrt(np.average((errors - mean) ** 2, weights=weights))),
        "p95": _round(np.percentile(errors, 95)),
        "max": _round(errors.max()),
    }


def _round(values) -> Any:
    return np.round(values, 4).tolist()


# ---- checks


def _check_lights_left(lights: set[str], samples: _Samples) -> None:
    lost = sorted(lights - set(samples.groups.tolist()))
    if lost:
        raise InputError(
            Problem(
                f"light {light!r}: no patch is known in every band",
                "some that do not clip through any filter",
                "add shorter exposures, or leave this light out",
            )
            for light in lost
        )


def _check_solvable(samples: _Samples, channels: tuple[str, ...]) -> None:
    s = samples.signals
    assert s.shape[1] == len(channels), (s.shape, channels)
    if len(s) < len(channels):
        raise fault(
            f"{len(s)} whole samples for {len(channels)} bands",
            f"{len(channels)} or more",
            "photograph more patches or lights, or expose so that fewer clip",
        )
    problems = [
        Problem(
            f"{channel} sees nothing under {light}",
            "a signal in every band under every light",
            "expose longer, choose another filter, or leave this light out",
        )
        for light in sorted(set(samples.groups.tolist()))
        for channel, brightest in zip(
            channels, s[samples.groups == light].max(axis=0, initial=0.0), strict=True
        )
        if brightest <= 0.0
    ]
    if problems:
        raise InputError(problems)
    if _condition(s) > 1.0 / _SINGULAR:
        _, _, v = np.linalg.svd(s / _rms(s), full_matrices=False)
        alike = [channels[i] for i in np.argsort(-np.abs(v[-1]))[:2]]
        raise fault(
            f"{alike[0]} and {alike[1]} follow from the other bands",
            "bands that differ",
            "use filters that differ, and more lights or colours",
        )


def _check_set(spectra: Spectra | None, what: str) -> list[Problem]:
    """What is wrong with lights or surfaces to train on, as the user gave them."""
    if spectra is None:
        return []
    problems = []
    values, names = spectra.values, spectra.names
    for name, column in zip(names, values.T, strict=True):
        top = column.max()
        if column.min() < -0.02 * np.abs(column).max():
            problems.append(
                Problem(f"{what} {name!r} is negative", "0 or more", "correct the readings")
            )
        elif top <= 0.0:
            problems.append(Problem(f"{what} {name!r} is 0 everywhere", "a spectrum", "remove it"))
        elif what == "surface" and top > 1.5:
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


def _check_readings(
    signals: Mapping[str, Any],
    spectra: Mapping[str, NDArray[np.float64]],
    patches: Sequence[str],
) -> None:
    """Refuses readings that cannot be of these patches under these lights."""
    problems: list[Problem] = []
    for light, rows in spectra.items():
        for patch, row in zip(patches, rows, strict=True):
            if row.min() < -0.02 * np.abs(row).max():
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


_MOST_PROBLEMS = 10
_MOST_LUMINANCE = 2e5  # cd/m2: white in full sun has 3e4
_ODD_RATIO = 30.0  # exposures are tagged to a few percent, units differ by 100 or 1000


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


def _check_lights(
    signals: Mapping[str, Any], radiances: Mapping[str, Spectra], patches: Sequence[str]
) -> None:
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
