"""The processes in which raw files are decoded, so that a file's decoder fails alone.

LibRaw reads what thirty years of cameras, and anybody at all, wrote. Where it crashes, never ends
or wants all the memory there is, that is the end of a process of its own, and a sentence about the
file. A few of them are started when first wanted and kept; pixels come back in an open file that
both see, not through the socket. Where no process can be started, files are decoded in this one.
"""

from __future__ import annotations

import atexit
import os
import pickle
import resource
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from calibration.errors import InputError, fault
from stages.bracket import workers

S = TypeVar("S")
T = TypeVar("T")


@dataclass(frozen=True)
class Limits:
    """What decoding one file may take.

    seconds, seconds_a_mb  of processor time: so much, and more as the file is larger
    wall                   times as long by the clock: disks are slow, and laptops sleep
    memory_bytes           of addresses. LibRaw refuses by itself what takes it over 2 GiB; the
                           largest photograph we take is another 800 MB, Python and NumPy 100 MB
    """

    seconds: float = 60.0
    seconds_a_mb: float = 1.0
    wall: float = 10.0
    memory_bytes: int = 3 << 30


LIMITS = Limits()

# A process is ready in about as long as a small file takes in all; it is not worth another where
# one of those there are comes free before.
_PATIENCE_S = 0.1
_EXPECTED = "a complete raw file"
_REMEDY = "copy the file again from the camera, or leave it out"
_PROGRAM = "from pipeline.files import decoding; decoding.serve()"
_TIMES_UP = (signal.SIGPROF, signal.SIGALRM)  # by the processor's clock, and by the wall's
_HEAD = 8  # bytes of a message's length


def run(function: Callable[..., T], path: Path, *given: Any, file: int | None = None) -> T:
    """function(path, *given) in a process apart.

    function  of `pipeline.files.raw`
    path      the raw file, which is what is at fault where the process fails
    file      descriptor of an open file, that the function is given as `file=` to write to
    raises    what the function does; InputError where it crashes or exceeds LIMITS
    """
    return _decoders.run(function, path, given, file)


def each(function: Callable[[S], T], items: Iterable[S]) -> list[T]:
    """function(item) of each, several at once; an interrupt ends what is being decoded."""
    with ThreadPoolExecutor(workers()) as pool:
        try:
            return list(pool.map(function, items))
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            stop()  # lest the threads wait for them, and we for the threads
            raise


def stop() -> None:
    """Ends all processes, and whatever waits for one; others are started when wanted."""
    _decoders.stop()


# ------------------------------------------------------------------------------------- this side


class _Decoder:
    """A process that decodes one file after another; OSError where it cannot be started."""

    def __init__(self) -> None:
        ours = str(Path(__file__).parents[2])
        theirs = os.environ.get("PYTHONPATH")
        self.used = False
        self._socket, other = socket.socketpair()
        try:
            with other:
                self._process = subprocess.Popen(
                    # -P: nothing of the current folder's
                    [sys.executable or "", "-P", "-c", _PROGRAM, str(other.fileno())],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,  # where LibRaw says what it thinks of a file
                    pass_fds=[other.fileno()],
                    env={
                        **os.environ,
                        "PYTHONPATH": os.pathsep.join(filter(None, (ours, theirs))),
                        "OPENBLAS_NUM_THREADS": "1",
                    },
                )
        except BaseException:
            self._socket.close()
            raise
        try:
            _receive(self._socket)  # that it is ready
        except (EOFError, ConnectionError) as error:
            raise ChildProcessError(f"ended with status {self.end()}") from error
        except BaseException:
            self.kill()
            self.end()
            raise

    def ask(self, *asked: Any, files: Sequence[int]) -> tuple[str, Any]:
        """What `_answer` returned there; EOFError or ConnectionError where the process ended."""
        _send(self._socket, (_folder(), *asked), files)
        answer, _ = _receive(self._socket)
        self.used = True
        return answer

    def kill(self) -> None:
        """Ends it whatever it is at."""
        self._process.kill()

    def end(self) -> int:
        """Waits for it to have ended, which it does now; its exit status."""
        self._socket.close()
        return self._process.wait()

    def forget(self) -> None:
        """Lets go of it in a process that is a copy of the one it belongs to."""
        self._socket.close()
        self._process.returncode = 0


class _Decoders:
    """All there are, at most as many as threads that decode."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._alive: set[_Decoder] = set()
        self._idle: list[_Decoder] = []
        self._starting = self._stops = 0
        self._can_start = True

    def run(self, function: Callable[..., T], path: Path, given: tuple, file: int | None) -> T:
        files = [] if file is None else [file]
        before = self._stops
        while True:
            decoder = self._take(before)
            if decoder is None:
                return _here(function, path, *given, **({} if file is None else {"file": file}))
            used, limits = decoder.used, _of_file(path)
            try:
                kind, value = decoder.ask(function, path, given, *limits, files=files)
            except (EOFError, ConnectionError):
                status = self._ended(decoder)
                if self._stops != before:
                    raise KeyboardInterrupt from None
                if used and -status not in _TIMES_UP:
                    continue  # it may be the doing of a file before this: another is to try
                raise _fault(status, limits, path) from None
            except BaseException:
                decoder.kill()
                self._ended(decoder)
                raise
            with self._changed:
                self._idle.append(decoder)
                self._changed.notify()
            if kind == "error":
                raise value
            return value

    def _take(self, stops: int) -> _Decoder | None:
        """One that is idle, now or soon, or a new one; None where none can be started.

        stops  how often all had been stopped when it was first asked: not again, or nobody waits
        """
        with self._changed:
            until = time.monotonic() + _PATIENCE_S
            while True:
                if self._stops != stops:
                    raise KeyboardInterrupt
                if self._idle:
                    return self._idle.pop()
                there = len(self._alive) + self._starting
                left = until - time.monotonic()
                if not there and not self._can_start:
                    return None
                room = self._can_start and there < workers()
                if room and (not there or left <= 0):
                    self._starting += 1
                    break
                self._changed.wait(left if room else None)
        decoder = None
        try:
            decoder = _Decoder()
        except OSError:  # not allowed, too many, or no Python there to be started
            self._can_start = False
        finally:
            with self._changed:
                self._starting -= 1
                if decoder is not None:
                    self._alive.add(decoder)
                    self._idle.append(decoder)
                self._changed.notify_all()
        return self._take(stops)

    def _ended(self, decoder: _Decoder) -> int:
        status = decoder.end()
        with self._changed:
            self._alive.discard(decoder)
            self._changed.notify_all()
        return status

    def stop(self) -> None:
        with self._changed:
            self._stops += 1
            idle, self._idle = self._idle, []
            for decoder in self._alive:
                decoder.kill()
            self._changed.notify_all()
        for decoder in idle:
            self._ended(decoder)

    def forget(self) -> None:
        for decoder in self._alive:
            decoder.forget()


_decoders = _Decoders()
atexit.register(stop)


def _forget() -> None:
    """A copy of this process has none: those there are answer to one alone."""
    global _decoders
    _decoders.forget()
    _decoders = _Decoders()


os.register_at_fork(after_in_child=_forget)


def _folder() -> str:
    """What paths are relative to by now; where it was removed, there is nothing to be found."""
    try:
        return os.getcwd()
    except FileNotFoundError:
        return os.sep


def _of_file(path: Path) -> tuple[float, float, int]:
    """Seconds of processor time and by the clock, and bytes of memory, that a file may take."""
    try:
        size = path.stat().st_size
    except OSError:
        size = 0  # whoever opens it says so
    seconds = LIMITS.seconds + LIMITS.seconds_a_mb * size / 1e6
    return seconds, LIMITS.wall * seconds, LIMITS.memory_bytes


def _fault(status: int, limits: tuple[float, float, int], path: Path) -> InputError:
    """Of a file at which its decoder ended."""
    if -status in _TIMES_UP:
        seconds = limits[_TIMES_UP.index(signal.Signals(-status))]
        found = f"its decoder was still at it after {seconds:.0f} s"
    elif -status == signal.SIGKILL:
        found = "its decoder was killed, most likely for want of memory"
    elif status < 0:
        found = f"its decoder crashed ({signal.Signals(-status).name})"
    else:
        found = f"its decoder ended with status {status}"
    return fault(found, _EXPECTED, _REMEDY, path)


_ALONE = threading.Lock()


def _here(function: Callable[..., T], path: Path, *given: Any, **named: Any) -> T:
    """Without a process apart: one file at a time, as stderr is one."""
    with _ALONE, quiet():
        return function(path, *given, **named)


@contextmanager
def quiet() -> Iterator[None]:
    """Keeps LibRaw, which prints what it thinks of damaged files itself, off stderr.

    What Python prints there meanwhile, of progress, still comes through.
    """
    ours = sys.stderr
    ours.flush()
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        with os.fdopen(os.dup(kept), "w", encoding=ours.encoding, errors="replace") as sys.stderr:
            yield
    finally:
        sys.stderr = ours
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


# ------------------------------------------------------------------------------------- both sides


def _send(to: socket.socket, value: Any, files: Sequence[int] = ()) -> None:
    data = pickle.dumps(value)
    socket.send_fds(to, [len(data).to_bytes(_HEAD, "little")], files)
    to.sendall(data)


def _receive(of: socket.socket) -> tuple[Any, list[int]]:
    """A value and descriptors of files; EOFError where the other side is gone."""
    head, files, _, _ = socket.recv_fds(of, _HEAD, 1)
    left = int.from_bytes(head, "little")
    parts = []
    while left or not head:
        parts.append(of.recv(min(left, 1 << 16)) if head else b"")
        if not parts[-1]:
            raise EOFError
        left -= len(parts[-1])
    return pickle.loads(b"".join(parts)), files


# ---------------------------------------------------------------------------------- the other side


def serve() -> None:
    """What the process does: answers until nobody asks any more."""
    asked = socket.socket(fileno=int(sys.argv[1]))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; whoever asks says what then
    for number in _TIMES_UP:
        signal.signal(number, signal.SIG_DFL)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    threading.Thread(target=_end_with, args=[asked.fileno()], daemon=True).start()
    import rawpy  # noqa: F401 - before anybody waits for it

    _send(asked, "ready")
    while True:
        try:
            (folder, function, path, given, *limits), files = _receive(asked)
        except (EOFError, ConnectionError):
            return
        named = {"file": files[0]} if files else {}
        _allow(*limits)
        answer = _answer(folder, function, path, *given, **named)
        _allow(0, 0, limits[-1])
        for file in files:
            os.close(file)
        try:
            _send(asked, answer)
        except ConnectionError:
            return


def _end_with(asked: int) -> None:
    """Ends this process when nobody is there to be answered, whatever it is at.

    LibRaw lets other threads run meanwhile.
    """
    gone = select.poll()
    gone.register(asked, 0)  # but for its end
    gone.poll()
    os._exit(0)


def _allow(seconds: float, by_clock: float, memory_bytes: int) -> None:
    """Has the kernel end this process where it takes longer, and refuse it more memory."""
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.setitimer(signal.ITIMER_REAL, by_clock)
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    if most != resource.RLIM_INFINITY:
        memory_bytes = min(memory_bytes, most)
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, most))


def _answer(
    folder: str, function: Callable[..., Any], path: Path, *given: Any, **named: Any
) -> tuple[str, Any]:
    """What came of it, as it can be told to another process: "done" or "error".

    folder  that paths are relative to
    """
    try:
        os.chdir(folder)
        return "done", function(path, *given, **named)
    except (InputError, OSError) as error:
        return "error", error
    except MemoryError:
        limit = resource.getrlimit(resource.RLIMIT_AS)[0] / 1e9
        found = f"takes more than {limit:.1f} GB of memory to decode"
        return "error", fault(found, _EXPECTED, _REMEDY, path)
    except Exception:  # a mistake of ours, to be told where somebody sees it
        return "error", RuntimeError(traceback.format_exc())
