"""One scale for all brackets of a camera: what its shutter's tags stand for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stages.types import Lights, Radiance

NOTHING = 1e-6  # squared log light by which brackets stray from any tags, ratios being uncertain
WORTH_A_WARNING = 0.01  # of one filter's scale against another's


@dataclass(frozen=True)
class Scale:
    """How brackets come to one scale.

    to_the_letter  whether times are what the tags say, not the series these are rounded from
    factors        by what each bracket's mosaic is to be multiplied, see `scaled`
    doubt          by what share the brackets' scales would differ, were that judged wrongly; 0
                   where the ratios tell it clearly
    """

    to_the_letter: bool
    factors: tuple[float, ...]
    doubt: float


def scale(brackets: Sequence[Lights]) -> Scale:
    """The scale of a camera's brackets, decided once by the evidence of all of them.

    An electronic shutter keeps to its tags: 1/60 is 1/60. A mechanical one runs in powers of two,
    and 1/60 stands for 1/64. A bracket of 1/60 and 1/15 fits both, and is 7 % brighter in the one
    case; one that has 1/125 too shows which it is.
    """
    from_series, series = _strays([b.series for b in brackets], brackets)
    from_tags, tags = _strays([b.tagged for b in brackets], brackets)
    to_the_letter = keeps_to_tags(series, tags)
    offsets = from_tags if to_the_letter else from_series
    told = to_the_letter or series + NOTHING < tags / 2
    apart = np.ptp(np.subtract(from_tags, from_series))
    return Scale(
        to_the_letter,
        factors=tuple(float(f) for f in np.exp(offsets)),
        doubt=0.0 if told else float(np.expm1(apart)),
    )


def keeps_to_tags(strays_from_series: float, strays_from_tags: float) -> bool:
    """Whether a shutter's times are its tags to the letter: where they fit clearly better.

    Both are sums of squared differences in log light.
    """
    return strays_from_tags + NOTHING < strays_from_series / 2


def _strays(nominal, brackets: Sequence[Lights]) -> tuple[list[float], float]:
    """Mean log of solved over nominal light of each bracket, and what is left, squared, of all."""
    offsets, left = [], 0.0
    for light, bracket in zip(nominal, brackets, strict=True):
        counted = np.equal(bracket.alike, np.arange(len(bracket.alike)))
        off = np.log(np.divide(bracket.solved, light))[counted]
        offsets.append(float(off.mean()))
        left += float(np.sum((off - off.mean()) ** 2))
    return offsets, left


def scaled(radiance: Radiance, factor: float) -> Radiance:
    """A merged bracket with its mosaic multiplied, as if all its exposures had been shorter."""
    if factor == 1:
        return radiance
    return replace(
        radiance,
        mosaic=radiance.mosaic * np.float32(factor),
        variance=radiance.variance * np.float32(factor**2),
        at_least=radiance.at_least * factor,
        solved=tuple(light / factor for light in radiance.solved),
    )


def warnings(
    scale: Scale,
    names: Sequence[str],
    remedy: str = "use the same shutter times for every filter",
) -> list[str]:
    """What the photographer should know, a sentence each.

    names   of the brackets, in order: their filters, or what else they are of
    remedy  what to do another time
    """
    if scale.doubt < WORTH_A_WARNING:
        return []
    said = " and ".join(names) if len(names) < 4 else f"{names[0]} and the {len(names) - 1} others"
    return [
        f"the shutter's true times cannot be told from these brackets: {said} may"
        f" differ in scale by {scale.doubt:.1%}; {remedy}"
    ]
