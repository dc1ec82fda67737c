"""Choosing filters to photograph light through: every combination tried on lights it has not seen.

A combination gives 3 bands a filter. For each light in turn, M_S is fitted by ridge to all the
other lights on all surfaces (in closed form, from sums kept per light); what it makes of the light
left out falls on the surfaces in the primaries, and the colours are compared with full spectra.
What noise in the bands adds to white is computed beside it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration import sets
from calibration.adaptation import D65, cat02
from calibration.difference import delta_e_2000, lab
from calibration.errors import fault
from calibration.optimise import WHITE_SHARE, true_lab
from calibration.primaries import Primaries
from calibration.spectra import WAVELENGTHS, Spectra

NO_FILTER = "no filter"
"""Always among the candidates: a photograph without a filter is one more to choose from."""

# Relative noise of one band of one pixel: about that of a well exposed bracket.
NOISE_LEVEL = 0.01
# A band is known no better than this share of its filter's brightest band, times the noise level:
# what leaks through where a filter blocks is not a measurement.
_FLOOR = 0.01
_DARKEST = 0.01  # share of the camera's light below which a candidate is left out
_BEAM = 100  # combinations that are tried with one filter more
_REFINED = 50  # best combinations that are tried again on all surfaces
_SCREEN_SURFACES, _SCREEN_LIGHTS = slice(None, None, 12), slice(None, None, 3)  # for all others
# A surface gathers light from many texels, even of gloss from about so many: that divides
# the variance of noise.
_TEXELS = 64


@dataclass(frozen=True)
class Ranked:
    """A combination of filters and how well light is known through it.

    rank            1 is best; 0 where it was not among those searched
    filters         names
    delta_e         mean CIEDE2000 of surfaces under lights left out of the fit, without noise
    noise_delta_e   rms CIEDE2000 that noise gives a white lit by one texel
    expected_delta_e  both together, noise averaged over 64 texels: what the ranking goes by
    amplification   greatest relative noise of a primary over that of the bands
    stops           light lost in the darkest filter, in daylight
    """

    rank: int
    filters: tuple[str, ...]
    delta_e: float
    noise_delta_e: float
    expected_delta_e: float
    amplification: float
    stops: float


def rank(
    camera: Spectra,
    candidates: Spectra,
    *,
    count: int,
    primaries: Primaries,
    lights: Spectra | None = None,
    surfaces: Spectra | None = None,
    noise_level: float = NOISE_LEVEL,
    best: int = 10,
    beside: Iterable[Sequence[str]] = (),
) -> list[Ranked]:
    """The best combinations of `count` candidates in front of a camera, best first.

    All singles and pairs are tried (of up to 100 candidates); triples extend the 100 best pairs.

    camera       sensitivities R, G, B
    candidates   transmittances; "no filter" is added
    lights       one of which is left out at a time; default "training"
    surfaces     default CES99 and rawtoaces' 190; white is added
    noise_level  relative, of each band of a pixel
    best         how many to return
    beside       other combinations to judge as well, such as ("cyan", "yellow"): at the end
    raises       InputError where candidates lack, or pass no light
    """
    trial = _Trial.of(camera, candidates, primaries, lights, surfaces, noise_level)
    others = [tuple(names) for names in beside]
    _check(trial, count, others)
    quick = trial.thinned(_SCREEN_SURFACES, _SCREEN_LIGHTS)
    found: list[tuple[tuple[int, ...], float]] = [((), 0.0)]
    for size in range(1, count + 1):
        known = {tuple(sorted({*c, i})) for c, _ in found[:_BEAM] for i in trial.bright()}
        found = [(c, quick.judge(c).expected_delta_e) for c in known if len(c) == size]
        found.sort(key=lambda pair: (pair[1], pair[0]))
    refined = [trial.judge(c) for c, _ in found[: max(_REFINED, best)]]
    refined.sort(key=lambda ranked: ranked.expected_delta_e)
    places = {r.filters: i for i, r in enumerate(refined, 1)}
    places |= {
        trial.names_of(c): i for i, (c, _) in enumerate(found, 1) if trial.names_of(c) not in places
    }
    judged = [*refined[:best], *(trial.judge(trial.columns(names)) for names in others)]
    return [_placed(r, places) for r in judged]


def _placed(ranked: Ranked, places: dict[tuple[str, ...], int]) -> Ranked:
    return replace(ranked, rank=places.get(ranked.filters, 0))


def _check(trial: _Trial, count: int, beside: Iterable[tuple[str, ...]]) -> None:
    names = trial.candidates.names
    if count not in (1, 2, 3):
        raise fault(f"{count} filters", "1, 2 or 3", "choose one of these", "--count")
    if len(trial.bright()) < count:
        raise fault(
            f"{len(trial.bright())} candidates that pass light",
            f"{count} or more",
            "add candidates, or check that their values are fractions",
        )
    if len(trial.light) < 2:
        raise fault(
            "a single light to judge by",
            "two or more: each is left out of the fit in turn",
            "add lights, or leave --lights out",
            "--lights",
        )
    for name in (name for combination in beside for name in combination):
        if name not in names:
            raise fault(
                f"no candidate is called {name!r}", ", ".join(names), "name candidates as the file"
            )


@dataclass(frozen=True)
class _Trial:
    """What every combination is tried on.

    bands        (n, 36, 3) of each candidate, the brightest summing to 1
    passed       (n,) each candidate's share of the camera's light in daylight, in its best band
    light        (L, 36) each with Y = 1
    moments      (L, 36, 36) sum over surfaces of radiance times radiance, by light
    all_moments  (36, 36) their sum over all lights
    reflectances (S, P) in the primaries, white first
    target       (L, S, 3) CIELAB
    d65_from     (L, 3, P) primaries to XYZ adapted to D65
    """

    candidates: Spectra
    bands: NDArray[np.float64]
    passed: NDArray[np.float64]
    primaries: Primaries
    light: NDArray[np.float64]
    moments: NDArray[np.float64]
    all_moments: NDArray[np.float64]
    reflectances: NDArray[np.float64]
    target: NDArray[np.float64]
    d65_from: NDArray[np.float64]
    noise_level: float

    @classmethod
    def of(cls, camera, candidates, primaries, lights, surfaces, noise_level) -> _Trial:
        lights = sets.lights("training") if lights is None else lights.resampled()
        values = sets.scaled_to_unit_luminance(lights.values)
        lights = Spectra(WAVELENGTHS, lights.names, values)
        surfaces = sets.surfaces("ces99+rawtoaces190") if surfaces is None else surfaces.resampled()
        # White comes first, so that every thinning of the surfaces keeps it.
        surfaces = Spectra(
            WAVELENGTHS,
            ("white", *surfaces.names),
            np.concatenate([np.ones((len(WAVELENGTHS), 1)), surfaces.values], axis=1),
        )
        others = len(surfaces) - 1
        weights = np.append(max(1.0, WHITE_SHARE * others), np.ones(others))
        on_surfaces = (surfaces.values * (weights / weights.sum())) @ surfaces.values.T
        moments = np.einsum("wl,wv,vl->lwv", lights.values, on_surfaces, lights.values)
        candidates = _with_none(candidates.resampled())
        rgb = camera.only("RGB").resampled().values
        glass = candidates.values.T[:, :, None]
        bands = glass * rgb
        daylight = sets.lights("darling2011")["D65"]
        brightest = (bands * daylight[:, None]).sum(axis=1).max(axis=1)
        whites = sets.xyz(lights.values.T)
        adapted = np.stack([cat02(white, D65) / white[1] for white in whites])
        return cls(
            candidates=candidates,
            bands=bands / np.maximum(brightest, 1e-12)[:, None, None],
            passed=brightest / brightest[-1],
            primaries=primaries,
            light=lights.values.T,
            moments=moments,
            all_moments=moments.sum(axis=0),
            reflectances=surfaces.values.T @ primaries.curves,
            target=true_lab(lights, surfaces),
            d65_from=adapted @ primaries.xyz_from_primaries,
            noise_level=noise_level,
        )

    def thinned(self, surfaces: slice, lights: slice) -> _Trial:
        """Judged on some surfaces under some lights; M_S is still fitted to all the others."""
        return replace(
            self,
            light=self.light[lights],
            moments=self.moments[lights],
            reflectances=self.reflectances[surfaces],
            target=self.target[lights, surfaces],
            d65_from=self.d65_from[lights],
        )

    def bright(self) -> list[int]:
        return np.flatnonzero(self.passed >= _DARKEST).tolist()

    def columns(self, names: Iterable[str]) -> tuple[int, ...]:
        return tuple(sorted(self.candidates.names.index(name) for name in names))

    def names_of(self, combination: Iterable[int]) -> tuple[str, ...]:
        return tuple(self.candidates.names[i] for i in combination)

    def judge(self, combination: Sequence[int]) -> Ranked:
        """What light is known through these candidates."""
        bands = np.concatenate([self.bands[i] for i in combination], axis=1)
        signals = self.light @ bands  # (L, B)
        M_S, overall = self._matrices(bands)
        seen = np.einsum("lpb,lb->lp", M_S, signals)
        by_primary = np.swapaxes(self.d65_from * seen[:, None, :], 1, 2)
        errors = delta_e_2000(self.target, lab(self.reflectances @ by_primary))

        noise = self.noise_level * np.sqrt(_noise_squares(signals**2))
        true = self.light @ self.primaries.curves
        shifts = np.einsum("lip,lpb,lb->lbi", self.d65_from, M_S, noise)
        white = np.einsum("lip,lp->li", self.d65_from, true)[:, None]
        of_bands = delta_e_2000(lab(white), lab(white + shifts))  # noise is small: to first order
        noise_square = np.mean(np.sum(of_bands**2, axis=1))
        in_primaries = np.sqrt(noise**2 @ (overall**2).T) / self.noise_level
        return Ranked(
            rank=0,
            filters=self.names_of(combination),
            delta_e=float(errors.mean()),
            noise_delta_e=float(np.sqrt(noise_square)),
            expected_delta_e=float(np.sqrt(errors.mean() ** 2 + noise_square / _TEXELS)),
            amplification=float((_rms(in_primaries) / _rms(true)).max()),
            stops=float(-np.log2(self.passed[list(combination)].min())),
        )

    def _matrices(self, bands):
        """M_S (L, P, B) of each light from all others, and (P, B) from all."""
        left, right = self._equations(bands, self.moments)
        all_left, all_right = self._equations(bands, self.all_moments[None])
        without = np.linalg.solve(all_left - left, all_right - right)
        return np.swapaxes(without, 1, 2), np.linalg.solve(all_left, all_right)[0].T

    def _equations(self, bands, moments):
        """Both sides of M (S S' + N) = T S', transposed, for each sum of moments."""
        half = np.swapaxes(moments @ bands, 1, 2)
        left = half @ bands
        noise = self.noise_level**2 * _noise_squares(np.einsum("lbb->lb", left))
        return left + noise[:, :, None] * np.eye(bands.shape[1]), half @ self.primaries.curves


def _noise_squares(squares) -> NDArray[np.float64]:
    """What the noise's square is relative to (L, B): the signal's, with its filter's floor."""
    by_filter = squares.reshape(len(squares), -1, 3)
    floored = by_filter + _FLOOR**2 * by_filter.max(axis=2, keepdims=True)
    noise: NDArray[np.float64] = floored.reshape(squares.shape)
    return noise


def _rms(values) -> NDArray[np.float64]:
    rms: NDArray[np.float64] = np.sqrt(np.mean(values**2, axis=0))
    return rms


def _with_none(candidates: Spectra) -> Spectra:
    if NO_FILTER in candidates.names:
        return candidates.only([*(n for n in candidates.names if n != NO_FILTER), NO_FILTER])
    clear = np.ones((len(WAVELENGTHS), 1))
    values = np.concatenate([candidates.values, clear], axis=1)
    return Spectra(WAVELENGTHS, (*candidates.names, NO_FILTER), values)
