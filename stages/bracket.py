"""Photographs of one scene by one camera, wherever they are kept."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from stages.types import Frame

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)


class Decoded(Protocol[T_co]):
    """Exposures that have been decoded once and can be read again, a few rows at a time.

    seen  what was made of each frame while it was there
    """

    @property
    def seen(self) -> Sequence[T_co]: ...

    def rows(self, top: int, bottom: int) -> NDArray[np.uint16]:
        """Raw samples (K, bottom - top, W) of all exposures; called from several threads."""


class Bracket(Protocol):
    """Photographs of one scene by one camera, any order, wherever they are kept."""

    def decoded(self, look: Callable[[Frame], T]) -> AbstractContextManager[Decoded[T]]:
        """Decodes each frame once, looks at it, and keeps its samples for `rows`.

        look  is called from several threads; must not keep the frame's samples
        """


@dataclass(frozen=True)
class InMemory:
    """A bracket of frames that are in memory anyway."""

    frames: Sequence[Frame]

    def decoded(self, look: Callable[[Frame], T]) -> AbstractContextManager[Decoded[T]]:
        return nullcontext(_InMemory([look(frame) for frame in self.frames], self.frames))


@dataclass(frozen=True)
class _InMemory:
    seen: Sequence
    frames: Sequence[Frame]

    def rows(self, top: int, bottom: int) -> NDArray[np.uint16]:
        return np.stack([frame.samples[top:bottom] for frame in self.frames])


def workers() -> int:
    """Threads that decode and merge: the processors this process may use, as far as memory goes."""
    return min(4, len(os.sched_getaffinity(0)))
