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
COUNTED = 1 << 20  # samples of a CFA position that a histogram is made of, at least


def develop(frame: Frame, limit: NDArray[np.float64] | None = None) -> Exposure:
    """One raw file as a linear photograph: black taken off, full scale 1, saturation marked.

    The scale comes from the tagged levels alone, so that it is the same in every exposure of a
    camera. What saturated is judged by the data where they show it, see `pile_up`: tags
    tend to lie a little too high, and a clipped sample taken for a good one is what turns
    highlights magenta. A saturated sample says nothing of its neighbours of other colours, which
    stay usable: a value that did not clip is right whatever clipped beside it, and `merge` takes
    the clipped one from a shorter exposure. Where no exposure has it `demosaic` gives no pixel.

    limit  (2, 2) raw value per CFA position from which on samples do not count; None: from the
           frame itself
    """
    cfa, samples = frame.cfa, frame.samples
    if limit is None:
        limit = usable_below(frame, [pile_up(frame)])
    mosaic = np.empty(samples.shape, np.float32)
    usable = np.empty(samples.shape, np.bool_)
    for y, x in np.ndindex(2, 2):
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


def usable_below(frame: Frame, edges, override: float | None = None) -> NDArray[np.float64]:
    """Raw value (2, 2) per CFA position from which on samples do not count.

    frame     for its tagged levels
    edges     (K, 2, 2) where samples of photographs with the same camera and ISO pile up
    override  raw saturation level to be believed instead

    The sensor is one, so the photographs that show where it fills up say so for the others: the
    median of them, where it lies below the tagged level; less a margin.
    """
    full = frame.saturation_level - frame.black_level
    if override is not None:
        return override - MARGIN * full
    edges = np.asarray(edges, np.float64)
    found = np.array(frame.saturation_level, np.float64)
    for at in np.ndindex(2, 2):
        shown = edges[:, *at][np.isfinite(edges[:, *at])]
        if shown.size:
            found[at] = min(found[at], np.median(shown))
    return found - MARGIN * full


def pile_up(frame: Frame) -> NDArray[np.float64]:
    """Raw value (2, 2) per CFA position where clipped samples pile up; inf where none do.

    Per colour, since analogue gains differ. Large frames are judged by some of their rows.
    """
    from stages.histogram import count_from

    edges = np.empty((2, 2))
    samples = np.ascontiguousarray(frame.samples)
    step = max(1, samples.size // 4 // COUNTED)
    for colour in np.unique(frame.cfa):
        sites = np.argwhere(frame.cfa == colour)
        black = max(frame.black_level[y, x] for y, x in sites)
        saturation = max(frame.saturation_level[y, x] for y, x in sites)
        floor = int(black + (LOWEST_PILE_UP - 2 * BAND) * (saturation - black))
        counts = np.zeros(2**16 - floor, np.int64)
        total = sum(count_from(floor, samples, y, 2 * step, x, counts) for y, x in sites)
        edges[frame.cfa == colour] = floor + _heap(counts, total, saturation - black)
    return edges


def _heap(counts: NDArray[np.int_], total: int, full: float) -> float:
    """Lower edge of the heap of clipped samples at a histogram's top end; inf where there is none.

    counts  of the upper end of the range, from LOWEST_PILE_UP less two bands on
    total   samples, those below included
    full    raw steps of full scale

    Light that does not clip thins out towards its brightest sample, over a width that photon noise
    alone makes wider than BAND. Clipped light ends at its densest. So it is a pile-up when
    the topmost band holds several times more samples than the band below it.
    (A noise-free picture of one bright tone, which no sensor makes, looks the same.)
    """
    band = BAND * full
    above = np.cumsum(counts[::-1])[::-1]  # samples at this value or higher
    many = np.flatnonzero(above > STRAY * total)
    top = int(many[-1]) if many.size else 0
    if top < 2 * band:
        return np.inf
    edge = top - band
    in_band = above[int(np.ceil(edge))]
    in_next = above[int(np.ceil(edge - band))] - in_band
    return edge if in_band >= 32 and in_band > 4 * in_next else np.inf
