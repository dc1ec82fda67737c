"""Lamps: an environment, or what is brightest in it, as directional lights."""

from __future__ import annotations

import heapq

import numpy as np

from stages import cube as cubes

MOST = 32  # directional lights that stand for the lamps
_AREA_SR = 0.02  # lamps are what is brightest in this solid angle, a disc 9 degrees across ...
_CAP = 10.0  # ... if it is brighter than so many times the mean


def take_out(cube):
    """Part an environment into lamps and what is left of it.

    cube     (6, N, N, C) linear
    returns  rest (6, N, N, C) float32; directions (K, 3) and flux (K, C), radiance times sr, of K
             directional lights, at most MOST. What the rest lacks is in the lights.

    Samples of a filtered map meet a small lamp only now and then, which shows as ripples in broad
    highlights; a directional light is met by all. Texels above a cap keep what is below it. A
    window is too large for few directions, and too large to need them: the cap is never less than
    what all but a hundredth of a steradian or two of the sky stays below.
    """
    cube = np.asarray(cube, np.float32)
    weight = np.broadcast_to(cubes.solid_angles(cube.shape[1]), cube.shape[:3]).ravel()
    power = cube.sum(axis=-1).ravel()
    order = np.argsort(-power, kind="stable")
    area = np.cumsum(weight[order])
    brim = power[order[min(int(np.searchsorted(area, _AREA_SR)), len(order) - 1)]]
    cap = max(brim, _CAP * float(power @ weight) / (4 * np.pi))
    rest, lamps = parted(cube, cap)
    return rest, *lights(lamps, MOST)


def parted(cube, cap: float):
    """What of an environment is below a cap, and what stands out above it; together all of it.

    cube     (6, N, N, C) linear
    cap      on the sum of a texel's channels; texels that exceed it keep their colour
    returns  two (6, N, N, C) float32
    """
    power = cube.sum(axis=-1, keepdims=True)
    cap = max(cap, 0.0)
    above = power > cap
    kept = np.divide(np.float32(cap), power, out=np.ones_like(power), where=above)
    return cube * kept, np.where(above, cube * (1 - kept), np.float32(0))


def lights(cube, count):
    """An environment as few directional lights.

    cube     (6, N, N, C) linear
    returns  directions (K, 3) float32, unit; flux (K, C) float32, radiance times sr. K <= count

    The map is cut in two again and again: the piece with the most light times breadth, across its
    broadest axis, where half its light lies on either side. After P. Debevec, "A median cut
    algorithm for light probe sampling" (2005), with breadth counted so that a lamp does not take
    all lights to itself.
    """
    n = cube.shape[1]
    direction = cubes.directions(n).reshape(-1, 3)
    flux = (cube * cubes.solid_angles(n)[..., None]).reshape(len(direction), -1)
    power = np.maximum(flux.sum(axis=1), 0)
    if not flux.any():
        return np.zeros((0, 3), np.float32), np.zeros((0, flux.shape[1]), np.float32)

    def piece(members):
        total = power[members].sum()
        if total <= 0 or len(members) == 1:
            return (0.0, members[0], members, 0)
        centre = power[members] @ direction[members] / total
        spread = power[members] @ (direction[members] - centre) ** 2 / total
        axis = int(np.argmax(spread))
        return (-total * np.sqrt(spread.sum()), members[0], members, axis)

    heap = [piece(np.flatnonzero(flux.any(axis=1)))]
    while len(heap) < count and heap[0][0] < 0:
        _, _, members, axis = heapq.heappop(heap)
        members = members[np.argsort(direction[members, axis], kind="stable")]
        running = np.cumsum(power[members])
        half = int(np.searchsorted(running, running[-1] / 2)) + 1
        half = min(max(half, 1), len(members) - 1)
        for part in (members[:half], members[half:]):
            heapq.heappush(heap, piece(part))
    centres = np.array([power[m] @ direction[m] for _, _, m, _ in heap])
    lengths = np.linalg.norm(centres, axis=1)
    kept = lengths > 0
    totals = np.array([flux[m].sum(axis=0) for _, _, m, _ in heap])
    return (
        (centres[kept] / lengths[kept, None]).astype(np.float32),
        totals[kept].astype(np.float32),
    )
