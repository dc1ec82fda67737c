"""Light that saturated even the shortest exposure: where it is, how large, and what it is at least.

It is not known and nothing is put in its place, but a map without its sun is another map: so the
photographer is told what is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stages.align import Alignment
from stages.cube import solid_angles
from stages.mirror import Array, Sphere
from stages.types import Float, Measured, Saturated
from stages.unwrap import unwrap

_RIM_PX = 1.0  # nearer the rim than that nothing counts in `unwrap` either
WORTH_A_WARNING = 1e-3  # of all light, by its lower bound: what is really there may be far more


@dataclass(frozen=True)
class Lost:
    """The light lost in one filter's photographs.

    solid_angle_sr  of the directions that lost samples take from the map, neighbours included
    share           that of the sphere's 4 pi
    direction       (3,) unit, its middle in the result's world; None where nothing is lost
    at_least        red, green, blue: the least integral over solid angle of the light there, camera
                    signal times sr; light that saturates one colour is counted in that alone
    of_light        the largest of these as a share of all light of its colour, so much at the least
    """

    solid_angle_sr: float
    share: float
    direction: tuple[float, float, float] | None
    at_least: tuple[float, float, float]
    of_light: float


def taken(saturated: Saturated) -> NDArray[np.bool_]:
    """Pixels (H, W) that are not known because of lost samples: these and all next to them."""
    import cv2

    return cv2.dilate(saturated.lost.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0


def lost(
    saturated: Saturated, sphere: Sphere, alignment: Alignment, number: int, known: Measured
) -> Lost:
    """What saturation took from the map of one filter.

    saturated  of its bracket
    sphere     as it is seen in the first filter's photograph
    alignment, number  where this one's lies
    known      (6, N, N, 3) this filter's bands, as they were unwrapped
    """
    omega, middle = _seen(taken(saturated), sphere, alignment, number)[:2]
    total = float(omega.sum())
    own, _, rows, columns = _seen(saturated.lost, sphere, alignment, number)
    colour = saturated.cfa[rows % 2, columns % 2]
    light = own * saturated.at_least[rows % 2, columns % 2]
    # One sample of a colour stands for a cell's four pixels: of red and blue there is one in it.
    red, green, blue = (
        float(4.0 * light[colour == c].sum() / (saturated.cfa == c).sum()) for c in range(3)
    )
    solid_angle = solid_angles(known.valid.shape[1])
    seen = np.where(known.valid[..., None] > 0, known.values, 0.0)
    rest = np.maximum(np.einsum("fyxc,yx->c", seen, solid_angle, dtype=np.float64), 0.0)
    shares = [part / (part + r) for part, r in zip((red, green, blue), rest, strict=True) if part]
    direction = None
    if total > 0:
        mean = omega @ middle
        x, y, z = (float(v) for v in mean / np.linalg.norm(mean))
        direction = x, y, z
    return Lost(
        total, total / (4.0 * np.pi), direction, (red, green, blue), max(shares, default=0.0)
    )


def lost_share(
    saturated: Sequence[Saturated], sphere: Sphere, alignment: Alignment, *, face_size: int
) -> Float:
    """How much (6, N, N) of each texel saturation took, in whichever filter it took the most."""
    share = np.zeros((6, face_size, face_size), np.float32)
    for number, one in enumerate(saturated):
        if one.lost.any():
            image = taken(one).astype(np.float32)[..., None]
            measured = Measured(image, np.zeros_like(image), np.ones_like(image[..., 0]))
            places = replace(
                alignment,
                shifts=np.asarray(alignment.shifts)[number : number + 1],
                scales=None if alignment.scales is None else alignment.scales[number : number + 1],
                turns_deg=None
                if alignment.turns_deg is None
                else alignment.turns_deg[number : number + 1],
            )
            seen = unwrap([measured], sphere, places, face_size=face_size)
            share = np.fmax(share, seen.values[..., 0] * seen.valid)
    return share


def _seen(
    pixels: NDArray[np.bool_], sphere: Sphere, alignment: Alignment, number: int
) -> tuple[Array, Array, NDArray[np.intp], NDArray[np.intp]]:
    """Solid angle (n,) and direction (n, 3) that pixels on the sphere show; rows and columns."""
    rows, columns = np.nonzero(pixels)
    square = np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
    corners = np.stack([columns, rows], axis=-1)[:, None] + square
    corners = alignment.to_first(number, corners.astype(np.float64))
    on = (sphere.inside_px(corners) > _RIM_PX).all(axis=-1)
    d = sphere.direction_of(corners[on])
    omega = 0.5 * np.linalg.norm(np.cross(d[:, 3] - d[:, 0], d[:, 2] - d[:, 1]), axis=-1)
    return omega, d.mean(axis=1), rows[on], columns[on]


def warnings(found: Sequence[Lost], filters: Sequence[str]) -> list[str]:
    """What the photographer should know, a sentence a filter that lost light worth telling."""
    said = []
    for name, one in zip(filters, found, strict=True):
        if one.of_light > WORTH_A_WARNING and one.direction is not None:
            x, y, z = one.direction
            said.append(
                f"{name} saturates in every exposure over {one.solid_angle_sr:.2g} sr about"
                f" ({x:.2f}, {y:.2f}, {z:.2f}): at least {one.of_light:.1%} of its light is"
                " missing; add shorter exposures"
            )
    return said
