"""Dark frames: the signal that pixels gather without light, and a merged bracket without it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stages.bracket import Bracket
from stages.types import Float, Frame, Radiance

HOT_SIGMAS = 5.0  # by which a pixel stands out of those about it, to be believed by itself
AROUND = 7  # cells of the CFA whose mean the others get: the glow of an amplifier is wider
FULL = 0.95  # of full scale: a pixel that dark alone fills so far tells nothing
BAND = 64  # rows at a time


@dataclass(frozen=True)
class Dark:
    """Dark current of each pixel.

    current   (H, W) full scale per second at ISO 100; NaN where dark alone saturates
    variance  (H, W) of the current
    """

    current: Float
    variance: Float


@dataclass(frozen=True)
class _Seen:
    """Of a dark frame: its height, levels (2, 2), and time_s * ISO / 100."""

    height: int
    black: NDArray[np.float64]
    full: NDArray[np.float64]
    gain_s: float

    @classmethod
    def of(cls, frame: Frame) -> _Seen:
        full = frame.saturation_level - frame.black_level
        return cls(len(frame.samples), frame.black_level, full, frame.time_s * frame.iso / 100)


def dark_current(frames: Bracket, gain: float) -> Dark:
    """Dark current from photographs with the cap on; any times and sensitivities.

    gain  of photon noise at ISO 100, see `stages.noise`

    A line through black is laid through each pixel's samples s by least squares,
    sum(g s) / sum(g^2) with g = time ISO / 100, which weighs long frames most. Most pixels' own
    current is less than the noise of that: subtracted, it would only add noise. So a pixel gets its
    own current where it stands out of its neighbours of the same CFA position, and else their
    mean, which follows the glow of an amplifier. Current doubles with every 6 K or so: dark frames
    belong to the temperature of the photographs.
    """
    with frames.decoded(_Seen.of) as decoded:
        seen = decoded.seen
        gains = np.array([one.gain_s for one in seen], np.float32)
        longest = int(np.argmax(gains))
        parts, filled = [], []
        for top in range(0, seen[0].height, BAND):
            rows = decoded.rows(top, min(top + BAND, seen[0].height))
            total = np.zeros(rows.shape[1:], np.float32)
            for samples, one in zip(rows, seen, strict=True):
                signal = _signal(samples, one)
                total += one.gain_s * signal
                if one is seen[longest]:
                    filled.append(signal > FULL)
            parts.append(total / np.sum(gains**2))
    measured, saturated = np.concatenate(parts), np.concatenate(filled)
    photons = gain * float(np.sum(gains**3) / np.sum(gains**2) ** 2)  # variance a unit of current
    current, variance = np.empty_like(measured), np.empty_like(measured)
    for y, x in np.ndindex(2, 2):
        own = np.ascontiguousarray(measured[y::2, x::2])
        current[y::2, x::2], variance[y::2, x::2] = _believed(own, photons)
    current[saturated] = np.nan
    return Dark(current, variance)


def _signal(samples, seen: _Seen) -> Float:
    """Full scale above black of rows that begin at an even one."""
    signal = samples.astype(np.float32)
    for y, x in np.ndindex(2, 2):
        plane = signal[y::2, x::2]
        plane -= np.float32(seen.black[y, x])
        plane /= np.float32(seen.full[y, x])
    return signal


def _believed(own: Float, photons: float) -> tuple[Float, Float]:
    """Current and variance (h, w) of the pixels of one CFA position."""
    import cv2

    middle = cv2.medianBlur(own, 5)
    sigma = 1.4826 * float(np.median(np.abs(own - middle)))
    level = np.clip(own, middle - 3 * sigma, middle + 3 * sigma)  # hot ones do not lift the others
    size = (min(AROUND, own.shape[1]), min(AROUND, own.shape[0]))
    around = cv2.blur(level, size, borderType=cv2.BORDER_REFLECT)
    hot = np.abs(own - around) > HOT_SIGMAS * sigma
    share = 1 / (size[0] * size[1])
    variance = np.where(hot, sigma**2 + photons * np.maximum(own, 0), sigma**2 * share)
    return np.where(hot, own, around), variance


def subtract(radiance: Radiance, dark: Dark, f_number: float) -> Radiance:
    """A merged bracket without its dark current.

    f_number  of the bracket

    Current grows with time and gain as the mosaic's unit, light = time ISO/100 / f_number^2, does:
    whatever exposures a pixel was merged of, its part is current * f_number^2. Photons of dark
    current are noise, and stay in the variance. Pixels that dark alone saturates are defective.
    """
    assert dark.current.shape == radiance.mosaic.shape, "dark frames of another size"
    unit = np.float32(f_number**2)
    dead = np.isnan(dark.current) & radiance.valid
    mosaic = radiance.mosaic - unit * dark.current
    variance = radiance.variance + unit**2 * dark.variance
    mosaic[dead] = variance[dead] = np.nan
    return replace(
        radiance.with_defects(dead),
        mosaic=mosaic,
        variance=variance,
    )
