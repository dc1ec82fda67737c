"""`sixlight batch --scheduler`: hands captures to the workers of a Dask cluster that is there.

Captures and results go by path, folders that all workers see under the same name, or by URL. A
worker runs a capture as a local batch does, in a process of its own; the stages of a capture stay
together. One that dies takes that process with it, and the scheduler gives the capture to another,
which goes on where it was. Dask gives up when four have died; it is asked again for as long as
steps are finished in between, and twice where none is: what a capture does hardly ever ends more
than its own process, and so it is rather the machines that are in trouble.
Results land once: whoever writes holds the output folder's lock, and files are moved into place; by
URL see `remote`.
"""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

from pipeline import finished
from pipeline.batch import Ended, Orders, Running, child
from pipeline.batch.child import FAILED, OURS, Outcome, Run
from pipeline.batch.shoot import Job
from pipeline.errors import fault
from pipeline.settings import Settings
from pipeline.storage import address, place

_ANSWER_S = 10.0  # that a scheduler is given to answer
_LOOK_S = 0.5  # between two looks at a process, and at whether all is to stop
_TRIES = 3  # that Dask is given to finish a step, each of four workers if they die
_BUSY_S = 60.0  # that a worker which is gone is given to let go of an output folder


def run(scheduler: str, jobs: Sequence[Job], orders: Orders, running: Running) -> Ended:
    """A `batch.Runner`, bound to the cluster whose scheduler is at an address: tcp://HOST:8786.

    How many run at once is the workers' business: one a thread of theirs.
    """
    try:
        from distributed import Client, Event, as_completed
    except ImportError as error:
        raise fault(
            "Dask is not installed", "", "run pip install 'sixlight[cluster]'", "--scheduler"
        ) from error
    name = f"sixlight-{uuid.uuid4().hex}"
    try:
        client = Client(scheduler, timeout=_ANSWER_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise fault(
            "no scheduler answers there", "tcp://HOST:8786", "check that it runs", scheduler
        ) from error
    with client:
        stop = Event(name, client=client)
        futures: dict[Any, _Try] = {}

        def given_out(job: Job, in_vain: int = 0) -> Any:
            future = client.submit(
                on_worker,
                *(address(job.folder), address(job.out), asdict(orders.settings)),
                *(orders.force, orders.limits.seconds, finished.code(), name),
                key=f"{name}-{len(futures)}",
                pure=False,
            )
            futures[future] = _Try(job, _steps_done(job), in_vain)
            return future

        try:
            ended = as_completed([given_out(job) for job in jobs], loop=client.loop)
            for future in _meanwhile(ended, lambda: running(_at_work(client, futures))):
                job, done_before, in_vain = futures[future]
                if future.status == "lost":  # its worker died before it told: Dask runs it again
                    ended.add(future)
                    continue
                if _killed(future):
                    in_vain = 0 if _steps_done(job) > done_before else in_vain + 1
                    if in_vain < _TRIES:
                        ended.add(given_out(job, in_vain))
                        continue
                outcome = _outcome(future)
                if outcome.state in (FAILED, OURS) and not orders.keep_going:
                    client.cancel([f for f in futures if not f.done()])
                    yield job, outcome
                    return
                yield job, outcome
        except (KeyboardInterrupt, GeneratorExit):  # here, or in whoever is told of an outcome
            stop.set()
            client.cancel(list(futures))
            raise


def _meanwhile(ended, look: Callable[[], None]) -> Iterator[Any]:
    """What has ended, as `as_completed` has it; `look` is called now and again between."""
    while ended.count():
        if ended.has_ready():
            yield next(ended)
        else:
            look()
            time.sleep(_LOOK_S)


def _at_work(client, futures: dict[Any, _Try]) -> list[str]:
    """Names of the captures that workers have; or that there are no workers, who may yet come."""
    try:
        workers = client.processing()
    except (OSError, RuntimeError):  # the scheduler is gone; the futures will say so
        return []
    keys = {key for given in workers.values() for key in given}
    names = [tried.job.name for future, tried in futures.items() if future.key in keys]
    return names if workers else ["waiting for workers"]


class _Try(NamedTuple):
    """Of a capture, by Dask: how many steps were done before, and how many tries did none."""

    job: Job
    steps_done: int
    in_vain: int


def _steps_done(job: Job) -> int:
    """How many steps have their results in place; by URL none are until all are."""
    return len(list(job.out.glob("work/*.made.json"))) if isinstance(job.out, Path) else 0


def _killed(future) -> bool:
    """Whether Dask has given up, as one worker after another died of it or with it."""
    return future.status == "error" and type(future.exception()).__name__ == "KilledWorker"


def _outcome(future) -> Outcome:
    error = future.exception() if future.status == "error" else None
    if error is None and future.status == "finished":
        return Outcome(**future.result())
    if _killed(future):
        said = "every worker that was given it died; try it on one machine with sixlight envmap"
    else:
        said = f"the cluster could not run it: {error or future.status}"
    return Outcome(FAILED, error=[said])


def on_worker(
    folder: str,
    out: str,
    settings: dict[str, Any],
    force: bool,
    seconds: float,
    code: str,
    stop: str,
) -> dict[str, Any]:
    """Runs one capture on this machine, and returns how it ended, as plain data.

    code  of the sixlight that asks: results must not depend on which worker makes them
    stop  name of the event that says that all is to end
    """
    from distributed import Event

    if finished.code() != code:
        return asdict(
            Outcome(FAILED, error=["a worker has another version of sixlight; install the same"])
        )
    capture, results, wanted = place(folder), place(out), Settings(**settings)
    ending = Event(stop)
    began = time.monotonic()
    while True:
        if (current := child.standing(capture, results, wanted)) is not None:
            return asdict(current)
        outcome = _followed(Run(capture, results, wanted, force, seconds), ending)
        busy = outcome.state == FAILED and any(child.BUSY in line for line in outcome.error)
        if not busy or time.monotonic() - began > _BUSY_S:
            return asdict(outcome)
        time.sleep(_LOOK_S)


def _followed(run: Run, ending) -> Outcome:
    try:
        while (outcome := run.poll()) is None:
            time.sleep(_LOOK_S)
            if ending.is_set():
                return Outcome()
        return outcome
    finally:
        child.stop([run])
