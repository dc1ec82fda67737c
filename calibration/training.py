"""What fits from known curves are made from: the light of rooms, and surfaces of all kinds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibration import sets
from calibration.checks import problems_of_set
from calibration.errors import InputError
from calibration.optimise import WHITE_SHARE
from calibration.spectra import WAVELENGTHS, Spectra

ROOM_LIGHTS = "room"
ROOM_SURFACES = "ces99+rawtoaces190"

# The lights of copy stands and booths, in which surfaces are photographed beside a white.
COPY_SET = "darling2011"
COPY_LIGHTS = ("D50", "A", "D65", "F40/C50 (Broadband FL)")


def checked(lights: Spectra | None, surfaces: Spectra | None) -> tuple[Spectra, Spectra]:
    """Lights, Y = 1 on white, and surfaces: those given, or the room's.

    raises  InputError of all that is wrong with those given
    """
    problems = [] if lights is None else problems_of_set(lights, "light")
    problems += [] if surfaces is None else problems_of_set(surfaces, "surface")
    if problems:
        raise InputError(problems)
    lights = sets.lights(ROOM_LIGHTS) if lights is None else lights.resampled()
    surfaces = sets.surfaces(ROOM_SURFACES) if surfaces is None else surfaces.resampled()
    scaled = sets.scaled_to_unit_luminance(lights.values)
    return Spectra(WAVELENGTHS, lights.names, scaled), surfaces


def copy_lights() -> Spectra:
    """The lights in which surfaces are photographed."""
    return sets.lights(COPY_SET).only(COPY_LIGHTS)


def with_white(surfaces: Spectra) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The surfaces and white (n, 36), and how much each counts (n,).

    White counts as WHITE_SHARE of the others, which keeps white neutral.
    """
    rows = np.concatenate([surfaces.values.T, np.ones((1, len(WAVELENGTHS)))])
    return rows, np.append(np.ones(len(surfaces)), max(1.0, WHITE_SHARE * len(surfaces)))


def lit(lights, reflectances) -> NDArray[np.float64]:
    """Radiance (L S, 36) of all surfaces (S, 36) under the first light, the second ... (L, 36)."""
    products: NDArray[np.float64] = lights[:, None] * reflectances
    return products.reshape(-1, products.shape[-1])
