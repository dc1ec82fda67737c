"""What captures a shoot has, on this machine or by URL, and where the results of each go."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from calibration.errors import InputError, Problem
from pipeline import needs, remote
from pipeline.errors import reading
from pipeline.needs import Needs
from pipeline.settings import Settings
from pipeline.storage import Listing, Place, Storage, Url, url_of

_OF_SENSOR = frozenset({"dark", "flat"})
AT_ONCE = 8  # questions to a storage


@dataclass(frozen=True)
class Job:
    """One capture of a batch.

    name         as it is told: its path below the folder that was searched
    folder, out  where it is, and where its results go
    needs        that it is expected to take at most
    """

    name: str
    folder: Place
    out: Place
    needs: Needs

    @property
    def elsewhere(self) -> bool:
        """Whether it is brought here to be run."""
        return isinstance(self.folder, Url) or isinstance(self.out, Url)


def plan(folders: Sequence[Place], out: Place | None, settings: Settings) -> list[Job]:
    """The captures below some folders, each with a place for its results.

    out      their results go to OUT/<path below the folder>; None: build/<name of the folder>/...
    raises   InputError, before anything runs, where there is none or two would share a place
    """
    found: dict[PurePosixPath, Job] = {}
    problems: list[Problem] = []
    for folder in folders:
        if isinstance(folder, Path) and not folder.is_dir():
            what = "is not a folder" if folder.exists() else "no such folder"
            problems.append(Problem(what, "a folder of captures", "check the path", folder))
            continue
        captures = _found(folder, settings)
        if not captures:
            problems.append(
                Problem(
                    "no captures found",
                    "folders with a capture.toml, or with a sub-folder of raw files a filter",
                    "check the path",
                    folder if isinstance(folder, Path) else str(folder),
                )
            )
        name = name_of(folder)
        for below, wanted in captures.items():
            if below.parts:
                job = Job(str(below), folder / below, (out or Path("build") / name) / below, wanted)
            else:
                job = Job(name, folder, (out or Path("build")) / name, wanted)
            found.setdefault(_path(job.folder), job)  # named twice, or through a link
    jobs = list(found.values())
    problems += _collisions(jobs)
    if problems:
        raise InputError(problems)
    return jobs


def name_of(folder: Place) -> str:
    return folder.resolve().name if isinstance(folder, Path) else folder.name


def _path(place: Place) -> PurePosixPath:
    """Where it lies, however it was named."""
    return url_of(place).path


def _found(folder: Place, settings: Settings) -> dict[PurePosixPath, Needs]:
    """Captures by their paths below a folder, in order, with what each takes."""
    if isinstance(folder, Path):
        on_disk = list(_captures(lambda below: _on_disk(folder / below)))
        return {below: needs_on_disk(folder / below, settings) for below in on_disk}
    files = Storage(folder).files()
    tree = _tree(files)
    listed = list(_captures(lambda below: tree.get(below, _NOTHING)))
    of_each: dict[PurePosixPath, Listing] = {below: {} for below in listed}
    for name, state in files.items():
        path = PurePosixPath(name)
        for below in path.parents:
            if below in of_each:
                of_each[below][str(path.relative_to(below))] = state

    def wanted(below: PurePosixPath) -> Needs:
        capture = Storage(folder / below if below.parts else folder)
        return remote.needs_of(capture, of_each[below], settings)

    with ThreadPoolExecutor(AT_ONCE) as pool:
        return dict(zip(listed, pool.map(wanted, listed), strict=True))


# ------------------------------------------------------------------------------- what is a capture


@dataclass(frozen=True)
class _Folder:
    """Names of what is in a folder, in order: sub-folders that are not hidden, and files."""

    folders: list[str]
    files: list[str]


_NOTHING = _Folder([], [])
_ITSELF = PurePosixPath()


def _captures(
    look: Callable[[PurePosixPath], _Folder], folder: PurePosixPath = _ITSELF
) -> Iterator[PurePosixPath]:
    """Captures in a folder and below it, by name; not what is within them, nor calibrations.

    look    tells what is in a folder
    folder  and those given, by paths below the one that is searched
    """
    own = look(folder)
    below = {name: look(folder / name) for name in own.folders}
    if "calibration.toml" in own.files or "capture.json" in below.get("work", _NOTHING).files:
        return  # a session for `fit`; results
    if any("radiance.csv" in each.files for each in below.values()):
        return
    if "capture.toml" in own.files or any(
        any(map(needs.is_raw, each.files)) for name, each in below.items() if name not in _OF_SENSOR
    ):
        yield folder
        return
    for name in own.folders:
        yield from _captures(look, folder / name)


def _on_disk(folder: Path) -> _Folder:
    """Links to folders are left out, as they may lead in a circle."""
    with reading(folder):
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
        return _Folder(
            [
                e.name
                for e in entries
                if not e.name.startswith(".") and e.is_dir(follow_symlinks=False)
            ],
            [e.name for e in entries if not e.is_dir()],
        )


def needs_on_disk(capture: Path, settings: Settings) -> Needs:
    files = (Path(place) / name for place, _, names in os.walk(capture) for name in names)
    return needs.of_folder(filter(needs.is_raw, files), settings)


def _tree(files: Listing) -> dict[PurePosixPath, _Folder]:
    """Folders by path, of a listing of files."""
    tree: dict[PurePosixPath, _Folder] = {_ITSELF: _Folder([], [])}
    for name in sorted(files):
        path = PurePosixPath(name)
        if any(part.startswith(".") for part in path.parent.parts):
            continue
        for folder in [*path.parents][::-1]:
            if folder not in tree:
                tree[folder] = _Folder([], [])
                tree[folder.parent].folders.append(folder.name)
        tree[path.parent].files.append(path.name)
    return tree


def _collisions(jobs: Sequence[Job]) -> list[Problem]:
    """Places that would hold two captures' results, or results among photographs."""
    problems = []
    places = {_path(job.out): job for job in reversed(jobs)}
    folders = {_path(job.folder) for job in jobs}
    for job in jobs:
        mine = _path(job.out)
        others = [places[p] for p in (mine, *mine.parents) if p in places and places[p] is not job]
        if others:
            problems.append(
                Problem(
                    f"would get results of {job.folder} and of {others[0].folder}",
                    "a place for each capture",
                    "rename one, or run the folders apart with -o",
                    str(job.out),
                )
            )
        elif folders & {mine, *mine.parents}:
            problems.append(
                Problem(
                    "lies in a capture's own folder",
                    "results apart from photographs",
                    "choose another with -o",
                    str(job.out),
                )
            )
    return problems
