"""Rooms of real surfaces under real lights, as spectra: the light that meets in one point.

A room is walls and things, each of one measured surface, under a window's daylight and one or two
lamps, each of which shines on what it faces and is itself seen. All lights are kept apart, so that
one can be changed: dimmed, moved, switched.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calibration import sets
from stages import cube

SIZE = 32
DIRECTIONS = cube.directions(SIZE)


@dataclass(frozen=True)
class Light:
    """spectrum (36,), mean 1; where it is (3,); radius in radians; brightness over its walls'."""

    spectrum: np.ndarray
    place: np.ndarray
    radius: float
    brightness: float
    strength: float = 1.0


@dataclass(frozen=True)
class Room:
    """reflectance (6, N, N, 36) of what is seen in each direction; its lights."""

    reflectance: np.ndarray
    lights: tuple[Light, ...]

    def radiance(self) -> np.ndarray:
        """Spectral radiance (6, N, N, 36)."""
        total = np.zeros(self.reflectance.shape)
        bounced = self.reflectance.reshape(-1, 36).mean(axis=0)  # the colour of light off the walls
        for light in self.lights:
            cosine = DIRECTIONS @ light.place
            # A lamp lights best what is near it; the rest gets what comes back from everything.
            lit = 0.05 + np.exp(-2.0 * (1.0 - cosine))
            on = (lit[..., None] + 0.3 * bounced) * light.spectrum * self.reflectance
            # Its rim crosses texels: the share of one that it fills.
            edge = (light.radius - np.arccos(np.clip(cosine, -1, 1))) / (np.pi / 2 / SIZE)
            filled = np.clip(edge + 0.5, 0.0, 1.0)[..., None]
            total += light.strength * (
                on * (1 - filled) + filled * light.brightness * light.spectrum
            )
        return total

    def with_light(self, index: int, **changes) -> Room:
        lights = list(self.lights)
        lights[index] = replace(lights[index], **changes)
        return replace(self, lights=tuple(lights))


def furnished(seed: int) -> Room:
    """A room with a window (light 0) and one or two lamps, of everything at random."""
    rng = np.random.default_rng(seed)
    surfaces = sets.surfaces("colorchecker24+cri14+cqs15").values.T
    panels = rng.normal(size=(80, 3))
    panels /= np.linalg.norm(panels, axis=1, keepdims=True)
    walls = surfaces[np.argsort(np.ptp(surfaces, axis=1))[:20]]  # walls are rarely colourful
    kinds = np.concatenate(
        [walls[rng.integers(20, size=40)], surfaces[rng.integers(len(surfaces), size=40)]]
    )
    nearest = (DIRECTIONS @ panels.T).argmax(axis=-1)
    shade = rng.uniform(0.7, 1.3, len(panels))[nearest][..., None]

    def place():
        d = rng.normal(size=3) * (1, 0.5, 1)
        return d / np.linalg.norm(d)

    daylight = sets.lights("daylight").values.T
    lamps = sets.lights("leds8+places5").values.T
    window = Light(
        _unit(daylight[rng.integers(len(daylight))]), place(), rng.uniform(0.2, 0.5), 10.0
    )
    lights = [window]
    for _ in range(rng.integers(1, 3)):
        spectrum = _unit(lamps[rng.integers(len(lamps))])
        strength = rng.uniform(0.2, 1.0)
        lights.append(Light(spectrum, place(), rng.uniform(0.03, 0.1), 100.0, strength))
    return Room(kinds[nearest] * shade, tuple(lights))


def _unit(spectrum):
    return spectrum / spectrum.mean()
