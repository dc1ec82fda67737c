"""Whoever takes the photographs: a camera on its tripod, and somebody to the right of it.

They are in each photograph, behind the camera's entrance pupil, and in no truth.
"""

from __future__ import annotations

import numpy as np

from pipeline.simulate.materials import paint
from pipeline.simulate.render import Surface, View
from pipeline.simulate.room import BLACK_PAINT, ball, box, cushion, rod

_BESIDE, _BACK = 0.42, 0.12  # m from the camera: to the right, and away from the sphere


def photographer(view: View) -> list[Surface]:
    """The surfaces of camera, tripod and photographer, standing where a view was taken from."""
    eye = np.asarray(view.eye, float)
    away = eye - np.asarray(view.sphere, float)
    away[1] = 0.0
    away /= np.linalg.norm(away)
    up = np.array([0.0, 1.0, 0.0])
    right = np.cross(up, away)
    turn = float(np.degrees(np.arctan2(away[0], away[2])))
    body = eye + 0.07 * away
    half = np.array([0.07, 0.05, 0.03])
    surfaces = [
        *box(body - half, body + half, BLACK_PAINT, turn),
        # The lens ends just behind its entrance pupil: in front it would stand in its own way.
        *rod(eye + 0.012 * away, body, 0.03, BLACK_PAINT),
    ]
    foot = body * (1.0, 0.0, 1.0)
    for angle in np.radians([0.0, 120.0, 240.0]):
        out = np.cos(angle) * away + np.sin(angle) * right
        surfaces += rod(body - 0.05 * up, foot + 0.4 * out, 0.012, paint("#2a2a2c"))
    stands = foot + _BESIDE * right + _BACK * away
    trousers, jumper, skin = paint("#2f4a73"), paint("#8e2f38"), paint("#d8a482")
    for side in (-0.09, 0.09):
        leg = stands + side * right
        surfaces += rod(leg, leg + 0.82 * up, 0.075, trousers)
        arm = stands + 2.6 * side * right
        surfaces += rod(arm + 1.3 * up, arm + 0.8 * up, 0.045, jumper)
    surfaces += cushion(stands + 1.1 * up, (0.22, 0.33, 0.13), jumper, turn)
    surfaces += ball(stands + 1.6 * up, 0.11, skin)
    return surfaces
