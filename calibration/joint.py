"""M_S and M_R fitted together, as the paper's simulation did: what one gets wrong the other mends.

They belong together: either alone is no better than its own fit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calibration import merit, sets
from calibration.fit import NOISE_LEVEL, fit
from calibration.linear import Samples
from calibration.primaries import Primaries
from calibration.rendering import Rendered, Side, fitted
from calibration.training import TrainingSet
from calibration.transform import Transform

# Below 10 the whites gain nothing more, and the primaries' own errors rise from 4 % to over 10 %.
STRENGTH = 1.0
_KEPT = ("condition", "samples", "lights")  # figures of a matrix alone that stay true


def fit_together(
    light: TrainingSet,
    surface: TrainingSet,
    primaries: Primaries,
    *,
    noise_level: float = NOISE_LEVEL,
    strength: float = STRENGTH,
    inputs: Mapping[str, str] | None = None,
) -> tuple[Transform, Transform]:
    """M_S and M_R of the least CIEDE2000 of photographed surfaces in photographed light.

    Every light, as its lamp sends it, falls on every surface.

    light        of quantity LIGHT; its whites alone are used
    surface      of quantity REFLECTANCE, under the light that it is photographed in
    noise_level  relative noise of one band of one pixel
    strength     of staying near ridge, see calibration.rendering
    inputs       name to sha256 of each file that the samples are from
    returns      M_S, M_R; both have `joint_delta_e` in their figures
    raises       InputError if the samples cannot determine the matrices
    """
    pair = light.whites(), surface
    alone = [
        fit(training, primaries, method="ridge", noise_level=noise_level, inputs=inputs)
        for training in pair
    ]
    lamps, reflectances = (Samples.of(training, primaries, noise_level) for training in pair)
    sides = _side(lamps, alone[0].matrix), _side(reflectances, alone[1].matrix)
    xyz = np.einsum(
        "lw,sw,wi->lsi", lamps.spectra, reflectances.spectra, sets.observer(), optimize=True
    )
    colours = Rendered.of(
        *sides,
        true_xyz=xyz,
        whites=sets.xyz(lamps.spectra),
        xyz_from_primaries=primaries.xyz_from_primaries,
        weights=np.outer(lamps.weights, reflectances.weights),
    )
    found = fitted(colours, strength)
    joint = merit.spread(colours.errors(*found).ravel(), colours.weights.ravel())
    m_s, m_r = (
        replace(
            transform,
            matrix=matrix,
            method="delta-e",
            figures={
                "joint_delta_e": joint,
                "noise_amplification": merit.rounded(
                    merit.noise_amplification(matrix, side.signals)
                ),
                **{key: transform.figures[key] for key in _KEPT},
            },
        )
        for transform, matrix, side in zip(alone, found, sides, strict=True)
    )
    return m_s, m_r


def _side(samples: Samples, ridge) -> Side:
    """The samples as a side of what is rendered, whose matrix stays near ridge (P, B)."""
    signals, weights, variances = samples.signals, samples.weights, samples.variances
    metric = (signals * weights[:, None]).T @ signals + np.diag(weights @ variances)
    return Side(samples.targets, signals, variances, ridge, metric / weights.sum())
