"""What a step is, and the files its names stand for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pipeline.capture import Capture
from pipeline.settings import Settings
from stages.export import triples

Learnt = Mapping[str, Any]


@dataclass(frozen=True)
class Step:
    """One step: what it reads and makes, and how.

    name, about  for people
    reads        files of the output folder; "raw" stands for a filter's photographs, "dark" and
                 "flat" for those that show the sensor. A name with {filter} stands for that
                 filter's file, or for those of all filters; one with {view} likewise, see
                 `files_of`; one with {triple} for a file every three channels, named by them: 123,
                 456, 78
    makes        files of the output folder, named likewise
    given        plain values it needs besides, from the capture, the settings and, where it is
                 done for each filter, that filter's index
    run          (paths read, paths to write, **given) -> what it learnt, for the report
    for_each     done once for each filter
    each_view    done once for each view, with what the capture is of that view alone
    several      left out where there is but one view
    calibrated   left out where the capture has no calibration
    """

    name: str
    about: str
    reads: tuple[str, ...]
    makes: tuple[str, ...]
    run: Callable[..., Learnt]
    given: Callable[[Capture, Settings, int], Mapping[str, Any]] = lambda c, s, i: {}
    for_each: bool = False
    each_view: bool = False
    several: bool = False
    calibrated: bool | None = None


def files_of(
    name: str, *, filters: Sequence[str], channels: int, views: Sequence[str | None] = (None,)
) -> list[str]:
    """The files a name in `reads` or `makes` stands for.

    filters   whose files {filter} stands for
    channels  how many {triple} deals into threes
    views     whose files {view} stands for; None alone where there is but one view, which files
              are not named by. Files of one view among several all lie in work/. {sphere} is what
              tells where the sphere is: as `locate` found it, or turned by `orient` to the others
    """
    if "{view}" in name:
        of_views = []
        for view in views:
            one = name.replace("{sphere}", "sphere" if view is None else "oriented")
            one = one.replace("{view}", "" if view is None else f"_{view}")
            one = one if view is None else f"work/{one.removeprefix('work/')}"
            of_views += files_of(one, filters=filters, channels=channels)
        return of_views
    if "{filter}" in name:
        return [name.format(filter=f) for f in filters]
    if "{triple}" in name:
        dealt = ("".join(str(i + 1) for i in triple) for triple in triples(channels))
        return [name.format(triple=numbers) for numbers in dealt]
    return [name]
