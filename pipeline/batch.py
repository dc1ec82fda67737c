"""`sixlight batch`: many captures, each a process of its own, as many at once as memory allows.

Whatever happens to one, a bad photograph, a crash or an endless loop of a decoder, ends that one
alone, with a sentence. Nothing slow is imported here: a batch whose captures are all finished is
through in a second.
"""

from __future__ import annotations

import ctypes
import json
import math
import os
import shlex
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from calibration.errors import InputError, Problem, fault, legible
from pipeline import finished, tiff
from pipeline.errors import reading, storing
from pipeline.progress import Captures
from pipeline.settings import Settings

SUMMARY = "batch.json"
DONE, CURRENT, FAILED, OURS, LEFT = STATES = ("done", "current", "failed", "our fault", "not run")

# What photographers' cameras write; LibRaw, which knows for certain, would take a second to ask.
_RAW = (
    *(".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".fff", ".iiq", ".kdc"),
    *(".mef", ".mos", ".mrw", ".nef", ".nrw", ".orf", ".pef", ".ptx", ".raf", ".raw", ".rw2"),
    *(".rwl", ".sr2", ".srf", ".srw", ".x3f"),
)
BUSY = "another run is writing here"  # what `envmap` says where one is
_OF_SENSOR = frozenset({"dark", "flat"})

# Peak of a whole run, measured (benchmarks/batch.py): Python, the libraries and OpenGL; what a
# pixel of the photographs adds where the sphere fills them; and what a texel of the cube adds.
_BASE_BYTES = 620e6
_BYTES_A_PIXEL = 150.0
_BYTES_A_TEXEL = 450.0
_SHARE_OF_MEMORY = 0.8
_SPARE = 1.15  # of what the largest so far took

_LIBC = ctypes.CDLL(None)  # before any fork
_PR_SET_PDEATHSIG = 1

_POLL_S = 0.05
_GRACE_S = 3.0  # that a child is given to end by itself


@dataclass(frozen=True)
class Job:
    """One capture of a batch.

    name          as it is told: its path below the folder that was searched
    folder, out   where it is, and where its results go
    memory_bytes  that it is expected to take at most
    """

    name: str
    folder: Path
    out: Path
    memory_bytes: float


@dataclass
class Outcome:
    """How a capture of a batch ended.

    state       one of STATES
    grade       of the verdict on its results; None where there are none
    seconds     it took
    peak_bytes  of memory, as measured; 0 where nothing ran here
    error       the sentences it ended with
    """

    state: str = LEFT
    grade: str | None = None
    seconds: float = 0.0
    peak_bytes: int = 0
    error: list[str] = field(default_factory=list)


# ------------------------------------------------------------------------------------ what there is


def plan(folders: Sequence[Path], out: Path | None, settings: Settings) -> list[Job]:
    """The captures below some folders, each with a place for its results.

    out      their results go to OUT/<path below the folder>; None: build/<name of the folder>/...
    raises   InputError, before anything runs, where there is none or two would share a place
    """
    found: dict[Path, Job] = {}
    problems: list[Problem] = []
    for folder in folders:
        if not folder.is_dir():
            what = "is not a folder" if folder.exists() else "no such folder"
            problems.append(Problem(what, "a folder of captures", "check the path", folder))
            continue
        captures = list(_captures(folder))
        if not captures:
            problems.append(
                Problem(
                    "no captures found",
                    "folders with a capture.toml, or with a sub-folder of raw files a filter",
                    "check the path",
                    folder,
                )
            )
        for capture in captures:
            below = capture.relative_to(folder)
            name = folder.resolve().name
            place = (out or Path("build") / name) / below
            if capture == folder:
                place = (out or Path("build")) / name
            told = name if capture == folder else str(below)
            job = Job(told, capture, place, estimate(capture, settings))
            if capture.resolve() not in found:  # named twice, or through a link
                found[capture.resolve()] = job
    jobs = list(found.values())
    problems += _collisions(jobs)
    if problems:
        raise InputError(problems)
    return jobs


def _captures(folder: Path) -> Iterator[Path]:
    """Captures in a folder and below it, by name; not what is within them, nor calibrations."""
    entries = sorted(_folders(folder))
    if (folder / "calibration.toml").is_file() or (folder / "work" / "capture.json").is_file():
        return  # a session for `fit`; results
    if any((entry / "radiance.csv").is_file() for entry in entries):
        return
    if (folder / "capture.toml").is_file() or any(
        _raws(entry) for entry in entries if entry.name not in _OF_SENSOR
    ):
        yield folder
        return
    for entry in entries:
        yield from _captures(entry)


def _folders(folder: Path) -> list[Path]:
    """Sub-folders that are not hidden; links are left out, as they may lead in a circle."""
    with reading(folder):
        return [
            Path(e.path)
            for e in os.scandir(folder)
            if not e.name.startswith(".") and e.is_dir(follow_symlinks=False)
        ]


def _raws(folder: Path) -> list[Path]:
    with reading(folder):
        paths = sorted(folder.iterdir())
    return [p for p in paths if p.suffix.lower() in _RAW and not p.name.startswith(".")]


def _collisions(jobs: Sequence[Job]) -> list[Problem]:
    """Places that would hold two captures' results, or results among photographs."""
    problems = []
    places = {job.out.resolve(): job for job in reversed(jobs)}
    captures = {job.folder.resolve() for job in jobs}
    for job in jobs:
        mine = job.out.resolve()
        others = [places[p] for p in (mine, *mine.parents) if p in places and places[p] is not job]
        if others:
            problems.append(
                Problem(
                    f"would get results of {job.folder} and of {others[0].folder}",
                    "a place for each capture",
                    "rename one, or run the folders apart with -o",
                    job.out,
                )
            )
        elif captures & {mine, *mine.parents}:
            problems.append(
                Problem(
                    "lies in a capture's own folder",
                    "results apart from photographs",
                    "choose another with -o",
                    job.out,
                )
            )
    return problems


def estimate(capture: Path, settings: Settings) -> float:
    """Bytes of memory a capture's run will take at most, by the size of its photographs.

    That is read from the headers of files made like TIFF; of others it is taken that a pixel takes
    a byte.
    """
    raws = [path for place, _, _ in os.walk(capture) for path in _raws(Path(place))]
    largest = max(raws, key=lambda path: path.stat().st_size, default=None)
    pixels = 0.0 if largest is None else float(_pixels(largest))
    face = settings.face_size or _largest_face(pixels)
    return _BASE_BYTES + _BYTES_A_PIXEL * pixels + _BYTES_A_TEXEL * 6 * face**2


def _largest_face(pixels: float) -> float:
    """Of a sphere that fills the photograph, as `stages.unwrap.default_face_size` has it."""
    return max(64.0, 2.0 ** round(math.log2(max(pixels, 1.0) ** 0.5 / 3.0)))


def _pixels(path: Path) -> int:
    with path.open("rb") as file:
        found = tiff.largest(tiff.directories(file))
    return found or path.stat().st_size


# --------------------------------------------------------------------------------------- running


@dataclass(frozen=True)
class Limits:
    """What a batch may use.

    jobs          captures at once
    memory_bytes  that they may take together, as far as can be told before
    seconds       that one may take, lest a decoder that never ends keeps the others waiting
    """

    jobs: int
    memory_bytes: float
    seconds: float


def available_memory() -> float:
    """Bytes to plan with where nothing is said: four fifths of what the system has to give."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        told = {name: int(rest.split()[0]) for name, _, rest in (x.partition(":") for x in lines)}
        return _SHARE_OF_MEMORY * told["MemAvailable"] * 1024
    except (OSError, KeyError, ValueError):
        return _SHARE_OF_MEMORY * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def run(
    jobs: Sequence[Job],
    settings: Settings,
    limits: Limits,
    *,
    keep_going: bool = True,
    force: bool = False,
    quiet: bool = False,
) -> dict[Job, Outcome]:
    """Brings the results of all captures up to date.

    keep_going  after one that failed; otherwise those that run are ended well, no others begun
    force       as `envmap` has it
    raises      KeyboardInterrupt once all that was running has been ended
    """
    outcomes = {job: Outcome() for job in jobs}
    waiting = [job for job in jobs if not _finished(job, outcomes[job], settings)]
    running: dict[Job, Run] = {}
    with (
        Captures(len(jobs), quiet=quiet) as display,
        asked_to_end() as asked,
        ExitStack() as at_end,
    ):
        at_end.callback(lambda: stop(running.values()))
        for job in jobs:
            if outcomes[job].state == CURRENT:
                display.ended(job.name, told(outcomes[job]))
        while waiting or running:
            for job in _admitted(waiting, running, limits, _taken(outcomes)):
                waiting.remove(job)
                running[job] = Run(job.folder, job.out, settings, force, limits.seconds)
            display.running([job.name for job in running])
            time.sleep(_POLL_S)
            if asked():
                raise KeyboardInterrupt
            for job in list(running):
                outcome = running[job].poll()
                if outcome is not None:
                    outcomes[job] = outcome
                    del running[job]
                    display.ended(job.name, told(outcome))
                    if outcome.state != DONE and not keep_going:
                        waiting.clear()
    return outcomes


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


def _finished(job: Job, outcome: Outcome, settings: Settings) -> bool:
    """Whether nothing needs to be done for a capture; if so its outcome says so."""
    if not finished.holds(job.folder, job.out, settings):
        return False
    outcome.state, outcome.grade = CURRENT, grade(job.out)
    return True


def grade(out: Path) -> str | None:
    """Of the verdict on a capture's results; None where there are none."""
    try:
        result = json.loads((out / "result.json").read_text(encoding="utf-8"))
        return str(result["verdict"]["grade"])
    except (OSError, ValueError, KeyError):
        return None


def _taken(outcomes: dict[Job, Outcome]) -> float:
    """The most that a capture of this batch took, of what was expected of it; 1 before any has.

    Spheres rarely fill the photographs of a shoot, and if they do not in one they do in none.
    """
    shares = [o.peak_bytes / job.memory_bytes for job, o in outcomes.items() if o.state == DONE]
    return _SPARE * max(shares) if shares else 1.0


def _admitted(
    waiting: Sequence[Job], running: Iterable[Job], limits: Limits, share: float = 1.0
) -> list[Job]:
    """Those that may begin: within the limits, the first first; one alone whatever it takes.

    share  of the memory expected that is to be reckoned with
    """
    admitted: list[Job] = []
    count = len(list(running))
    taken = share * sum(job.memory_bytes for job in running)
    for job in waiting:
        more = share * job.memory_bytes
        if count >= limits.jobs or (count and taken + more > limits.memory_bytes):
            break
        admitted.append(job)
        count, taken = count + 1, taken + more
    return admitted


class Run:
    """One capture's `envmap`, running in a process and session of its own."""

    def __init__(self, folder: Path, out: Path, settings: Settings, force: bool, seconds: float):
        self.out, self.seconds = out, seconds
        self.began = time.monotonic()
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - closed when the process has ended
        self._timed_out = False
        ours = str(Path(__file__).parent.parent)
        theirs = os.environ.get("PYTHONPATH")
        self.process = subprocess.Popen(
            _command(folder, out, settings, force),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self._said,
            start_new_session=True,  # Ctrl-C reaches us alone, and what it means is ours to say
            preexec_fn=_end_with_parent,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (ours, theirs)))},
        )

    def poll(self) -> Outcome | None:
        """How it ended, or None while it runs."""
        pid, status, usage = os.wait4(self.process.pid, os.WNOHANG)
        seconds = time.monotonic() - self.began
        if pid == 0:
            if seconds > self.seconds and not self._timed_out:
                self._timed_out = True
                os.killpg(self.process.pid, signal.SIGKILL)
            return None
        self.process.returncode = code = os.waitstatus_to_exitcode(status)
        self._said.seek(max(0, self._said.seek(0, os.SEEK_END) - 20_000))
        said = self._said.read().decode(errors="replace").splitlines()
        self._said.close()
        outcome = Outcome(DONE, None, round(seconds, 1), usage.ru_maxrss * 1024)
        if code == 0:
            outcome.grade = grade(self.out)
        elif code == 2:
            outcome.state, outcome.error = FAILED, said or ["ended without a word"]
        elif code < 0:
            outcome.state, outcome.error = FAILED, [self._killed(-code)]
        else:
            outcome.state, outcome.error = OURS, said or [f"ended with status {code}"]
        return outcome

    def _killed(self, number: int) -> str:
        if self._timed_out:
            return (
                f"was still running after {self.seconds / 60:g} minutes and was ended; a raw file"
                " may keep its decoder busy for ever: try them one by one, or raise --time-limit"
            )
        if number == signal.SIGKILL:
            return "was killed, most likely for want of memory; lower --jobs or --memory"
        name = signal.Signals(number).name
        return (
            f"crashed ({name}), most likely in decoding; try its raw files one by one, and tell us"
        )


def _command(folder: Path, out: Path, settings: Settings, force: bool) -> list[str]:
    program = [sys.executable, "-P", "-m", "pipeline"]  # -P: nothing of the current folder's
    arguments = ["envmap", "--quiet", "--json", "-o", str(out)]
    for name, value in asdict(settings).items():
        if value is not None:
            arguments += [f"--{name.replace('_', '-')}", str(value)]
    return [*program, *arguments, *(["--force"] if force else []), "--", str(folder)]


def _end_with_parent() -> None:
    """Has the kernel tell a child when its parent is killed, which cannot do so itself."""
    if sys.platform == "linux":
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def stop(runs: Iterable[Run]) -> None:
    """Ends processes: asks, waits a little, and then insists."""
    left = [run.process for run in runs if run.process.returncode is None]
    for process in left:
        process.terminate()
    until = time.monotonic() + _GRACE_S
    for process in left:
        try:
            process.wait(max(0.0, until - time.monotonic()))
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


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


def summary(outcomes: dict[Job, Outcome], limits: Limits, out: Path) -> dict[str, Any]:
    """What batch.json holds; paths are relative to its folder."""

    def relative(path: Path) -> str:
        return os.path.relpath(path.resolve(), out.resolve())

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
                "expected_mb": round(job.memory_bytes / 1e6),
                "peak_mb": round(outcome.peak_bytes / 1e6),
                "error": outcome.error,
            }
            for job, outcome in outcomes.items()
        ],
    }


def save(content: dict[str, Any], out: Path) -> Path:
    """Writes batch.json beside its place, then moves it there."""
    path = out / SUMMARY
    text = json.dumps(content, indent=2) + "\n"
    with storing(path):
        out.mkdir(parents=True, exist_ok=True)
        beside = out / f".unfinished-{SUMMARY}"
        try:
            beside.write_text(text, encoding="utf-8")
            os.replace(beside, path)
        finally:
            beside.unlink(missing_ok=True)
    return path


def place_of_summary(folders: Sequence[Path], out: Path | None) -> Path:
    """Where batch.json goes: OUT, or where the only folder's results go, or build/."""
    if out is not None:
        return out
    return Path("build") / folders[0].resolve().name if len(folders) == 1 else Path("build")


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
        f"  ({job.memory_bytes / 1e9:.1f} GB)"
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
    return Limits(count, memory, minutes * 60)
