"""Functions over arrays compiled to machine code, where passes of NumPy would be bound by memory.

A module of such functions loads the compiler, so it is imported where it is used, not at the top.
`python -m pipeline.compiling` compiles them all, that none need be when they are first used.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np

F = TypeVar("F", bound=Callable)


def compiled(function: F) -> F:
    """The function, compiled when it is first called with arguments of some types.

    The machine code is kept beside the source or, where that cannot be written, in the user's cache
    (or NUMBA_CACHE_DIR); where neither can be, each run compiles anew. Sums are added in the order
    written, so that no result depends on the machine. Other threads run meanwhile.
    """
    machine: Any = numba.njit(nogil=True, error_model="numpy")(function)
    try:
        machine.enable_caching()
    except RuntimeError as error:
        if "no locator available" not in str(error):
            raise
    return machine


def compile_all() -> None:
    """Has every compiled function run once, on arrays as small as they may be."""
    from stages.align import Alignment
    from stages.merge import InMemory, merge
    from stages.mirror import Sphere
    from stages.types import Frame, Measured
    from stages.unwrap import unwrap

    light = np.linspace(1000, 4000, 64 * 64).reshape(64, 64)
    black, cfa = np.full((2, 2), 100.0), np.array([[0, 1], [1, 2]])
    merge(
        InMemory([
            Frame((100 + t * light).astype(np.uint16), cfa, black, black + 16000, t, 100.0, 1.0)
            for t in (1.0, 2.0)
        ])
    )  # fmt: skip
    values = np.ones((48, 48, 3), np.float32)
    image = Measured(values, values, values[..., 0])
    sphere = Sphere.from_rim(
        24.0, 24.0, 20.0, radius_mm=50.0, principal_px=(24.0, 24.0), distance_mm=1500.0
    )
    still = Alignment(np.zeros((2, 2)), np.ones(2), np.zeros(2))
    unwrap([image, image], sphere, still, face_size=16, noise_area_px=(1.0, 1.0, 1.0))
