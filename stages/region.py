"""A part of the photograph, where only a part is needed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stages.mirror import Sphere
from stages.types import Frame


@dataclass(frozen=True)
class Region:
    """Rows and columns of the visible photograph; its own first pixel is an even one of either.

    So the pattern of the colour filter array, and of all that follows it, is the same in it.

    top, bottom  rows, the last left out
    left, right  columns likewise
    frame        height, width of the whole photograph
    """

    top: int
    bottom: int
    left: int
    right: int
    frame: tuple[int, int]

    @classmethod
    def whole(cls, frame: tuple[int, int]) -> Region:
        """All of a photograph of this height and width."""
        return cls(0, frame[0], 0, frame[1], frame)

    @classmethod
    def around(cls, low, high, frame: tuple[int, int]) -> Region:
        """What of the frame lies between two corners x, y in px, and a little more.

        A region's sides are whole numbers of `_STEP`, so that a corner that moves by a hair does
        not make another region.
        """
        ends = []
        for first, last, size in zip(low, high, frame[::-1], strict=True):
            begin = int(np.floor(first / _STEP)) * _STEP
            end = int(np.ceil(last / _STEP)) * _STEP
            ends.append((int(np.clip(begin, 0, (size - 1) // 2 * 2)), int(np.clip(end, 2, size))))
        (left, right), (top, bottom) = ends
        return cls(top, bottom, left, right, frame)

    @property
    def shape(self) -> tuple[int, int]:
        """Height, width."""
        return self.bottom - self.top, self.right - self.left

    @property
    def origin_px(self) -> tuple[float, float]:
        """x, y in the photograph of the region's own 0, 0."""
        return float(self.left), float(self.top)

    @property
    def share(self) -> float:
        """Of the photograph's area."""
        return self.shape[0] * self.shape[1] / (self.frame[0] * self.frame[1])

    @property
    def of_frame(self) -> tuple[slice, slice]:
        """Its rows and columns, as an index of an array of the whole photograph."""
        return slice(self.top, self.bottom), slice(self.left, self.right)

    def part_of(self, frame: Frame) -> Frame:
        """What the region shows of a photograph; a view, nothing is copied."""
        return replace(frame, samples=frame.samples[self.of_frame])

    def inside(self, sphere: Sphere) -> Sphere:
        """A sphere of the photograph, in px of the region."""
        return sphere.with_shift((-self.left, -self.top))


_STEP = 16  # px, even
