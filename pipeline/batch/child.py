"""One capture's `envmap`, in a process of its own: it may crash, hang or be killed alone."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path

from pipeline import finished, remote
from pipeline.settings import Settings
from pipeline.storage import Place, address

DONE, CURRENT, FAILED, OURS, LEFT = STATES = ("done", "current", "failed", "our fault", "not run")
BUSY = "another run is writing here"  # what `envmap` says where one is

_LIBC = ctypes.CDLL(None)  # before any fork
_PR_SET_PDEATHSIG = 1
_GRACE_S = 3.0  # that a child is given to end by itself


@dataclass
class Outcome:
    """How a capture ended.

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


def standing(folder: Place, out: Place, settings: Settings) -> Outcome | None:
    """How a capture ended that needs nothing done; None where it does."""
    if isinstance(folder, Path) and isinstance(out, Path):
        current = finished.holds(folder, out, settings)
    else:
        current = remote.holds(folder, out, settings)
    return Outcome(CURRENT, grade(folder, out)) if current else None


def grade(folder: Place, out: Place) -> str | None:
    """Of the verdict on a capture's results; None where there are none."""
    if not isinstance(folder, Path) or not isinstance(out, Path):
        return remote.grade(out)
    try:
        result = json.loads((out / "result.json").read_text(encoding="utf-8"))
        return str(result["verdict"]["grade"])
    except (OSError, ValueError, KeyError):
        return None


class Run:
    """One capture's `envmap`, running in a process and session of its own."""

    def __init__(self, folder: Place, out: Place, settings: Settings, force: bool, seconds: float):
        self.folder, self.out, self.seconds = folder, out, seconds
        self.began = time.monotonic()
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - closed when the process has ended
        self._timed_out = False
        ours = str(Path(__file__).parents[2])
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
            outcome.grade = grade(self.folder, self.out)
        elif code == 2:
            outcome.state, outcome.error = FAILED, said or ["ended without a word"]
        elif code < 0:
            outcome.state, outcome.error = FAILED, [self._killed(-code)]
            remote.clear_left()
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


def _command(folder: Place, out: Place, settings: Settings, force: bool) -> list[str]:
    program = [sys.executable, "-P", "-m", "pipeline"]  # -P: nothing of the current folder's
    arguments = ["envmap", "--quiet", "--json", "-o", address(out)]
    for name, value in asdict(settings).items():
        if value is not None:
            arguments += [f"--{name.replace('_', '-')}", str(value)]
    return [*program, *arguments, *(["--force"] if force else []), "--", address(folder)]


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
            remote.clear_left()
