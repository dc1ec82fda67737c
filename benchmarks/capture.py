"""The whole job: the bundled capture against its truth.

The whole of `sixlight envmap sample_captures/room`, compared by benchmarks/check_sample.py.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from benchmarks.check_sample import compare
from benchmarks.figure import Figure
from pipeline import capture, runner
from pipeline.settings import Settings

CAPTURE = Path("sample_captures/room")
RESULT = Path("build/room")


def measure() -> Iterator[Figure]:
    runner.run(capture.load(CAPTURE), RESULT, Settings(), force=False, quiet=True)
    yield from compare(RESULT, CAPTURE)
