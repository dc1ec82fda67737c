"""Did the light change between one filter's photographs and another's?

Filters overlap: what one filter's bands see of a spectrum says much about another's. So the bands
of each further filter are predicted from the first one's, and where the light stood still they
differ from that by noise and by what spectra may do within such bands. What differs by more changed
between the passes: a cloud, a lamp that was switched, moved or flickers, somebody's shadow.

What is predicted is a cubic in the logarithms: of the first filter's two ratios of bands. Where the
bands of known spectra are given it is learnt from those, and all changes show. Without, it is
learnt from the capture itself, which can only see what sets some directions apart from others of
the same colour: that all light fell by a tenth, or all of the daylight in a room where
nothing else is as blue, looks like other filters.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages import cube
from stages.types import Float, Measured

Array = NDArray[np.float64]

MAP_SIZE = 32  # texels a side, 2.8 degrees: what is left of edges that filters draw unlike is small
DEGREE = 3  # of the prediction; a cube of real spectra bends more than a square follows
LEAST_SIGNAL = 5.0  # standard deviations of the noise, in every band; darker texels are not judged
MOST = 0.9  # of a coarse texel must be known
TEXELS_PER_TERM = 10  # that are needed to learn the prediction from
KNOWN_PER_TERM = 5  # the same of known spectra, which have no noise and did not change

# A texel counts as changed from so many standard deviations on; ...
SIGNIFICANT = 4.0
# ... and by at least this: no prediction is believed further than the tails of real spectra.
LEAST_CHANGE = 0.05

# What is worth a warning; undisturbed simulated captures stay well below, see docs/how-it-works.md.
MUCH_OF_THE_LIGHT = 0.005  # share that came or went
MUCH_OVERALL = 2.5  # standard deviations of the overall ratio

# The robust fit.
ROUNDS = 20
FAR = 3.0  # standard deviations from which on a texel counts less
FLOOR = 0.001  # no band is predicted better: linearity of a good sensor, the filters' shift


@dataclass(frozen=True)
class Change:
    """How the light of one filter's pass compares with the first filter's.

    log_ratio    (6, n, n) float32, ln of the light in this pass over that in the first, as this
                 filter's bands see it; NaN where not known
    sigma        (6, n, n) float32, standard deviation of that: noise, and what spectra may do
    share        of the light seen that came or went where the change is significant, 0..1
    largest      ratio of the light in the texel with the most of that; 1 where there is none
    direction    (3,) unit vector to it; None where there is none
    overall      median ratio over all directions; None without known spectra, which cannot tell
    overall_log_sigma  standard deviation of its logarithm, were all the light of one kind that is
                 as unlike the known ones as those are unlike each other
    """

    log_ratio: Float
    sigma: Float
    share: float
    largest: float
    direction: Array | None
    overall: float | None
    overall_log_sigma: float | None


def drift(
    bands: Measured,
    *,
    channels: int = 3,
    common: Float | None = None,
    known: Array | None = None,
) -> list[Change]:
    """How the light changed from the first filter's pass to each of the others'.

    bands     (6, N, N, B), a filter's `channels` beside each other
    common    (6, N, N, B) how many times a texel's variance counts in a sum over many, see
              `assess.shared_noise`; 1 where left out
    known     (n, B) bands of light as it comes back from things, in the same unit (sums over known
              sensitivities, or what the bands saw of a chart): makes the changes absolute. Fewer
              than KNOWN_PER_TERM to each term of the prediction are as good as none
    returns   one Change for each filter but the first; their n is MAP_SIZE, N if that is less
    """
    if known is not None and len(known) < KNOWN_PER_TERM * len(_powers(channels - 1)):
        known = None
    values, variance, seen = _coarse(bands, common)
    n = values.shape[1]
    weight = np.where(seen, cube.solid_angles(n), 0.0)
    filters = range(channels, values.shape[-1], channels)
    return [
        _change(
            values,
            variance,
            weight,
            np.r_[0:channels, first : first + channels],
            known,
        )
        for first in filters
    ]


def worth_telling(changes: Sequence[Change], names: Sequence[str]) -> list[str]:
    """What the photographer should know, a sentence each.

    names  of all filters, in order
    """
    said = []
    for change, name in zip(changes, names[1:], strict=True):
        passes = f"between the photographs through {names[0]} and {name}"
        if change.overall is not None and change.overall_log_sigma is not None:
            off = np.log(change.overall) / change.overall_log_sigma
            if abs(off) > MUCH_OVERALL:
                said.append(
                    f"all light changed to {change.overall:.3g} times what it was {passes},"
                    " or the shutter times are not what they are tagged as"
                )
        if change.share > MUCH_OF_THE_LIGHT and change.direction is not None:
            x, y, z = change.direction
            said.append(
                f"{change.share:.1%} of the light changed {passes}, most of it in the direction"
                f" ({x:.2f}, {y:.2f}, {z:.2f}), to {change.largest:.3g} times what it was"
            )
    return said


def _coarse(bands: Measured, common: Float | None) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Values and variances (6, n, n, B) of larger texels, and which are known for the most part."""
    size = bands.values.shape[1]
    n = min(MAP_SIZE, size)
    start = np.ceil(np.arange(n) * size / n).astype(int)

    def gathered(texels):
        return np.add.reduceat(np.add.reduceat(texels, start, axis=0), start, axis=1)

    solid_angles = cube.solid_angles(size)
    whole = gathered(solid_angles)
    values = np.empty((6, n, n, bands.values.shape[-1]))
    variance = np.empty_like(values)
    seen = np.empty((6, n, n), np.bool_)
    for face in range(6):
        known = (bands.valid[face] > 0) & np.isfinite(bands.values[face]).all(axis=-1)
        omega = np.where(known, solid_angles, 0.0)
        total = gathered(omega)
        divisor = np.maximum(total, 1e-30)[..., None]
        omega, known = omega[..., None], known[..., None]
        shared = 1.0 if common is None else common[face]
        signal = np.where(known, bands.values[face], 0.0)
        noise = np.where(known, bands.variance[face] * shared, 0.0)
        values[face] = gathered(signal * omega) / divisor
        variance[face] = gathered(noise * omega**2) / divisor**2
        seen[face] = total > MOST * whole
    return values, variance, seen


def _change(values, variance, weight, columns, known) -> Change:
    values, variance = values[..., columns], variance[..., columns]
    count = len(columns) // 2
    n = values.shape[1]
    clear = (weight > 0) & (values > LEAST_SIGNAL * np.sqrt(variance)).all(axis=-1)
    log_ratio = np.full((6, n, n), np.nan, np.float32)
    sigma = np.full((6, n, n), np.nan, np.float32)
    overall = overall_log_sigma = None
    signal, omega = values[clear], weight[clear]
    share, largest, direction = 0.0, 1.0, None
    if known is None:
        prediction = _learnt(signal, omega, TEXELS_PER_TERM)
    else:
        prediction = _learnt(known[:, columns], np.ones(len(known)), KNOWN_PER_TERM)
    if prediction is not None and len(signal):
        relative = variance[clear] / signal**2
        change, spread = prediction.compare(np.log(signal), relative)
        log_ratio[clear], sigma[clear] = change, spread
        light = omega * signal[:, count:].sum(axis=1)
        changed = np.abs(change) > np.maximum(SIGNIFICANT * spread, LEAST_CHANGE)
        # What is there now less what was; of a light that went the most that can be said is all.
        moved = np.where(changed, light * np.abs(np.expm1(-change)), 0.0)
        total = np.sum(light * np.where(changed, np.maximum(1.0, np.exp(-change)), 1.0))
        share = float(moved.sum() / total)
        if changed.any():
            most = int(np.argmax(moved))
            largest = float(np.exp(change[most]))
            direction = cube.directions(n)[clear][most]
        if known is not None:
            middle = _median(change, omega)
            overall, overall_log_sigma = float(np.exp(middle)), prediction.scale_spread
    return Change(log_ratio, sigma, share, largest, direction, overall, overall_log_sigma)


@dataclass(frozen=True)
class _Prediction:
    """A further filter's bands from the first one's, in logarithms.

    centre, scale  (C - 1,) of the first filter's ratios of bands, to bring them about 0 and 1
    coefficients   (terms, C)
    covariance     (C, C) of what is left where nothing changed and nothing is noise
    """

    centre: Array
    scale: Array
    coefficients: NDArray[np.floating]
    covariance: Array

    @property
    def scale_spread(self) -> float:
        """Standard deviation of the change that spectra alone feign."""
        ones = np.ones(len(self.covariance))
        return float((ones @ np.linalg.solve(self.covariance, ones)) ** -0.5)

    def compare(self, logs: Array, relative: Array) -> tuple[Array, Array]:
        """The change (n,) by generalised least squares, and its standard deviation (n,).

        logs      (n, 2 C) logarithms of both filters' bands
        relative  (n, 2 C) their variances: variances over squares of the bands
        """
        count = logs.shape[1] // 2
        ratios, level = _ratios(logs[:, :count])
        x = (ratios - self.centre) / self.scale
        left = logs[:, count:] - level - _terms(x) @ self.coefficients
        # How the prediction follows the noise of what it is made from.
        of_ratios = np.einsum("ntk,tc->nck", _slopes(x), self.coefficients) / self.scale
        to_ratios = np.eye(count)[1:] - np.eye(count)[:1]
        follows = of_ratios @ to_ratios + 1.0 / count
        spread = self.covariance + np.einsum(
            "nca,na,nda->ncd", follows, relative[:, :count], follows
        )
        spread += np.einsum("nc,cd->ncd", relative[:, count:], np.eye(count))
        weights = np.linalg.solve(spread, np.ones((len(logs), count, 1)))[..., 0]
        information = weights.sum(axis=1)
        return np.sum(weights * left, axis=1) / information, information**-0.5


def _learnt(signal: Array, weight: Array, least: int) -> _Prediction | None:
    """The prediction from bands (n, 2 C) of light that did not change; None if they are too few.

    weight  (n,) how much each counts
    least   how many there must be for each term

    A few that did change are borne: each counts by how usual it is (Huber 1964), and the spread is
    scaled to that of the better half.
    """
    count = signal.shape[1] // 2
    lit = (signal > 0.0).all(axis=1)
    logs = np.log(signal[lit])
    weight = weight[lit]
    ratios, level = _ratios(logs[:, :count])
    if len(logs) < least * len(_powers(count - 1)):
        return None
    centre: Array = np.average(ratios, axis=0, weights=weight)
    spread = np.average((ratios - centre) ** 2, axis=0, weights=weight)
    scale: Array = np.sqrt(np.maximum(spread, 1e-6))
    terms = _terms((ratios - centre) / scale)
    wanted = logs[:, count:] - level[:, :1]
    usual: NDArray[np.floating] = np.ones(len(logs))
    ridge = 1e-6 * np.eye(terms.shape[1])  # light of one colour leaves terms undecided
    floor = FLOOR**2 * np.eye(count)
    for _ in range(ROUNDS):
        w = (weight * usual / np.sum(weight * usual))[:, None]
        coefficients = np.linalg.solve(terms.T @ (w * terms) + ridge, terms.T @ (w * wanted))
        left = wanted - terms @ coefficients
        shape = left.T @ (w * left) + floor
        distance = np.einsum("nc,cd,nd->n", left, np.linalg.inv(shape), left)
        middle = _median(distance, weight) / _chi_square_median(count)
        usual = np.minimum(1.0, FAR**2 * middle / np.maximum(distance, 1e-30))
    covariance = middle * shape + floor
    return _Prediction(centre, scale, coefficients, covariance)


def _chi_square_median(freedom: int) -> float:
    return freedom * (1.0 - 2.0 / (9.0 * freedom)) ** 3  # Wilson and Hilferty 1931


def _ratios(logs: Array) -> tuple[Array, Array]:
    """ln of the bands over the first one's (n, C - 1), and the mean logarithm (n, 1)."""
    return logs[:, 1:] - logs[:, :1], logs.mean(axis=1, keepdims=True)


def _powers(variables: int) -> list[tuple[int, ...]]:
    return [p for p in itertools.product(range(DEGREE + 1), repeat=variables) if sum(p) <= DEGREE]


def _terms(x: Array) -> Array:
    """All products (n, terms) of powers of the variables x (n, k), up to DEGREE."""
    return np.stack([np.prod(x**p, axis=1) for p in np.array(_powers(x.shape[1]))], axis=1)


def _slopes(x: Array) -> Array:
    """The terms' derivatives (n, terms, k) by the variables."""
    slopes = np.zeros((len(x), len(_powers(x.shape[1])), x.shape[1]))
    for t, p in enumerate(np.array(_powers(x.shape[1]))):
        for k in np.flatnonzero(p):
            lower = p - (np.arange(len(p)) == k)
            slopes[:, t, k] = p[k] * np.prod(x**lower, axis=1)
    return slopes


def _median(values: Array, weight: Array) -> float:
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return float(values[order[np.searchsorted(total, total[-1] / 2.0)]])
