"""Captures done by a Dask cluster of real processes, a worker of which is killed now and again.

    python -m benchmarks.cluster [COUNT] [--workers N] [--every SECONDS] [--seed N] [--bands]

Each capture must be done once, and each result must be, byte for byte, what one machine makes. A
worker that was killed is replaced by another. Needs the extra `cluster`; and a processor for each
worker, or kills that are so much rarer, for what takes longer than a worker lives is never done.
With --bands the captures have no calibration, which leaves them half the steps, all of them short.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.kills import made, problems, small

_LONGEST_S = 60.0  # that a scheduler may take to come up
_SETTINGS = ("--preview-width", "192")


@dataclass
class Cluster:
    """A scheduler and its workers on this machine.

    folder   for what they write down
    workers  processes; one that was killed is replaced
    """

    folder: Path
    workers: list[subprocess.Popen] = field(default_factory=list)
    _begun: list[subprocess.Popen] = field(default_factory=list)

    @property
    def _file(self) -> Path:
        return self.folder / "scheduler.json"

    def address(self) -> str:
        """Of the scheduler, which is started."""
        self._start("dask_scheduler", "--host", "127.0.0.1", "--port", "0")
        until = time.monotonic() + _LONGEST_S
        while not self._file.exists() or not self._file.read_text():
            if time.monotonic() > until:
                raise SystemExit(f"no scheduler within {_LONGEST_S:.0f} s: see {self.folder}")
            time.sleep(0.1)
        return str(json.loads(self._file.read_text())["address"])

    def add_worker(self) -> None:
        name = f"worker{len(self._begun)}"
        scratch = "--local-directory", self.folder / name
        options = "--no-nanny", "--nthreads", "1", "--name", name, *scratch
        self.workers.append(self._start("dask_worker", *options))

    def replace(self, number: int) -> None:
        """Kills a worker, and starts another."""
        killed = self.workers.pop(number)
        killed.kill()
        killed.wait()
        self.add_worker()

    def end(self) -> None:
        for process in reversed(self._begun):
            process.kill()
            process.wait()

    def _start(self, module: str, *options) -> subprocess.Popen:
        program = sys.executable, "-m", f"distributed.cli.{module}", "--scheduler-file", self._file
        with (self.folder / f"{module}{len(self._begun)}.log").open("w") as log:
            process = subprocess.Popen(
                [*program, *options, "--no-dashboard"],
                stdout=log,
                stderr=log,
                env=os.environ | {"PYTHONPATH": os.getcwd(), "OMP_NUM_THREADS": "1"},
            )
        self._begun.append(process)
        return process


@contextmanager
def cluster(folder: Path, workers: int) -> Iterator[tuple[Cluster, str]]:
    """A cluster on this machine, and its scheduler's address; ended with the block."""
    folder.mkdir()
    started = Cluster(folder)
    try:
        address = started.address()
        for _ in range(workers):
            started.add_worker()
        yield started, address
    finally:
        started.end()


def done_under_kills(
    place: Path, count: int, workers: int, every_s: float, seed: int, *, bands: bool
) -> tuple[int, list[str]]:
    """How many workers were killed, and a sentence for each result that is not as it ought to be.

    place  empty folder, for the captures and all that is made of them
    bands  whether the captures are to have no calibration
    """
    capture, here = small(place / "small"), place / "here"
    if bands:
        toml = capture / "capture.toml"
        toml.write_text(toml.read_text().split("[calibration]")[0])
    shoot, out = place / "shoot", place / "out"
    for i in range(count):
        shutil.copytree(capture, shoot / f"c{i:02}")
    run = sys.executable, "-m", "pipeline"
    alone = [*run, "envmap", capture, "-o", here, "--quiet", *_SETTINGS]
    subprocess.run(alone, check=True, stdout=subprocess.DEVNULL)
    moments, kills = random.Random(seed), 0
    with cluster(place / "cluster", workers) as (ours, address):
        given = "-o", out, "--scheduler", address, "--json", "--quiet", *_SETTINGS
        with subprocess.Popen([*run, "batch", shoot, *given], stdout=subprocess.PIPE) as batch:
            while batch.poll() is None:
                try:
                    batch.wait(moments.uniform(0.5, 1.5) * every_s)
                except subprocess.TimeoutExpired:
                    ours.replace(moments.randrange(workers))
                    kills += 1
            assert batch.stdout is not None
            told = json.loads(batch.stdout.read())
    wrong = [
        f"{one['capture']}: {one['state']}, {one['error']}"
        for one in told["captures"]
        if one["state"] not in ("done", "current")  # current: its worker died before it said so
    ]
    if len(told["captures"]) != count:
        wrong.append(f"{len(told['captures'])} captures are told of, not {count}")
    expected = made(here)
    for i in range(count):
        results = out / f"c{i:02}"
        if made(results) != expected:
            wrong.append(f"{results.name}: not what one machine makes")
        wrong += [f"{results.name}: {what}" for what in problems(results) or ()]
    return kills, wrong


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", nargs="?", type=int, default=24)
    parser.add_argument("--workers", type=int, default=3)
    parser.add_argument("--every", type=float, default=5.0, help="seconds between kills, about")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--bands", action="store_true", help="captures without a calibration")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        began = time.monotonic()
        kills, wrong = done_under_kills(
            Path(place), given.count, given.workers, given.every, given.seed, bands=given.bands
        )
        seconds = time.monotonic() - began
    print(f"{given.count} captures, {given.workers} workers, {kills} killed, {seconds:.0f} s")
    for line in wrong:
        print(line)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
