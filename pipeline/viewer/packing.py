"""Arrays as text for a page: half floats in ten significant bits, predicted, deflated, in base 85.

Everything after the rounding is lossless and in integers, so that `unpack.js` undoes it to the last
bit. Numbers that are predicted well leave small differences, which deflate well: a map of 256
texels a face in six channels, with all its mips, is three megabytes in place of twelve.
"""

from __future__ import annotations

import base64
import struct
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Codes = NDArray[np.int64]

# Base 85 of Python in characters that mean nothing to HTML.
_ALPHABET = bytes.maketrans(b"<>&`", b",.:/")

# A mip is told from the one before it: the Gaussian of stages/prefilter.py, whose sigma is 1.2 of
# the finer texels, over eight of them, in parts of 4096.
_TAPS = np.exp(-0.5 * ((np.arange(8) - 3.5) / 1.2) ** 2)
TAPS = tuple(int(w) for w in np.round(4096 * _TAPS / _TAPS.sum()))


def code(values, bits: int) -> Codes:
    """Half floats as integers in their order, rounded to some of their ten bits after the point.

    Neighbours differ by a ratio of about 1 + 2 ** -bits, whatever their size, as logarithms do.
    """
    values = np.asarray(values, np.float32)
    shift = 23 - bits
    pattern = np.abs(values).view(np.int32).astype(np.int64)
    # Single floats in their order; halves have another exponent, and from 2 ** -14 down even steps.
    ordered = (pattern - (112 << 23) + (1 << shift >> 1)) >> shift
    small = np.abs(values) < 2.0**-14
    even = np.round(np.abs(values) * 2.0 ** (14 + bits)).astype(np.int64)
    most = 0x7BFF >> (10 - bits)  # the largest that is finite
    size = np.minimum(np.where(small, even, ordered), most)
    return np.where(np.signbit(values), -size, size)


class Pack:
    """Arrays on their way into a page.

    index  what `unpack.js` must know of each: its name, its shape, and how it was told
    """

    def __init__(self) -> None:
        self.index: list[dict[str, Any]] = []
        self._parts: list[bytes] = []

    def cube(self, name: str, codes: Codes) -> None:
        """A cubemap (6, N, N, C) of codes, each told from its neighbours above and to the left."""
        self._differences(name, "cube", codes.shape, _planar(codes) - _from_neighbours(codes))

    def mip(self, name: str, codes: Codes, finer: str, finer_codes: Codes) -> None:
        """A cubemap of codes told from the mip before it, of the name `finer`."""
        differences = _planar(codes) - _planar(_coarser(finer_codes))
        self._differences(name, "mip", codes.shape, differences, base=finer)

    def like(self, name: str, codes: Codes, other: str, other_codes: Codes) -> None:
        """A cubemap of codes that is much like another of the same size."""
        self._differences(name, "like", codes.shape, _planar(codes - other_codes), base=other)

    def vectors(self, name: str, numbers: Sequence[Sequence[int]] | NDArray[Any]) -> None:
        """Integers (K, C), from -32768 to 32767, that run smoothly down the columns."""
        columns = np.asarray(numbers, np.int64).T
        differences = np.diff(np.diff(columns, prepend=0), prepend=0)
        self._differences(name, "vectors", np.shape(numbers), differences)

    def bytes(self, name: str, numbers: NDArray[np.uint8]) -> None:
        """A cubemap (6, N, N, C) of bytes."""
        rows = np.moveaxis(numbers, -1, 1).astype(np.int64)
        differences = np.diff(rows, axis=-1, prepend=0) & 0xFF
        self.index.append({"name": name, "told": "bytes", "shape": list(numbers.shape)})
        self._parts.append(differences.astype(np.uint8).tobytes())

    def text(self) -> str:
        """All of it in base 85: how many bytes follow, and these, deflated without a header."""
        deflate = zlib.compressobj(6, zlib.DEFLATED, -15, 9, zlib.Z_FILTERED)
        deflated = deflate.compress(b"".join(self._parts)) + deflate.flush()
        framed = struct.pack("<I", len(deflated)) + deflated
        return base64.b85encode(framed, pad=True).translate(_ALPHABET).decode("ascii")

    def _differences(self, name: str, told: str, shape, differences, **more: str) -> None:
        """Signs go into the lowest bit; all low bytes come first, then all high ones."""
        wrapped = ((differences + 0x8000) & 0xFFFF) - 0x8000
        folded = np.where(wrapped < 0, -2 * wrapped - 1, 2 * wrapped).astype(np.uint16)
        self.index.append({"name": name, "told": told, "shape": list(shape), **more})
        self._parts.append((folded & 0xFF).astype(np.uint8).tobytes())
        self._parts.append((folded >> 8).astype(np.uint8).tobytes())


def _planar(codes: Codes) -> Codes:
    """(6, C, N, N): a channel's texels lie together."""
    return np.moveaxis(codes, -1, 1)


def _from_neighbours(codes: Codes) -> Codes:
    """What each texel is expected to be, of those left (a), above (b) and above left of it (c).

    M. Weinberger, G. Seroussi and G. Sapiro, "The LOCO-I lossless image compression algorithm"
    (2000), section III A: a + b - c, or where there is an edge, the nearer of a and b.
    """
    q = np.pad(_planar(codes), ((0, 0), (0, 0), (1, 0), (1, 0)))
    a, b, c = q[..., 1:, :-1], q[..., :-1, 1:], q[..., :-1, :-1]
    low, high = np.minimum(a, b), np.maximum(a, b)
    return np.clip(a + b - c, low, high)


def _coarser(codes: Codes) -> Codes:
    """What the next mip is expected to be: TAPS over both axes, faces by themselves."""
    n = codes.shape[1]
    for axis in (1, 2):
        pad = [(0, 0)] * 4
        pad[axis] = (3, 3)
        wide = np.moveaxis(np.pad(codes, pad, mode="edge"), axis, 0)
        total = sum(w * wide[k : k + n - 1 : 2] for k, w in enumerate(TAPS))
        codes = np.moveaxis(np.asarray(total), 0, axis)
    return (codes + (1 << 23)) >> 24
