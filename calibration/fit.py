"""M_S: the matrix from a camera's bands to rendering primaries, fitted and written down.

A capture's bands are the camera's R, G, B through each filter in turn: `cyan.R`, `cyan.G`, ...
For light, `primaries = matrix @ bands`. The fit is linear, from samples whose bands and spectral
radiance are both known: chart patches under several lights, or known spectra seen by known
sensitivities.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.adaptation import D65, cat02
from calibration.difference import delta_e_2000, lab
from calibration.errors import InputError, Problem, fault
from calibration.primaries import Primaries
from calibration.spectra import WAVELENGTHS, Spectra

METHODS = ("pinv", "ridge")
DEFAULT_METHOD = "ridge"

# Relative noise of one band of one texel that a fit should expect: about that of a well exposed
# bracket. At this level amplification drops by a factor of five for .1 dE or less.
NOISE_LEVEL = 0.01

ABSOLUTE_UNITS = "W/(sr m2 nm)"
RELATIVE_UNITS = (
    "relative; 1 is the spectral radiance of an equal-energy light that brings the most sensitive "
    "band to the saturation level in 1 s at ISO 100 and f/1"
)

# What a fit from sensitivities is trained on; the white share keeps what is white neutral.
ROOM_LIGHTS = "room"
ROOM_SURFACES = "ces99+rawtoaces190"
WHITE_SHARE = 0.2

# Ratio of the least to the greatest singular value of the bands, each scaled to rms 1, below
# which some band tells nothing that the others do not: no exposure separates it from noise.
_SINGULAR = 1e-5


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
    inputs: Mapping[str, str] | None = None,
) -> Transform:
    """The matrix that brings camera signals nearest to the radiances' primaries.

    "pinv" is the paper's: plain least squares over all samples. "ridge" is the best linear
    estimate when every band of every pixel carries noise, M = T S' (S S' + N)^-1 with T the
    primaries, S the signals and N the noise's covariance summed over the samples; and each light
    counts alike however bright it was.

    signals      (n, B) camera signals, one row a sample; rows with NaN are left out
    radiances    (n, 36) their spectral radiance on WAVELENGTHS
    channels     (B,) names of the bands
    groups       (n,) the light of each sample, for balance and cross-validation
    variances    (n, B) of one pixel's signals, not of a patch's mean; noise_level is the floor
    weights      (n,) how often a sample counts; default 1
    noise_level  relative noise of one band of one pixel
    absolute     whether the radiances are W/(sr m2 nm)
    returns      the Transform. Its figures: `training_delta_e` and, with more than one light,
                 `leave_one_light_out_delta_e` (CIEDE2000 through the primaries' own matrix, each
                 light's brightest sample as its white), `noise_amplification` (relative noise of
                 each primary over relative noise of the bands), `condition` of the bands,
                 numbers of samples and lights
    raises       InputError if the samples cannot determine the matrix
    """
    assert method in METHODS, method
    samples = _Samples.of(signals, radiances, primaries, groups, variances, weights, noise_level)
    _check_lights_left(set(groups), samples)
    _check_solvable(samples, tuple(channels))
    equations = _Equations.of(samples, method)
    matrix = equations.solved()
    figures = {
        "training_delta_e": _spread(_errors(matrix, samples, primaries), samples.weights),
        **_leave_one_light_out(equations, samples, primaries),
        "noise_amplification": _round(noise_amplification(matrix, samples.signals)),
        "condition": _round(_condition(samples.signals)),
        "samples": len(samples.signals),
        "samples_left_out": len(np.asarray(signals)) - len(samples.signals),
        "lights": len(set(samples.groups)),
    }
    return Transform(
        matrix=matrix,
        channels=tuple(channels),
        primaries=primaries.name,
        primaries_digest=primaries.digest,
        peaks_nm=tuple(np.round(primaries.peaks_nm, 3).tolist()),
        widths_nm=tuple(np.round(primaries.widths_nm, 3).tolist()),
        units=ABSOLUTE_UNITS if absolute else RELATIVE_UNITS,
        absolute=absolute,
        method=method,
        noise_level=0.0 if method == "pinv" else noise_level,
        figures=figures,
        inputs=dict(inputs or {}),
    )


def from_chart(
    signals: Mapping[str, NDArray[np.floating]],
    variances: Mapping[str, NDArray[np.floating]],
    radiances: Mapping[str, Spectra],
    *,
    patches: Sequence[str],
    channels: Sequence[str],
    primaries: Primaries,
    method: str = DEFAULT_METHOD,
    noise_level: float = NOISE_LEVEL,
    inputs: Mapping[str, str] | None = None,
) -> Transform:
    """M_S from chart photographs and spectroradiometer readings under several lights.

    signals    light -> (n, B) mean signal of each patch in each band, NaN where it clipped
    variances  light -> (n, B) variance of one pixel in it
    radiances  light -> spectra named as the patches, W/(sr m2 nm)
    patches    (n,) names, in the order of the rows
    the rest   as in `fit`
    raises     InputError if lights or patches do not match, or determine no matrix
    """
    _check_lights(signals, radiances, patches)
    rows = [
        np.asarray(signals[light], np.float64).reshape(len(patches), len(channels))
        for light in signals
    ]
    spectra = [radiances[light].resampled().only(patches).values.T for light in signals]
    return fit(
        np.concatenate(rows),
        np.concatenate(spectra),
        primaries=primaries,
        channels=channels,
        groups=[light for light in signals for _ in patches],
        variances=np.concatenate([variances[light] for light in signals]),
        method=method,
        noise_level=noise_level,
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
    from calibration import sets

    channels, bands = sensitivities(camera, filters, filter_names)
    lights = sets.lights(ROOM_LIGHTS) if lights is None else lights.resampled()
    surfaces = sets.surfaces(ROOM_SURFACES) if surfaces is None else surfaces.resampled()
    scaled = sets.scaled_to_unit_luminance(lights.values)
    walls = np.concatenate([surfaces.values, np.ones((len(WAVELENGTHS), 1))], axis=1)
    radiances = np.einsum("wl,ws->lsw", scaled, walls).reshape(-1, len(WAVELENGTHS))
    weights = np.append(np.ones(len(surfaces)), max(1.0, WHITE_SHARE * len(surfaces)))
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


def matched(transform: Transform, channels: Sequence[str], primaries: Primaries) -> Transform:
    """The transform with its columns in the order of these bands.

    raises  InputError if it is for other bands or other primaries
    """
    problems = []
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
    return replace(transform, matrix=transform.matrix[:, order], channels=tuple(channels))


def to_toml(transform: Transform) -> str:
    """The transform as the text of M_S.toml."""
    import tomli_w

    return tomli_w.dumps(
        {
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


def from_toml(text: str) -> Transform:
    """The transform that `to_toml` wrote; raises InputError with every problem found."""
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise fault(f"not TOML: {error}", "a file that sixlight fit wrote", "fit again") from None
    problems = [
        Problem(f"{'.'.join(path)} is {_kind(value)}", what, "fit the matrix again")
        for path, types, what in _KEYS
        if not _is(value := _at(table, path), types)
    ]
    if problems:
        raise InputError(problems)
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
    )


def write_transform(path: str | Path, transform: Transform) -> None:
    """Write M_S.toml."""
    Path(path).write_text(to_toml(transform), encoding="utf-8", newline="")


def read_transform(path: str | Path) -> Transform:
    """Read M_S.toml; raises InputError naming the file."""
    path = Path(path)
    if not path.is_file():
        raise fault("no such file", "M_S.toml", "run sixlight fit, or correct the path", path)
    try:
        return from_toml(path.read_text(encoding="utf-8"))
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


# ---- samples, and the solution


@dataclass(frozen=True)
class _Samples:
    """What a fit is made from, all rows whole; T, S, N of the formula before weighting.

    signals    (n, B)        targets    (n, P) the radiances in primaries
    variances  (n, B)        groups     (n,) light of each row
    weights    (n,) how often a row counts
    scale      (n,) what its light's brightest sample, by luminance, is divided by to become 1
    """

    signals: NDArray[np.float64]
    targets: NDArray[np.float64]
    variances: NDArray[np.float64]
    groups: NDArray[np.str_]
    weights: NDArray[np.float64]
    scale: NDArray[np.float64]

    @classmethod
    def of(cls, signals, radiances, primaries, groups, variances, weights, noise_level):
        signals = np.asarray(signals, np.float64)
        targets = primaries.project(radiances)
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
            targets,
            np.fmax(expected, measured),
            groups,
            np.ones(len(signals)) if weights is None else np.asarray(weights, np.float64),
            scale,
        )
        return samples.only(np.isfinite(signals).all(axis=1) & np.isfinite(targets).all(axis=1))

    def only(self, rows) -> _Samples:
        return _Samples(*(values[rows] for values in vars(self).values()))


@dataclass(frozen=True)
class _Equations:
    """Each light's share of the normal equations: M (S S' + N) = T S', summed over the lights.

    lights  (L,) names     left  (L, B, B) S S' + N     right  (L, B, P) S T'
    """

    lights: tuple[str, ...]
    left: NDArray[np.float64]
    right: NDArray[np.float64]

    @classmethod
    def of(cls, samples: _Samples, method: str) -> _Equations:
        lights = tuple(sorted(set(samples.groups.tolist())))
        left, right = [], []
        for light in lights:
            rows = samples.only(samples.groups == light)
            weights = rows.weights if method == "pinv" else rows.weights / rows.scale**2
            weighted = rows.signals * weights[:, None]
            noise = 0.0 if method == "pinv" else np.diag(weights @ rows.variances)
            left.append(weighted.T @ rows.signals + noise)
            right.append(weighted.T @ rows.targets)
        return cls(lights, np.stack(left), np.stack(right))

    def solved(self, without: str | None = None) -> NDArray[np.float64]:
        """The matrix (P, B) from all lights, or from all but one."""
        used = [light != without for light in self.lights]
        return np.linalg.lstsq(self.left[used].sum(axis=0), self.right[used].sum(axis=0))[0].T


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
        matrix = equations.solved(without=light)
        errors[inside] = _errors(matrix, samples.only(inside), primaries)
    worst = max(counts, key=lambda light: errors[samples.groups == light].mean())
    spread = _spread(errors, samples.weights)
    return {"leave_one_light_out_delta_e": {**spread, "worst_light": worst}}


def _errors(matrix, samples: _Samples, primaries: Primaries) -> NDArray[np.float64]:
    """CIEDE2000 (n,) of what the matrix makes of the signals, adapted to each light's white."""
    true = samples.targets @ primaries.xyz_from_primaries.T
    seen = samples.signals @ (primaries.xyz_from_primaries @ matrix).T
    errors = np.empty(len(true))
    for light in set(samples.groups.tolist()):
        rows = samples.groups == light
        white = true[rows][np.argmax(true[rows, 1])]
        to_d65 = cat02(white, D65) / white[1]
        errors[rows] = delta_e_2000(lab(true[rows] @ to_d65.T), lab(seen[rows] @ to_d65.T))
    return errors


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
