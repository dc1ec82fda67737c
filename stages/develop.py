"""Raw samples to a linear photograph."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.types import Exposure, Frame

# All four in units of full scale (saturation level - black level) or shares of the samples.
MARGIN = 0.01  # below saturation where sensors stop being linear, and where noise reaches it
BAND = 0.005  # wider than a clipped sensor's own spread, narrower than photon noise near full
# scale (0.4 % for a large full well of 60 000 electrons): only what is clipped ends so abruptly
LOWEST_PILE_UP = 0.7  # no camera we know clips further below its tag; a still of a Canon's video
# mode may end at 0.78
STRAY = 1e-5  # share of samples of a colour that may lie above a pile-up


def develop(frame: Frame) -> Exposure:
    """One raw file as a linear photograph: black taken off, full scale 1, saturation marked.

    The scale comes from the tagged levels alone, so that it is the same in every exposure of a
    camera. What saturated is judged by the data where they show it, see `_saturated_from`: tags
    tend to lie a little too high, and a clipped sample taken for a good one is what turns
    highlights magenta. A saturated sample says nothing of its neighbours of other colours, which
    stay usable: a value that did not clip is right whatever clipped beside it, and `merge` takes
    the clipped one from a shorter exposure. Where no exposure has it `demosaic` gives no pixel.
    """
    cfa, samples = frame.cfa, frame.samples
    limit = _saturated_from(frame)
    mosaic = np.empty(samples.shape, np.float32)
    usable = np.empty(samples.shape, np.bool_)
    for y in range(2):
        for x in range(2):
            plane = samples[y::2, x::2]
            black, saturation = frame.black_level[y, x], frame.saturation_level[y, x]
            mosaic[y::2, x::2] = (plane - np.float32(black)) * np.float32(1 / (saturation - black))
            usable[y::2, x::2] = plane < limit[y, x]
    return Exposure(
        mosaic=mosaic,
        usable=usable,
        cfa=cfa,
        light=frame.light,
        time_s=frame.time_s,
        levels=float(np.mean(frame.saturation_level - frame.black_level)),
    )


def _saturated_from(frame: Frame) -> NDArray[np.float64]:
    """Raw value (2, 2) per CFA position from which on samples do not count.

    Per colour, since analogue gains differ: the lower edge of the pile-up where there is one
    that lies below the tagged level, otherwise the tagged level; less a margin.
    """
    limit = np.empty((2, 2))
    for colour in np.unique(frame.cfa):
        sites = np.argwhere(frame.cfa == colour)
        counts = np.sum([_histogram(frame.samples[y::2, x::2]) for y, x in sites], axis=0)
        for y, x in sites:
            black, saturation = frame.black_level[y, x], frame.saturation_level[y, x]
            edge = min(saturation, _pile_up(counts, black, saturation))
            limit[y, x] = edge - MARGIN * (saturation - black)
    return limit


def _histogram(plane: NDArray[np.uint16]) -> NDArray[np.int_]:
    return np.bincount(plane.ravel(), minlength=1 << 16)


def _pile_up(counts: NDArray[np.int_], black: float, saturation: float) -> float:
    """Lower edge of the heap of clipped samples at a histogram's top end; inf where there is none.

    Light that does not clip thins out towards its brightest sample, over a width that photon noise
    alone makes wider than BAND. Clipped light ends at its densest. So it is a pile-up when
    the topmost band holds several times more samples than the band below it.
    (A noise-free picture of one bright tone, which no sensor makes, looks the same.)
    """
    band = BAND * (saturation - black)
    above = np.cumsum(counts[::-1])[::-1]  # samples at this value or higher
    top = int(np.flatnonzero(above > STRAY * above[0])[-1])
    if top < black + LOWEST_PILE_UP * (saturation - black):
        return np.inf
    edge = top - band
    in_band = above[int(np.ceil(edge))]
    in_next = above[int(np.ceil(edge - band))] - in_band
    return edge if in_band >= 32 and in_band > 4 * in_next else np.inf
