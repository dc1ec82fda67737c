"""What goes wrong around the stages: the user's input, the machine, or us."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from calibration.errors import InputError, Problem, fault

__all__ = ["InputError", "Problem", "fault", "of_machine", "reading", "replacing", "storing"]

# What the operating system says when a place cannot take a file, and what the user can do.
_STORAGE = {
    errno.ENOSPC: ("no space is left on the device", "free some space or choose another with -o"),
    errno.EDQUOT: ("the disk quota is used up", "free some space or choose another with -o"),
    errno.EFBIG: ("the file would exceed the size limit", "raise the limit or choose another -o"),
    errno.EACCES: ("permission is denied", "choose a folder you may write to with -o"),
    errno.EPERM: ("permission is denied", "choose a folder you may write to with -o"),
    errno.EROFS: ("the file system is read-only", "choose a folder you may write to with -o"),
    errno.ENOTDIR: ("a file stands where a folder is needed", "choose another folder with -o"),
    errno.EEXIST: ("a file stands where a folder is needed", "choose another folder with -o"),
    errno.EISDIR: ("a folder stands where a file is needed", "remove it or choose another -o"),
    errno.EIO: ("the device fails", "check the disk, and choose another folder with -o"),
    errno.ESTALE: ("the file system is gone", "mount it again, or choose another with -o"),
    errno.ENOTCONN: ("the file system is gone", "mount it again, or choose another with -o"),
    errno.ENODEV: ("the file system is gone", "mount it again, or choose another with -o"),
    errno.ENAMETOOLONG: ("the name is too long", "choose a shorter one with -o"),
}

# What libraries say that have no more memory, and raise as something else than a MemoryError.
_NO_MEMORY = (
    "bad_alloc",
    "can't start new thread",
    "cannot allocate memory",
    "failed to map segment",
    "insufficient memory",
)


def of_machine(error: Exception) -> Problem | None:
    """What the machine had no more of, whichever library raised it; None where it is no such error.

    What cannot be stored is told by `storing`; what is left is what we print.
    """
    said = str(error).lower()
    if isinstance(error, MemoryError) or any(words in said for words in _NO_MEMORY):
        remedy = "end other programs, or give it a larger machine; what is finished stays"
        return Problem("memory ran out", "", remedy, "sixlight")
    if isinstance(error, OSError) and error.filename is None and error.errno in _STORAGE:
        return Problem(_STORAGE[error.errno][0], "", "print to another place", "standard output")
    return None


@contextmanager
def reading(file: str | Path) -> Iterator[None]:
    """Turns the operating system's refusal to read a file of the user's into an InputError."""
    try:
        yield
    except OSError as error:
        found = (error.strerror or "cannot be read").lower()
        raise fault(
            found, "a file that can be read", "put it back, or correct its permissions", file
        ) from error


@contextmanager
def storing(place: str | Path) -> Iterator[None]:
    """Turns the operating system's refusal to store something at `place` into an InputError."""
    try:
        yield
    except OSError as error:
        if error.errno not in _STORAGE:
            raise
        found, remedy = _STORAGE[error.errno]
        raise fault(found, "a folder that can be written to", remedy, place) from error


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A place beside `path` to write a file to: moved there at the end, or removed if it failed."""
    beside = path.with_name(f".{path.name}.unfinished")
    try:
        with storing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield beside
            os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)
