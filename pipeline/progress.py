"""What a run says of itself while it goes: a bar on a terminal, a line a step elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager


class Progress:
    """Says on stderr which of `total` steps is being done.

    total  number of steps
    quiet  say nothing
    """

    def __init__(self, total: int, *, quiet: bool = False):
        self.total, self.quiet, self.done = total, quiet, 0
        self._status = None
        if not quiet and sys.stderr.isatty():
            from rich.console import Console

            self._status = Console(stderr=True).status("")

    @contextmanager
    def step(self, name: str, made: str) -> Iterator[None]:
        """Around one step that is being done."""
        began = time.monotonic()
        if self._status is not None:
            self._status.update(f"[{self.done + 1}/{self.total}] {name}")
            self._status.start()
        try:
            yield
        finally:
            if self._status is not None:
                self._status.stop()
        self._say(f"{name}: {made} ({time.monotonic() - began:.1f} s)")

    def current(self, name: str) -> None:
        """One step's results are current; nothing is done."""
        self._say(f"{name}: current")

    def _say(self, text: str) -> None:
        self.done += 1
        if not self.quiet:
            print(f"[{self.done}/{self.total}] {text}", file=sys.stderr, flush=True)
