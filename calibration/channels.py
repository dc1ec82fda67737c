"""Light times surface in a few channels, and how far its colours are from full spectra.

Every method compared here is the same three steps: light and surface are each reduced to a few
numbers by curves, the numbers are multiplied channel by channel, and a matrix brings the products
to XYZ. Methods differ in the curves: those of rendering primaries, the observer's (XYZ, sharpened
RGB), or what a matrix makes of a camera's bands.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration import sets
from calibration.difference import delta_e_2000, delta_e_2000_parts
from calibration.optimise import WHITE_SHARE, adapted_lab, true_lab
from calibration.primaries import Primaries
from calibration.spectra import Spectra

SHARP_FROM_XYZ = np.array(
    [[1.2694, -0.0988, -0.1706], [-0.8364, 1.8006, 0.0357], [0.0297, -0.0315, 1.0018]]
)
"""Sharpened RGB from XYZ: Ward and Eydelberg-Vileshin, "Picture Perfect RGB Rendering Using
Spectral Prefiltering and Sharp Color Primaries" (2002)."""


@dataclass(frozen=True)
class Channels:
    """A way to render: what reduces light and surfaces, and the way back to XYZ.

    light              (36, C) curves that spectral radiance is summed over
    surface            (36, C) curves that reflectance is summed over; white is 1 in each channel
    xyz_from_channels  (3, C)
    """

    light: NDArray[np.float64]
    surface: NDArray[np.float64]
    xyz_from_channels: NDArray[np.float64]

    def xyz(self, lights: Spectra, surfaces: Spectra) -> NDArray[np.float64]:
        """XYZ (L, S, 3) of every surface under every light, rendered."""
        products = (lights.values.T @ self.light)[:, None] * (surfaces.values.T @ self.surface)
        return products @ self.xyz_from_channels.T

    def errors(self, lights: Spectra, surfaces: Spectra) -> NDArray[np.float64]:
        """CIEDE2000 (L, S) from the same colours in full spectra, each light's white at D65."""
        rendered = adapted_lab(self.xyz(lights, surfaces), lights)
        return delta_e_2000(true_lab(lights, surfaces), rendered)


def of_primaries(primaries: Primaries) -> Channels:
    """A set of primaries, from full spectra."""
    return Channels(primaries.curves, primaries.curves, primaries.xyz_from_primaries)


def of_colour_space(channels_from_xyz) -> Channels:
    """XYZ (Borges 1991; the identity) or three channels linear in it.

    A surface is what it makes of D65: its XYZ under D65 over those of D65, in that space.
    """
    channels_from_xyz = np.asarray(channels_from_xyz, np.float64)
    light = sets.observer() @ channels_from_xyz.T
    return Channels(light, _averages(light * _daylight()), np.linalg.inv(channels_from_xyz))


def photographed(
    channels: Channels,
    bands,
    *,
    light: bool,
    surface: bool,
    lights: Spectra,
    surfaces: Spectra,
) -> Channels:
    """The same channels from a camera in place of full spectra, for light, surfaces or both.

    A surface is its signals over those of a white beside it, both lit by D65. The matrices M_S and
    M_R from the signals to the channels are fitted together to the least sum of squared
    CIEDE2000 of the rendered colours, starting from the best linear estimates of the channels.

    bands             (36, B) sensitivities of the camera's bands
    light, surface    whether it is photographed
    lights, surfaces  to fit to; white is added
    """
    surfaces, root_weights = _with_white(surfaces)
    bands = np.asarray(bands, np.float64)
    surface_bands = _averages(bands * _daylight())
    seen = np.einsum("wl,ws->lsw", lights.values, surfaces.values) * root_weights[:, None]
    weighted = surfaces.values.T * root_weights[:, None]
    M_S = best_linear(seen, bands, channels.light) if light else None
    M_R = best_linear(weighted, surface_bands, channels.surface) if surface else None
    fit = _Fit(channels, bands, surface_bands, lights, surfaces, root_weights)
    return fit.through(*fit.solved(M_S, M_R))


def best_linear(spectra, bands, curves) -> NDArray[np.float64]:
    """The matrix (C, B) from bands to curves of least squared error over spectra (..., 36)."""
    flat = np.asarray(spectra, np.float64).reshape(-1, len(bands))
    return np.linalg.lstsq(flat @ bands, flat @ curves, rcond=None)[0].T


@dataclass(frozen=True)
class _Fit:
    """The fit of the matrices M_S and M_R; None for one: that side is known as full spectra.

    channels       in which light and surface meet
    light_bands    (36, B) what a camera sees of light
    surface_bands  (36, B) what it sees of a surface beside a white, each summing to 1
    root_weights   (S,) of the surfaces
    """

    channels: Channels
    light_bands: NDArray[np.float64]
    surface_bands: NDArray[np.float64]
    lights: Spectra
    surfaces: Spectra
    root_weights: NDArray[np.float64]

    def through(self, M_S, M_R) -> Channels:
        """The channels as these matrices make them of the bands."""
        changed = self.channels
        if M_S is not None:
            changed = replace(changed, light=self.light_bands @ M_S.T)
        if M_R is not None:
            changed = replace(changed, surface=self.surface_bands @ M_R.T)
        return changed

    def solved(self, M_S, M_R):
        """The matrices with the least sum of squared CIEDE2000, started from these."""
        from scipy.optimize import least_squares  # .8 s

        target = true_lab(self.lights, self.surfaces)
        given = [m for m in (M_S, M_R) if m is not None]

        def split(x):
            first = 0 if M_S is None else M_S.size
            return (
                None if M_S is None else x[:first].reshape(M_S.shape),
                None if M_R is None else x[first:].reshape(M_R.shape),
            )

        def parts(x):
            found = self._parts(target, self.through(*split(x)).xyz(self.lights, self.surfaces))
            return (found * self.root_weights[:, None]).ravel()

        found = least_squares(
            parts,
            np.concatenate([m.ravel() for m in given]),
            lambda x: self._jacobian(target, *split(x)),
            method="lm",
            x_scale=np.concatenate([np.full(m.size, np.abs(m).max()) for m in given]),
            ftol=1e-5,  # scale that M_S and M_R exchange changes nothing: it would creep there
        )
        return split(found.x)

    def _parts(self, target, xyz):
        return delta_e_2000_parts(target, adapted_lab(xyz, self.lights))

    def _jacobian(self, target, M_S, M_R):
        """Derivatives (L S 3, unknowns) of the weighted parts.

        XYZ is linear in each matrix, which is written out; from XYZ to the parts of the difference
        there are only three numbers, which are stepped.
        """
        channels = self.through(M_S, M_R)
        xyz = channels.xyz(self.lights, self.surfaces)
        here, step = self._parts(target, xyz), 1e-6
        stepped = [self._parts(target, xyz + step * axis) - here for axis in np.eye(3)]
        by_xyz = np.stack(stepped, axis=-1) * (self.root_weights[:, None, None] / step)
        by_channel = by_xyz @ channels.xyz_from_channels  # (L, S, 3, C)
        columns = []
        if M_S is not None:
            other = self.surfaces.values.T @ channels.surface
            signals = self.lights.values.T @ self.light_bands
            columns.append(np.einsum("lskc,sc,lb->lskcb", by_channel, other, signals))
        if M_R is not None:
            other = self.lights.values.T @ channels.light
            signals = self.surfaces.values.T @ self.surface_bands
            columns.append(np.einsum("lskc,lc,sb->lskcb", by_channel, other, signals))
        return np.concatenate([c.reshape(here.size, -1) for c in columns], axis=1)


def _daylight() -> NDArray[np.float64]:
    """D65 (36, 1): what surfaces are photographed and filtered under."""
    return sets.lights("darling2011")["D65"][:, None]


def _averages(curves) -> NDArray[np.float64]:
    return curves / curves.sum(axis=0)


def _with_white(surfaces: Spectra) -> tuple[Spectra, NDArray[np.float64]]:
    """The surfaces and white, and the roots of their weights."""
    values = np.concatenate([surfaces.values, np.ones((len(surfaces.wavelengths), 1))], axis=1)
    roots = np.append(np.ones(len(surfaces)), np.sqrt(max(1.0, WHITE_SHARE * len(surfaces))))
    return Spectra(surfaces.wavelengths, (*surfaces.names, "white"), values), roots
