"""Captures by URL, and a stand-in for `envmap` that takes one as it does, and milliseconds."""

from __future__ import annotations

import json
from pathlib import Path

import fsspec

PROGRAM = """
import json, os, sys
from pipeline import remote, storage
from pipeline.errors import InputError
from pipeline.settings import Settings

out, folder = map(storage.place, sys.argv[1:])
try:
    with remote.here(folder, out, Settings()) as (here, results):
        names = sorted(str(p.relative_to(here)) for p in here.rglob("*") if p.is_file())
        if "bad" in here.name:
            raise InputError(remote.Problem("damaged", "", "copy it again", here / names[0]))
        if "killed" in here.name:
            os.kill(os.getpid(), 9)
        results.mkdir(parents=True)
        (results / "cubemap.exr").write_text(" ".join(names))
        (results / "result.json").write_text(json.dumps({"verdict": {"grade": "good"}}))
except InputError as error:
    sys.exit(print(error, file=sys.stderr) or 2)
"""


def put_capture(url: str, **files: str) -> None:
    """Two photographs and a manifest; more files by their names."""
    for name, content in {
        "capture.toml": "",
        "cyan/1.dng": "one",
        "yellow/1.dng": "another",
        **files,
    }.items():
        write(f"{url}/{name}", content)


def write(url: str, content: str) -> None:
    with fsspec.open(url, "w", auto_mkdir=True) as file:
        file.write(content)


def read(url: str) -> str:
    with fsspec.open(url) as file:
        return file.read().decode()


def names(url: str) -> set[str]:
    """Of all files below a folder."""
    fs, path = fsspec.core.url_to_fs(url)
    fs.invalidate_cache()
    return {p.removeprefix(path).lstrip("/") for p in fs.find(path)}


def make(results: Path, version: str = "1") -> None:
    """Results, as a run leaves them: which run they are of is in each."""
    (results / "work").mkdir(parents=True, exist_ok=True)
    for name in ("cubemap.exr", "report.html", f"only_{version}.png", "work/report.made.json"):
        (results / name).write_text(version)
    for name in ("work/image.exr", "work/lock", "work/finished.json"):
        (results / name).write_text("of no use elsewhere")
    told = {"version": version, "verdict": {"grade": "good"}}
    (results / "result.json").write_text(json.dumps(told))
