"""Which ways to face to stand in one of two lights rather than the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages import cube

_STEP_DEG = 5
_TILT_DEG = 20.0  # up: what a viewer a little above sees of things faces him, and him is up
_DIM = 0.1  # of the brightest side: darker ones are nobody's choice
_NEARLY = 0.01  # of a light's share: sides that differ by less are as good


@dataclass(frozen=True)
class Side:
    """What falls on a surface that faces one way.

    azimuth_deg  from +Z towards +X
    irradiance   (P,) in the primaries, over pi: what a white surface there returns
    amounts      (2,) of the two lights, whose sum is nearest to it
    """

    azimuth_deg: float
    irradiance: NDArray[np.float64]
    amounts: NDArray[np.float64]

    @property
    def share(self) -> float:
        """Of the first light in the two together, by their amounts."""
        return float(self.amounts[0] / self.amounts.sum())


def facing(irradiance, lights, luminance) -> tuple[Side, Side]:
    """The side with most of the first of two lights, and that with most of the second.

    Of sides that are nearly as good, the one with the least light behind it for what it has in
    front: a picture taken there is not taken against the light.

    irradiance  (6, n, n, P) over pi, as `prefilter.irradiance` gives it
    lights      (2, P) in the same primaries, each with a luminance of 1
    luminance   (P,) weights of Y
    """
    from scipy.optimize import nnls

    sides: list[tuple[Side, float]] = []
    tilt = np.radians(_TILT_DEG)
    for azimuth in range(0, 360, _STEP_DEG):
        a = np.radians(azimuth)
        across, up = np.cos(tilt), np.sin(tilt)
        direction = np.array([across * np.sin(a), up, across * np.cos(a)])
        light = np.asarray(cube.sample(irradiance, direction), np.float64)
        amounts = nnls(np.asarray(lights, np.float64).T, light)[0]
        if amounts.sum() > 0.0:
            against = cube.sample(irradiance, direction * [-1.0, 1.0, -1.0]) @ luminance
            side = Side(float(azimuth), light, amounts)
            sides.append((side, float(against / (light @ luminance))))
    brightest = max((s.irradiance @ luminance for s, _ in sides), default=0.0)
    lit = [(s, a) for s, a in sides if s.irradiance @ luminance >= _DIM * brightest]
    assert lit, "a map without light"

    def best(share) -> Side:
        most = max(share(side) for side, _ in lit)
        good = [(a, k) for k, (s, a) in enumerate(lit) if share(s) >= most - _NEARLY]
        return lit[min(good)[1]][0]

    return best(lambda side: side.share), best(lambda side: 1.0 - side.share)
