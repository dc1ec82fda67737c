"""What machines do in the night: kills, signals, full disks, files that change or vanish."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import zlib
from pathlib import Path

import numpy as np
import pytest
from conftest import digests

from pipeline import cli, digest, runner
from pipeline.steps import geometry

ROOT = Path(__file__).parent.parent


@pytest.fixture
def bands(small):
    """The small capture without its calibration: half the steps."""
    toml = small / "capture.toml"
    toml.write_text(toml.read_text().split("[calibration]")[0])
    return small


def results(out: Path) -> dict[str, str]:
    """Results but for those that tell how many seconds steps took."""
    timed = ("result.json", "report.html")
    return {k: v for k, v in digests(out).items() if not k.startswith("work/") and k not in timed}


def started(*arguments, **environment) -> subprocess.Popen:
    """The command in a process of its own, which Ctrl-C ends even where it does not end the tests:
    what is started in the background inherits that it is to be ignored."""
    return subprocess.Popen(
        [sys.executable, "-m", "pipeline", *map(str, arguments)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, **environment},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


# ------------------------------------------------------------------------------- kills and signals


@pytest.mark.slow
def test_killed_at_any_moment_the_next_run_ends_as_an_undisturbed_one(bands, tmp_path):
    from benchmarks.kills import kill

    (tmp_path / "outs").mkdir()
    done = kill(bands, tmp_path / "outs", 12, 7)
    assert done.wrong == ()
    assert done.kills == 12


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_run_cleanly(bands, tmp_path, number):
    process = started("envmap", bands, "-o", tmp_path / "out")
    for line in process.stderr:  # one step is done, and another is under way
        if b"merge" in line:
            break
    before = results(tmp_path / "out")
    process.send_signal(number)
    began = time.monotonic()
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert time.monotonic() - began < 30
    assert b"Traceback" not in said
    assert not list((tmp_path / "out" / "work").glob("unfinished-*"))
    assert results(tmp_path / "out").items() >= before.items()


def test_an_interrupt_says_nothing_and_ends_with_130(sixlight, bands, tmp_path, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(runner, "_key", interrupted)
    outcome = sixlight("envmap", bands, "-o", tmp_path / "out", "--quiet")
    assert (outcome.status, outcome.out, outcome.err) == (cli.INTERRUPTED, "", "")


def test_memory_that_runs_out_is_a_line_and_what_is_finished_stays(
    sixlight, bands, tmp_path, monkeypatch
):
    def greedy(*_, **__):
        np.empty(1 << 50)

    run = "envmap", bands, "-o", tmp_path / "out", "--quiet"
    with monkeypatch.context() as patched:
        patched.setattr(geometry, "unwrap", greedy)
        outcome = sixlight(*run)
    assert outcome.status == 2
    assert outcome.err.startswith("sixlight: memory ran out")
    assert len(outcome.err.splitlines()) == 1
    merged = {k: v for k, v in digests(tmp_path / "out").items() if "merged" in k}
    assert merged
    assert sixlight(*run).status == 0
    assert digests(tmp_path / "out").items() >= merged.items()


@pytest.mark.parametrize("buffered", ["", "1"])
def test_what_cannot_be_printed(buffered):
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("there is no /dev/full here")
    command = [sys.executable, "-m", "pipeline", "steps"]
    environment = {**os.environ, "PYTHONUNBUFFERED": buffered}
    with full.open("w") as out:
        ended = subprocess.run(
            command, cwd=ROOT, env=environment, stdout=out, stderr=subprocess.PIPE, check=False
        )
    assert ended.returncode == 2
    assert ended.stderr.startswith(b"standard output: no space is left")
    assert ended.stderr.count(b"\n") == 1
    gone = subprocess.Popen(
        command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    gone.stdout.close()  # as `head` does, once it has enough
    assert gone.stderr.read() == b""
    gone.wait()
    gone.stderr.close()


@pytest.mark.slow
def test_little_memory_from_the_start_is_a_line(bands, tmp_path):
    """Little more than libraries take: what comes first, an array or a thread, is too much."""
    program = (
        "import resource, sys; from pathlib import Path; from pipeline import cli, runner, steps;"
        "from stages import footprint, merge, preview;"
        "pages = int(Path('/proc/self/statm').read_text().split()[0]);"
        "most = pages * resource.getpagesize() + (8 << 20);"
        "resource.setrlimit(resource.RLIMIT_AS, (most, most)); cli.main()"
    )
    run = [sys.executable, "-c", program, "envmap", bands, "-o", tmp_path / "out", "--quiet"]
    ended = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode == 2, ended.stderr
    assert ended.stderr.startswith("sixlight: memory ran out")
    assert len(ended.stderr.splitlines()) == 1


@pytest.mark.slow
def test_a_first_run_prints_its_results_as_json(sixlight, bands, tmp_path):
    outcome = sixlight("envmap", bands, "-o", tmp_path / "out", "--quiet", "--json")
    assert outcome.status == 0, outcome.err
    assert json.loads(outcome.out) == json.loads((tmp_path / "out" / "result.json").read_text())


# ---------------------------------------------------------------------- photographs that don't stay


def removed(path):
    path.unlink()


def rewritten(path):
    path.write_bytes(path.read_bytes())
    os.utime(path, ns=(1, 1))


def cut(path):
    path.write_bytes(path.read_bytes()[:100])


@pytest.mark.parametrize("change", [removed, rewritten, cut])
def test_a_photograph_that_changes_during_the_run_makes_no_result(
    sixlight, bands, tmp_path, monkeypatch, change
):
    """Once its digest is taken: what is then read would be told to be of another content."""
    of_file = digest.of_file

    def changed_after(path):
        found = of_file(path)
        if path.name == "cyan_2.dng":
            change(path)
        return found

    monkeypatch.setattr(digest, "of_file", changed_after)
    outcome = sixlight("envmap", bands, "-o", tmp_path / "out", "--quiet")
    assert outcome.status == 2
    assert len(outcome.err.splitlines()) == 1
    assert "cyan_2.dng" in outcome.err
    assert results(tmp_path / "out") == {}
    assert not list((tmp_path / "out" / "work").glob("unfinished-*"))


def test_a_photograph_that_vanishes_before_it_is_looked_at(sixlight, bands, tmp_path, monkeypatch):
    claim = runner.claim

    def vanishing(*given):
        (bands / "yellow" / "yellow_0.dng").unlink()
        claim(*given)

    monkeypatch.setattr(runner, "claim", vanishing)
    outcome = sixlight("envmap", bands, "-o", tmp_path / "out", "--quiet")
    assert outcome.status == 2
    assert len(outcome.err.splitlines()) == 1
    assert "yellow_0.dng: no such file" in outcome.err


# --------------------------------------------------------------------------------- disks and places


@pytest.fixture
def disk(tmp_path):
    """A small disk of its own: disk(options) mounts it, or mounts it anew."""
    if os.geteuid() != 0:
        pytest.skip("mounting a small disk takes root")
    place = tmp_path / "disk"
    place.mkdir()

    def mount(options: str) -> Path:
        again = "remount," if os.path.ismount(place) else ""
        command = ["mount", "-t", "tmpfs", "-o", again + options, "tmpfs", place]
        if subprocess.run(command, capture_output=True).returncode:
            pytest.skip("this machine does not let root mount a tmpfs")
        return place

    yield mount
    if os.path.ismount(place):
        subprocess.run(["umount", place], check=True)


@pytest.mark.slow
def test_fifty_sizes_of_a_full_disk(sixlight, bands, disk):
    """One output, on a disk that grows: each run gets a little further, and loses nothing."""
    sizes = [100_000 + 160_000 * i for i in range(50)]
    before: dict[str, str] = {}
    full = 0
    for size in sizes:
        place = disk(f"size={size}")
        outcome = sixlight("envmap", bands, "-o", place / "out", "--quiet")
        assert not list(place.rglob("unfinished-*"))
        now = results(place / "out")
        assert now.items() >= before.items()
        before = now
        if outcome.status:
            full += 1
            assert outcome.status == 2, outcome.err
            assert len(outcome.err.splitlines()) == 1
            assert "no space" in outcome.err
    assert full >= 20
    outcome = sixlight("envmap", bands, "-o", disk("size=64m") / "out", "--quiet")
    assert outcome.status == 0, outcome.err
    assert sixlight("verify", disk("size=64m") / "out").status == 0


def test_an_output_that_is_read_only(sixlight, bands, disk):
    disk("size=1m")
    place = disk("ro")
    outcome = sixlight("envmap", bands, "-o", place / "out", "--quiet")
    assert outcome.status == 2
    assert len(outcome.err.splitlines()) == 1
    assert "read-only" in outcome.err
    assert list(place.iterdir()) == []


# --------------------------------------------------------------------- surroundings and odd names


@pytest.mark.slow
@pytest.mark.parametrize(
    "environment",
    [
        {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        {"LC_ALL": "tr_TR.ISO-8859-9", "PYTHONUTF8": "0", "PYTHONIOENCODING": "latin-1"},
    ],
    ids=["ASCII", "Latin-1"],
)
def test_no_home_and_an_odd_locale(bands, environment):
    odd = bands.rename(bands.parent / "Küche 東")
    kept = {k: v for k, v in os.environ.items() if k not in ("HOME", "LANG")}
    done = subprocess.run(
        [sys.executable, "-m", "pipeline", "inspect", odd],
        cwd=ROOT,
        capture_output=True,
        env={**kept, **environment},
    )
    assert done.returncode == 0, done.stderr
    assert b"cyan_3.dng" in done.stdout


HOSTILE = [
    "\x1b]0;owned\x07",  # sets a terminal's title
    "\x1b[2J",  # clears its screen
    "a\u202egnp.exe",  # turns what follows around
    "[red]bold[/red]",  # rich's markup
    "<script>alert(1)</script>",
    "new\nline",
]


@pytest.mark.parametrize("name", HOSTILE)
def test_names_reach_no_terminal_raw(sixlight, small, name):
    folder = small.parent / name.replace("/", "\u2215")
    small.rename(folder)
    (folder / "cyan" / "cyan_1.dng").write_bytes(b"no photograph")
    outcome = sixlight("envmap", folder, "-o", small.parent / "out")
    assert outcome.status == 2
    assert len(outcome.err.splitlines()) == 1
    assert not set(outcome.err) & set("\x1b\x07\u202e")
    listed = sixlight("batch", folder, "-o", small.parent / "out", "--dry-run")
    assert len(listed.out.splitlines()) == 2
    assert not set(listed.out) & set("\x1b\x07\u202e")


def test_markup_in_a_captures_own_words_stays_text(sixlight, bands):
    toml = bands / "capture.toml"
    toml.write_text(toml.read_text().replace('"small"', '"[red]<b>x</b>[/red]"'))
    assert "[red]<b>x</b>[/red]" in sixlight("inspect", bands).out


# ----------------------------------------------------------------------------------- hostile files


WIDTH, HEIGHT, BITS, COMPRESSION, STRIPS, STRIP_BYTES, FORMAT = 256, 257, 258, 259, 273, 279, 339


def claims(path: Path, values: dict[int, int]) -> None:
    """Makes a DNG's directory say other numbers, by tag."""
    import struct

    content = bytearray(path.read_bytes())
    (at,) = struct.unpack_from("<I", content, 4)
    (count,) = struct.unpack_from("<H", content, at)
    for entry in range(at + 2, at + 2 + 12 * count, 12):
        (tag,) = struct.unpack_from("<H", content, entry)
        if tag in values:
            struct.pack_into("<HHII", content, entry, tag, 4, 1, values[tag])
    path.write_bytes(content)


@pytest.mark.parametrize(("width", "height"), [(65535, 65535), (30000, 20000)])
def test_a_raw_file_that_claims_to_be_enormous(sixlight, small, width, height):
    claims(small / "cyan" / "cyan_1.dng", {WIDTH: width, HEIGHT: height})
    outcome = sixlight("inspect", small)
    assert outcome.status == 2
    assert len(outcome.err.splitlines()) == 1
    assert "cyan_1.dng: " in outcome.err


def test_a_raw_file_that_unpacks_to_a_thousand_times_its_size(sixlight, small):
    dng = small / "cyan" / "cyan_1.dng"
    packer = zlib.compressobj()
    packed = b"".join(packer.compress(bytes(1 << 24)) for _ in range(32)) + packer.flush()
    size = dng.stat().st_size
    with dng.open("ab") as file:
        file.write(packed)
    deflated = {COMPRESSION: 8, STRIPS: size, STRIP_BYTES: len(packed)}
    claims(dng, deflated | {BITS: 32, FORMAT: 3})
    outcome = sixlight("inspect", small)
    assert outcome.status == 2
    assert len(outcome.err.splitlines()) == 1
    assert "cyan_1.dng: " in outcome.err


def test_a_table_of_gigabytes(sixlight, small):
    with (small / "C.csv").open("ab") as file:
        file.truncate(3 << 30)  # holes: nothing is stored
    outcome = sixlight("inspect", small)
    assert outcome.status == 2
    assert len(outcome.err.splitlines()) == 1
    assert "C.csv: 3221 MB of text" in outcome.err


@pytest.mark.parametrize("depth", [100, 100_000])
@pytest.mark.parametrize("bracket", ["[", "{a="])
def test_toml_of_absurd_depth(sixlight, small, depth, bracket):
    closing = {"[": "]", "{a=": "}"}[bracket]
    text = f"x = {bracket * depth}1{closing * depth}\n"
    (small / "capture.toml").write_text(text)
    outcome = sixlight("inspect", small)
    assert outcome.status == 2
    assert "capture.toml" in outcome.err
    assert len(outcome.err) < 2000


def test_an_exr_whose_header_claims_too_much(sixlight, tmp_path):
    import numpy as np

    from pipeline import io

    path = tmp_path / "map.exr"
    io.write_exr(path, np.zeros((12, 2, 3), np.float32), "RGB", {})
    content = path.read_bytes()
    window = b"dataWindow\0box2i\0\x10\0\0\0"
    at = content.index(window) + len(window)
    large = np.array([0, 0, 99_999, 599_999], "<i4").tobytes()
    path.write_bytes(content[:at] + large + content[at + 16 :])
    outcome = sixlight("preview", path, "-o", tmp_path / "new")
    assert outcome.status == 2
    assert len(outcome.err.splitlines()) == 1
    assert "map.exr" in outcome.err


def test_a_gltf_of_absurd_depth(sixlight, finished_once, tmp_path):
    nodes = [{"children": [i + 1]} for i in range(20_000)] + [{}]
    deep = {"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "scene": 0, "nodes": nodes}
    (tmp_path / "deep.gltf").write_text(json.dumps(deep))
    (tmp_path / "nested.gltf").write_text("[" * 200_000)
    for name in ("deep.gltf", "nested.gltf"):
        outcome = sixlight(
            "preview", finished_once, "--scene", tmp_path / name, "-o", tmp_path / "new"
        )
        assert outcome.status == 2
        assert len(outcome.err.splitlines()) == 1
        assert name in outcome.err


def test_links_out_of_the_capture_are_not_followed(sixlight, small):
    shutil.move(small / "F.csv", small.parent / "F.csv")
    (small / "F.csv").symlink_to(small.parent / "F.csv")
    outcome = sixlight("inspect", small)
    assert outcome.status == 2
    assert "calibration.filters" in outcome.err
    assert "inside the capture's folder" in outcome.err


# -------------------------------------------------------------------------------------- determinism


@pytest.mark.slow
def test_one_thread_or_eight_make_the_same_bytes(small, tmp_path):
    every = os.sched_getaffinity(0)
    for threads in ("1", "8"):
        names = "OMP_NUM_THREADS", "OPENCV_FOR_THREADS_NUM", "NUMBA_NUM_THREADS"
        names += "OPENBLAS_NUM_THREADS", "OPENIMAGEIO_THREADS"
        # Threads that decode: as many as there are processors that may be used.
        processors = set(sorted(every)[: int(threads)])
        os.sched_setaffinity(0, processors)
        process = started(
            *("envmap", small, "-o", tmp_path / threads, "--quiet", "--preview-width", "192"),
            **dict.fromkeys(names, threads),
        )
        os.sched_setaffinity(0, every)
        _, said = process.communicate()
        assert process.returncode == 0, said
    one, eight = (results(tmp_path / threads) for threads in ("1", "8"))
    assert {k: v for k, v in one.items() if k.endswith(".exr")}
    assert one == eight
