"""Frames as video, by OpenCV's FFmpeg; the wheel brings its encoders."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from pipeline.errors import fault, storing

FORMATS = {".mp4": "vp09"}
"""Suffix and codec: VP9, which browsers and players know; the wheel has no encoder of H.264."""

RATE = 24.0  # frames a second


def write(path: Path, frames: Iterable, *, rate: float = RATE) -> None:
    """A video of pictures (H, W, 3), encoded sRGB 0..1, H and W even; at least one.

    path  its suffix is one of FORMATS
    """
    import cv2

    codec = FORMATS[path.suffix.lower()]
    writer = None
    try:
        for frame in frames:
            pixels = np.rint(np.clip(frame, 0, 1) * 255).astype(np.uint8)[..., ::-1]
            if writer is None:
                with storing(path):
                    path.touch()
                size = (pixels.shape[1], pixels.shape[0])
                fourcc = cv2.VideoWriter.fourcc(*codec)
                writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, fourcc, rate, size)
                if not writer.isOpened():
                    raise fault(
                        f"this OpenCV cannot write {codec}",
                        f"an encoder for {path.suffix}",
                        "give a folder, for frames, in place of a video",
                        path,
                    )
            writer.write(np.ascontiguousarray(pixels))
    finally:
        if writer is not None:
            writer.release()
