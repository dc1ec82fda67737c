"""[mask] of capture.toml: what of the photographs is left out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from pipeline import io
from pipeline.files.tables import Table
from stages.mask import Mask


def read(table: Table, frame_size: tuple[int, int] | None) -> Mask:
    """The mask that polygons and a painted file make together; empty where neither is given.

    table       its problems are noted
    frame_size  height, width of the photographs; None where they are not known, being at fault
    """
    polygons = _polygons(table, frame_size)
    file = table.path("file")
    table.nothing_else()
    runs: Sequence[int] = ()
    if file is not None and frame_size is not None:
        with table.noting("file"):
            pixels = io.read_image(file)[0]
            if pixels.shape[:2] != frame_size:
                table.wrong(
                    "file",
                    f"{pixels.shape[1]} x {pixels.shape[0]} px",
                    f"the photographs' own {frame_size[1]} x {frame_size[0]} px",
                    "paint it over a photograph of full size",
                )
            else:
                runs = Mask.painted(pixels[..., 0] > 0.5).runs
    return Mask(polygons, runs)


def _polygons(table: Table, frame_size: tuple[int, int] | None):
    found = table.raw("polygons")
    if found is None:
        return ()
    expected = "[[[x, y], [x, y], [x, y], ...], ...]: a list of polygons of three corners or more"
    if not isinstance(found, list):
        table.wrong("polygons", repr(found), expected, "correct it")
        return ()
    polygons = []
    for number, polygon in enumerate(found, 1):
        name = f"polygons[{number}]"
        if not (isinstance(polygon, list) and len(polygon) >= 3 and all(map(_point, polygon))):
            table.wrong(name, repr(polygon), expected, "correct it")
            continue
        outside = [p for p in polygon if frame_size and not _inside(p, frame_size)]
        if outside and frame_size:
            table.wrong(
                name,
                f"drawn through {outside[0]}",
                f"px of the {frame_size[1]} x {frame_size[0]} photograph",
                "correct it",
            )
            continue
        polygons.append(tuple((float(x), float(y)) for x, y in polygon))
    return tuple(polygons)


def _point(value: Any) -> bool:
    return (
        isinstance(value, list)
        and len(value) == 2
        and all(isinstance(x, int | float) and not isinstance(x, bool) for x in value)
        and all(map(math.isfinite, value))
    )


def _inside(point, frame_size: tuple[int, int]) -> bool:
    return 0 <= point[0] <= frame_size[1] and 0 <= point[1] <= frame_size[0]
