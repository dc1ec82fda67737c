"""A screen whose every number is known, for tests: curves, primaries, leaking light."""

from __future__ import annotations

import numpy as np

from calibration import display

WHITE_CD_M2 = 120.0
BLACK = np.array([0.30, 0.28, 0.45])  # cd/m2
GAMMAS = np.array([2.2, 2.4, 2.0])


def curve(drive):
    """Linear light (..., 3): like an LCD's, an S near full drive."""
    return drive**GAMMAS * (1 + 0.1 * drive * (1 - drive))


def xyz(drive):
    """What the instrument reads, cd/m2, of drives in [0, 1]."""
    matrix = display.DISPLAY_P3.xyz_from_rgb * (WHITE_CD_M2 - BLACK[1])
    return curve(np.asarray(drive, float)) @ matrix.T + BLACK


def drives(levels=18, mixed=40):
    """Black, ramps, greys and mixed colours (n, 3), in 8-bit steps over 255."""
    steps = np.round(np.linspace(0, 255, levels)) / 255
    ramps = [step * axis for axis in np.eye(3) for step in steps[1:]]
    greys = [np.full(3, step) for step in steps]
    rng = np.random.default_rng(3)
    return np.array([*greys, *ramps, *np.round(rng.uniform(20, 235, (mixed, 3))) / 255])


def table(levels=18, mixed=40):
    """Rows R, G, B (8 bit), X, Y, Z."""
    sent = drives(levels, mixed)
    return np.concatenate([np.round(sent * 255), xyz(sent)], axis=1)


def write(path, rows, header="R,G,B,X,Y,Z"):
    lines = [header, *(",".join(f"{v:.10g}" for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path
