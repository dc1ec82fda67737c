"""Files that once did harm when they were read, and a few hundred new ones every time.

`python -m benchmarks.fuzz` finds them, and says what harm is.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from benchmarks import fuzz

FOUND = sorted((Path(__file__).parent / "fuzz").glob("*.*.*"))


@pytest.mark.filterwarnings("ignore")  # of libraries, of what is wrong with the files
@pytest.mark.parametrize("path", FOUND, ids=[path.name for path in FOUND])
def test_what_did_harm_once_does_no_more(path, tmp_path):
    kind = path.name.split(".", 1)[1]
    copy = Path(shutil.copy(path, tmp_path / f"input{path.suffix}"))
    assert fuzz.read(kind, copy) is None


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return fuzz.seeds(tmp_path_factory.mktemp("good"))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # likewise
@pytest.mark.parametrize("kind", fuzz.READERS)
def test_mutated_files_do_no_harm(kind, good, tmp_path):
    assert fuzz.read(kind, _written(good[kind], tmp_path / f"good{Path(kind).suffix}")) is None
    assert list(fuzz.hunt(kind, good[kind], 200, 11, tmp_path)) == []


def _written(content: bytes, path: Path) -> Path:
    path.write_bytes(content)
    return path
