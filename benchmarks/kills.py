"""Kills runs at random moments, and looks at what they leave.

    python -m benchmarks.kills [COUNT] [--seed N] [--capture DIR]

After each SIGKILL every result that stands must be, byte for byte, what an undisturbed run makes,
and `sixlight verify` must say what is missing, or that nothing is; the next run goes on from there.
Once one has come through, `verify` must hold, and the folder is emptied for the next. Runs are over
the tests' small capture, whose kills come quickly, or over that of --capture.
"""

from __future__ import annotations

import argparse
import hashlib
import multiprocessing
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import InputError
from pipeline.verify import verify

_TIMED = ("result.json", "report.html")  # tell how many seconds steps took
_OURS = ("pipeline.cli", "pipeline.runner", "pipeline.capture", "pipeline.steps")


@dataclass(frozen=True)
class Outcome:
    """Of many kills.

    kills     runs that were killed before they ended
    through   runs that came through between, and were whole
    named     kills after which verify named something, against nothing to verify yet
    wrong     sentences, one a result that was not what it ought to be; empty where all is well
    """

    kills: int
    through: int
    named: int
    wrong: tuple[str, ...]


def kill(
    capture: Path,
    folder: Path,
    count: int,
    seed: int,
    *options: str,
    progress: Callable[[str], None] = lambda line: None,
) -> Outcome:
    """Kills `count` runs over a capture.

    folder    empty; for outputs
    options   of `sixlight envmap`
    progress  is told how many were killed, whenever a run came through
    """
    # Processes begin with everything imported, so that kills fall upon the work.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(_OURS))
    moments = random.Random(seed)
    calm, out = folder / "calm", folder / "out"
    began = time.monotonic()
    run = _started(context, capture, calm, options)
    run.join()
    assert run.exitcode == 0, "an undisturbed run failed"
    seconds, expected = time.monotonic() - began, made(calm)
    kills = through = named = 0
    wrong: list[str] = []
    while kills < count:
        run = _started(context, capture, out, options)
        run.join(moments.uniform(0.0, seconds / 3))
        alive = run.is_alive()
        if alive and run.pid is not None:
            os.kill(run.pid, signal.SIGKILL)
        run.join()
        wrong += _differing(out, expected, f"kill {kills}")
        missing = problems(out)
        if alive:
            kills += 1
            named += bool(missing)
            # What a kill leaves is what steps did not come to: never a file that is there, but not
            # what its stamp says, but for the moment between a file's move and its stamp's.
            if missing == [] and made(out).keys() != expected.keys():
                wrong.append(f"kill {kills}: verify holds over missing results")
            continue
        through += 1
        progress(f"{kills} kills, {through} runs came through, {len(wrong)} wrong")
        if run.exitcode != 0:
            wrong.append(f"a run after kill {kills} ended with status {run.exitcode}")
        wrong += [f"after kill {kills}, through: {p}" for p in missing or ()]
        if made(out) != expected:
            wrong.append(f"after kill {kills} a run came through, but not with all results")
        shutil.rmtree(out)
    last = _started(context, capture, out, options)
    last.join()
    if last.exitcode != 0 or made(out) != expected or problems(out):
        wrong.append("the run after the last kill did not end as an undisturbed one")
    return Outcome(kills, through, named, tuple(wrong))


def _started(context, capture: Path, out: Path, options: tuple[str, ...]):
    process = context.Process(target=_envmap, args=(capture, out, options))
    process.start()
    return process


def _envmap(capture: Path, out: Path, options: tuple[str, ...]) -> None:
    from pipeline import cli

    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    sys.exit(cli.status(["envmap", str(capture), "-o", str(out), "--quiet", *options]))


def made(out: Path) -> dict[str, str]:
    """Results in an output folder, by digest, without those that tell the time."""
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(out.glob("*"))
        if path.is_file() and path.name not in _TIMED
    }


def _differing(out: Path, expected: dict[str, str], when: str) -> list[str]:
    return [
        f"{when}: {name} is not what an undisturbed run makes"
        for name, digest in made(out).items()
        if expected.get(name) != digest
    ]


def problems(out: Path) -> list[str] | None:
    """What verify says; None where it says that there is nothing to verify yet."""
    try:
        return list(verify(out)["problems"])
    except InputError:
        return None


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", nargs="?", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--capture", type=Path, help="in place of the tests' small one")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        capture = given.capture or small(Path(place) / "small")
        began = time.monotonic()
        outs = _folder(Path(place) / "outs")
        done = kill(capture, outs, given.count, given.seed, progress=_say)
    print(
        f"{done.kills} kills in {time.monotonic() - began:.0f} s, seed {given.seed};"
        f" verify named what was missing after {done.named}; {done.through} runs came through whole"
    )
    for line in done.wrong:
        print(line)
    return 1 if done.wrong else 0


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def small(folder: Path) -> Path:
    """The tests' small capture, written to a new folder."""
    sys.path.insert(0, "tests")
    import small_capture

    return small_capture.make(_folder(folder))


def _folder(path: Path) -> Path:
    path.mkdir()
    return path


if __name__ == "__main__":
    sys.exit(main())
