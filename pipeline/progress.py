"""What a run says of itself while it goes: a bar on a terminal, a line a step elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from calibration.errors import legible


def _bar():
    """The bar, on stderr, gone when it has ended."""
    from rich import progress
    from rich.console import Console

    return progress.Progress(
        progress.SpinnerColumn(),
        progress.TextColumn("{task.description}", markup=False),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
    )


class Progress:
    """Says on stderr which of `total` steps is being done.

    total  number of steps
    quiet  say nothing
    """

    def __init__(self, total: int, *, quiet: bool = False):
        self.total, self.quiet, self.done = total, quiet, 0
        self._bar = None
        if not quiet and sys.stderr.isatty():
            self._bar = _bar()
            self._task = self._bar.add_task("", total=total)

    @contextmanager
    def step(self, name: str, made: str) -> Iterator[None]:
        """Around one step that is being done."""
        began = time.monotonic()
        if self._bar is not None:
            self._bar.update(self._task, description=legible(name), completed=self.done)
            self._bar.start()
        try:
            yield
        finally:
            if self._bar is not None:
                self._bar.stop()
        self._say(f"{name}: {made} ({time.monotonic() - began:.1f} s)")

    @contextmanager
    def again(self, name: str) -> Iterator[None]:
        """Around one that is done again for what it left, which had been removed."""
        if not self.quiet:
            print(f"again: {legible(name)}", file=sys.stderr, flush=True)
        yield

    def current(self, name: str) -> None:
        """One step's results are current; nothing is done."""
        self._say(f"{name}: current")

    def _say(self, text: str) -> None:
        self.done += 1
        if not self.quiet:
            print(f"[{self.done}/{self.total}] {legible(text)}", file=sys.stderr, flush=True)


class Captures:
    """Says on stderr how a batch goes: one bar on a terminal, a line a capture elsewhere.

    total  number of captures
    quiet  say nothing
    """

    def __init__(self, total: int, *, quiet: bool = False):
        self.total, self.quiet, self.done = total, quiet, 0
        self._bar = None
        self._running: list[str] = []
        if not quiet and sys.stderr.isatty():
            self._bar = _bar()

    def __enter__(self) -> Captures:
        if self._bar is not None:
            self._bar.start()
            self._task = self._bar.add_task("", total=self.total)
        return self

    def __exit__(self, *_) -> None:
        if self._bar is not None:
            self._bar.stop()

    def running(self, names: Sequence[str]) -> None:
        """Which captures are being done."""
        if self._bar is not None and names != self._running:
            self._running = list(names)
            self._bar.update(self._task, description=legible(", ".join(names))[:60])

    def ended(self, name: str, how: str) -> None:
        """One has ended."""
        self.done += 1
        line = legible(f"[{self.done}/{self.total}] {name}: {how}")
        if self._bar is not None:
            self._bar.update(self._task, completed=self.done)
            self._bar.console.print(line, markup=False, highlight=False)
        elif not self.quiet:
            print(line, file=sys.stderr, flush=True)
