"""A painting and a white card photographed through two filters, for tests: reflectances, a lamp on
one side, a shift of the second filter's image, sensor, DNG.

The paints are mixtures of six, so that six bands tell their primaries exactly: what M_R is, is
known on paper, and nothing is left to its fit.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from small_capture import BLACK, SATURATION, sensitivities, transmittances, write_shot

from calibration import primaries, sets, transform
from calibration.fit import REFLECTANCE_UNITS

SIZE = (170, 210)  # height, width
SHIFTS = {"cyan": (0.0, 0.0), "yellow": (0.62, -1.37)}
PRIMARIES = primaries.load("darling2011")
TIMES_S, TAGS = (2.0**-9, 2.0**-5), ((1, 500), (1, 30))
# Full scales per second of the white where it is brightest, in its strongest band: the longer
# exposure clips there.
LEVEL = 40.0


def paints():
    """Six reflectances (36, 6), each between 0 and 1: patches of the chart."""
    return sets.surfaces("colorchecker24").only(("13", "14", "15", "16", "18", "19")).values


def bands():
    """What the camera's six bands see of a reflectance in daylight (36, 6), columns of sum 1."""
    camera, filters = sensitivities().values, transmittances().values
    seen = (filters[:, :, None] * camera[:, None, :]).reshape(36, 6)
    return sets.lights("darling2011")["D65"][:, None] * seen


def m_r(channels=None) -> transform.Transform:
    """The matrix that is exact for mixtures of the paints."""
    ratio = bands() / bands().sum(axis=0)
    matrix = (PRIMARIES.curves.T @ paints()) @ np.linalg.inv(ratio.T @ paints())
    return transform.Transform(
        matrix=matrix,
        channels=channels or tuple(f"{f}.{c}" for f in SHIFTS for c in "RGB"),
        primaries=PRIMARIES.name,
        primaries_digest=PRIMARIES.digest,
        peaks_nm=tuple(PRIMARIES.peaks_nm),
        widths_nm=tuple(PRIMARIES.widths_nm),
        units=REFLECTANCE_UNITS,
        absolute=False,
        method="pinv",
        noise_level=0.0,
        quantity=transform.REFLECTANCE,
    )


def amounts(x, y):
    """How much of each paint (..., 6) lies at px x, y: a smooth pattern, sum 1."""
    rng = np.random.default_rng(12)
    waves = []
    for _ in range(6):
        k, phase = (
            rng.uniform(0.08, 0.3, (2, 4)) * rng.choice([-1, 1], (2, 4)),
            rng.uniform(0, 6, 4),
        )
        waves.append(sum(np.sin(k[0, i] * x + k[1, i] * y + phase[i]) for i in range(4)))
    weight = np.exp(0.7 * np.stack(waves, axis=-1))
    return weight / weight.sum(axis=-1, keepdims=True)


def shading(x, y):
    """A lamp at the left: light (...,) that falls from 1 to about .4, and over a corner less."""
    height, width = SIZE
    return 1.0 / (1 + (x / width) ** 2 + 0.5 * (y / height) ** 2)


def truth():
    """The painting in the primaries (H, W, 6)."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    return amounts(x, y) @ (paints().T @ PRIMARIES.curves)


def photograph(folder: Path, surface, rng, *, times_s=TIMES_S, tags=TAGS, dim=1.0) -> Path:
    """Brackets through both filters of surface(x, y) -> reflectances (..., 36)."""
    seen = bands() * LEVEL / bands().sum(axis=0).max()
    for f, (name, (dx, dy)) in enumerate(SHIFTS.items()):
        y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
        signal = surface(x - dx, y - dy) @ seen[:, 3 * f : 3 * f + 3]
        signal = signal * shading(x, y)[..., None] * dim
        (folder / name).mkdir(parents=True)
        for i, (time_s, tag) in enumerate(zip(times_s, tags, strict=True)):
            write_shot(folder / name / f"{i}.dng", samples(signal, time_s, rng), tag)
    return folder


def samples(colours, time_s: float, rng):
    """Raw RGGB samples of an image (H, W, 3) in full scales per second."""
    mosaic = np.empty(SIZE)
    for row in (0, 1):
        for column in (0, 1):
            mosaic[row::2, column::2] = colours[row::2, column::2, row + column]
    full_well, read_noise = 40000.0, 4.0
    electrons = rng.poisson(mosaic * time_s * full_well) + read_noise * rng.standard_normal(SIZE)
    raw = BLACK + electrons / full_well * (SATURATION - BLACK)
    return np.clip(np.round(raw), 0, SATURATION).astype(np.uint16)


def painting(x, y):
    return amounts(x, y) @ paints().T


def white(x, y):
    return np.ones((*np.shape(x), 36))


def make(folder: Path) -> Path:
    """Writes surface/, white/ and M_R.toml."""
    rng = np.random.default_rng(31)
    photograph(folder / "surface", painting, rng)
    photograph(folder / "white", white, rng)
    transform.write_transform(folder / "M_R.toml", m_r())
    return folder
