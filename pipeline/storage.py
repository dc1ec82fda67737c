"""Folders by URL, s3://bucket/shoot: what of fsspec a capture needs, and its errors as sentences.

fsspec, which an extra brings, is imported where a URL is first opened; paths never need it.
"""

from __future__ import annotations

import errno
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from calibration.errors import InputError, Problem, fault

_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://")
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_REFUSED = (401, 403)  # HTTP's words for it, and most object stores'
_MOST_SAID = 200  # characters of what a storage says

# What tells whether a file is still what it was, in the words of S3, Google, Azure, HTTP, SFTP,
# FTP, HDFS and file systems; case, "_" and "-" aside.
_TELLING = {
    *("etag", "md5", "md5hash", "contentmd5", "digest", "sha", "generation", "versionid"),
    *("lastmodified", "updated", "created", "mtime", "modify", "modified", "modificationtime"),
    *("lastwritetime", "changetime"),
}

State = list[int | str]  # of a file: its size, and what else would tell of a change
Listing = dict[str, State]  # by name below a folder


@dataclass(frozen=True)
class Url:
    """A folder by URL: as much of a Path as a batch needs.

    text  as fsspec takes it; str() leaves out a password that may be in it
    """

    text: str = field(repr=False)

    @property
    def protocol(self) -> str:
        protocol = self.text.partition("://")[0].lower()
        return "file" if protocol == "local" else protocol

    @property
    def path(self) -> PurePosixPath:
        """Where it lies, to be compared and laid out alike: /s3/bucket/shoot."""
        return PurePosixPath("/", self.protocol, str(self).partition("://")[2].strip("/"))

    @property
    def name(self) -> str:
        return self.path.name

    @property
    def parents(self) -> list[Url]:
        """The folders above it, the nearest first, up to the bucket or host."""
        protocol, _, rest = self.text.partition("://")
        top, *parts = rest.split("/")
        above = ["/".join([top, *parts[:n]]) for n in range(len(parts))]
        return [Url(f"{protocol}://{each}") for each in reversed(above)]

    def __truediv__(self, below: str | PurePosixPath) -> Url:
        return Url(f"{self.text.rstrip('/')}/{below}")

    def __str__(self) -> str:
        return _without_password(self.text)


Place = Path | Url


def _without_password(text: str) -> str:
    return re.sub(r"(://[^/@:\s]*):[^/@\s]*@", r"\1@", text)


def place(word: str) -> Place:
    """A folder as the command line has it: a path or a URL."""
    if not _URL.match(word):
        return Path(word)
    protocol, _, below = word.partition("://")
    if not below.strip("/") or ".." in below.split("/"):
        expected = "PROTOCOL://BUCKET/FOLDER, without .."
        raise fault("names no folder", expected, "correct it", str(Url(word)))
    return Url(f"{protocol}://{below.rstrip('/')}")


def address(where: Place) -> str:
    """The word that `place` makes the same folder of, from whichever folder it is called."""
    return where.text if isinstance(where, Url) else str(where.resolve())


def url_of(where: Place) -> Url:
    return where if isinstance(where, Url) else Url(f"file://{where.resolve()}")


class MissingError(InputError):
    """What was asked for is not there."""


class RefusedError(InputError):
    """It may not be read, or not be written."""


class Storage:
    """A folder by URL. What the storage refuses, each method raises as an InputError."""

    def __init__(self, url: Url):
        self.url = url
        try:
            from fsspec import AbstractFileSystem, get_filesystem_class
            from fsspec.core import url_to_fs
        except ImportError as error:
            remedy = "run pip install 'sixlight[cluster]'"
            raise fault("URLs need fsspec, which is not installed", "", remedy, str(url)) from error
        try:
            get_filesystem_class(url.protocol)
        except ImportError as error:  # whose text says which package it is
            found = f"{url.protocol}:// needs a package that is not installed"
            raise fault(found, "", str(error), str(url)) from error
        except ValueError as error:
            known = "s3://, gs://, abfs://, sftp://, https://, file:// or another of its list"
            found = f"{url.protocol}:// is nothing fsspec knows"
            raise fault(found, known, "correct it", str(url)) from error
        with self._asking():
            self._fs, self._path = url_to_fs(url.text)
        # What does not rename copies and removes, and would take "[" in a name for a pattern.
        self._renames = type(self._fs).mv is not AbstractFileSystem.mv

    def files(self, below: str = "") -> Listing:
        """All files below the folder, or below one in it; none where there is no such folder."""
        with self._asking(below):
            self._fs.invalidate_cache()  # of listings: others write here too
            try:
                found = self._fs.find(self._at(below), detail=True)
            except (FileNotFoundError, NotADirectoryError):
                return {}
            listing = {}
            for path, info in sorted(found.items()):
                name = self._name(path)
                if info.get("islink"):  # to a file it counts as one; those to folders may circle
                    info = self._fs.info(path)
                if info.get("type") != "file" or not name or name.endswith("/"):
                    continue  # a mark that stands for a folder; or the folder is a file
                listing[name] = self._state(path, info)
            return listing

    def state(self, name: str) -> State | None:
        """Of a file; None where there is none of that name."""
        with self._asking(name):
            try:
                info = self._fs.info(self._at(name))
            except (FileNotFoundError, NotADirectoryError):
                return None
            return self._state(self._at(name), info) if info["type"] == "file" else None

    def read(self, name: str, first: int | None = None) -> bytes | None:
        """What is in a file, or in the first bytes of it; None where there is none."""
        with self._asking(name):
            try:
                content: bytes = self._fs.cat_file(self._at(name), start=0, end=first)
            except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
                return None
            return content[:first]

    def get(self, files: Mapping[str, State], folder: Path) -> None:
        """Brings files to a folder of this machine."""
        here = {name: folder / name for name in files}
        if self.url.protocol == "file":
            self._check_links(files)
        with self._asking(full=folder):
            for parent in {path.parent for path in here.values()}:
                parent.mkdir(parents=True, exist_ok=True)
            self._fs.get([self._at(name) for name in here], [str(p) for p in here.values()])
        for name, path in here.items():
            came, listed = path.stat().st_size, files[name][0]
            if came != listed:
                found = f"{came} bytes of it came"
                raise fault(found, f"{listed}, as listed", "run again", str(self.url / name))

    def put(self, folder: Path, names: Collection[str], below: str) -> None:
        """Stores files from a folder of this machine in a folder below this one."""
        there = [f"{below}/{name}" for name in names]
        with self._asking(below):
            self._make_folders(there)
            self._fs.put([str(folder / n) for n in names], [self._at(n) for n in there])

    def write(self, name: str, content: bytes, *, new: bool = False) -> bool:
        """Stores a small file, and returns whether it did.

        new  only where there is none of that name: in one step where the storage knows how to
             (S3, Google, Azure), else by looking first
        """
        with self._asking(name):
            self._make_folders([name])
            try:
                self._fs.pipe_file(self._at(name), content, **({"mode": "create"} if new else {}))
            except FileExistsError:
                return False
            return True

    def move(self, moves: Sequence[tuple[str, str]]) -> None:
        """Gives files other names, (old, new), in this order: by renaming where the storage can,
        else by copies that it makes itself, each there whole or not at all."""
        with self._asking():
            self._make_folders([new for _, new in moves])
            for old, new in moves:
                if self._renames:
                    self._fs.mv(self._at(old), self._at(new))
                else:
                    self._fs.cp_file(self._at(old), self._at(new))
                    self._fs.rm_file(self._at(old))

    def remove(self, names: Iterable[str]) -> None:
        """Removes files, where they are there."""
        with self._asking():
            for name in names:
                with suppress(FileNotFoundError):
                    self._fs.rm_file(self._at(name))

    def folders(self, below: str) -> list[str]:
        """Names of the sub-folders of one below this."""
        with self._asking(below):
            self._fs.invalidate_cache()
            try:
                found = self._fs.ls(self._at(below), detail=True)
            except (FileNotFoundError, NotADirectoryError):
                return []
            return [PurePosixPath(i["name"]).name for i in found if i["type"] == "directory"]

    def remove_folder(self, below: str) -> None:
        """Removes a folder below this one, with all that is in it."""
        with self._asking(below):
            self._fs.invalidate_cache()
            found = self._fs.find(self._at(below), withdirs=True, detail=True)
            folders = {self._at(below)}
            for path, info in found.items():
                if info["type"] == "directory":
                    folders.add(path)
                else:
                    self._fs.rm_file(path)
            for folder in sorted(folders, key=len, reverse=True):
                with suppress(OSError, NotImplementedError):  # object stores have none
                    self._fs.rmdir(folder)

    def _check_links(self, names: Iterable[str]) -> None:
        """Of all storage it is file systems whose links could give away what lies elsewhere."""
        own = Path(self._path).resolve()
        for name in names:
            if not (own / name).resolve().is_relative_to(own):
                found, remedy = "a link that leads out of the folder", "put the file there"
                raise fault(found, "a file", remedy, str(self.url / name))

    def _make_folders(self, names: Iterable[str]) -> None:
        bucket = "" if "://" in self._path else self._path.partition("/")[0]
        if bucket and not self._fs.exists(bucket):  # or s3fs would make it, were it a slip of hand
            found = "no such bucket, or none for you"
            raise MissingError(Problem(found, "one that is there", "make it", str(self.url)))
        for folder in {self._at(name).rpartition("/")[0] for name in names}:
            self._fs.makedirs(folder, exist_ok=True)

    def _at(self, name: str) -> str:
        return f"{self._path.rstrip('/')}/{name}" if name else self._path

    def _name(self, path: str) -> str:
        """Of a file below the folder; InputError where it would lead out of any."""
        name = path.removeprefix(self._path.rstrip("/")).removeprefix("/")
        plain = str(PurePosixPath(name)) if name else ""
        if name.startswith("/") or ".." in name.split("/") or name.removesuffix("/") != plain:
            raise fault("a name that leads elsewhere", "a file below it", "rename it", path)
        return name

    def _state(self, path: str, info: Mapping[str, Any]) -> State:
        if info.get("size") is None:  # HTTP tells it only when asked for the file
            info = self._fs.info(path)
        told = {re.sub("[_-]", "", key).lower(): value for key, value in info.items()}
        telling = [f"{key} {told[key]}" for key in sorted(_TELLING & told.keys())]
        return [int(info.get("size") or 0), *telling]

    @contextmanager
    def _asking(self, name: str = "", full: Path | None = None) -> Iterator[None]:
        """Around what is asked of the storage.

        full  what is full if there is no space; else the storage itself
        """
        about = str(self.url / name if name else self.url)
        try:
            yield
        except InputError:
            raise
        # Each kind of storage has errors of its own, and not all of them are OSErrors.
        except Exception as error:
            raise self._said(error, about, full) from error

    def _said(self, error: Exception, about: str, full: Path | None) -> InputError:
        number = getattr(error, "errno", None)
        text = _without_password(" ".join(str(error).split()) or type(error).__name__)
        if isinstance(error, FileNotFoundError):
            return MissingError(
                Problem("is not there", "what was there before", "run again if it is back", about)
            )
        if number in _FULL:
            remedy = "free some, or have TMPDIR name a larger disk" if full else "free some"
            return fault("no space is left", "", remedy, full or about)
        if isinstance(error, PermissionError) or getattr(error, "status", None) in _REFUSED:
            remedy = "check its permissions, or the credentials fsspec is given"
            return RefusedError(Problem("access is refused", "", remedy, about))
        if isinstance(error, NotImplementedError):
            found = f"{self.url.protocol}:// can only be read"
            return RefusedError(
                Problem(found, "a place to write to", "choose another with -o", about)
            )
        remedy = "check the address, the network and the credentials"
        return fault(f"cannot be reached: {text[:_MOST_SAID]}", "", remedy, about)
