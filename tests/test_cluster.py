"""Captures done by the workers of a real Dask cluster: each once, though workers die."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pipeline import batch as batches
from pipeline.batch import cluster as clusters
from pipeline.batch import shoot
from pipeline.settings import Settings

ROOT = Path(__file__).parent.parent

# In place of `envmap`: takes the output's lock, as a run does, and leaves word of each end.
STAND_IN = '''
import sys
from pipeline.batch import child

PROGRAM = """
import fcntl, json, pathlib, sys, time
out = pathlib.Path(sys.argv[1])
(out / "work").mkdir(parents=True, exist_ok=True)
with (out / "work" / "lock").open("w") as lock:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        sys.exit(print("another run is writing here", file=sys.stderr) or 2)
    if (out / "result.json").exists():
        sys.exit()  # current: its worker died before it could say so
    time.sleep(0.4)
    with (out / "done").open("a") as done:
        done.write("x")
    (out / "result.json").write_text(json.dumps({"verdict": {"grade": "good"}}))
"""
child._command = lambda folder, out, settings, force: [sys.executable, "-c", PROGRAM, str(out)]
'''


# Finishes a step, and takes its worker with it; but for "hopeless", which finishes none, ever.
FATAL = '''
import sys
from pipeline.batch import child

PROGRAM = """
import json, os, pathlib, signal, sys
out = pathlib.Path(sys.argv[1])
(out / "work").mkdir(parents=True, exist_ok=True)
done = len(list(out.glob("work/*.made.json")))
if done == 6:
    (out / "result.json").write_text(json.dumps({"verdict": {"grade": "good"}}))
    sys.exit()
if out.name != "hopeless":
    (out / "work" / f"step{done}.made.json").touch()
os.kill(os.getppid(), signal.SIGKILL)
"""
child._command = lambda folder, out, settings, force: [sys.executable, "-c", PROGRAM, str(out)]
'''


# The second worker to end a capture dies soon after; what is asked later takes its time.
SILENT = (
    STAND_IN
    + """
import os, pathlib, signal, threading, time
from pipeline.batch.cluster import on_worker as ran

def told(*given, ran=ran):
    answer = ran(*given)
    before = list(pathlib.Path(os.environ["ENDS"]).iterdir())
    pathlib.Path(os.environ["ENDS"], str(len(before))).touch()
    if len(before) == 1:
        threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGKILL)).start()
    if len(before) > 1:
        time.sleep(4)
    return answer

if ran.__name__ == "on_worker":  # Dask loads this twice
    from pipeline.batch import cluster
    cluster.on_worker = told
"""
)


@pytest.fixture
def cluster(tmp_path):
    """Starts a scheduler and workers; cluster(count, *options) -> its address, the workers.

    With "--nanny" among the options, workers that die are started again.
    """
    pytest.importorskip("distributed", reason="needs pip install 'sixlight[cluster]'")
    processes: list[subprocess.Popen] = []
    address = tmp_path / "scheduler.json"

    def process(module: str, *options) -> subprocess.Popen:
        command = [sys.executable, "-m", f"distributed.cli.{module}", "--scheduler-file", address]
        log = (tmp_path / f"{module}{len(processes)}.log").open("w")
        processes.append(
            subprocess.Popen(
                [*command, *options, "--no-dashboard"],
                stderr=log,
                env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
            )
        )
        log.close()
        return processes[-1]

    def start(count: int, *options) -> tuple[str, list[subprocess.Popen]]:
        process("dask_scheduler", "--host", "127.0.0.1", "--port", "0")
        until = time.monotonic() + 120
        while not address.exists():
            assert time.monotonic() < until
            time.sleep(0.1)
        time.sleep(0.2)
        workers = [
            process(
                *("dask_worker", "--nthreads", "1", "--name", f"w{i}"),
                *("--local-directory", tmp_path / "scratch"),
                *(options if "--nanny" in options else ("--no-nanny", *options)),
            )
            for i in range(count)
        ]
        return json.loads(address.read_text())["address"], workers

    start.scheduler = lambda: processes[0]
    yield start
    for each in reversed(processes):
        each.kill()
        each.wait()


def batch(*arguments) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "pipeline", "batch", *map(str, arguments)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.slow
def test_all_are_done_once_though_a_worker_is_killed(cluster, tmp_path):
    (tmp_path / "stand_in.py").write_text(STAND_IN)
    for i in range(12):
        (tmp_path / "shoot" / f"c{i:02}").mkdir(parents=True)
        (tmp_path / "shoot" / f"c{i:02}" / "capture.toml").touch()
    address, workers = cluster(3, "--preload", tmp_path / "stand_in.py")
    given = "-o", tmp_path / "out", "--scheduler", address, "--json"
    with batch(tmp_path / "shoot", *given) as process:
        for number, _ in enumerate(process.stderr, 1):
            if number == 2:  # the others are at work
                workers[0].send_signal(signal.SIGKILL)
        told = json.loads(process.stdout.read())
    assert process.returncode == 0, told
    # One whose worker died before it could tell of it is current when it is given to another.
    assert {c["state"] for c in told["captures"]} <= {"done", "current"}
    assert [c["grade"] for c in told["captures"]] == ["good"] * 12
    for i in range(12):
        assert (tmp_path / "out" / f"c{i:02}" / "done").read_text() == "x"


@pytest.mark.slow
def test_one_goes_on_as_long_as_steps_are_finished_though_each_kills_its_worker(cluster, tmp_path):
    (tmp_path / "fatal.py").write_text(FATAL)
    for name in ("hard", "hopeless"):
        (tmp_path / "shoot" / name).mkdir(parents=True)
        (tmp_path / "shoot" / name / "capture.toml").touch()
    address, _ = cluster(2, "--nanny", "--preload", tmp_path / "fatal.py")
    given = "-o", tmp_path / "out", "--scheduler", address, "--json"
    with batch(tmp_path / "shoot", *given) as process:
        told = {
            Path(c["capture"]).name: c for c in json.loads(process.communicate()[0])["captures"]
        }
    assert told["hard"]["state"] in ("done", "current")
    assert told["hopeless"]["state"] == "failed"
    assert "every worker that was given it died" in told["hopeless"]["error"][0]
    assert len(list((tmp_path / "out" / "hard" / "work").glob("*.made.json"))) == 6


@pytest.mark.slow
def test_an_answer_that_died_with_its_worker_is_waited_for(cluster, tmp_path, monkeypatch):
    (tmp_path / "silent.py").write_text(SILENT)
    (tmp_path / "ends").mkdir()
    monkeypatch.setenv("ENDS", str(tmp_path / "ends"))
    for i in range(2):
        (tmp_path / "shoot" / f"c{i}").mkdir(parents=True)
        (tmp_path / "shoot" / f"c{i}" / "capture.toml").touch()
    address, workers = cluster(2, "--preload", tmp_path / "silent.py")
    jobs = shoot.plan([tmp_path / "shoot"], tmp_path / "out", Settings())
    orders = batches.Orders(Settings(), batches.limits_of(None, None, 1))
    outcomes = []
    running = []
    for _, outcome in clusters.run(address, jobs, orders, running.append):
        outcomes.append(outcome)
        while all(worker.poll() is None for worker in workers):
            time.sleep(0.1)
        time.sleep(1)  # the scheduler hears of it, and gives the capture to the other
    assert [o.grade for o in outcomes] == ["good", "good"], outcomes
    for job in jobs:
        assert (job.out / "done").read_text() == "x"
    assert {name for names in running for name in names} >= {"c0", "c1"}


@pytest.mark.slow
def test_a_scheduler_that_dies_ends_the_batch_with_sentences(cluster, tmp_path):
    for i in range(2):
        (tmp_path / "shoot" / f"c{i}").mkdir(parents=True)
        (tmp_path / "shoot" / f"c{i}" / "capture.toml").touch()
    address, _ = cluster(0)
    jobs = shoot.plan([tmp_path / "shoot"], tmp_path / "out", Settings())
    orders = batches.Orders(Settings(), batches.limits_of(None, None, 1))
    running = []

    def seen(names):
        running.append(names)
        if len(running) == 2:
            cluster.scheduler().kill()

    outcomes = [outcome for _, outcome in clusters.run(address, jobs, orders, seen)]
    assert running[0] == ["waiting for workers"]
    assert [o.state for o in outcomes] == ["failed", "failed"]
    assert all("the cluster could not run it" in o.error[0] for o in outcomes)


@pytest.mark.slow
def test_captures_by_url_are_brought_to_the_workers(cluster, tmp_path, monkeypatch):
    elsewhere = pytest.importorskip("elsewhere", reason="needs fsspec")
    monkeypatch.setenv("TMPDIR", str(tmp_path / "scratch"))
    (tmp_path / "scratch").mkdir()
    (tmp_path / "stand_in.py").write_text(
        f"import sys\nfrom pipeline.batch import child\nPROGRAM = {elsewhere.PROGRAM!r}\n"
        "child._command = lambda folder, out, *_:"
        " [sys.executable, '-c', PROGRAM, child.address(out), child.address(folder)]\n"
    )
    shoot, maps = f"file://{tmp_path}/shoot", f"file://{tmp_path}/maps"
    for i in range(6):
        elsewhere.put_capture(f"{shoot}/c{i}")
    address, workers = cluster(2, "--preload", tmp_path / "stand_in.py")
    with batch(shoot, "-o", maps, "--scheduler", address, "--json") as process:
        process.stderr.readline()
        workers[0].send_signal(signal.SIGKILL)
        told = json.loads(process.stdout.read())
    assert process.returncode == 0, told
    assert [c["grade"] for c in told["captures"]] == ["good"] * 6
    with batch(shoot, "-o", maps, "--scheduler", address, "--json") as process:
        again = json.loads(process.stdout.read())
    assert {c["state"] for c in again["captures"]} == {"current"}


@pytest.mark.slow
def test_real_captures_are_the_same_as_done_here(cluster, small, sixlight, tmp_path):
    toml = small / "capture.toml"
    toml.write_text(toml.read_text().split("[calibration]")[0])
    for i in range(6):
        shutil.copytree(small, tmp_path / "shoot" / f"c{i}")
    assert sixlight("envmap", small, "-o", tmp_path / "here", "--quiet").status == 0
    address, workers = cluster(2)
    given = "-o", tmp_path / "out", "--scheduler", address, "--json"
    with batch(tmp_path / "shoot", *given) as process:
        process.stderr.readline()
        workers[0].send_signal(signal.SIGKILL)
        said, err = process.communicate()
    assert process.returncode == 0, (said, err)
    assert {c["state"] for c in json.loads(said)["captures"]} <= {"done", "current"}
    expected = (tmp_path / "here" / "cubemap_bands.exr").read_bytes()
    for i in range(6):
        made = (tmp_path / "out" / f"c{i}" / "cubemap_bands.exr").read_bytes()
        assert made == expected
        assert sixlight("verify", tmp_path / "out" / f"c{i}").status == 0


def test_no_scheduler_there(sixlight, tmp_path):
    pytest.importorskip("distributed", reason="needs pip install 'sixlight[cluster]'")
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / "capture.toml").touch()
    for address in ("tcp://127.0.0.1:1", "nonsense://x"):
        outcome = sixlight("batch", tmp_path, "-o", tmp_path / "o", "--scheduler", address)
        assert outcome.status == 2
        assert outcome.err.count("\n") == 1
        assert "no scheduler answers" in outcome.err
