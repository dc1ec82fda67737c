"""Every knob of a run, once: name, unit, default, and why that default."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    """What the command line may change about a run; the capture itself says the rest.

    face_size        edge of a cube face in texels; 0: from the sphere's size in the photograph,
                     so that a texel in front is about as large as a pixel
    preview_width    px of the whole picture, six channels beside three; half as high
    preview_samples  directions a shaded point draws from the light for its gloss; None: as many as
                     each material's roughness asks for
    """

    face_size: int = 0
    preview_width: int = 1280
    preview_samples: int | None = None
