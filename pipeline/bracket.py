"""The exposures of a bracket, decoded and developed one at a time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from pipeline import io
from stages.develop import develop
from stages.types import Exposure


@dataclass(frozen=True)
class Bracket:
    """What `stages.merge` iterates over, as often as it likes.

    files      raw files of one scene through one filter
    exposures  time_s, iso and f_number of each
    """

    files: Sequence[Path]
    exposures: Sequence[Mapping[str, float]]

    @classmethod
    def of(cls, shots: Sequence[io.Shot]) -> Bracket:
        return cls([s.path for s in shots], [exposure(s) for s in shots])

    def __iter__(self) -> Iterator[Exposure]:
        # One decoding thread ahead of the merge; no more, or the frames would pile up.
        with ThreadPoolExecutor(1) as pool:
            ahead = pool.submit(self._developed, 0)
            for i in range(1, len(self.files)):
                ready, ahead = ahead, pool.submit(self._developed, i)
                yield ready.result()
            yield ahead.result()

    def _developed(self, i: int) -> Exposure:
        return develop(io.read_frame(self.files[i], **self.exposures[i]))


def exposure(shot: io.Shot) -> dict[str, float]:
    """What a raw file's samples must be divided by, as `io.read_frame` takes it."""
    return {"time_s": shot.time_s, "iso": shot.iso, "f_number": shot.f_number}
