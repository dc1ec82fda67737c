"""The directories of TIFF files, and of raw files made like them: CR2, NEF, ARW, PEF, ORF, DNG.

Only what says where image data lie: LibRaw and exifread read everything else.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from typing import BinaryIO

_MAGIC = (42, 0x4F52, 0x5352, 0x55)  # TIFF; Olympus's two; Panasonic's
_SIZES = {3: ("H", 2), 4: ("I", 4), 13: ("I", 4)}  # whole numbers; other types are passed over
_WIDTH, _HEIGHT = 256, 257
_SUB_DIRECTORIES = 330
_DATA = ((273, 279), (324, 325))  # offsets and byte counts of strips, and of tiles
_ACTIVE_AREA = 50829  # of a DNG: top, left, bottom, right
_MOST = 64  # directories, lest one that points to itself never ends

Directory = dict[int, tuple[int, ...]]  # tag -> numbers


def directories(file: BinaryIO) -> list[Directory]:
    """All directories with their sub-directories; empty where the file is no TIFF, or is cut."""
    try:
        return list(_directories(file))
    except (struct.error, OverflowError):
        return []


def data_end(directories: list[Directory]) -> int | None:
    """Where the last image data end, in bytes from the file's beginning; None: nothing says so."""
    ends = [
        offset + count
        for directory in directories
        for offsets, counts in _DATA
        for offset, count in zip(
            directory.get(offsets, ()), directory.get(counts, ()), strict=False
        )
    ]
    return max(ends, default=None)


def largest(directories: list[Directory]) -> int | None:
    """Pixels of the largest image, as the directories claim; None where they hold none."""
    claims = [
        directory[_WIDTH][0] * directory[_HEIGHT][0]
        for directory in directories
        if directory.get(_WIDTH) and directory.get(_HEIGHT)
    ]
    return max(claims, default=None)


def active_area(directories: list[Directory]) -> tuple[int, int] | None:
    """Top and left of a DNG's active area; None where there is none."""
    for directory in directories:
        if len(directory.get(_ACTIVE_AREA, ())) == 4:
            top, left, *_ = directory[_ACTIVE_AREA]
            return top, left
    return None


def _directories(file: BinaryIO) -> Iterator[Directory]:
    length_of_file = file.seek(0, os.SEEK_END)
    file.seek(0)
    head = file.read(8)
    order = {b"II": "<", b"MM": ">"}.get(head[:2])
    if order is None:
        return
    magic, first = struct.unpack(order + "HI", head[2:])
    if magic not in _MAGIC:
        return
    waiting, seen = [first], set[int]()
    while waiting and len(seen) < _MOST:
        at = waiting.pop()
        if at in seen or at == 0:
            continue
        seen.add(at)
        file.seek(at)
        (count,) = struct.unpack(order + "H", file.read(2))
        entries = file.read(12 * count)
        (following,) = struct.unpack(order + "I", file.read(4))
        directory = {}
        for tag, kind, length, value in struct.iter_unpack(order + "HHI4s", entries):
            if kind not in _SIZES:
                continue
            letter, size = _SIZES[kind]
            if length * size > 4:
                file.seek(struct.unpack(order + "I", value)[0])
                value = file.read(min(length * size, length_of_file))  # what claims more is cut
            directory[tag] = struct.unpack_from(f"{order}{length}{letter}", value)
        yield directory
        waiting += [following, *directory.get(_SUB_DIRECTORIES, ())]
