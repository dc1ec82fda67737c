"""A white sheet with pictures, lettering and diagrams at whole pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calibration.display import SRGB
from pipeline import io

WIDTH = 1600  # px of every sheet
MARGIN = 24
GAP = 16  # between pictures
LINE = 34  # px, of the lettering
INK, SOFT, PAPER = "#22262b", "#5b626b", "#ffffff"
_DPI = 100


class Sheet:
    """Pictures keep their pixels; places are px from the left and from the top."""

    def __init__(self, height: int, width: int = WIDTH):
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self.width, self.height = width, height
        self.figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor=PAPER)
        self._canvas = FigureCanvasAgg(self.figure)
        self._pictures: list[tuple[int, int, np.ndarray]] = []

    def picture(self, signal, left: int, top: int) -> None:
        """A picture (H, W, 3), encoded for sRGB, 0..1."""
        self._pictures.append((left, top, np.asarray(signal, np.float32)))

    def text(
        self, said: str, left: float, top: float, *, size: float = 20, colour: str = INK,
        bold: bool = False, align: str = "left",
    ) -> None:  # fmt: skip
        """A line whose upper edge is at `top`; size in px."""
        self.figure.text(
            left / self.width, 1 - top / self.height, said, fontsize=size * 72 / _DPI,
            color=colour, weight="bold" if bold else "normal", ha=align, va="top",
        )  # fmt: skip

    def axes(self, left: float, top: float, width: float, height: float):
        """Matplotlib axes with that rectangle for their frame."""
        bottom = self.height - top - height
        box = (left / self.width, bottom / self.height, width / self.width, height / self.height)
        return self.figure.add_axes(box)

    def signal(self) -> np.ndarray:
        """All of it (H, W, 3) in 0..1."""
        self._canvas.draw()
        whole = np.asarray(self._canvas.buffer_rgba())[..., :3].astype(np.float32) / 255
        for left, top, picture in self._pictures:
            height, width = picture.shape[:2]
            whole[top : top + height, left : left + width] = picture
        return whole

    def save(self, path: Path, description: str) -> None:
        io.write_picture(path, self.signal(), SRGB, description=description)


def columns(count: int, width: int = WIDTH) -> tuple[list[int], int]:
    """Left edges of pictures side by side across a sheet, and how wide each may be."""
    wide = (width - 2 * MARGIN - (count - 1) * GAP) // count
    return [MARGIN + k * (wide + GAP) for k in range(count)], wide


def enlarged(picture, times: int):
    """A picture with each pixel as a square of `times` by `times`."""
    return np.asarray(picture).repeat(times, axis=0).repeat(times, axis=1)
