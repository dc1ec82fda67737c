"""Fitting primaries to the colours they are to reproduce: their matrix to XYZ, or curves and all.

`python -m calibration.optimise NAME` makes the files in data/primaries/NAME anew.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration import sets
from calibration.adaptation import D65, cat02
from calibration.descent import Colours, Equations, descend
from calibration.difference import delta_e_2000, delta_e_2000_parts, lab
from calibration.errors import InputError, Problem
from calibration.primaries import Primaries, gaussians, write
from calibration.spectra import WAVELENGTHS, Spectra

# Section "Selection of Rendering Primaries" of the paper.
DARLING_PEAKS_NM = np.array([447.0, 481.5, 519.6, 543.1, 572.9, 622.4])
DARLING_WIDTHS_NM = np.array([16.9, 4.3, 7.8, 9.4, 15.5, 18.0])

# White counts as this share of all surfaces: what is white in one light must be in every other,
# and captured light is judged by the white it falls on.
WHITE_SHARE = 0.2

KINDS = ("signed", "nonnegative", "gaussian")
STARTS = 25
SMOOTHING = 0.1

# Random starts are judged on about so many colours; so many of them go on to all colours.
_FEW = 3000
_FINALISTS = 2
# Rounds of weighing colours anew, from the least sum of squares to nearly the least mean.
_ROUNDS = 6

# A Gaussian narrower than this lies between two wavelengths 10 nm apart; the paper's has 4.3.
_NARROWEST_NM = 4.0

_PEAKS_WITHIN_NM = (425.0, 660.0)  # what eyes see lies around peaks in here
# Of a light's mean: less is no light at all. A three-part LED has .01 in its darkest sixth, a
# candle .06, a low-pressure sodium lamp 0.
_DARK = 0.002

Progress = Callable[[int, int], None]


def true_lab(lights: Spectra, surfaces: Spectra) -> NDArray[np.float64]:
    """CIELAB (L, S, 3) of surfaces under lights, from full spectra, adapted to D65."""
    stimuli = np.einsum("wl,ws->lsw", lights.values, surfaces.values)
    return adapted_lab(sets.xyz(stimuli), lights)


def adapted_lab(xyz, lights: Spectra) -> NDArray[np.float64]:
    """CIELAB (L, S, 3) of XYZ (L, S, 3) seen under lights, as corresponding colours for D65.

    Each light's own true white is scaled to Y = 1 and adapted from, fully, by CAT02.
    """
    whites = sets.xyz(lights.values.T)
    to_d65 = np.stack([cat02(white / white[1], D65) / white[1] for white in whites])
    return lab(np.einsum("lij,lsj->lsi", to_d65, xyz))


def products(curves, lights: Spectra, surfaces: Spectra) -> NDArray[np.float64]:
    """Light times surface (L, S, N) channel by channel: equation 2 of the paper."""
    return (lights.values.T @ curves)[:, None, :] * (surfaces.values.T @ curves)[None]


def rendering_errors(
    primaries: Primaries, lights: Spectra, surfaces: Spectra
) -> NDArray[np.float64]:
    """CIEDE2000 (L, S) between light times surface done in primaries and done in full spectra."""
    rendered = products(primaries.curves, lights, surfaces) @ primaries.xyz_from_primaries.T
    return delta_e_2000(true_lab(lights, surfaces), adapted_lab(rendered, lights))


def fit_matrix(
    curves, lights: Spectra, surfaces: Spectra, white_share: float = WHITE_SHARE
) -> NDArray[np.float64]:
    """The matrix (3, N) to XYZ with the least sum of squared CIEDE2000 over lights x surfaces.

    curves       (36, N), each summing to 1
    surfaces     without white, which is added with the weight of white_share of them all; 0: not
    white_share  see WHITE_SHARE
    returns      (3, N), equal-energy light of unit radiance on white has exactly Y = 1
    """
    from scipy.optimize import least_squares  # .8 s

    count = len(surfaces)
    root_weights = np.ones(count)
    if white_share > 0.0:
        surfaces = _with_white(surfaces)
        root_weights = np.append(root_weights, np.sqrt(white_share * count))
    phi = products(curves, lights, surfaces)
    target = true_lab(lights, surfaces)
    stimuli = np.einsum("wl,ws->lsw", lights.values, surfaces.values)
    flat = phi.reshape(-1, phi.shape[-1])
    start = np.linalg.lstsq(flat, sets.xyz(stimuli).reshape(-1, 3), rcond=None)[0].T

    def parts(matrix):
        rendered = adapted_lab(phi @ matrix.reshape(3, -1).T, lights)
        return (delta_e_2000_parts(target, rendered) * root_weights[:, None]).ravel()

    found = least_squares(parts, start.ravel(), method="lm", x_scale=np.abs(start.ravel()))
    matrix = found.x.reshape(3, -1)
    return matrix / matrix[1].sum()


def new_set(
    lights: Spectra,
    surfaces: Spectra,
    *,
    channels: int = 6,
    kind: str = "signed",
    starts: int = STARTS,
    seed: int = 0,
    smoothing: float = SMOOTHING,
    name: str = "new",
    first: Primaries | None = None,
    progress: Progress | None = None,
) -> tuple[Primaries, dict[str, Any]]:
    """New primaries: the curves and the matrix that best reproduce surfaces under lights.

    Random Gaussians are improved on some of the colours; the best few of what they become go on
    to all colours, and the best of those is brought nearer to the least mean of CIEDE2000.

    lights     relative, any scale
    surfaces   without white, which is added
    channels   how many curves
    kind       one of KINDS. "signed" curves are free but smooth, and may dip below zero;
               "nonnegative" ones are as free above it; "gaussian" ones have a peak and a width
    starts     how many random starts
    seed       of the starts
    smoothing  what the free curves' bends cost; see `cross_validate`
    name       the set's
    first      a set to start from, too: of as many channels, its shapes as the kind allows
    progress   called with how much is done, and of how much
    returns    the set, and figures as in `figures_of`, with `starts_within_1_percent` of the best
    raises     InputError if lights and surfaces cannot determine the set
    """
    assert kind in KINDS, kind
    lights, surfaces = lights.resampled(), surfaces.resampled()
    _check_training(lights, surfaces, channels)
    form = _Form(kind, channels, smoothing)
    colours = Colours.of(lights, surfaces, WHITE_SHARE)
    few = colours.thinned(_FEW)
    rng = np.random.default_rng(seed)
    curves = [_random_gaussians(rng, channels) for _ in range(starts)]
    if first is not None:
        curves.append(np.asarray(first.curves))
    finalists = min(_FINALISTS, len(curves))
    steps = _counted(len(curves) + finalists + _ROUNDS, progress)

    tried = []
    for start in curves:
        begin = np.concatenate([form.free(start), few.linear_matrix(start).ravel()])
        tried.append(form.descend(few, begin, 80))
        next(steps)
    tried.sort(key=lambda pair: pair[1].cost)
    improved = []
    for begin, _ in tried[:finalists]:
        improved.append(form.descend(colours, begin, 60))
        next(steps)
    at, here = min(improved, key=lambda pair: pair[1].cost)
    for _ in range(_ROUNDS):
        nearer = colours.nearer_the_mean(here.errors)
        at, here = form.descend(nearer, at, 25)
        next(steps)
    primaries = _finished(name, *form.curves_and_matrix(at))
    costs = np.array([equations.cost for _, equations in tried])
    return primaries, {
        **figures_of(primaries, lights, surfaces),
        "starts": len(costs),
        "starts_within_1_percent": int(np.sum(costs <= 1.01 * costs[0])),
    }


def figures_of(primaries: Primaries, lights: Spectra, surfaces: Spectra) -> dict[str, Any]:
    """How good a set is, and how steady.

    `delta_e` and `white_delta_e` (CIEDE2000 over lights x surfaces and over lights x white: mean,
    sd, max, p90), `condition` of the matrix to XYZ, `least`, the lowest value of any curve as a
    part of its own highest.
    """
    curves = primaries.curves
    return {
        "delta_e": _spread(rendering_errors(primaries, lights, surfaces)),
        "white_delta_e": _spread(rendering_errors(primaries, lights, sets.surfaces("white"))),
        "condition": float(np.linalg.cond(primaries.xyz_from_primaries)),
        "least": float((curves.min(axis=0) / curves.max(axis=0)).min()),
    }


def cross_validate(
    lights: Spectra,
    surfaces: Spectra,
    *,
    smoothings: Sequence[float],
    channels: int = 6,
    kind: str = "signed",
    folds: int = 3,
    starts: int = 5,
    seed: int = 0,
    progress: Progress | None = None,
) -> list[dict[str, float]]:
    """How well new primaries do on lights and surfaces they were not trained on.

    Lights and surfaces are dealt into folds; lights that are nearly the same spectrum stay
    together. Each fold's lights on its surfaces are rendered with primaries trained on the other
    folds' lights and surfaces.

    smoothings  to choose from
    the rest    as in `new_set`
    returns     for each smoothing {"smoothing", "mean", "sd", "max", "p90"}: CIEDE2000 held out
    """
    lights, surfaces = lights.resampled(), surfaces.resampled()
    rng = np.random.default_rng(seed)
    light_fold = _dealt(rng, _alike(lights), folds)
    surface_fold = _dealt(rng, np.arange(len(surfaces)), folds)
    steps = _counted(len(smoothings) * folds, progress)
    rows = []
    for smoothing in smoothings:
        errors = []
        for fold in range(folds):
            trained, _ = new_set(
                _where(lights, light_fold != fold),
                _where(surfaces, surface_fold != fold),
                channels=channels,
                kind=kind,
                starts=starts,
                seed=seed,
                smoothing=smoothing,
            )
            held_out = _where(lights, light_fold == fold), _where(surfaces, surface_fold == fold)
            errors.append(rendering_errors(trained, *held_out).ravel())
            next(steps)
        rows.append({"smoothing": smoothing, **_spread(np.concatenate(errors))})
    return rows


@dataclass(frozen=True)
class _Form:
    """Which curves are allowed, and the unknowns that make them.

    The unknowns are first those of the curves, then the matrix row by row: a Gaussian's are its
    peak and its width's logarithm, in steps of 10 nm; a free curve's its samples, of any scale,
    since each curve is divided by its sum.
    """

    kind: str
    channels: int
    smoothing: float

    def free(self, curves: NDArray[np.float64]) -> NDArray[np.float64]:
        """The unknowns of curves (36, P), or of the nearest allowed."""
        if self.kind == "gaussian":
            like = Primaries("", curves, np.empty((3, self.channels)))
            return np.concatenate([like.peaks_nm / 10.0, np.log(like.widths_nm / 10.0)])
        return np.maximum(curves, 0.0 if self.kind == "nonnegative" else -np.inf).T.ravel()

    def descend(
        self, colours: Colours, at: NDArray[np.float64], steps: int
    ) -> tuple[NDArray[np.float64], Equations]:
        """A better point, and its equations."""
        lowest = np.full(len(at), -np.inf)
        if self.kind == "nonnegative":
            lowest[: -3 * self.channels] = 0.0
        if self.kind == "gaussian":
            lowest[self.channels : 2 * self.channels] = np.log(_NARROWEST_NM / 10.0)
        return descend(self.equations(colours), at, steps=steps, lowest=lowest)

    def curves_and_matrix(self, at):
        """Curves (36, P) and matrix (3, P) at a point."""
        return self._curves(at)[0], at[-3 * self.channels :].reshape(3, -1)

    def _curves(self, at) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Curves (36, P), and the slopes (36 P, n) of their samples, curve by curve."""
        count, bands = self.channels, len(WAVELENGTHS)
        if self.kind == "gaussian":
            peaks, widths = at[:count], np.exp(at[count : 2 * count])
            off = (WAVELENGTHS[:, None] / 10.0 - peaks) / widths
            shapes = np.exp(-0.5 * off**2)
            by_peak, by_width = shapes * off / widths, shapes * off**2
            slopes = np.zeros((count, bands, 2 * count))
            for i in range(count):
                slopes[i, :, i], slopes[i, :, count + i] = by_peak[:, i], by_width[:, i]
        else:
            shapes = at[: count * bands].reshape(count, bands).T
            slopes = np.eye(count * bands).reshape(count, bands, -1)
        sums = shapes.sum(axis=0)
        sums = np.where(np.abs(sums) > 1e-9, sums, np.nan)
        curves = shapes / sums
        slopes = (slopes - curves.T[:, :, None] * slopes.sum(axis=1)[:, None]) / sums[:, None, None]
        return curves, slopes.reshape(count * bands, -1)

    def equations(self, colours: Colours) -> Callable[[NDArray[np.float64]], Equations]:
        """The normal equations by the unknowns, with the cost of bends."""
        samples = self.channels * len(WAVELENGTHS)
        bends = 0.0 if self.kind == "gaussian" else self.smoothing
        penalty = bends * np.kron(np.eye(self.channels), _BENDING)

        def at_point(at) -> Equations:
            curves, slopes = self._curves(at)
            if not np.isfinite(curves).all():  # a curve has vanished: nothing to go on with
                return Equations(np.inf, np.empty((0, 0)), np.empty(0), np.empty(0))
            e = colours.equations(curves, at[-3 * self.channels :].reshape(3, -1))
            flat = curves.T.ravel()
            cost = e.cost + flat @ penalty @ flat
            e.left[:samples, :samples] += penalty
            e.right[:samples] += penalty @ flat
            unknowns = slopes.shape[1]
            left = np.empty((unknowns + 3 * self.channels,) * 2)
            left[:unknowns, :unknowns] = slopes.T @ e.left[:samples, :samples] @ slopes
            left[:unknowns, unknowns:] = slopes.T @ e.left[:samples, samples:]
            left[unknowns:, :unknowns] = left[:unknowns, unknowns:].T
            left[unknowns:, unknowns:] = e.left[samples:, samples:]
            right = np.concatenate([slopes.T @ e.right[:samples], e.right[samples:]])
            return Equations(float(cost), left, right, e.errors)

        return at_point


def _bending() -> NDArray[np.float64]:
    """(36, 36): the sum of squared second differences of a curve that is zero outside."""
    differences = np.zeros((len(WAVELENGTHS) + 2, len(WAVELENGTHS)))
    for i in range(len(WAVELENGTHS)):
        differences[i : i + 3, i] = 1.0, -2.0, 1.0
    return differences.T @ differences


_BENDING = _bending()


def _random_gaussians(rng, channels: int) -> NDArray[np.float64]:
    """Curves (36, P) whose peaks leave no large part of what eyes see without one."""
    edges = np.linspace(*_PEAKS_WITHIN_NM, channels + 1)
    peaks = np.sort(edges[:-1] + rng.uniform(-0.3, 1.3, channels) * np.diff(edges))
    return gaussians(peaks, rng.uniform(9.0, 22.0, channels))


def _finished(name: str, curves, matrix) -> Primaries:
    """A set of these, in order of peak, rounded as files hold it."""
    order = np.argsort(Primaries(name, curves, matrix).peaks_nm)
    matrix = matrix[:, order] / matrix[1].sum()
    return Primaries(name, np.round(curves[:, order], 9), np.round(matrix, 6))


def _counted(total: int, progress: Progress | None) -> Iterator[None]:
    """Each `next` says that one more of the total is done."""
    for done in range(1, total + 1):
        if progress is not None:
            progress(done, total)
        yield


def _spread(errors) -> dict[str, float]:
    return {
        "mean": float(errors.mean()),
        "sd": float(errors.std()),
        "max": float(errors.max()),
        "p90": float(np.percentile(errors, 90)),
    }


def _where(spectra: Spectra, chosen) -> Spectra:
    names = tuple(name for name, take in zip(spectra.names, chosen, strict=True) if take)
    return Spectra(spectra.wavelengths, names, spectra.values[:, chosen])


def _alike(spectra: Spectra, cosine: float = 0.99) -> NDArray[np.intp]:
    """A number (n,) for each spectrum, the same for those linked by pairs nearly alike."""
    unit = spectra.values / np.linalg.norm(spectra.values, axis=0)
    near = unit.T @ unit > cosine
    label = np.arange(len(spectra))
    while True:
        lowest = np.where(near, label, len(label)).min(axis=1)
        if np.array_equal(lowest, label):
            return label
        label = lowest


def _dealt(rng, groups: NDArray[np.intp], folds: int) -> NDArray[np.intp]:
    """A fold (n,) for each, whole groups together and folds about equally full."""
    fold = np.empty(len(groups), np.intp)
    filled = np.zeros(folds)
    names, sizes = np.unique(groups, return_counts=True)
    shuffled = rng.permutation(len(names))
    for i in shuffled[np.argsort(-sizes[shuffled], kind="stable")]:
        to = int(np.argmin(filled))
        fold[groups == names[i]] = to
        filled[to] += sizes[i]
    return fold


def _ranges(channels: int) -> list[NDArray[np.bool_]]:
    """Masks (36,) of the wavelengths that each of so many channels is about.

    Of more than six, those of six: three-part lamps leave narrower ranges dark, rightly.
    """
    edges = np.linspace(*_PEAKS_WITHIN_NM, min(channels, 6) + 1)
    return [(low <= WAVELENGTHS) & (high >= WAVELENGTHS) for low, high in itertools.pairwise(edges)]


def _check_training(lights: Spectra, surfaces: Spectra, channels: int) -> None:
    problems = []
    if not 3 <= channels <= 12:
        problems.append(Problem(f"{channels} channels", "3 to 12", "choose fewer or more"))
    for what, spectra in (("light", lights), ("surface", surfaces)):
        for name, values in zip(spectra.names, spectra.values.T, strict=True):
            if values.min() < 0.0 or values.max() <= 0.0:
                problems.append(
                    Problem(
                        f"the {what} {name!r} is " + ("negative" if values.min() < 0.0 else "zero"),
                        "0 or more at every wavelength, and more somewhere",
                        "correct it, or leave it out",
                    )
                )
    ranges = _ranges(channels)
    for name, values in zip(lights.names, lights.values.T, strict=True):
        darkest = min(ranges, key=lambda band: values[band].max())
        if values[darkest].max() < _DARK * values.mean():
            first, last = WAVELENGTHS[darkest][[0, -1]]
            problems.append(
                Problem(
                    f"the light {name!r} has nothing from {first:.0f} to {last:.0f} nm",
                    "some power in the range of every channel, or nothing tells what it should be",
                    "leave it out, or mix it with the light it is used with",
                )
            )
    for name, values in zip(surfaces.names, surfaces.values.T, strict=True):
        if values.max() > 2.0:
            problems.append(
                Problem(f"the surface {name!r} reflects {values.max():.3g}", "0..1", "scale it")
            )
    # Bends of free curves are costed, so they need fewer; a Gaussian's peak and width need as many.
    colours, least = len(lights) * len(surfaces), 5 * channels
    if colours < least:
        problems.append(
            Problem(
                f"{len(lights)} lights x {len(surfaces)} surfaces are {colours} colours",
                f"{least} or more for {channels} channels",
                "add lights or surfaces",
            )
        )
    if problems:
        raise InputError(problems)


def darling2011() -> Primaries:
    """The paper's Gaussians with a matrix fitted as the paper's was, on surfaces that ship.

    The paper prints the Gaussians but not the matrix, and its 100 artists' paints are not public.
    """
    lights, surfaces = sets.lights("darling2011"), sets.surfaces("ces99+rawtoaces190")
    # Rounded here, so that the figures are those of the files as they ship.
    curves = np.round(gaussians(DARLING_PEAKS_NM, DARLING_WIDTHS_NM), 9)
    matrix = np.round(fit_matrix(curves, lights, surfaces), 6)
    primaries = Primaries("darling2011", curves, matrix, _DARLING_TEXT)
    figures = [
        f"{what}: {_summary(rendering_errors(primaries, lights, sets.surfaces(name)))}"
        for what, name in (
            ("CES99 + 190 patches (trained on)", "ces99+rawtoaces190"),
            ("ColorChecker (not trained on)", "colorchecker24"),
            ("white", "white"),
        )
    ]
    text = "\n".join([_DARLING_TEXT, *figures])
    return Primaries("darling2011", curves, matrix, text)


_DARLING_TEXT = """\
Curves: the six Gaussians of Darling, Ferwerda, Berns, Chen, "Real-Time Multispectral Rendering
with Complex Illumination" (CIC 19, 2011), each normalised to sum 1 on 380..730/10 nm.
Matrix: not printed in the paper; fitted here (calibration/optimise.py) to the least sum of squared
CIEDE2000 after CAT02 to D65 under the paper's 19 lights. The paper's 100 artists' paints are not
public: CES99 and rawtoaces' 190 patches, with white as a fifth of them, stand in; for the measured
D50 booth the lamp F40/C50 does.
CIEDE2000 under the 19 lights, mean/sd/max/90th percentile:"""


def _summary(errors) -> str:
    return _line(_spread(errors))


def _with_white(surfaces: Spectra) -> Spectra:
    white = np.ones((len(surfaces.wavelengths), 1))
    return Spectra(
        surfaces.wavelengths,
        (*surfaces.names, "white"),
        np.concatenate([surfaces.values, white], axis=1),
    )


TRAINED = {
    "gaussian6": ("gaussian", 6),
    "signed5": ("signed", 5),
    "signed6": ("signed", 6),
    "signed7": ("signed", 7),
    "signed8": ("signed", 8),
    "nonnegative6": ("nonnegative", 6),
}
"""The shipped sets that `trained` makes: their kind and how many channels they have."""
TRAINING_LIGHTS, TRAINING_SURFACES = "training", "ces99+rawtoaces190"
_TRAINING_STARTS, _TRAINING_SEED = 8, 2011

# A deep minimum for six Gaussians under the paper's 19 lights, which random starts seldom find.
_DEEP_PEAKS_NM = np.array([448.7, 513.1, 544.6, 574.2, 608.6, 642.5])
_DEEP_WIDTHS_NM = np.array([17.9, 11.7, 11.2, 11.0, 9.8, 9.1])


def trained(name: str, progress: Progress | None = None) -> Primaries:
    """One of TRAINED, made anew, with its figures in its `trained_on`."""
    kind, channels = TRAINED[name]
    lights, surfaces = sets.lights(TRAINING_LIGHTS), sets.surfaces(TRAINING_SURFACES)
    deep = Primaries("deep", gaussians(_DEEP_PEAKS_NM, _DEEP_WIDTHS_NM), np.empty((3, 6)))
    primaries, figures = new_set(
        lights,
        surfaces,
        channels=channels,
        kind=kind,
        starts=_TRAINING_STARTS,
        seed=_TRAINING_SEED,
        name=name,
        first=deep if channels == 6 else None,
        progress=progress,
    )
    shape = {
        "gaussian": "Gaussians",
        "signed": f"free and smooth (bends cost {SMOOTHING:g}), signed",
        "nonnegative": f"free and smooth (bends cost {SMOOTHING:g}), nowhere negative",
    }[kind]
    checker = sets.surfaces("colorchecker24")
    lines = [
        f"Curves: {channels}, {shape}, each normalised to sum 1.",
        "Curves and matrix: fitted together (calibration/optimise.py) to CIEDE2000 after CAT02 to",
        f"D65; least squares, then {_ROUNDS} rounds reweighted towards the least mean; of "
        f"{figures['starts']}",
        f"starts (seed {_TRAINING_SEED}), {figures['starts_within_1_percent']} came within 1 % of "
        "the best.",
        f'Trained on: {len(lights)} lights (the set "{TRAINING_LIGHTS}" of calibration/sets.py) x '
        "CES99 + 190 patches,",
        "with white as a fifth of them. Never on a ColorChecker, nor on any light within .99",
        'cosine of the test lights "leds8" and "places5"; so not on D65 or D75.',
        f"Condition of the matrix: {figures['condition']:.1f}. Lowest value of a curve: "
        f"{100.0 * figures['least']:.0f} % of its highest.",
        "CIEDE2000, mean/sd/max/90th percentile:",
        f"trained on: {_line(figures['delta_e'])}",
        f"white under the same lights: {_line(figures['white_delta_e'])}",
    ]
    for what, of in (
        ("the paper's 19 lights", "darling2011"),
        ("places5", "places5"),
        ("leds8", "leds8"),
    ):
        errors = rendering_errors(primaries, sets.lights(of), checker)
        lines.append(f"ColorChecker (not trained on), {what}: {_summary(errors)}")
    return replace(primaries, trained_on="\n".join(lines))


def _line(spread: dict[str, float]) -> str:
    return "/".join(f"{spread[what]:.2f}" for what in ("mean", "sd", "max", "p90"))


def main(arguments: list[str]) -> int:
    names = ("darling2011", *TRAINED)
    if len(arguments) != 1 or arguments[0] not in names:
        print(f"usage: python -m calibration.optimise {'|'.join(names)}", file=sys.stderr)
        return 2
    name = arguments[0]

    def progress(done: int, total: int) -> None:
        print(f"{name}: {done} of {total}", file=sys.stderr)

    made = darling2011() if name == "darling2011" else trained(name, progress)
    write(made, Path(__file__).parent / "data" / "primaries" / name)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
