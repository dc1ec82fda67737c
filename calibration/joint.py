"""M_S and M_R fitted together, as the paper's simulation did: what one gets wrong the other mends.

They belong together: either alone is no better than its own fit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from calibration import merit, sets
from calibration.fit import NOISE_LEVEL, fit
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
    light = light.whites()
    alone, sides, weights = [], [], []
    for training in (light, surface):
        transform = fit(training, primaries, method="ridge", noise_level=noise_level, inputs=inputs)
        signals = training.signals.reshape(-1, training.signals.shape[-1])
        counts = np.tile(training.counts, len(training.lights))
        variances = (noise_level * signals) ** 2
        metric = (signals * counts[:, None]).T @ signals + np.diag(counts @ variances)
        true = primaries.project(_rows(training))
        alone.append(transform)
        sides.append(Side(true, signals, variances, transform.matrix, metric / counts.sum()))
        weights.append(counts)
    lamps, reflectances = _rows(light), _rows(surface)
    xyz = np.einsum("lw,sw,wi->lsi", lamps, reflectances, sets.observer(), optimize=True)
    whites, xyz_from = sets.xyz(lamps), primaries.xyz_from_primaries
    colours = Rendered.of(sides[0], sides[1], xyz, whites, xyz_from, np.outer(*weights))
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


def _rows(training: TrainingSet):
    """The spectra (L n, 36)."""
    return training.spectra.reshape(-1, training.spectra.shape[-1])
