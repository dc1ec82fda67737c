"""The exposures of a bracket, decoded once and kept in a file to be read by rows."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from pipeline import io
from pipeline.errors import fault, storing
from stages.bracket import workers
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
        """Decodes each file once, in threads, as LibRaw lets others run meanwhile.

        InputError where one is damaged, or is not like the first.
        """
        place = self.folder or tempfile.gettempdir()
        with storing(place), tempfile.TemporaryFile(dir=place) as spool:

            def one(i: int) -> tuple[T, tuple[int, ...], str]:
                with io.opened_frame(self.files[i], **self.exposures[i]) as whole:
                    frame = whole if self.region is None else self.region.part_of(whole)
                    samples = np.ascontiguousarray(frame.samples)
                    _write(spool.fileno(), samples, i * samples.nbytes)
                    cfa = "".join("RGB"[c] for c in frame.cfa.ravel())
                    return look(replace(frame, samples=samples)), whole.samples.shape, cfa

            with io.quiet_libraw(), ThreadPoolExecutor(workers()) as pool:
                seen, shapes, cfas = zip(*pool.map(one, range(len(self.files))), strict=True)
            # Headers were compared when the capture was loaded; now it is the samples themselves.
            for i, found in enumerate(zip(shapes, cfas, strict=True)):
                if found != (shapes[0], cfas[0]):
                    raise fault(
                        f"{shapes[i][1]} x {shapes[i][0]} samples in the pattern {cfas[i]}",
                        f"{shapes[0][1]} x {shapes[0][0]} of {cfas[0]} as in {self.files[0].name}",
                        "keep photographs of one camera and setting only",
                        self.files[i],
                    )
            shape = shapes[0] if self.region is None else self.region.shape
            yield Decoded(seen, spool.fileno(), shape)


def frames(
    files: Sequence[Path], exposures: Sequence[Mapping[str, float]]
) -> Generator[Frame, None, None]:
    """The photographs one by one, each gone when the next is asked for."""
    for path, given in zip(files, exposures, strict=True):
        with io.opened_frame(path, **given) as frame:
            yield frame


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
    """What a raw file's samples must be divided by, as `io.opened_frame` takes it."""
    return {"time_s": shot.time_s, "iso": shot.iso, "f_number": shot.f_number}


def _write(file: int, array: NDArray, offset: int) -> None:
    data = array.data.cast("B")
    while data:
        written = os.pwrite(file, data, offset)
        data, offset = data[written:], offset + written


def _read(file: int, array: NDArray, offset: int) -> None:
    data = array.data.cast("B")
    while data:
        read = os.preadv(file, [data], offset)
        assert read, "the spool ended early"
        data, offset = data[read:], offset + read
