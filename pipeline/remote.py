"""Captures and results by URL: brought to a folder here, run, and put back whole.

Most storage knows no renaming, and none that of many files at once. So what marks results as
complete is a file, result.json: all others are stored beside their places first, under
work/unfinished-*; then it is removed, they are moved, and it comes last. Whoever reads takes
results that have one. One run at a time moves: the first that is through with a capture; whoever
made the same meanwhile finds it done. work/stored.json then keeps what was listed of all that was
read and written, and while a listing says the same there is nothing to be done.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import tempfile
import time
import tomllib
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any

from calibration.errors import InputError, Problem, fault
from pipeline import defaults, finished, needs
from pipeline.errors import storing
from pipeline.needs import Needs
from pipeline.settings import Settings
from pipeline.storage import Listing, Place, RefusedError, State, Storage, Url, url_of

STAMP = "work/stored.json"
_RESULT = "result.json"
_OWNER = "work/capture.json"
_LANDING = "work/landing"
_WORK, _UNFINISHED = "work", "unfinished-"

_OURS = "sixlight-"  # folders below TMPDIR
_STORAGE_BYTES = 100e6  # of memory: s3fs with all it imports, 40 MB as measured, and its buffers
_MOST_TOML = 1 << 20
_SILENT_S = 60.0  # after which a run that is moving its results is taken to have died
_LOOK_S = 0.5


# ---------------------------------------------------------------------------- what need not be done


def holds(capture: Place, out: Place, settings: Settings) -> bool:
    """Whether results by URL are certain to be current: by listings, no photograph is read."""
    source, target = url_of(capture), url_of(out)
    try:
        return _holds(Storage(target), _stamp(source, _inputs(source, target), settings))
    except InputError:
        return False


def grade(out: Place) -> str | None:
    """Of the verdict on results by URL; None where there are none."""
    try:
        return str(json.loads(Storage(url_of(out)).read(_RESULT) or b"")["verdict"]["grade"])
    except (InputError, ValueError, KeyError, TypeError):
        return None


def _holds(target: Storage, stamp: dict[str, Any]) -> bool:
    kept = _read_json(target, STAMP)
    if kept is None or not isinstance(kept.get("made"), dict):
        return False
    listing = target.files()
    made = {name: listing.get(name) for name in kept["made"]}
    states = [*stamp["inputs"].values(), *made.values()]
    certain = all(state is not None and len(state) > 1 for state in states)
    return certain and kept == {**stamp, "made": made}


def _stamp(source: Url, inputs: dict[Url, Listing], settings: Settings) -> dict[str, Any]:
    return {
        "capture": str(source),
        "inputs": {
            os.path.normpath(os.path.relpath(folder.path / name, source.path)): state
            for folder, files in inputs.items()
            for name, state in files.items()
        },
        "settings": vars(settings),
        "code": finished.code(),
        "versions": finished.versions(),
    }


def _inputs(source: Url, target: Url) -> dict[Url, Listing]:
    """All that a run reads, by folder: the capture's files, each defaults.toml above it that may
    be read, and what that refers to. Results that lie in the capture's folder are none of it."""
    files = Storage(source).files()
    mine = {n: s for n, s in files.items() if not (source.path / n).is_relative_to(target.path)}
    found = {source: mine}
    for folder in _above(source):
        above = Storage(folder)
        try:
            own = above.state(defaults.NAME)
        except RefusedError:
            break
        if own is None:
            continue
        found[folder] = {defaults.NAME: own}
        for name in _referred(above, own):
            state = above.state(name)
            found[folder] |= {name: state} if state is not None else above.files(name)
    return found


def _above(source: Url) -> list[Url]:
    if source.path.parts[1] == "file":
        path = Path("/", *source.path.parts[2:])
        return [url_of(file.parent) for file in defaults.above(path)] if path.is_dir() else []
    return source.parents


def _referred(above: Storage, own: State) -> list[str]:
    """What may be names of files beside a defaults.toml in it; none where it is no TOML, which the
    run will say."""
    if int(own[0]) > _MOST_TOML:
        return []
    try:
        tables = tomllib.loads((above.read(defaults.NAME) or b"").decode())
    except (ValueError, RecursionError):
        return []
    words = [w for t in tables.values() if isinstance(t, dict) for w in t.values()]
    paths = [PurePosixPath(word) for word in words if isinstance(word, str)]
    return [str(p) for p in paths if p.parts and not p.is_absolute() and ".." not in p.parts]


def _write_json(storage: Storage, name: str, content: dict[str, Any]) -> None:
    storage.write(name, f"{json.dumps(content, indent=2)}\n".encode())


def _read_json(storage: Storage, name: str) -> dict[str, Any] | None:
    try:
        content = json.loads(storage.read(name) or b"null")
    except ValueError:
        return None
    return content if isinstance(content, dict) else None


# ------------------------------------------------------------------------------------- running here


def needs_of(capture: Storage, files: Listing, settings: Settings) -> Needs:
    """What running a capture takes, its photographs brought here; reads the head of one."""
    sizes = {name: int(state[0]) for name, state in files.items()}
    largest = needs.largest_raw(sizes)
    if largest is None or sizes[largest] == 0:
        own = needs.of_pixels(0.0, settings)
    else:
        head = capture.read(largest, first=needs.HEADER_BYTES) or b""
        own = needs.of_header(sizes[largest], head, settings)
    return Needs(own.memory_bytes + _STORAGE_BYTES, own.disk_bytes + sum(sizes.values()))


@contextmanager
def here(
    capture: Place, out: Place, settings: Settings, *, force: bool = False
) -> Iterator[tuple[Path, Path]]:
    """A capture's folder and the folder for its results, both on this machine.

    They are the ones given where both are paths. If one is a URL a work folder below TMPDIR, gone
    afterwards, holds what stands for it, and the results until, all having gone well, they are put
    into their place.

    force   as `runner.run` has it
    raises  InputError that names URLs, not what stood for them here
    """
    if isinstance(capture, Path) and isinstance(out, Path):
        yield capture, out
        return
    source, target = Storage(url_of(capture)), Storage(url_of(out))
    inputs = _inputs(source.url, target.url)
    if not inputs[source.url]:
        raise fault("nothing is there", "a folder of a capture", "check the URL", str(source.url))
    _claim(source.url, target, force)
    with _work_folder() as work:
        try:
            _check_space(work, needs_of(source, inputs[source.url], settings))
            folder, place = (_stand_in(work, url) for url in (source.url, target.url))
            if isinstance(capture, Path):
                folder = capture
            else:
                _bring(inputs, target.url, work)
            yield folder, place
            _land(target, place, _stamp(source.url, inputs, settings))
        except InputError as error:
            raise _told(error, work, source.url, target.url) from error


def _stand_in(work: Path, url: Url) -> Path:
    """The folder here that stands for one by URL: laid out alike, so that relative paths hold."""
    return work / url.path.relative_to("/")


def _claim(source: Url, target: Storage, force: bool) -> None:
    """As the runner does it on disk: results are of one capture, and nothing else lies there. That
    it can be written to shows before a long run, not after."""
    mine = {"capture": os.path.relpath(source.path, target.url.path)}
    theirs = _read_json(target, _OWNER)
    if theirs == mine:
        return
    if not force and (theirs is not None or target.files()):
        raise fault(
            "holds files that sixlight did not write"
            if theirs is None
            else f"holds results of another capture ({theirs.get('capture')})",
            "an empty folder or earlier results of the same capture",
            "choose another with -o, or --force",
            str(target.url),
        )
    _write_json(target, _OWNER, mine)


def _check_space(work: Path, wanted: Needs) -> None:
    free = shutil.disk_usage(work).free
    if free < wanted.disk_bytes:
        raise fault(
            f"{free / 1e9:.1f} GB are free",
            f"{wanted.disk_bytes / 1e9:.1f} GB for the capture and what is made of it",
            "free some, or have TMPDIR name a larger disk",
            work.parent,
        )


def _bring(inputs: dict[Url, Listing], target: Url, work: Path) -> None:
    """Copies a capture to this machine; InputError where a file changed or vanished meanwhile."""
    source = next(iter(inputs))
    failed: InputError | None = None
    try:
        for folder, files in inputs.items():
            Storage(folder).get(files, _stand_in(work, folder))
    except InputError as error:
        failed = error
    now = _inputs(source, target)
    for folder, files in inputs.items():
        for name, state in files.items():
            if (still := now.get(folder, {}).get(name)) != state:
                raise fault(
                    "is gone" if still is None else "has changed since the run began",
                    "photographs that stay as they are while they are read",
                    "run again once it is there, complete",
                    str(folder / name),
                ) from failed
    if failed is not None:
        raise failed


def _told(error: InputError, work: Path, *urls: Url) -> InputError:
    """The same error, with URLs where it names what stands for them here."""
    known = {str(_stand_in(work, u)): str(u) for url in urls for u in (url, *url.parents)}

    def named(text: str) -> str:
        for folder in sorted(known, key=len, reverse=True):
            text = text.replace(folder, known[folder])
        return text

    def remedy(p: Problem) -> str:
        if p.file is not None and Path(p.file).is_relative_to(work) and "-o" in p.remedy:
            return "have TMPDIR name a folder with room"  # it is not where -o leads that lacks it
        return named(p.remedy)

    return InputError(
        Problem(
            named(p.found),
            named(p.expected),
            remedy(p),
            None if p.file is None else named(str(p.file)),
        )
        for p in error.problems
    )


@contextmanager
def _work_folder() -> Iterator[Path]:
    """A folder of ours below TMPDIR, gone afterwards. While it is locked it is in use."""
    clear_left()
    with storing(tempfile.gettempdir()):
        new = Path(tempfile.mkdtemp(prefix=f".{_OURS}")).resolve()
        lock = (new / defaults.ROOT).open("w")
    with lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        work = new.rename(new.with_name(new.name[1:]))  # locked before it goes by that name
        try:
            yield work
        finally:
            shutil.rmtree(work, ignore_errors=True)


def clear_left() -> None:
    """Removes work folders whose process was killed."""
    for work in Path(tempfile.gettempdir()).glob(f"{_OURS}*"):
        with suppress(OSError):  # someone else's, gone, or in use
            if work.lstat().st_uid == os.getuid():
                with (work / defaults.ROOT).open() as lock:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(work)


# ------------------------------------------------------------------------------------- putting back


def _land(target: Storage, place: Path, stamp: dict[str, Any]) -> None:
    """Puts results into their place; see above for how. What stood there stays until all is
    stored beside it; what cannot be stored leaves it as it was."""
    names = sorted(
        str(file.relative_to(place))
        for file in place.rglob("*")
        if file.is_file() and _is_kept(file.relative_to(place).as_posix())
    )
    beside = f"{_WORK}/{_UNFINISHED}{uuid.uuid4().hex}"
    try:
        target.put(place, names, beside)
        with _alone(target) as still_here:
            if _holds(target, stamp):
                return  # another run made the same meanwhile
            before = (_read_json(target, STAMP) or {}).get("made", {})
            # Holds for nothing, and names all that may be there now.
            _write_json(target, STAMP, {**stamp, "made": dict.fromkeys({*before, *names})})
            target.remove([_RESULT])
            for name in (n for n in names if n != _RESULT):
                still_here()
                target.move([(f"{beside}/{name}", name)])
            target.remove(set(before) & set(target.files()) - set(names))
            target.move([(f"{beside}/{_RESULT}", _RESULT)])
            listing = target.files()
            made = {name: listing.get(name) for name in names}
            _write_json(target, STAMP, {**stamp, "made": made})
            for left in target.folders(_WORK):
                if left.startswith(_UNFINISHED):
                    target.remove_folder(f"{_WORK}/{left}")
    finally:
        with suppress(InputError):
            target.remove_folder(beside)


def _is_kept(name: str) -> bool:
    """Results, and of what is in work/ the small files that `verify` reads. Whose they are was
    said there before."""
    return not name.startswith("work/") or name.endswith(".made.json")


@contextmanager
def _alone(target: Storage) -> Iterator[Callable[[], None]]:
    """Around what one run at a time may do in a place; gives what is to be called meanwhile.

    Whoever holds the place writes to its mark again and again; a mark that stays the same is of one
    that died. No clocks are compared.
    """
    mine = uuid.uuid4().hex
    seen, since = b"", time.monotonic()
    while not target.write(_LANDING, mine.encode(), new=True):
        mark = target.read(_LANDING) or b""
        if mark != seen:
            seen, since = mark, time.monotonic()
        elif time.monotonic() - since > _SILENT_S:
            target.remove([_LANDING])
        else:
            time.sleep(_LOOK_S)
    told = time.monotonic()

    def still_here() -> None:
        nonlocal told
        if time.monotonic() - told > _SILENT_S / 10:
            told = time.monotonic()
            target.write(_LANDING, f"{mine} {told}".encode())

    try:
        yield still_here
    finally:
        target.remove([_LANDING])
