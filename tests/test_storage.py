"""Folders by URL: what they are called, what is in them, and what a storage's refusals become."""

from __future__ import annotations

import errno
import resource
from pathlib import Path, PurePosixPath

import pytest

fsspec = pytest.importorskip("fsspec", reason="needs pip install 'sixlight[cluster]'")

from pipeline import storage  # noqa: E402
from pipeline.errors import InputError  # noqa: E402
from pipeline.storage import RefusedError, Storage, Url, place  # noqa: E402


@pytest.fixture(params=["memory", "file"])
def folder(request, tmp_path) -> Url:
    """An empty folder in each kind of storage: one that renames, one that copies."""
    root = f"memory://{tmp_path.name}" if request.param == "memory" else f"file://{tmp_path}/x"
    yield place(root)
    fsspec.filesystem("memory").store.clear()


# ------------------------------------------------------------------------------------------ names


def test_what_has_a_protocol_is_a_url():
    assert place("week47/office") == Path("week47/office")
    assert place("s3://bucket/shoot/") == Url("s3://bucket/shoot")
    assert place("C:/odd") == Path("C:/odd")
    assert str(place("s3://bucket/shoot") / PurePosixPath("a/b")) == "s3://bucket/shoot/a/b"


@pytest.mark.parametrize("word", ["s3://", "s3://bucket/a/../b"])
def test_a_url_that_names_no_folder_is_refused(word):
    with pytest.raises(InputError, match="names no folder"):
        place(word)


def test_a_password_is_never_shown():
    url = place("sftp://me:secret@host:22/shoot")
    assert str(url) == "sftp://me@host:22/shoot"
    assert "secret" not in f"{url!r} {url.path}"
    assert str(place("file:///a:b@c")) == "file:///a:b@c"  # no password
    assert str(place("abfs://container@account/shoot")) == "abfs://container@account/shoot"


def test_parents_go_up_to_the_bucket():
    told = [str(url) for url in place("s3://bucket/a/b").parents]
    assert told == ["s3://bucket/a", "s3://bucket"]


# ---------------------------------------------------------------------------------------- content


def test_files_come_back_as_they_were_put(folder, tmp_path):
    here = tmp_path / "here"
    (here / "cyan [1]").mkdir(parents=True)
    (here / "a.txt").write_text("a")
    (here / "cyan [1]" / "b*.txt").write_text("bb")  # no patterns, but names
    names = ["a.txt", "cyan [1]/b*.txt"]
    stored = Storage(folder)
    stored.put(here, names, "beside")
    stored.move([(f"beside/{name}", name) for name in names])
    stored.put(here, names, "beside")
    assert sorted(stored.folders("")) == ["beside", "cyan [1]"]
    stored.remove_folder("beside")
    assert stored.folders("") == ["cyan [1]"]
    files = stored.files()
    assert {name: state[0] for name, state in files.items()} == {names[0]: 1, names[1]: 2}
    assert all(len(state) > 1 for state in files.values())
    stored.get(files, tmp_path / "back")
    assert (tmp_path / "back" / names[1]).read_text() == "bb"
    assert stored.files("cyan [1]").keys() == {names[1]}
    stored.remove([*names, "never there"])
    assert stored.files() == {}


def test_a_file_is_read_where_it_is(folder):
    stored = Storage(folder)
    assert stored.read("a") is None
    assert stored.state("a") is None
    assert stored.files() == {}
    assert stored.write("a", b"0123")
    assert not stored.write("a", b"other", new=True)
    assert (stored.read("a"), stored.read("a", first=2)) == (b"0123", b"01")
    before = stored.state("a")
    assert stored.write("a", b"4567")
    assert stored.state("a") != before


# ----------------------------------------------------------------------------------------- errors


def test_an_unknown_protocol_is_told():
    with pytest.raises(InputError, match="nosuch:// is nothing fsspec knows"):
        Storage(place("nosuch://bucket/shoot"))


def test_a_package_that_lacks_is_named():
    with pytest.raises(InputError, match=r"needs a package.*adlfs"):
        Storage(place("abfs://container/shoot"))


def test_names_that_lead_out_are_refused(folder, monkeypatch):
    """Keys of an object store may be anything."""
    stored = Storage(folder)
    for name in ("../x", "a/../../x", "/etc/x", "a//b", "./a"):
        found = {f"{stored._path}/{name}": {"type": "file", "size": 1}}
        monkeypatch.setattr(stored._fs, "find", lambda *_, found=found, **__: found)
        with pytest.raises(InputError, match="leads elsewhere"):
            stored.files()


def test_links_that_lead_out_are_not_followed(tmp_path):
    (tmp_path / "secret").write_text("s")
    (tmp_path / "shoot" / "cyan").mkdir(parents=True)
    (tmp_path / "shoot" / "cyan" / "1.dng").write_text("one")
    (tmp_path / "shoot" / "2.dng").symlink_to("cyan/1.dng")
    (tmp_path / "shoot" / "circle").symlink_to(tmp_path / "shoot")
    stored = Storage(storage.url_of(tmp_path / "shoot"))
    assert [*stored.files()] == ["2.dng", "cyan/1.dng"]
    stored.get(stored.files(), tmp_path / "before")
    assert (tmp_path / "before" / "2.dng").read_text() == "one"
    (tmp_path / "shoot" / "a").symlink_to(tmp_path / "secret")
    with pytest.raises(InputError, match="leads out"):
        stored.get(stored.files(), tmp_path / "here")
    assert not (tmp_path / "here").exists()


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (PermissionError("AccessDenied"), "access is refused"),
        (type("Odd", (Exception,), {"status": 403})("no"), "access is refused"),
        (OSError(errno.ENOSPC, "full"), "no space is left; free some"),
        (NotImplementedError(), "can only be read"),
        (RuntimeError("no route to memory://x\n"), "cannot be reached: no route to memory://x"),
    ],
    ids=["denied", "403", "full", "read-only", "unknown"],
)
def test_what_a_storage_refuses_is_a_sentence(monkeypatch, error, said):
    stored = Storage(place("memory://x"))

    def refuse(*_, **__):
        raise error

    monkeypatch.setattr(stored._fs, "pipe_file", refuse)
    with pytest.raises(InputError) as raised:
        stored.write("a", b"")
    (problem,) = raised.value.problems
    assert str(problem).startswith("memory://x/a: ")
    assert said in str(problem)
    assert isinstance(raised.value, RefusedError) == ("refused" in said or "read" in said.split())


def test_a_disk_that_takes_no_more_is_told(tmp_path):
    """The kernel's own word: no file of more than 1000 bytes."""
    (tmp_path / "large").write_bytes(bytes(5000))
    stored = Storage(storage.url_of(tmp_path / "there"))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        with pytest.raises(InputError, match="no space is left"):
            stored.put(tmp_path, ["large"], "beside")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
