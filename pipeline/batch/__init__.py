"""`sixlight batch`: many captures, each a process of its own, as many at once as memory allows.

Whatever happens to one, a bad photograph, a crash or an endless loop of a decoder, ends that one
alone, with a sentence. Nothing slow is imported here: a batch whose captures are all finished is
through in a second.
"""

from __future__ import annotations

import json
import os
import shlex
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from calibration.errors import fault, legible
from pipeline.batch import child
from pipeline.batch.child import CURRENT, DONE, FAILED, LEFT, OURS, STATES, Outcome, Run
from pipeline.batch.shoot import AT_ONCE, Job, name_of
from pipeline.errors import storing
from pipeline.progress import Captures
from pipeline.settings import Settings
from pipeline.storage import Place, Storage, Url

SUMMARY = "batch.json"
_UNFINISHED = f".unfinished-{SUMMARY}"

_SHARE_OF_MEMORY = 0.8
_SHARE_OF_DISK = 0.8
_SPARE = 1.15  # of what the largest so far took
_POLL_S = 0.05


# --------------------------------------------------------------------------------------- running


@dataclass(frozen=True)
class Limits:
    """What a batch may use.

    jobs          captures at once
    memory_bytes  that they may take together, as far as can be told before
    seconds       that one may take, lest a decoder that never ends keeps the others waiting
    disk_bytes    that those brought here may take together, while they run
    """

    jobs: int
    memory_bytes: float
    seconds: float
    disk_bytes: float


@dataclass(frozen=True)
class Orders:
    """How a batch's captures are to be run.

    keep_going  after one that failed; otherwise those that run are ended well, no others begun
    force       as `envmap` has it
    """

    settings: Settings
    limits: Limits
    keep_going: bool = True
    force: bool = False


Running = Callable[[Sequence[str]], None]  # is told the names of those that run
Ended = Generator[tuple[Job, Outcome]]  # each capture when it has ended; those not begun are not in
Runner = Callable[[Sequence[Job], Orders, Running], Ended]


def run(
    jobs: Sequence[Job], orders: Orders, *, by: Runner | None = None, quiet: bool = False
) -> dict[Job, Outcome]:
    """Brings the results of all captures up to date.

    by      what runs them: `here`, or the workers of a `cluster`
    raises  KeyboardInterrupt once all that was running has been ended
    """
    outcomes = {job: Outcome() for job in jobs}
    with (
        Captures(len(jobs), quiet=quiet) as display,
        closing((by or here)(jobs, orders, display.running)) as ended,
    ):
        for job, outcome in ended:
            outcomes[job] = outcome
            display.ended(job.name, told(outcome))
    return outcomes


def here(jobs: Sequence[Job], orders: Orders, running: Running) -> Ended:
    """Runs captures on this machine, as many at once as its limits allow."""
    with ThreadPoolExecutor(AT_ONCE) as pool:  # storage far away takes its time to answer
        looked = pool.map(lambda j: child.standing(j.folder, j.out, orders.settings), jobs)
        outcomes = {job: outcome for job, outcome in zip(jobs, looked, strict=True) if outcome}
    yield from list(outcomes.items())
    waiting = [job for job in jobs if job not in outcomes]
    runs: dict[Job, Run] = {}
    with asked_to_end() as asked, ExitStack() as at_end:
        at_end.callback(lambda: child.stop(runs.values()))
        while waiting or runs:
            for job in _admitted(waiting, runs, orders.limits, _taken(outcomes)):
                waiting.remove(job)
                limit_s = orders.limits.seconds
                runs[job] = Run(job.folder, job.out, orders.settings, orders.force, limit_s)
            running([job.name for job in runs])
            time.sleep(_POLL_S)
            if asked():
                raise KeyboardInterrupt
            for job in list(runs):
                outcome = runs[job].poll()
                if outcome is not None:
                    outcomes[job] = outcome
                    del runs[job]
                    if outcome.state != DONE and not orders.keep_going:
                        waiting.clear()
                    yield job, outcome


@contextmanager
def asked_to_end() -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C or SIGTERM came meanwhile: noted, lest it come between a process's beginning
    and our knowing of it."""
    came: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    kept = {
        number: signal.signal(number, lambda number, _: came.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield lambda: bool(came)
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)


def _taken(outcomes: dict[Job, Outcome]) -> float:
    """The most that a capture of this batch took, of what was expected of it; 1 before any has.

    Spheres rarely fill the photographs of a shoot, and if they do not in one they do in none.
    """
    shares = [
        o.peak_bytes / job.needs.memory_bytes for job, o in outcomes.items() if o.state == DONE
    ]
    return _SPARE * max(shares) if shares else 1.0


def _admitted(
    waiting: Sequence[Job], running: Iterable[Job], limits: Limits, share: float = 1.0
) -> list[Job]:
    """Those that may begin: within the limits, the first first; one alone whatever it takes.

    share  of the memory expected that is to be reckoned with
    """
    admitted: list[Job] = []
    before = list(running)
    for job in waiting:
        begun = [*before, *admitted]
        together = [*begun, job]
        memory = share * sum(each.needs.memory_bytes for each in together)
        disk = sum(each.needs.disk_bytes for each in together if each.elsewhere)
        fits = memory <= limits.memory_bytes and disk <= limits.disk_bytes
        if len(begun) >= limits.jobs or (begun and not fits):
            break
        admitted.append(job)
    return admitted


def available_memory() -> float:
    """Bytes to plan with where nothing is said: four fifths of what the system has to give."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        told = {name: int(rest.split()[0]) for name, _, rest in (x.partition(":") for x in lines)}
        return _SHARE_OF_MEMORY * told["MemAvailable"] * 1024
    except (OSError, KeyError, ValueError):
        return _SHARE_OF_MEMORY * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


# --------------------------------------------------------------------------------------- telling


def told(outcome: Outcome) -> str:
    """An outcome in a line."""
    if outcome.state == DONE:
        return f"{outcome.grade} ({outcome.seconds:.1f} s)"
    if outcome.state == CURRENT:
        return f"{outcome.grade} (current)"
    last = outcome.error[-1:] or [""]
    return f"{outcome.state}: {last[0]}" if outcome.error else outcome.state


def status(outcomes: Iterable[Outcome]) -> int:
    """Of the command: 1 where one failed by a fault of ours, 2 by its input, else 0."""
    states = {outcome.state for outcome in outcomes}
    return 1 if OURS in states else 2 if FAILED in states else 0


def summary(outcomes: dict[Job, Outcome], limits: Limits, out: Place) -> dict[str, Any]:
    """What batch.json holds; of paths, where it lies by a path itself, relative to its folder."""

    def relative(place: Place) -> str:
        if isinstance(place, Url) or isinstance(out, Url):
            return str(place)
        return os.path.relpath(place.resolve(), out.resolve())

    return {
        "sixlight": version("sixlight"),
        "jobs": limits.jobs,
        "memory_mb": round(limits.memory_bytes / 1e6),
        "captures": [
            {
                "name": job.name,
                "capture": relative(job.folder),
                "out": relative(job.out),
                "state": outcome.state,
                "grade": outcome.grade,
                "seconds": outcome.seconds,
                "expected_mb": round(job.needs.memory_bytes / 1e6),
                "peak_mb": round(outcome.peak_bytes / 1e6),
                "error": outcome.error,
            }
            for job, outcome in outcomes.items()
        ],
    }


def save(content: dict[str, Any], out: Place) -> None:
    """Writes batch.json beside its place, then moves it there."""
    text = json.dumps(content, indent=2) + "\n"
    if isinstance(out, Url):
        storage = Storage(out)
        storage.write(_UNFINISHED, text.encode())
        storage.move([(_UNFINISHED, SUMMARY)])
        return
    path = out / SUMMARY
    with storing(path):
        out.mkdir(parents=True, exist_ok=True)
        beside = out / _UNFINISHED
        try:
            beside.write_text(text, encoding="utf-8")
            os.replace(beside, path)
        finally:
            beside.unlink(missing_ok=True)


def place_of_summary(folders: Sequence[Place], out: Place | None) -> Place:
    """Where batch.json goes: OUT, or where the only folder's results go, or build/."""
    if out is not None:
        return out
    return Path("build") / name_of(folders[0]) if len(folders) == 1 else Path("build")


def as_text(outcomes: dict[Job, Outcome]) -> str:
    """A table for people: a line a capture, the sentences of those that failed, and the sums."""
    rows = [("capture", "verdict", "seconds", "")]
    for job, outcome in outcomes.items():
        seconds = "" if outcome.state in (CURRENT, LEFT) else f"{outcome.seconds:.1f}"
        errors = outcome.error[-1:] if outcome.state == OURS else outcome.error
        first, *more = errors or ["current" if outcome.state == CURRENT else ""]
        grade = outcome.grade if outcome.state in (DONE, CURRENT) else outcome.state
        rows.append((legible(job.name), grade or "", seconds, legible(first)))
        rows += [("", "", "", legible(line)) for line in more]
    widths = [max(len(row[i]) for row in rows) for i in range(3)]
    lines = [
        f"{name:<{widths[0]}}  {grade:<{widths[1]}}  {seconds:>{widths[2]}}  {error}".rstrip()
        for name, grade, seconds, error in rows
    ]
    states = [outcome.state for outcome in outcomes.values()]
    counts = ", ".join(f"{states.count(s)} {s}" for s in STATES if s in states)
    return "\n".join([*lines, f"{len(states)} captures: {counts}"])


def plan_as_text(jobs: Sequence[Job], limits: Limits) -> str:
    """What `--dry-run` says."""
    lines = [
        f"{shlex.quote(legible(str(job.folder)))} -> {shlex.quote(legible(str(job.out)))}"
        f"  ({job.needs.memory_bytes / 1e9:.1f} GB)"
        for job in jobs
    ]
    admitted = len(_admitted(jobs, [], limits))
    return "\n".join(
        [
            *lines,
            f"{len(jobs)} captures, {admitted} at once in {limits.memory_bytes / 1e9:.1f} GB",
        ]
    )


def limits_of(jobs: int | None, memory_gb: float | None, minutes: float) -> Limits:
    """Limits as the command line has them, with what stands for what is not given."""
    count = jobs or max(1, len(os.sched_getaffinity(0)) // 2)
    if memory_gb is not None and memory_gb <= 0:
        raise fault(f"--memory {memory_gb:g}", "GB, above 0", "correct it")
    memory = available_memory() if memory_gb is None else memory_gb * 1e9
    disk = _SHARE_OF_DISK * shutil.disk_usage(tempfile.gettempdir()).free
    return Limits(count, memory, minutes * 60, disk)
