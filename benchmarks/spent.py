"""What this process and the programs it runs have taken, those that are still there included."""

from __future__ import annotations

import os
import resource
import time
from pathlib import Path


def cpu_s() -> float:
    """Seconds of processor time, of all threads and programs together."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    ticks = os.sysconf("SC_CLK_TCK")
    living = sum(sum(map(int, _stat(pid)[11:13])) for pid in _children())  # utime, stime
    return time.process_time() + ended.ru_utime + ended.ru_stime + living / ticks


def peak_mb() -> float:
    """The most memory that each of those that are there has held, added up.

    Not getrusage's, which begins at what the parent process had.
    """
    kilobytes = 0
    for pid in ("self", *_children()):
        status = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
        kilobytes += int(status.split("VmHWM:")[1].split()[0])
    return kilobytes / 1e3


def _children() -> list[str]:
    return [str(pid) for task in Path("/proc/self/task").iterdir() for pid in _of_thread(task)]


def _of_thread(task: Path) -> list[str]:
    return (task / "children").read_text(encoding="ascii").split()


def _stat(pid: str) -> list[str]:
    """The fields of proc(5) from the third on: the second is a name, with any characters."""
    return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
