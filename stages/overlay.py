"""A picture to check a sphere by: the photograph, with the rim and centre that were found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stages.mirror import ENOUGH_OF_THE_RIM, Sphere
from stages.region import Region
from stages.types import Float, Measured

_LONGEST = 1600  # px of the picture
_FINE = 8  # bits of a pixel's fraction, for OpenCV's lines
_GOOD, _POOR = (64, 255, 90), (255, 90, 40)
_ASTRAY = (255, 0, 255)  # of sectors that do not agree
_LETTERS = 0.55  # OpenCV's scale of them: 12 px high
_BESIDE = 10  # px left and right of them


def overlay(image: Measured, sphere: Sphere, region: Region | None = None) -> Float:
    """The photograph as a display signal, marked.

    image    (H, W, C), the one the sphere was found in; three of its channels make the colours
    sphere   as found; its rim is drawn green, or red if little of it agrees, and magenta in the
             sectors that do not
    region   of the photograph that the image shows; None: all of it
    returns  (h, w, 3) sRGB signal, 0..1, at most 1600 px a side
    """
    import cv2

    light = image.values[..., :3] if image.values.shape[-1] >= 3 else image.values[..., :1]
    known = np.isfinite(light).all(axis=-1)
    height, width = known.shape
    scale = min(1.0, _LONGEST / max(height, width))
    levels = np.asarray(np.median(light[known], axis=0) if known.any() else 1.0)
    signal = np.ones((height, width, 3), np.float32)  # what is not known was too bright
    # Each channel by its own median, so that a filter's colour does not hide the picture; then
    # Reinhard's curve, x / (1 + x), as the light spans ten thousand to one.
    tone = np.maximum(light[known] / np.maximum(levels, 1e-12), 0.0)
    signal[known] = (tone / (1.0 + tone)) ** (1.0 / 2.2)
    size = round(width * scale), round(height * scale)
    picture = cv2.resize(signal, size, interpolation=cv2.INTER_AREA)
    picture = np.rint(255.0 * picture).astype(np.uint8)  # OpenCV writes on 8 bits only
    agreed = not sphere.rim_found < ENOUGH_OF_THE_RIM  # NaN: given, not found
    colour = _GOOD if agreed else _POOR

    corner = (0.0, 0.0) if region is None else region.origin_px

    def at(pixels):
        place = ((np.asarray(pixels) - corner) * scale - 0.5) * 2**_FINE
        return np.rint(place).astype(np.int32)

    x, y = sphere.centre_px
    parts = [f"x {x:.2f}  y {y:.2f}  radius {sphere.rim_px:.2f}"]
    if np.isfinite(sphere.rim_sigma_px).all():
        parts.append("+- " + " ".join(f"{s:.2f}" for s in sphere.rim_sigma_px))
    parts[-1] += " px"
    if np.isfinite(sphere.rim_found):
        parts[-1] += ";"
        residual = sphere.rim_residual_px
        parts.append(f"{sphere.rim_found:.0%} of the rim agrees, to {residual:.2f} px")
    else:
        parts[-1] += ", as given"
    _caption(picture, parts, colour)

    # Each sector for itself: those that see the rim elsewhere, or not at all, are marked.
    sectors = sphere.rim_agrees or (True,)
    steps = max(1, 720 // len(sectors))
    rim = sphere.outline(steps * len(sectors))
    for k, agrees in enumerate(sectors):
        arc = np.arange(k * steps, (k + 1) * steps + 1) % len(rim)
        shade = colour if agrees else _ASTRAY
        cv2.polylines(picture, [at(rim[arc])], False, shade, 1, cv2.LINE_AA, _FINE)
    for dx, dy in ((8.0 / scale, 0.0), (0.0, 8.0 / scale)):
        ends = at([(x - dx, y - dy), (x + dx, y + dy)]).tolist()
        cv2.line(picture, ends[0], ends[1], colour, 1, cv2.LINE_AA, _FINE)
    return np.asarray(picture / 255.0, np.float32)


def _caption(picture: NDArray[np.uint8], parts: Sequence[str], colour: tuple[int, ...]) -> None:
    """Writes on the picture (h, w, 3), top left, as many parts to a line as it is wide."""
    import cv2

    font, tall, room = cv2.FONT_HERSHEY_SIMPLEX, _LETTERS, picture.shape[1] - 2 * _BESIDE

    def wide(line: str) -> int:
        return int(cv2.getTextSize(line, font, tall, 1)[0][0])

    lines = [parts[0]]
    for part in parts[1:]:
        together = f"{lines[-1]} {part}"
        lines[-1:] = [together] if wide(together) <= room else [lines[-1], part]
    widest = max(map(wide, lines))
    if widest > room:  # a picture narrower than a part
        tall *= max(room, 1) / widest
    (_, high), below = cv2.getTextSize(lines[0], font, tall, 1)
    step = high + below + 4
    picture[: len(lines) * step + 8, : min(widest, room) + 2 * _BESIDE] //= 4
    for k, line in enumerate(lines):
        place = (_BESIDE, 6 + high + k * step)
        cv2.putText(picture, line, place, font, tall, colour, 1, cv2.LINE_AA)
