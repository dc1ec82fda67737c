"""Pairs of paints that match under one light and part under another.

What three channels cannot show and six can (Darling et al. 2011, figure 8). A pair is sought by
linear programming: everything asked of two reflectance curves is linear in them, but for the
colour difference itself, which is straight enough near one colour to be maximised along one of its
directions at a time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration import sets
from calibration.adaptation import D65
from calibration.channels import SHARP_FROM_XYZ, Channels, of_colour_space, of_primaries
from calibration.difference import delta_e_2000
from calibration.errors import fault
from calibration.optimise import adapted_lab, true_lab
from calibration.primaries import Primaries
from calibration.slopes import lab_slopes
from calibration.spectra import WAVELENGTHS, Spectra

NAMES = ("first", "second")

PART = 18.0
"""CIEDE2000: two colours nobody would confuse; more would ask for stranger paints."""

# A paint's curve is smooth. Of the ColorChecker's patches the sharpest bends by .035 in 10 nm; of
# CES99's by .06.
_BEND = 0.035
_LOWEST, _HIGHEST = 0.03, 0.92  # reflectance factors of paints
# How far six channels may be from full spectra, of XYZ relative to a white: .3 dE or so.
_HELD = 6e-4
_TARGETS = 4  # colours the pairs match in ...
_DIRECTIONS = 6  # ... and directions in which they part, of each
_ALIKE = 2.0  # dE: what parts by less, nobody sees part


@dataclass(frozen=True)
class Pair:
    """Two paints and how they compare.

    paints   the reflectances `first` and `second` on WAVELENGTHS
    figures  CIEDE2000 between the two: match_true and part_true in full spectra under each light,
             match_six and part_six in the primaries, match_sharp and part_sharp in sharpened RGB;
             and held, the greatest difference of any of the four colours rendered in the
             primaries from the same in full spectra
    """

    paints: Spectra
    figures: dict[str, float]


def pair(
    light_match, light_part, primaries: Primaries, seed: int = 1, *, part: float = PART
) -> Pair:
    """Two paints that match under one light, part under the other, and that six channels hold.

    light_match, light_part  (36,) on WAVELENGTHS, on any scale
    primaries                in which they are to be rendered: both paints come out as in full
                             spectra, under both lights
    seed                     of the colours and directions that are tried
    part                     CIEDE2000 they are to part by; less where the lights do not allow it
    returns                  the pair with the most of two: what it parts by under the second light,
                             and what sharpened RGB tears it apart under the first, where it matches
    raises                   InputError where no pair parts by what can be seen: lights too alike
    """
    lights = _lights(light_match, light_part)
    six, sharp = of_primaries(primaries), of_colour_space(SHARP_FROM_XYZ)
    rng = np.random.default_rng(seed)
    best, best_score = None, -np.inf
    for target in _targets(rng, lights):
        search = _Search(lights, six, sharp, target)
        for angle in rng.uniform(0.0, np.pi) + np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS:
            curves = search.along(angle)
            if curves is None:
                continue
            paints = _parting_by(part, Spectra(WAVELENGTHS, NAMES, curves), lights)
            figures = compare(paints, lights, six, sharp)
            # A pair made for daylight matches in sharpened RGB as well: then the first alone counts
            score = figures["part_true"] + figures["match_sharp"]
            if score > best_score:
                best, best_score = Pair(paints, figures), score
    if best is None or best.figures["part_true"] < _ALIKE:
        raise fault(
            "no two paints that match under one of these lights part under the other",
            "two lights of unlike spectra",
            "name others, a daylight and a lamp",
        )
    return best


def _parting_by(part: float, paints: Spectra, lights: Spectra) -> Spectra:
    """The paints brought together, if they part by more: all that is linear in them stays."""
    middle = paints.values.mean(axis=1, keepdims=True)
    apart = paints.values - middle

    def at(share: float) -> Spectra:
        return Spectra(WAVELENGTHS, NAMES, middle + share * apart)

    def parts(share: float) -> float:
        colours = true_lab(lights, at(share))[1]
        return float(delta_e_2000(colours[0], colours[1]))

    low, high = 0.0, 1.0
    if parts(high) <= part:
        return paints
    for _ in range(30):  # to a millionth
        half = (low + high) / 2.0
        low, high = (half, high) if parts(half) < part else (low, half)
    return at(high)


def compare(paints: Spectra, lights: Spectra, six: Channels, sharp: Channels) -> dict[str, float]:
    """The figures of `Pair`.

    lights  two, the one they match under first
    """
    true = true_lab(lights, paints)
    ways = {
        "true": true,
        "six": adapted_lab(six.xyz(lights, paints), lights),
        "sharp": adapted_lab(sharp.xyz(lights, paints), lights),
    }
    figures: dict[str, float] = {}
    for way, colours in ways.items():
        apart = delta_e_2000(colours[:, 0], colours[:, 1])
        figures |= {f"match_{way}": float(apart[0]), f"part_{way}": float(apart[1])}
    return figures | {"held": float(delta_e_2000(true, ways["six"]).max())}


def _lights(light_match, light_part) -> Spectra:
    values = np.stack([np.asarray(light_match, float), np.asarray(light_part, float)], axis=1)
    return Spectra(WAVELENGTHS, ("match", "part"), sets.scaled_to_unit_luminance(values))


def _targets(rng, lights: Spectra) -> NDArray[np.float64]:
    """XYZ (n, 3) under the first light of muted paints to match in, a white being the light's own.

    Muted, because a strong colour leaves little room for two ways to make it. Those of smooth
    curves, which surely exist: mixtures of the ColorChecker's greys and its colours.
    """
    chart = sets.surfaces("colorchecker24").values
    colours = chart[:, rng.choice(18, _TARGETS, replace=False)]
    share = rng.uniform(0.15, 0.4, _TARGETS)
    grey = rng.uniform(0.2, 0.4, _TARGETS)
    return sets.xyz((lights.values[:, :1] * (share * colours + (1.0 - share) * grey)).T)


class _Search:
    """The linear programme of one target colour; unknowns are both paints' curves, 72 numbers."""

    def __init__(self, lights: Spectra, six: Channels, sharp: Channels, target):
        self.count = len(WAVELENGTHS)
        observer = sets.observer()
        true = [(observer * light[:, None]).T for light in lights.values.T]  # XYZ from paint
        held = [
            _xyz_from_surface(six, light) - t
            for light, t in zip(lights.values.T, true, strict=True)
        ]
        bend = np.diff(np.eye(self.count), 2, axis=0)
        white = sets.xyz(lights.values.T)
        nothing = np.zeros_like(true[0])
        self.equal = np.concatenate(
            [
                np.concatenate([true[0], nothing], axis=1),
                np.concatenate([nothing, true[0]], axis=1),
                np.concatenate([held[0], -held[0]], axis=1),  # match in six channels too
            ]
        )
        self.equals = np.concatenate([target, target, np.zeros(3)])
        rows = np.concatenate([bend, *held])
        limits = np.concatenate([np.full(len(bend), _BEND), *(_HELD * w for w in white)])
        both = np.kron(np.eye(2), rows)
        self.less = np.concatenate([both, -both])
        self.limit = np.tile(limits, 4)
        torn = _xyz_from_surface(sharp, lights.values[:, 0])
        self.lab_part = _lab_of(true[1], white[1], target / white[0] * white[1])
        self.lab_torn = _lab_of(torn, white[0], target)

    def along(self, angle: float) -> NDArray[np.float64] | None:
        """Curves (36, 2) that part most along a direction of a*, b*; None where there are none."""
        from scipy.optimize import linprog  # .8 s

        gain = np.array([0.0, np.cos(angle), np.sin(angle)]) @ (self.lab_part + self.lab_torn)
        found = linprog(
            -np.concatenate([gain, -gain]),
            self.less,
            self.limit,
            self.equal,
            self.equals,
            bounds=(_LOWEST, _HIGHEST),
            method="highs",
        )
        return found.x.reshape(2, self.count).T if found.status == 0 else None


def _xyz_from_surface(channels: Channels, light) -> NDArray[np.float64]:
    """XYZ (3, 36) that the channels make of a surface's curve under a light (36,)."""
    return np.asarray(channels.xyz_from_channels * (light @ channels.light)) @ channels.surface.T


def _lab_of(xyz_from_surface, white, near) -> NDArray[np.float64]:
    """Change of CIELAB (3, 36) with a surface's curve, for colours near an XYZ under that white."""
    slopes = lab_slopes(near / white * D65)[1]
    return np.asarray(slopes @ (D65[:, None] / white[:, None] * xyz_from_surface))
