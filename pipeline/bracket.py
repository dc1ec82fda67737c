"""The exposures of a bracket, decoded once and kept in a file to be read by rows."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline import io
from pipeline.errors import fault, storing
from pipeline.files import decoding
from stages.region import Region
from stages.types import Frame

T = TypeVar("T")


@dataclass(frozen=True)
class Bracket:
    """Raw files as `stages.merge` takes them.

    files      of one scene through one filter
    exposures  time_s, iso and f_number of each
    folder     where the decoded samples go meanwhile, 2 bytes a pixel and exposure; None: where
               temporary files go
    region     of the photographs that is wanted; None: all of them
    """

    files: Sequence[Path]
    exposures: Sequence[Mapping[str, float]]
    folder: Path | None = None
    region: Region | None = None

    @classmethod
    def of(cls, shots: Sequence[io.Shot]) -> Bracket:
        return cls([s.path for s in shots], [exposure(s) for s in shots])

    @contextmanager
    def decoded(self, look: Callable[[Frame], T]) -> Iterator[Decoded[T]]:
        """Decodes each file once, several side by side.

        InputError where one is damaged, or is not like the first.
        """
        place = self.folder or tempfile.gettempdir()
        part = None if self.region is None else self.region.of_frame
        with storing(place), tempfile.TemporaryFile(dir=place) as spool:

            def one(i: int) -> tuple[T, tuple[int, ...], str]:
                frame, size = io.decode_into(
                    spool.fileno(), i, self.files[i], part=part, **self.exposures[i]
                )
                return look(frame), size, "".join("RGB"[c] for c in frame.cfa.ravel())

            seen, sizes, cfas = zip(*decoding.each(one, range(len(self.files))), strict=True)
            # Headers were compared when the capture was loaded; now it is the samples themselves.
            for i, found in enumerate(zip(sizes, cfas, strict=True)):
                if found != (sizes[0], cfas[0]):
                    raise fault(
                        f"{sizes[i][1]} x {sizes[i][0]} samples in the pattern {cfas[i]}",
                        f"{sizes[0][1]} x {sizes[0][0]} of {cfas[0]} as in {self.files[0].name}",
                        "keep photographs of one camera and setting only",
                        self.files[i],
                    )
            shape = sizes[0] if self.region is None else self.region.shape
            yield Decoded(seen, spool.fileno(), shape)


def frames(
    files: Sequence[Path], exposures: Sequence[Mapping[str, float]]
) -> Generator[Frame, None, None]:
    """The photographs one by one, each gone when the next is asked for."""
    for path, given in zip(files, exposures, strict=True):
        yield io.read_frame(path, **given)


@dataclass(frozen=True)
class Decoded(Generic[T]):
    """See `stages.bracket.Decoded`."""

    seen: Sequence[T]
    spool: int
    shape: tuple[int, ...]

    def rows(self, top: int, bottom: int) -> NDArray[np.uint16]:
        height, width = self.shape
        rows = np.empty((len(self.seen), bottom - top, width), np.uint16)
        for i, into in enumerate(rows):
            _read(self.spool, into, 2 * width * (i * height + top))
        return rows


def exposure(shot: io.Shot) -> dict[str, float]:
    """What a raw file's samples must be divided by, as `io.read_frame` takes it."""
    return {"time_s": shot.time_s, "iso": shot.iso, "f_number": shot.f_number}


def _read(file: int, array: NDArray, offset: int) -> None:
    data = array.data.cast("B")
    while data:
        read = os.preadv(file, [data], offset)
        assert read, "the spool ended early"
        data, offset = data[read:], offset + read
