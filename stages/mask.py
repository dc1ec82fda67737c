"""Parts of the photographs that are left out: the stand, the camera, whoever took them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stages.region import Region
from stages.types import Measured

Point = tuple[float, float]


@dataclass(frozen=True)
class Mask:
    """What is left out, in px of the whole photograph.

    polygons  corners x, y of each; a pixel is left out where its middle lies inside of one, by the
              even-odd rule where its sides cross
    runs      of the photograph's pixels in a row, row after row, those at which what is left out
              begins and ends in turn, ascending: a painted mask
    """

    polygons: Sequence[Sequence[Point]] = ()
    runs: Sequence[int] = ()

    @classmethod
    def painted(cls, left_out: NDArray[np.bool_]) -> Mask:
        """A mask (H, W) as runs."""
        flat = np.concatenate([[False], left_out.ravel(), [False]])
        return cls(runs=tuple(np.flatnonzero(flat[1:] != flat[:-1]).tolist()))

    def of(self, region: Region) -> NDArray[np.bool_]:
        """Which pixels (h, w) of a part of the photograph are left out."""
        height, width = region.shape
        left_out = np.zeros((height, width), bool)
        if self.runs:
            turns = np.zeros(region.frame[0] * region.frame[1] + 1, bool)
            turns[list(self.runs)] = True
            painted = np.logical_xor.accumulate(turns)[:-1].reshape(region.frame)
            left_out |= painted[region.of_frame]
        for polygon in self.polygons:
            corners = np.asarray(polygon) - region.origin_px
            # Along a row a side is crossed at x: what lies to the right of it turns.
            turns = np.zeros((height, width + 1), bool)
            for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
                first, last = np.clip(np.ceil(np.array(sorted((y0, y1))) - 0.5), 0, height)
                rows = np.arange(int(first), int(last))
                if len(rows):
                    x = x0 + (rows + 0.5 - y0) * (x1 - x0) / (y1 - y0)
                    turns[rows, np.clip(np.ceil(x - 0.5), 0, width).astype(int)] ^= True
            left_out |= np.logical_xor.accumulate(turns, axis=1)[:, :-1]
        return left_out


def leave_out(image: Measured, mask: Mask, region: Region) -> Measured:
    """The image (h, w, C) of a part of the photograph without what the mask leaves out."""
    if not mask.polygons and not mask.runs:
        return image
    out = mask.of(region)
    return replace(
        image,
        values=np.where(out[..., None], np.float32(np.nan), image.values),
        variance=np.where(out[..., None], np.float32(np.nan), image.variance),
        valid=np.where(out, np.float32(0.0), image.valid),
    )
