"""A ColorChecker's signals and readings under lights of the paper, and the camera that saw it."""

from __future__ import annotations

import numpy as np

from calibration import sets
from calibration.bands import sensitivities
from calibration.spectra import WAVELENGTHS, Spectra
from calibration.training import TrainingSet, photographed

PATCHES = tuple(str(i) for i in range(1, 25))


def step(centre_nm, slope_nm):
    return 1.0 / (1.0 + np.exp(-(WAVELENGTHS - centre_nm) / slope_nm))


def glasses() -> Spectra:
    """A cyan and a yellow glass: smooth curves much like BG39 and GG475."""
    cyan, yellow = 0.93 * (1.0 - step(600.0, 16.0)), 0.91 * step(476.0, 7.0)
    return Spectra(WAVELENGTHS, ("cyan", "yellow"), np.stack([cyan, yellow], axis=1))


def bands():
    """Names and curves of the bands of a measured camera behind the glasses."""
    return sensitivities(sets.camera("nikon5100"), glasses())


def session(lights=("A", "D65", "F2", "D50"), seed=0, noise=0.003):
    """The chart's signals, variances of their means, and radiances, each by light."""
    rng = np.random.default_rng(seed)
    chart, lamps = sets.surfaces("colorchecker24"), sets.lights("darling2011")
    radiances = {
        light: Spectra(WAVELENGTHS, chart.names, 0.01 * lamps[light][:, None] * chart.values)
        for light in lights
    }
    exact = {light: spectra.values.T @ bands()[1] for light, spectra in radiances.items()}
    signals = {light: s * (1 + noise * rng.normal(size=s.shape)) for light, s in exact.items()}
    return signals, {light: (0.004 * s) ** 2 for light, s in exact.items()}, radiances


def seen(given, **options) -> TrainingSet:
    """What a session gives to fit to."""
    return photographed(*given, patches=PATCHES, channels=bands()[0], **options)
