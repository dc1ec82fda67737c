"""Linear least squares from camera bands to primaries: its samples, and what solves for them.

With T the primaries of the samples, S their signals and N the noise's covariance summed over them,
M = T S' (S S' + N)^-1 is the best linear estimate; with N = 0 it is the pseudo-inverse's.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration import sets
from calibration.errors import InputError, Problem, fault
from calibration.primaries import Primaries
from calibration.training import TrainingSet

# Ratio of the least to the greatest singular value of the bands, each scaled to rms 1, below
# which some band tells nothing that the others do not: no exposure separates it from noise.
_SINGULAR = 1e-5


@dataclass(frozen=True)
class Samples:
    """What a fit is made from, all rows whole.

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
    def of(cls, training: TrainingSet, primaries: Primaries, noise_level: float) -> Samples:
        """A training set's samples that are whole, with the noise that a fit should expect.

        noise_level  relative noise of one band of one pixel; the variances are at least its
        """
        lights, each, bands = training.signals.shape
        signals = training.signals.reshape(-1, bands)
        spectra = training.spectra.reshape(lights * each, -1)
        targets = primaries.project(spectra)
        luminance = (targets @ primaries.xyz_from_primaries[1]).reshape(lights, each)
        variances = (noise_level * signals) ** 2
        if training.variances is not None:
            variances = np.fmax(variances, training.variances.reshape(-1, bands))
        samples = cls(
            signals=signals,
            spectra=spectra,
            targets=targets,
            variances=variances,
            groups=np.repeat(training.lights, each),
            weights=np.tile(training.counts, lights),
            scale=np.repeat(luminance.max(axis=1), each),
            names=np.tile(training.names or ("",) * each, lights),
        )
        return samples.only(np.isfinite(signals).all(axis=1) & np.isfinite(targets).all(axis=1))

    @property
    def lights(self) -> tuple[str, ...]:
        """The lights, in the order they first appear."""
        return tuple(dict.fromkeys(self.groups.tolist()))

    def only(self, rows) -> Samples:
        """Some rows, by mask or index."""
        return Samples(*(values[rows] for values in vars(self).values()))

    def without(self, lights: Collection[str]) -> Samples:
        """All but the rows of some lights."""
        return self.only(~np.isin(self.groups, list(lights)))

    def brightest(self, light: str) -> int:
        """The row of a light's sample of most luminance: its white."""
        rows = np.flatnonzero(self.groups == light)
        return int(rows[np.argmax(self.spectra[rows] @ sets.observer()[:, 1])])

    def thinned(self, most: int) -> Samples:
        """About `most` rows of each light: its brightest, and evenly some others, for all."""
        kept, weights = [], self.weights.copy()
        for light in self.lights:
            rows = np.flatnonzero(self.groups == light)
            brightest = self.brightest(light)
            others = rows[rows != brightest]
            step = -(-len(others) // max(1, most - 1)) if len(others) else 1
            some = others[::step]
            weights[some] *= weights[others].sum() / max(weights[some].sum(), 1e-300)
            kept += [brightest, *some]
        samples = replace(self, weights=weights)
        return samples.only(np.sort(kept))


@dataclass(frozen=True)
class Equations:
    """Each light's share of the normal equations: M (S S' + N) = T S', summed over the lights.

    lights   (L,) names           weights  (L,) their samples' weights, summed
    left     (L, B, B) S S' + N   right    (L, B, P) S T'
    """

    lights: tuple[str, ...]
    weights: NDArray[np.float64]
    left: NDArray[np.float64]
    right: NDArray[np.float64]

    @classmethod
    def of(cls, samples: Samples, *, noise: bool = True) -> Equations:
        """With noise each light counts alike however bright it was; without, as it is."""
        left, right, counts = [], [], []
        for light in samples.lights:
            rows = samples.only(samples.groups == light)
            weights = rows.weights / rows.scale**2 if noise else rows.weights
            weighted = rows.signals * weights[:, None]
            summed = np.diag(weights @ rows.variances) if noise else 0.0
            left.append(weighted.T @ rows.signals + summed)
            right.append(weighted.T @ rows.targets)
            counts.append(rows.weights.sum())
        return cls(samples.lights, np.array(counts), np.stack(left), np.stack(right))

    def solved(self, without: Collection[str] = ()) -> NDArray[np.float64]:
        """The matrix (P, B) from all lights, or from all but some."""
        used = self._used(without)
        return np.linalg.lstsq(self.left[used].sum(axis=0), self.right[used].sum(axis=0))[0].T

    def metric(self, without: Collection[str] = ()) -> NDArray[np.float64]:
        """What moving the matrix away from `solved` adds to the mean sample's squared error."""
        used = self._used(without)
        mean: NDArray[np.float64] = self.left[used].sum(axis=0) / self.weights[used].sum()
        return mean

    def _used(self, without: Collection[str]) -> list[bool]:
        return [light not in without for light in self.lights]


def condition(signals) -> float:
    """Greatest over least singular value of the bands, each scaled to rms 1."""
    singular = np.linalg.svd(signals / _rms(signals), compute_uv=False)
    return float(singular[0] / max(singular[-1], np.finfo(float).tiny))


def _rms(signals) -> NDArray[np.float64]:
    rms: NDArray[np.float64] = np.sqrt(np.mean(signals**2, axis=0))
    return rms


def check_solvable(samples: Samples, training: TrainingSet) -> None:
    """Refuses samples that determine no matrix; they are those of `training` that are whole."""
    channels = training.channels
    lost = sorted(set(training.lights) - set(samples.lights))
    if lost:
        raise InputError(
            Problem(
                f"light {light!r}: no patch is known in every band",
                "some that do not clip through any filter",
                "add shorter exposures, or leave this light out",
            )
            for light in lost
        )
    s = samples.signals
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
        for light in sorted(samples.lights)
        for channel, brightest in zip(
            channels, s[samples.groups == light].max(axis=0, initial=0.0), strict=True
        )
        if brightest <= 0.0
    ]
    if problems:
        raise InputError(problems)
    if condition(s) > 1.0 / _SINGULAR:
        _, _, v = np.linalg.svd(s / _rms(s), full_matrices=False)
        alike = [channels[i] for i in np.argsort(-np.abs(v[-1]))[:2]]
        raise fault(
            f"{alike[0]} and {alike[1]} follow from the other bands",
            "bands that differ",
            "use filters that differ, and more lights or colours",
        )
