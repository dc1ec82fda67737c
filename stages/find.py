"""Find about where the sphere is, before anything is merged: only there is it worth merging.

One photograph of the bracket is enough, binned until few pixels are left, and `locate`'s own search
in that. What it finds must be clear beyond doubt: a region that misses the sphere spoils all that
follows, one that is larger than it need be costs a little time. Where no photograph is clear
the region is the whole photograph, and `locate` decides on the merged one.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from stages.locate import Rim, search_rims, sphere_maker
from stages.mirror import Array, rim_from_circle
from stages.noise import typical
from stages.region import Region
from stages.types import Frame, Measured

# What follows needs of the picture beside the sphere: `align` a fifth of the radius and its reach
# of 16 px, `measure_rim` 12 px, `merge` some plain parts to tell the noise by. The rest is for
# the rough place.
MARGIN = 0.25  # of the rim's radius ...
MARGIN_PX = 24.0  # ... and so many pixels

# How far the photograph is binned, px a side at the most, and how many circles are fitted there:
# roughly first, as a sphere that fills its usual share of the frame needs no more.
_LOOKS = ((180, 4), (360, 12))
# Share of a rim that agrees, beyond the .4 of its votes that agree in clutter: what alone makes it
# clear, and what does where two looks have it in common. On 80 spheres behind hands and stands,
# before busy walls, in three exposures each, the first that was wrong had .25, the next .19.
_CLUTTER, _CLEAR, _LIKELY = 0.4, 0.27, 0.2
_RIVAL = 0.6  # of the best rim's merit: what another one, elsewhere, must stay under
_SAME = 0.05  # of the radius: rims that lie no further apart are one


@dataclass(frozen=True)
class Found:
    """Where the sphere is, roughly.

    region  of the photograph: sphere and margin
    rim     x, y, radius in px of the photograph; None: not found, and the region is all of it
    tried   photographs looked at
    """

    region: Region
    rim: tuple[float, float, float] | None
    tried: int


def find(
    frames: Iterable[Frame],
    *,
    frame_size: tuple[int, int],
    radius_mm: float,
    distance_mm: float | None = None,
    focal_px: float | None = None,
    outline: Sequence[float] | None = None,
    distortion: Sequence[float] = (0.0, 0.0, 0.0),
) -> Found:
    """The part of the photographs that holds the sphere, with all that later steps want about it.

    frames      photographs of one view, the likeliest to show the sphere well first; taken one by
                one until one is clear, and none is kept
    frame_size  height, width of each
    radius_mm, distance_mm, focal_px, outline, distortion  as `locate` has them
    """
    whole = Region.whole(frame_size)
    sphere_at = sphere_maker(
        whole,
        radius_mm=radius_mm,
        distance_mm=distance_mm,
        focal_px=focal_px,
        distortion=distortion,
    )

    def found(rim, tried: int) -> Found:
        x, y, radius = (float(v) for v in rim)
        ends = sphere_at(x, y, radius).outline()
        margin = MARGIN * radius + MARGIN_PX
        region = Region.around(ends.min(axis=0) - margin, ends.max(axis=0) + margin, frame_size)
        return Found(region, (x, y, radius), tried)

    if outline is not None:
        x, y, radius = outline
        return found(rim_from_circle(x, y, radius, sphere_at), 0)
    tried = 0
    likely: list[Array] = []
    for tried, frame in enumerate(frames, 1):
        assert frame.samples.shape == frame_size, "photographs of different sizes"
        for longest, candidates in _LOOKS:
            factor = 2 * max(1, -(-max(frame_size) // (2 * longest)))
            rims = search_rims(_binned(frame, factor), sphere_at, 1.0 / factor, candidates)
            seen = _seen(rims)
            if seen < _LIKELY:
                continue
            rim = factor * rims[0].rim
            if seen > _CLEAR or any(_apart(rim, other) < _SAME for other in likely):
                return found(rim, tried)
            likely.append(rim)
    return Found(whole, None, tried)


def _seen(rims: Sequence[Rim]) -> float:
    """How well the first rim is seen; 0 where another one, elsewhere, is nearly as likely."""
    if not rims:
        return 0.0
    best, *others = rims
    rival = max((r.merit for r in others if _apart(r.rim, best.rim) > 2 * _SAME), default=0.0)
    return best.found - _CLUTTER * best.voting if rival < _RIVAL * best.merit else 0.0


def _apart(one: Array, other: Array) -> float:
    """The most by which x, y or size of two rims differ, as a share of the radius."""
    return float(np.abs(one - other).max() / one[2])


def _binned(frame: Frame, factor: int) -> Measured:
    """Means of factor x factor px, even, of all colours together: (h, w, 1).

    What saturates counts as it is: as the lamp that it is.
    """
    height, width = (n // factor for n in frame.samples.shape)
    cells = frame.samples[: height * factor, : width * factor]
    # Rows first, whose sums the processor adds up side by side.
    rows = cells.reshape(height, factor, -1).sum(axis=1, dtype=np.uint32)
    means = rows.reshape(height, width, factor).sum(axis=2) / np.float32(factor**2)
    black = np.float32(frame.black_level.mean())
    full = np.float32(frame.saturation_level.mean()) - black
    light = ((means - black) / full).astype(np.float32)
    gain, read = typical(float(full))
    variance = np.float32(gain / factor**2) * np.maximum(light, 0) + np.float32(
        (read / factor) ** 2
    )
    return Measured(light[..., None], variance[..., None], np.ones(light.shape, np.float32))
