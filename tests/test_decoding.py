"""A raw file that harms its decoder harms nothing else, and nothing is left behind."""

import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import plain_dng
import pytest

from pipeline import io
from pipeline.files import decoding

ROOT = Path(__file__).parent.parent
AS_SHOT = {"time_s": 1.0, "iso": 100.0, "f_number": 1.0}

# Python runs it as a process begins. LibRaw then does harm to itself at files of certain names.
SPOILT = """
import os, signal, time
import rawpy

sound, before = rawpy.imread, []

def kill(number):
    os.kill(os.getpid(), number)

def loop():
    while True:
        pass

def imread(path):
    doings = {
        "crash": lambda: kill(signal.SIGSEGV),
        "killed": lambda: kill(signal.SIGKILL),
        "loop": loop,
        "sleep": lambda: time.sleep(1000),
        "greedy": lambda: bytearray(8 << 30),
        "second": lambda: before and kill(signal.SIGSEGV),
    }
    with open(os.path.join(os.path.dirname(__file__), "reading"), "a") as file:
        print(os.getpid(), os.path.basename(path), file=file)
    for word, do in doings.items():
        if word in os.path.basename(path):
            do()
    before.append(path)
    return sound(path)

rawpy.imread = imread
"""


@pytest.fixture
def spoilt(tmp_path, monkeypatch):
    """A folder; what decodes from now on is spoilt, and notes in `reading` there what it reads."""
    folder = tmp_path / "spoilt"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(SPOILT)
    monkeypatch.setenv("PYTHONPATH", str(folder))
    decoding.stop()
    yield folder
    decoding.stop()


def write(path, samples=None, **tags):
    samples = np.full((60, 80), 900) if samples is None else samples
    tags = {"time_s": (1, 30), **tags}
    plain_dng.write(path, samples, black_level=100, saturation_level=15000, **tags)
    return path


HARM = {
    "crash": r"its decoder crashed \(SIGSEGV\)",
    "killed": "its decoder was killed, most likely for want of memory",
    "loop": "its decoder was still at it after 1 s",
    "sleep": "its decoder was still at it after 2 s",
    "greedy": r"takes more than 3\.2 GB of memory to decode",
}


@pytest.mark.parametrize("harm", HARM)
def test_what_harms_its_decoder_is_a_line_and_the_others_are_read(
    spoilt, tmp_path, monkeypatch, harm
):
    by_clock = 3 if harm == "sleep" else 1000  # as machines have other things to do
    limits = replace(decoding.LIMITS, seconds=0.6, wall=by_clock)
    monkeypatch.setattr(decoding, "LIMITS", limits)
    paths = [write(tmp_path / f"{i}.dng", time_s=(1, 10 + i)) for i in range(3)]
    paths.insert(1, write(tmp_path / f"{harm}.dng"))
    shots, problems = io.read_shots(paths)
    assert [shot.path.name for shot in shots] == ["0.dng", "1.dng", "2.dng"]
    (problem,) = problems
    assert problem.file == paths[1]
    assert re.search(HARM[harm], str(problem))
    assert io.read_frame(paths[0], **AS_SHOT).samples.shape == (60, 80)


def test_a_command_ends_with_the_line(spoilt, small, sixlight):
    path = small / "cyan" / "cyan_1.dng"
    path = path.rename(path.with_name("crash.dng"))
    outcome = sixlight("inspect", small)
    assert (outcome.status, outcome.out) == (2, "")
    assert outcome.err.splitlines() == [
        f"{path}: its decoder crashed (SIGSEGV) (expected a complete raw file); copy the file again"
        " from the camera, or leave it out"
    ]


def test_a_crash_that_may_be_an_earlier_files_doing_is_not_held_against_a_file(spoilt, tmp_path):
    paths = [write(tmp_path / name) for name in ("first.dng", "second.dng")]
    for path in paths:
        assert io.read_shot(path).path == path


def test_paths_are_relative_to_where_one_is_by_now(tmp_path, monkeypatch):
    for name, tag in (("a", (1, 10)), ("b", (1, 20))):
        (tmp_path / name).mkdir()
        write(tmp_path / name / "0.dng", time_s=tag)
        monkeypatch.chdir(tmp_path / name)
        shot = io.read_shot(Path("0.dng"))
        assert (shot.path, shot.time_s) == (Path("0.dng"), pytest.approx(1 / tag[1]))


def test_frames_are_kept_as_long_as_they_are_held(tmp_path):
    worlds = np.random.default_rng(1).integers(0, 15000, (5, 60, 80)).astype(np.uint16)
    paths = [write(tmp_path / f"{i}.dng", world) for i, world in enumerate(worlds)]
    frames = [io.read_frame(path, **AS_SHOT) for path in paths]
    np.testing.assert_array_equal([frame.samples for frame in frames], worlds)


def test_what_a_file_says_may_be_long(tmp_path):
    shot = io.read_shot(write(tmp_path / "talkative.dng", model="x" * 1_000_000))
    assert shot.camera.endswith("xxx")
    assert len(shot.camera) > 1_000_000


def test_where_no_process_can_be_started_files_are_decoded_in_this_one(
    tmp_path, monkeypatch, capfd
):
    monkeypatch.setattr(sys, "executable", str(tmp_path / "no python"))
    monkeypatch.setattr(decoding, "_decoders", decoding._Decoders())
    paths = [write(tmp_path / f"{i}.dng") for i in range(3)]
    paths[1].write_bytes(paths[1].read_bytes()[:-100])
    shots, problems = io.read_shots(paths)
    assert [shot.path.name for shot in shots] == ["0.dng", "2.dng"]
    assert "the raw data cannot be decoded" in str(problems[0])
    assert (io.read_frame(paths[0], **AS_SHOT).samples == 900).all()
    assert capfd.readouterr().err == ""


def test_libraw_is_kept_quiet_and_python_is_not(capfd):
    with decoding.quiet():
        os.write(2, b"from a library in C\n")
        print("from Python", file=sys.stderr)
    print("and after", file=sys.stderr)
    assert capfd.readouterr().err.splitlines() == ["from Python", "and after"]


FORKED = """
import os, sys
from pathlib import Path
from pipeline import io

read = lambda: io.read_shot(Path(sys.argv[1]))
first = read()
child = os.fork()
same = read() == first == read()
if not child:
    os._exit(0 if same else 1)
print(same, os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), read() == first)
"""


def test_a_copy_of_the_process_has_decoders_of_its_own_and_nothing_is_left(tmp_path):
    done = subprocess.run(
        [sys.executable, "-X", "dev", "-W", "error", "-c", FORKED, write(tmp_path / "0.dng")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.stdout, done.stderr, done.returncode) == ("True 0 True\n", "", 0)


INTERRUPTED = """
import signal, sys
from pathlib import Path
from pipeline import io

signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGTERM, signal.default_int_handler)
try:
    io.read_shots([Path(path) for path in sys.argv[1:]])
except KeyboardInterrupt:
    sys.exit(130)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_signal_leaves_no_decoder_behind(spoilt, tmp_path, number):
    """Not even one that never ends."""
    paths = [write(tmp_path / f"{name}.dng") for name in ("0", "loop1", "loop2")]
    process = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED, *paths], cwd=ROOT, stderr=subprocess.PIPE
    )
    noted = spoilt / "reading"
    wait_until(lambda: noted.exists() and "loop" in noted.read_text())
    process.send_signal(number)
    _, said = process.communicate(timeout=20)
    assert (process.returncode, said) == (-number if number == signal.SIGKILL else 130, b"")
    decoders = {Path("/proc") / line.split()[0] for line in noted.read_text().splitlines()}
    assert decoders
    wait_until(lambda: not any(decoder.exists() for decoder in decoders))


def wait_until(holds, seconds=20.0):
    until = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < until
        time.sleep(0.02)
