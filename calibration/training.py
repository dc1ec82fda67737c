"""What M_S and M_R are fitted to: samples under several lights, photographed or computed.

Photographed, they are a chart's patches beside a spectroradiometer's readings; computed, surfaces
of all kinds in the light of rooms, as known curves of camera and filters see them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration import sets
from calibration.bands import sensitivities
from calibration.checks import check_lights, check_readings, problems_of_set
from calibration.errors import InputError, Problem
from calibration.optimise import WHITE_SHARE
from calibration.spectra import WAVELENGTHS, Spectra
from calibration.transform import LIGHT, QUANTITIES, REFLECTANCE

ROOM_LIGHTS = "room"
ROOM_SURFACES = "ces99+rawtoaces190"

# The lights of copy stands and booths, in which surfaces are photographed beside a white.
COPY_SET = "darling2011"
COPY_LIGHTS = ("D50", "A", "D65", "F40/C50 (Broadband FL)")

# Of a white's most; a spectroradiometer's reading below that is noise, and says nothing of what a
# patch reflects.
READABLE = 1e-3


@dataclass(frozen=True)
class TrainingSet:
    """The same n samples under each of L lights: what B bands saw, and the spectra it was of.

    channels   (B,) names of the bands, "<filter>.<R, G or B>"
    lights     (L,) names
    signals    (L, n, B) of the bands; NaN where not known
    spectra    (L, n, 36) on WAVELENGTHS: radiance, or for M_R reflectance factors
    variances  (L, n, B) of the signals; None: they were computed from known curves
    counts     (n,) how often a sample counts
    names      (n,) of a chart's patches; empty: the samples have none
    quantity   LIGHT, what M_S is fitted to; or REFLECTANCE, M_R: all over those of a white
    """

    channels: tuple[str, ...]
    lights: tuple[str, ...]
    signals: NDArray[np.float64]
    spectra: NDArray[np.float64]
    variances: NDArray[np.float64] | None
    counts: NDArray[np.float64]
    names: tuple[str, ...] = ()
    quantity: str = LIGHT

    def __post_init__(self) -> None:
        shape = len(self.lights), len(self.counts), len(self.channels)
        assert self.signals.shape == shape, (self.signals.shape, shape)
        assert self.spectra.shape == (*shape[:2], len(WAVELENGTHS)), self.spectra.shape
        assert self.quantity in QUANTITIES, self.quantity

    @property
    def photographed(self) -> bool:
        """Whether signals are readings, and radiances in W/(sr m2 nm), rather than computed."""
        return self.variances is not None

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which samples (L, n) are known in every band: only they are fitted to."""
        return np.asarray(np.isfinite(self.signals).all(axis=-1))

    @property
    def white(self) -> NDArray[np.int_]:
        """The sample (L,) that is brightest under each light, of those known."""
        return np.argmax(np.where(self.known, sets.xyz(self.spectra)[..., 1], -np.inf), axis=1)

    def whites(self) -> TrainingSet:
        """Each light's white alone: what was computed of a light, as its lamp sends it."""
        at = np.arange(len(self.lights)), self.white
        return replace(
            self,
            signals=self.signals[at][:, None],
            spectra=self.spectra[at][:, None],
            variances=None if self.variances is None else self.variances[at][:, None],
            counts=np.ones(1),
            names=(),
        )


def photographed(
    signals: Mapping[str, NDArray[np.floating]],
    variances: Mapping[str, NDArray[np.floating]],
    radiances: Mapping[str, Spectra],
    *,
    patches: Sequence[str],
    channels: Sequence[str],
    quantity: str = LIGHT,
) -> TrainingSet:
    """Photographs of a chart and spectroradiometer readings of it, under several lights.

    signals    light -> (n, B) mean signal of each patch in each band, NaN where it clipped
    variances  light -> (n, B) variance of these means
    radiances  light -> spectra named as the patches, W/(sr m2 nm)
    patches    (n,) names, in the order of the rows
    channels   (B,) names of the bands
    quantity   LIGHT; or REFLECTANCE: all over the brightest patch's, which counts as WHITE_SHARE
               of all. Where a light's white reads less than READABLE of its most, what the patches
               reflect is the mean of what other lights show
    raises     InputError if lights or patches do not match or readings cannot be of them; for
               REFLECTANCE also where a white clips, or no light reaches some wavelength
    """
    assert quantity in QUANTITIES, quantity
    check_lights(signals, radiances, patches)
    spectra = {light: radiances[light].resampled().only(patches).values.T for light in signals}
    check_readings(signals, spectra, patches)
    chart = TrainingSet(
        channels=tuple(channels),
        lights=tuple(signals),
        signals=_stacked(signals.values()),
        spectra=_stacked(spectra.values()),
        variances=_stacked(variances[light] for light in signals),
        counts=np.ones(len(patches)),
        names=tuple(patches),
    )
    return chart if quantity == LIGHT else _over_white(chart)


def _stacked(parts) -> NDArray[np.float64]:
    return np.stack([np.asarray(part, np.float64) for part in parts])


def _over_white(chart: TrainingSet) -> TrainingSet:
    """All over each light's brightest patch; raises InputError of whites that cannot be one.

    The white counts as WHITE_SHARE of all, so that white comes out white.
    """
    white = np.argmax(sets.xyz(chart.spectra)[..., 1], axis=1)
    at = np.arange(len(chart.lights)), white
    signals, spectra = chart.signals[at][:, None], chart.spectra[at][:, None]
    problems = [
        Problem(
            f"light {light!r}: the white, patch {chart.names[i]}, is not known everywhere",
            "a white that does not clip through any filter",
            "add shorter exposures, or leave this light out",
        )
        for light, i, seen in zip(chart.lights, white, signals, strict=True)
        if not np.all(seen > 0.0)
    ]
    readable = spectra >= READABLE * spectra.max(axis=-1, keepdims=True)
    problems += [
        Problem(
            f"no light shows what the patches reflect at {wavelength:.0f} nm",
            f"one whose white reads {READABLE:.1%} of its most there",
            "add a light that reaches there, such as an incandescent one or daylight",
        )
        for wavelength in WAVELENGTHS[~readable.any(axis=(0, 1))][:1]
    ]
    if problems:
        raise InputError(problems)
    assert chart.variances is not None
    # What a patch reflects is its own: where one light has nothing to read it by, others have.
    factors = chart.spectra / np.where(readable, spectra, 1.0)
    shown = np.mean(factors, axis=0, where=np.broadcast_to(readable, factors.shape))
    counts = chart.counts.copy()
    counts[white] = max(1.0, WHITE_SHARE * len(counts))
    return replace(
        chart,
        signals=chart.signals / signals,
        spectra=np.where(readable, factors, shown),
        variances=chart.variances / signals**2,
        counts=counts,
        quantity=REFLECTANCE,
    )


def computed(
    camera: Spectra,
    filters: Spectra,
    *,
    filter_names: Sequence[str] | None = None,
    lights: Spectra | None = None,
    surfaces: Spectra | None = None,
    quantity: str = LIGHT,
) -> TrainingSet:
    """What a camera of known curves would see of lights on all kinds of surfaces.

    Curves are relative, so these signals and radiances are. Light is taken as it comes back from
    walls, not only as lamps send it, since most of a room is walls.

    camera        spectral sensitivities R, G, B
    filters       transmittance, named as the capture's filters
    filter_names  the capture's filters, in its order; default: all, in the file's
    lights        default ROOM_LIGHTS; for REFLECTANCE COPY_LIGHTS
    surfaces      reflectance factors; default ROOM_SURFACES. White is added, last
    quantity      LIGHT; or REFLECTANCE: signals over those of a perfect white in the same light
    raises        InputError if the curves leave no bands, or of all that is wrong with lights and
                  surfaces given
    """
    assert quantity in QUANTITIES, quantity
    channels, bands = sensitivities(camera, filters, filter_names)
    if lights is None and quantity == REFLECTANCE:
        lights = sets.lights(COPY_SET).only(COPY_LIGHTS)
    lights, surfaces = checked(lights, surfaces)
    rows, counts = with_white(surfaces)
    lamps = lights.values.T[:, None]
    spectra = lamps * rows
    signals = spectra @ bands
    if quantity == REFLECTANCE:
        signals = signals / (lamps @ bands)
        spectra = np.broadcast_to(rows, spectra.shape)
    return TrainingSet(channels, lights.names, signals, spectra, None, counts, quantity=quantity)


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
