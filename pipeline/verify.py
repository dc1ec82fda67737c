"""`sixlight verify`: whether a finished capture's photographs and results are what they were."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pipeline import digest
from pipeline.errors import fault, storing


def verify(out: Path) -> dict[str, Any]:
    """Compares every input and output of a capture with the digests kept when it was made.

    out      folder that `envmap` wrote to
    returns  `checked`, how many files; `problems`, a sentence each: empty where all holds
    raises   InputError where the folder holds no finished capture
    """
    result, owner = (_read(out / name) for name in ("result.json", "work/capture.json"))
    folder = (out / owner["capture"]).resolve()
    expected = [(folder / name, digest_) for name, digest_ in result["inputs"].items()]
    expected += [(out / name, digest_) for name, digest_ in _made(out, result) if _kept(out / name)]
    return {
        "checked": len(expected),
        "problems": [said for path, was in expected if (said := _problem(path, was, out))]
        + [
            f"{path.relative_to(out)}: left by a run that was stopped; the next run clears it away"
            for path in sorted((out / "work").glob("unfinished-*"))
        ],
    }


def _kept(path: Path) -> bool:
    """Whether it ought to be there: what steps leave each other, `sixlight clean` may remove."""
    return path.parent.name != "work" or path.exists()


def _read(path: Path) -> dict[str, Any]:
    try:
        with storing(path):
            content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            return content
    except ValueError:
        found = "not JSON"
    except FileNotFoundError:
        found = "not there"
    raise fault(
        found, "the results of a finished run", "run sixlight envmap, or name its folder", path
    )


def _made(out: Path, result: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Each result with its digest; pages made from result.json keep theirs beside them."""
    made: dict[str, str] = {}
    for step in result["steps"].values():
        made |= step["made"]
    for stamp in sorted((out / "work").glob("*.made.json")):
        of_pages = json.loads(stamp.read_text(encoding="utf-8"))["made"]
        made |= {name: was for name, was in of_pages.items() if name.endswith(".html")}
    yield from made.items()


def _problem(path: Path, was: str, out: Path) -> str | None:
    name = path.relative_to(out) if path.is_relative_to(out) else path
    if not path.is_file():
        return f"{name}: missing"
    with storing(path):
        return f"{name}: not what it was" if digest.of_file(path) != was else None
