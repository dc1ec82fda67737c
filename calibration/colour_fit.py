"""M_S or M_R by colour: what leaves the least colour difference on lights left out of the fit.

Three kinds of matrices are tried: ridge over the samples; for M_S the best estimate through the
camera's estimated curves (`calibration.through_curves`); and those that descend from ridge towards
the least CIEDE2000 of what is rendered with them (`calibration.rendering`), from light on surfaces
of all kinds for M_S, from surfaces in light of all kinds for M_R. Each is fitted to all lights but
some and judged on those, noise of one pixel included.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration import merit, sets, training
from calibration.linear import Equations, Samples
from calibration.primaries import Primaries
from calibration.rendering import Rendered, Side, fitted
from calibration.through_curves import ThroughCurves
from calibration.transform import LIGHT, REFLECTANCE

RIDGE, CURVES = "ridge", "curves"
# Strengths of staying near ridge, in dE per unit of a primary, each started from the one before.
STRENGTHS = (100.0, 30.0, 10.0)
_WHITES = 0.5  # how often white counts among the known surfaces, as a share of the others
_WHITE_STAYS = 1e4  # how much dearer M_R's error of white is than that of the mean sample
_FOLDS = 8  # more lights than this are left out in neighbouring groups, not one by one
_MOST_COLOURS = 4_000  # of lights times surfaces that are looked at; more say the same
_EVERY = 12  # of the room's surfaces, what known light falls on; of its lights, a third of that
# What few lights left out say is uncertain by some percent; that of all kinds the one through the
# curves knows of other lights than the session's is not.
_PREFERRED = 0.95
_TOO_FEW = "too few lights or samples to leave one out: photograph three lights or more"


def by_colour(
    samples: Samples, primaries: Primaries, quantity: str, noise_level: float | None
) -> tuple[NDArray[np.float64], dict[str, Any]]:
    """The matrix (P, B), and figures of how it was chosen.

    noise_level  of one pixel's bands, relative, expected where the camera's curves are estimated;
                 None: they are not, since the samples were computed from known ones

    Its figures are `chosen`, with the mean rendered dE of each kind on lights left out, and
    `leave_one_light_out_delta_e` of the kind that was chosen. With fewer than three lights nothing
    can be left out, and ridge is kept.
    """
    equations = Equations.of(samples)
    folds = _folds(samples.lights)
    fewest = min(np.count_nonzero(~np.isin(samples.groups, fold)) for fold in folds)
    if len(samples.lights) < 3 or fewest < samples.signals.shape[1]:
        figures = merit.leave_one_light_out(equations.solved, samples, primaries)
        return equations.solved(), {
            **figures,
            "chosen": {"method": "ridge", "because": _TOO_FEW},
        }
    trial = _Trial.of(samples, equations, primaries, quantity, noise_level)
    scores = dict.fromkeys(trial.kinds, 0.0)
    errors = {kind: np.zeros(len(samples.groups)) for kind in trial.kinds}
    for fold in folds:
        inside = np.isin(samples.groups, fold)
        for kind, matrix in trial.matrices(without=fold):
            scores[kind] += trial.seen(fold, matrix) / len(folds)
            errors[kind][inside] = merit.errors(matrix, samples.only(inside), primaries)
    best = min(scores, key=lambda kind: scores[kind] * (_PREFERRED if kind == CURVES else 1.0))
    (matrix,) = (matrix for kind, matrix in trial.matrices() if kind == best)
    table = {kind: merit.rounded(score) for kind, score in scores.items()}
    chosen: dict[str, Any] = {
        "method": best if best in (RIDGE, CURVES) else "delta-e",
        "rendered_delta_e_left_out": table,
    }
    if chosen["method"] == "delta-e":
        chosen["strength"] = float(best)
    return matrix, {
        "leave_one_light_out_delta_e": merit.left_out(errors[best], samples),
        "chosen": chosen,
    }


@dataclass(frozen=True)
class _Trial:
    """The kinds of matrices, and the colours that they are judged by.

    rendered  what is made of `thin`, some of the samples
    """

    equations: Equations
    curves: ThroughCurves | None
    rendered: Rendered
    thin: Samples
    quantity: str

    @classmethod
    def of(cls, samples, equations, primaries, quantity, noise_level) -> _Trial:
        curves = None
        if noise_level is not None and quantity == LIGHT:
            curves = ThroughCurves(samples, primaries, noise_level)
        rendered, thin = _rendered(samples, primaries, quantity)
        return cls(equations, curves, rendered, thin, quantity)

    @property
    def kinds(self) -> tuple[str, ...]:
        """The names of what `matrices` gives, in its order."""
        curves = () if self.curves is None else (CURVES,)
        return (RIDGE, *curves, *(f"{k:g}" for k in STRENGTHS))

    def matrices(self, without: Collection[str] = ()) -> Iterator[tuple[str, NDArray[np.float64]]]:
        """Each kind's matrix from all lights, or from all but some."""
        ridge = self.equations.solved(without)
        yield RIDGE, ridge
        if self.curves is not None:
            yield CURVES, self.curves.solved(without)
        colours, matrix = self._tied(without, ridge), ridge
        for strength in STRENGTHS:
            (matrix,) = (m for m in fitted(colours, strength, [matrix]) if m is not None)
            yield f"{strength:g}", matrix

    def seen(self, lights: Collection[str], matrix) -> float:
        """Mean CIEDE2000 of these lights' colours, noise included."""
        held = self._some(np.isin(self.thin.groups, list(lights)))
        return held.mean_error(**{"m_s" if self.quantity == LIGHT else "m_r": matrix})

    def _some(self, rows) -> Rendered:
        return self.rendered.only(rows, "lights" if self.quantity == LIGHT else "surfaces")

    def _tied(self, without: Collection[str], ridge) -> Rendered:
        """All but some lights' colours, tied to the ridge that comes of the same samples."""
        some = self._some(~np.isin(self.thin.groups, list(without)))
        metric = self.equations.metric(without)
        if self.quantity == REFLECTANCE:
            metric = metric + _WHITE_STAYS  # the white is 1 in every primary, not just to the eye
        side = "light" if self.quantity == LIGHT else "surface"
        return replace(some, **{side: replace(getattr(some, side), ridge=ridge, metric=metric)})


def _folds(lights: Sequence[str]) -> list[tuple[str, ...]]:
    """The lights one by one, or where they are many in groups of neighbours."""
    ends = np.linspace(0, len(lights), min(_FOLDS, len(lights)) + 1).round().astype(int)
    return [tuple(lights[a:b]) for a, b in itertools.pairwise(ends)]


def _rendered(samples: Samples, primaries: Primaries, quantity: str) -> tuple[Rendered, Samples]:
    """The colours that are looked at, and the samples they are made of.

    For M_S: each sample's light, on surfaces of all kinds and white, seen by an eye adapted to
    the brightest sample of its lamp. For M_R: each sample as a surface, in light of all kinds.
    """
    if quantity == LIGHT:
        others, shares = _known_surfaces()
    else:
        others, shares = _known_lights()
    thin = samples.thinned(max(2, _MOST_COLOURS // (len(others) * len(samples.lights))))
    scale = thin.scale[:, None] if quantity == LIGHT else np.ones((len(thin.scale), 1))
    sought = Side(thin.targets / scale, thin.signals / scale, thin.variances / scale**2)
    known = Side(primaries.project(others))
    spectra = thin.spectra / scale
    if quantity == LIGHT:
        xyz = np.einsum("lw,sw,wi->lsi", spectra, others, sets.observer(), optimize=True)
        white_of = {light: sets.xyz(spectra[thin.brightest(light)]) for light in thin.lights}
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
    some = sets.surfaces(training.ROOM_SURFACES).values.T[::_EVERY]
    white = np.ones((1, some.shape[1]))
    return np.concatenate([some, white]), np.append(np.ones(len(some)), _WHITES * len(some))


def _known_lights() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Spectra (L, 36) of lamps of all kinds, Y = 1 on white, and how much each counts (L,)."""
    some = sets.lights(training.ROOM_LIGHTS).values.T[:: _EVERY // 3]
    return some, np.ones(len(some))
