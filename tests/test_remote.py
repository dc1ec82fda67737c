"""Captures and results by URL: brought here, put back whole or not at all, and not twice."""

from __future__ import annotations

import errno
import fcntl
import json
import math
import shutil
import sys
import tempfile
import threading

import pytest

pytest.importorskip("fsspec", reason="needs pip install 'sixlight[cluster]'")

import elsewhere
import fsspec
from conftest import QUICK

from pipeline import batch, defaults, remote
from pipeline.batch import child
from pipeline.batch.shoot import plan
from pipeline.errors import InputError, fault, storing
from pipeline.settings import Settings
from pipeline.storage import Storage, place

SETTINGS = Settings()
SHOOT = "memory://bucket/shoot"
CAPTURE, OUT = f"{SHOOT}/office", "memory://bucket/maps/office"
PUT = {"cubemap.exr", "report.html", "only_1.png", "work/report.made.json", "result.json"}
ALL = PUT | {"work/capture.json", "work/stored.json"}


@pytest.fixture(autouse=True)
def bucket(monkeypatch, tmp_path):
    """An empty store, and a TMPDIR of one's own, that is empty in the end."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(tmp_path))  # of children
    yield
    fsspec.filesystem("memory").store.clear()
    fsspec.filesystem("memory").pseudo_dirs[:] = [""]
    assert not list(tmp_path.glob("sixlight-*"))


def run(version="1", **how) -> None:
    with remote.here(place(CAPTURE), place(OUT), SETTINGS, **how) as (_, results):
        elsewhere.make(results, version)


def holds(settings=SETTINGS) -> bool:
    return remote.holds(place(CAPTURE), place(OUT), settings)


# --------------------------------------------------------------------------------- there and back


def test_paths_stay_where_they_are(tmp_path):
    with remote.here(tmp_path, tmp_path / "out", SETTINGS) as given:
        assert given == (tmp_path, tmp_path / "out")


def test_a_capture_is_brought_and_its_results_are_put_back():
    elsewhere.put_capture(CAPTURE)
    with remote.here(place(CAPTURE), place(OUT), SETTINGS) as (folder, results):
        assert (folder / "cyan" / "1.dng").read_text() == "one"
        assert (folder / "capture.toml").is_file()
        elsewhere.make(results)
        work = results
    assert elsewhere.names(OUT) == ALL
    assert elsewhere.read(f"{OUT}/cubemap.exr") == "1"
    told = json.loads(elsewhere.read(f"{OUT}/work/capture.json"))
    assert told == {"capture": "../../shoot/office"}  # as for folders laid out like that
    assert remote.grade(place(OUT)) == "good"
    assert not work.exists()


def test_results_by_url_of_a_capture_that_is_here(tmp_path):
    elsewhere.put_capture(f"file://{tmp_path}/office")
    with remote.here(tmp_path / "office", place(OUT), SETTINGS) as (folder, results):
        assert folder == tmp_path / "office"  # nothing is copied
        elsewhere.make(results)
    assert elsewhere.names(OUT) == ALL
    assert remote.holds(tmp_path / "office", place(OUT), SETTINGS)


def test_what_stands_above_counts_as_it_would_here():
    elsewhere.put_capture(CAPTURE)
    content = '[sphere]\nradius_mm = 50.0\n[calibration]\ntransform = "fits/M_S.toml"\n'
    elsewhere.write(f"{SHOOT}/defaults.toml", content)
    elsewhere.write(f"{SHOOT}/fits/M_S.toml", "first")
    elsewhere.write(f"{SHOOT}/hall/cyan/1.dng", "another capture's")
    elsewhere.write("memory://bucket/defaults.toml", "no TOML [")
    with remote.here(place(CAPTURE), place(OUT), SETTINGS) as (folder, results):
        shoot = folder.parent
        above = [shoot / "defaults.toml", shoot.parent / "defaults.toml"]
        assert defaults.above(folder) == above  # and none of this machine's
        assert (shoot / "fits" / "M_S.toml").read_text() == "first"
        assert not (shoot / "hall").exists()
        elsewhere.make(results)
    assert holds()
    elsewhere.write(f"{SHOOT}/fits/M_S.toml", "second")
    assert not holds()


def test_errors_name_the_url():
    elsewhere.put_capture(CAPTURE)
    brought = remote.here(place(CAPTURE), place(OUT), SETTINGS)
    with pytest.raises(InputError) as raised, brought as (folder, _):
        raise fault(f"not as in {folder.parent}", "", "copy it again", folder / "1.dng")
    assert str(raised.value) == f"{CAPTURE}/1.dng: not as in {SHOOT}; copy it again"
    assert elsewhere.names(OUT) == {"work/capture.json"}


def test_a_full_work_folder_is_told_as_one():
    elsewhere.put_capture(CAPTURE)
    brought = remote.here(place(CAPTURE), place(OUT), SETTINGS)
    full = pytest.raises(InputError, match=r"no space .*TMPDIR")
    with full, brought as (_, results), storing(results):
        raise OSError(errno.ENOSPC, "")


def test_results_of_another_capture_are_not_replaced():
    elsewhere.put_capture(CAPTURE)
    elsewhere.write(f"{OUT}/thesis.pdf", "")
    with pytest.raises(InputError, match="sixlight did not write"):
        run()
    run(force=True)
    elsewhere.put_capture(f"{SHOOT}/hall")
    said = r"another capture \(../../shoot/office\)"
    hall = remote.here(place(f"{SHOOT}/hall"), place(OUT), SETTINGS)
    with pytest.raises(InputError, match=said), hall:
        pass
    assert elsewhere.read(f"{OUT}/thesis.pdf") == ""


def test_nothing_is_brought_where_it_would_not_fit(monkeypatch):
    elsewhere.put_capture(CAPTURE)
    usage = type(shutil.disk_usage("/"))(100, 99, 1)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    with pytest.raises(InputError, match=r"0.0 GB are free .*TMPDIR"):
        run()


@pytest.mark.parametrize(
    ("change", "said"),
    [(None, "is gone"), ("longer", "bytes|has changed"), ("two", "has changed")],
)
def test_a_photograph_that_changes_while_it_is_brought(monkeypatch, change, said):
    elsewhere.put_capture(CAPTURE)
    get = Storage.get
    victim = f"{CAPTURE}/cyan/1.dng"

    def changing(*given):
        if change is None:
            fsspec.filesystem("memory").rm(victim)
        else:
            elsewhere.write(victim, change)
        get(*given)

    monkeypatch.setattr(Storage, "get", changing)
    with pytest.raises(InputError, match=said) as raised:
        run()
    assert str(raised.value).startswith(f"{victim}: ")


# ----------------------------------------------------------------------------- whole or not at all


class DiedError(Exception):
    """The machine, as far as the storage can tell."""


@pytest.fixture
def dies_at(monkeypatch):
    """dies_at(k): after k more changes to the store none comes through any more."""
    fs = fsspec.filesystem("memory")
    left = [math.inf]

    def counted(name):
        original = getattr(fs, name)

        def change(*given, **how):
            if left[0] <= 0:
                raise DiedError
            left[0] -= 1
            return original(*given, **how)

        monkeypatch.setattr(fs, name, change)

    for name in ("put_file", "cp_file", "rm_file", "pipe_file"):
        counted(name)

    def at(changes) -> None:
        left[0] = changes

    return at


def whole(version: str) -> bool:
    """Whether what stands, if it is marked as complete, is all of one run."""
    names = elsewhere.names(OUT)
    if "result.json" not in names:
        return False
    of = json.loads(elsewhere.read(f"{OUT}/result.json"))["version"]
    expected = {"cubemap.exr", "report.html", f"only_{of}.png"}
    assert expected <= names
    assert {elsewhere.read(f"{OUT}/{name}") for name in expected} == {of}
    return of == version


def test_a_run_that_dies_at_any_moment_leaves_nothing_half(dies_at, monkeypatch):
    elsewhere.put_capture(CAPTURE)
    monkeypatch.setattr(remote, "_SILENT_S", 0.0)  # the mark of the dead is soon passed over
    monkeypatch.setattr(remote, "_LOOK_S", 0.0)
    old, new = "1", "2"
    run(old)
    stood = 0
    for changes in range(200):
        elsewhere.write(f"{CAPTURE}/cyan/1.dng", f"again {changes}")
        dies_at(changes)
        try:
            run(new)
        except InputError:
            pass
        else:
            break
        dies_at(math.inf)
        stands = whole(old)  # if it is neither, nothing is marked as complete
        stood += stands
        assert whole(new) or not holds()
        run(new)
        assert whole(new)
        assert holds()
        assert elsewhere.names(OUT) == {n.replace("_1", f"_{new}") for n in ALL}  # no leftovers
        old, new = new, old
    assert changes > 20
    assert stood > len(PUT)  # while things are stored beside, what was there stays


def test_of_two_runs_on_one_output_the_first_counts():
    elsewhere.put_capture(CAPTURE)
    with remote.here(place(CAPTURE), place(OUT), SETTINGS) as (_, results):
        run("2")
        elsewhere.make(results, "1")
    assert whole("2")
    assert elsewhere.names(OUT) == {n.replace("_1", "_2") for n in ALL}


def test_runs_move_their_results_one_at_a_time(monkeypatch):
    elsewhere.put_capture(CAPTURE)
    monkeypatch.setattr(remote, "_LOOK_S", 0.01)
    target = Storage(place(OUT))
    inside, most = [], []

    def move():
        with remote._alone(target) as still_here:
            inside.append(1)
            most.append(len(inside))
            still_here()
            inside.pop()

    threads = [threading.Thread(target=move) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == [1] * 8


def test_work_folders_of_the_killed_are_cleared_away(tmp_path):
    left, used = tmp_path / "sixlight-left", tmp_path / "sixlight-used"
    for folder in (left, used):
        folder.mkdir()
        (folder / defaults.ROOT).touch()
    with (used / defaults.ROOT).open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        remote.clear_left()
        assert not left.exists()
        assert used.exists()
    remote.clear_left()
    assert not used.exists()


# ----------------------------------------------------------------------------------- not twice


def photograph_changed():
    elsewhere.write(f"{CAPTURE}/cyan/1.dng", "two")


def photograph_more():
    elsewhere.write(f"{CAPTURE}/cyan/2.dng", "")


def photograph_less():
    fsspec.filesystem("memory").rm(f"{CAPTURE}/cyan/1.dng")


def defaults_new():
    elsewhere.write(f"{SHOOT}/defaults.toml", "")


def result_gone():
    fsspec.filesystem("memory").rm(f"{OUT}/cubemap.exr")


def result_changed():
    elsewhere.write(f"{OUT}/cubemap.exr", "2")


def stamp_gone():
    fsspec.filesystem("memory").rm(f"{OUT}/work/stored.json")


def stamp_of_nothing():
    elsewhere.write(f"{OUT}/work/stored.json", "[]")


@pytest.mark.parametrize(
    "change",
    [
        photograph_changed,
        photograph_more,
        photograph_less,
        defaults_new,
        result_gone,
        result_changed,
        stamp_gone,
        stamp_of_nothing,
    ],
)
def test_whatever_is_doubtful_is_run(change):
    elsewhere.put_capture(CAPTURE)
    assert not holds()
    run()
    assert holds()
    assert not holds(Settings(face_size=64))
    change()
    assert not holds()


def test_where_nothing_tells_of_a_change_all_is_run(monkeypatch):
    elsewhere.put_capture(CAPTURE)
    monkeypatch.setattr("pipeline.storage._TELLING", set())
    run()
    assert not holds()


# --------------------------------------------------------------------------------------- batches


@pytest.fixture
def stand_in(monkeypatch):
    monkeypatch.setattr(
        child,
        "_command",
        lambda folder, out, *_: [
            *(sys.executable, "-c", elsewhere.PROGRAM),
            *map(child.address, (out, folder)),
        ],
    )


def outcomes(shoot: str, out: str) -> dict[str, child.Outcome]:
    jobs = plan([place(shoot)], place(out), SETTINGS)
    orders = batch.Orders(SETTINGS, batch.Limits(2, math.inf, 60.0, math.inf))
    return {job.name: outcome for job, outcome in batch.run(jobs, orders, quiet=True).items()}


def test_captures_are_found_by_url_as_on_disk(tmp_path):
    for root in (SHOOT, f"file://{tmp_path}"):
        elsewhere.put_capture(f"{root}/office")
        elsewhere.write(f"{root}/week2/hall/cyan/1.CR2", "")
        elsewhere.write(f"{root}/.hidden/x/capture.toml", "")
        elsewhere.write(f"{root}/results/work/capture.json", "")
        elsewhere.write(f"{root}/results/capture.toml", "")
        elsewhere.write(f"{root}/session/A/radiance.csv", "")
        elsewhere.write(f"{root}/session/A/cyan/1.dng", "")
        elsewhere.write(f"{root}/sensor/dark/1.dng", "")
    jobs = plan([place(SHOOT)], place("memory://bucket/maps"), SETTINGS)
    assert [(job.name, str(job.out)) for job in jobs] == [
        ("office", OUT),
        ("week2/hall", "memory://bucket/maps/week2/hall"),
    ]
    here = plan([tmp_path], tmp_path / "out", SETTINGS)
    assert [j.name for j in here] == [j.name for j in jobs]
    more = {j.needs.memory_bytes - h.needs.memory_bytes for j, h in zip(jobs, here, strict=True)}
    assert more == {remote._STORAGE_BYTES}  # the same is read of the photographs


@pytest.mark.parametrize(
    ("shoot", "out", "said"),
    [
        ("memory://bucket/empty", "memory://bucket/maps", "no captures found"),
        (SHOOT, CAPTURE, "own folder"),
        ("nosuch://bucket/shoot", "out", "nothing fsspec knows"),
        ("abfs://container/shoot", "out", "adlfs"),
    ],
)
def test_what_cannot_be_done_is_refused_before_anything_runs(sixlight, shoot, out, said):
    elsewhere.put_capture(CAPTURE)
    outcome = sixlight("batch", shoot, "-o", out)
    assert (outcome.status, outcome.err.count("\n")) == (2, 1)
    assert said in outcome.err


def test_a_batch_by_url(stand_in, tmp_path, sixlight):
    shoot, maps = f"file://{tmp_path}/shoot", f"file://{tmp_path}/maps"
    for name in ("bad", "hall", "killed"):
        elsewhere.put_capture(f"{shoot}/{name}")
    outcome = sixlight("batch", shoot, "-o", maps, "--quiet", "--json", "--jobs", "2")
    assert outcome.status == 2, outcome
    told = {c["name"]: c for c in json.loads(elsewhere.read(f"{maps}/batch.json"))["captures"]}
    assert json.loads(outcome.out)["captures"] == list(told.values())
    assert [told[n]["state"] for n in ("bad", "hall", "killed")] == ["failed", "done", "failed"]
    assert told["bad"]["error"] == [f"{shoot}/bad/capture.toml: damaged; copy it again"]
    assert "memory" in told["killed"]["error"][0]
    assert told["hall"]["grade"] == "good"
    assert elsewhere.read(f"{maps}/hall/cubemap.exr") == "capture.toml cyan/1.dng yellow/1.dng"


def test_what_is_finished_starts_no_process(stand_in, tmp_path, monkeypatch):
    shoot, maps = f"file://{tmp_path}/shoot", f"file://{tmp_path}/maps"
    elsewhere.put_capture(f"{shoot}/office")
    assert outcomes(shoot, maps)["office"].state == child.DONE
    monkeypatch.setattr(batch, "Run", None)
    monkeypatch.setattr(Storage, "get", None)
    again = outcomes(shoot, maps)["office"]
    assert (again.state, again.grade) == (child.CURRENT, "good")


def test_those_brought_here_share_the_disk():
    for name in ("a", "b", "c"):
        elsewhere.put_capture(f"{SHOOT}/{name}")
    jobs = plan([place(SHOOT)], place(OUT), SETTINGS)
    disk = 2.5 * jobs[0].needs.disk_bytes
    limits = batch.Limits(8, math.inf, 60.0, disk)
    assert len(batch._admitted(jobs, [], limits)) == 2
    assert len(batch._admitted(jobs, jobs[:1], limits)) == 1


@pytest.mark.slow
def test_a_real_capture_by_url_is_as_one_on_disk(
    small_capture_once, finished_once, sixlight, tmp_path
):
    shutil.copytree(small_capture_once, tmp_path / "shoot" / "small")
    given = f"file://{tmp_path}/shoot", "-o", f"file://{tmp_path}/maps", "--json", *QUICK
    first, again = (sixlight("batch", *given) for _ in range(2))
    assert first.status == 0, first
    assert json.loads(again.out)["captures"][0]["state"] == child.CURRENT
    there = tmp_path / "maps" / "small"
    for path in finished_once.glob("*.exr"):
        assert (there / path.name).read_bytes() == path.read_bytes()
    assert sixlight("verify", there).status == 0


# ------------------------------------------------------------------------------------ a real store


@pytest.fixture
def s3(monkeypatch):
    """A bucket of a server that speaks S3."""
    pytest.importorskip("s3fs", reason="needs pip install s3fs")
    server = pytest.importorskip("moto.server", reason="needs pip install 'moto[s3,server]'")
    threaded = server.ThreadedMotoServer("127.0.0.1", 0)
    threaded.start()
    host, port = threaded.get_host_and_port()
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "test")
    fsspec.filesystem("s3").mkdir("bucket")
    yield "s3://bucket"
    threaded.stop()


@pytest.mark.slow
def test_a_batch_in_an_object_store(s3, stand_in, sixlight):
    for name in ("hall", "office [1]"):
        elsewhere.put_capture(f"{s3}/shoot/{name}")
    elsewhere.write(f"{s3}/shoot/defaults.toml", "")
    outcome = sixlight("batch", f"{s3}/shoot", "-o", f"{s3}/maps", "--quiet", "--json")
    assert outcome.status == 0, outcome
    assert [c["grade"] for c in json.loads(outcome.out)["captures"]] == ["good", "good"]
    assert elsewhere.names(f"{s3}/maps/office [1]") == {
        *("cubemap.exr", "result.json", "work/capture.json", "work/stored.json")
    }
    again = sixlight("batch", f"{s3}/shoot", "-o", f"{s3}/maps", "--quiet", "--json")
    assert {c["state"] for c in json.loads(again.out)["captures"]} == {child.CURRENT}
    elsewhere.write(f"{s3}/shoot/hall/cyan/1.dng", "two")
    third = sixlight("batch", f"{s3}/shoot", "-o", f"{s3}/maps", "--quiet", "--json")
    assert [c["state"] for c in json.loads(third.out)["captures"]] == [child.DONE, child.CURRENT]
    nowhere = sixlight("batch", f"{s3}/shoot", "-o", "s3://slip/maps", "--quiet")
    assert "no such bucket" in nowhere.out.splitlines()[1]
    assert not fsspec.filesystem("s3").exists("slip")
