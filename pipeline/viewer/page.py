"""viewer.html: template, style, script, shaders and a map made one page that needs nothing else."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import pipeline.viewer as here
from calibration.primaries import Primaries
from pipeline import io, previews
from pipeline.errors import fault
from pipeline.viewer.contents import contents, pack
from pipeline.viewer.packing import TAPS
from stages.types import Measured
from stages.view import view as seen

LIMIT = 4_000_000  # bytes of a page
# Of half floats after the point: nine are right to a thousandth. Fewer where noise fills the page.
BITS = (9, 8, 7, 6, 5)

# In the order they are put one behind another: each after those it imports from.
SCRIPTS = (
    "unpack.js",
    "state.js",
    "camera.js",
    "colour.js",
    "gl.js",
    "draw.js",
    "refine.js",
    "probe.js",
    "plot.js",
    "ui.js",
    "reading.js",
    "desk.js",
    "main.js",
)
_IMPORT = re.compile(r'^import \{[^}]*\} from "\./([\w.]+)";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=(?:async )?(?:function|class|const) )", re.MULTILINE)
_PART = re.compile(r"\{\{(\w+)\}\}")


def page(name: str, unit: str, measured: Measured, primaries: Primaries) -> str:
    """The page of a map, under LIMIT bytes.

    name, unit  of the map, in words; any text
    measured    (6, N, N, P) light in the primaries
    """
    if len(primaries.channels) > 9:
        raise fault(f"{len(primaries.channels)} channels", "at most 9", "view fewer channels")
    view = seen(measured)
    told, shapes = contents(name, unit, view, primaries)
    for bits in BITS:
        packed = pack(view, shapes, bits)
        numbers = {"bits": bits, "taps": TAPS, "arrays": packed.index}
        text = assembled({**told, **numbers}, packed.text())
        if len(text.encode()) < LIMIT:
            break
    return text


def assembled(told, numbers: str) -> str:
    """The template with everything in its place.

    told     what JSON can say; no `<` of it reaches the page as such, so that names stay text
    numbers  as `Pack.text` has them

    The policy lets the page run its own script and style, by their digests, and reach nothing.
    """
    folder = resources.files(here)
    style = folder.joinpath("viewer.css").read_text(encoding="utf-8")
    script = joined(SCRIPTS)
    json_text = json.dumps(told, ensure_ascii=True, separators=(",", ":"), allow_nan=False)
    policy = "; ".join(
        [
            "default-src 'none'",
            f"script-src {_digest(script)}",
            f"style-src {_digest(style)}",
            "img-src data: blob:",
            "base-uri 'none'",
            "form-action 'none'",
        ]
    )
    parts = {
        "policy": policy,
        "style": style,
        "script": script,
        "contents": json_text.replace("<", "\\u003c"),
        "numbers": numbers,
    }
    template = folder.joinpath("index.html").read_text(encoding="utf-8")
    return _PART.sub(lambda place: parts[place[1]], template)


def joined(files: Sequence[str]) -> str:
    """Modules put one behind another, as one: what they import from each other is already there."""
    folder = resources.files(here)
    before: set[str] = set()
    parts = []
    for file in files:
        text = folder.joinpath(file).read_text(encoding="utf-8")
        missing = set(_IMPORT.findall(text)) - before
        assert not missing, f"{file} imports {missing}, which must come before it"
        text = _EXPORT.sub("", _IMPORT.sub("", text))
        assert not re.search(r"^(import|export)\b", text, re.MULTILINE), file
        assert "</script" not in text, file
        parts.append(f"// {file}\n{text}")
        before.add(file)
    return "\n".join(parts)


def view(envmap: Path, out: Path | None, *, force: bool = False) -> Path:
    """Writes the page of a finished map.

    envmap  a folder `sixlight envmap` wrote, or a cubemap.exr
    out     the page; None: viewer.html where the map is
    raises  InputError where the map or the place is wrong; a page of ours is replaced
    """
    environment = previews.read(envmap)
    measured, _ = io.read_measured(environment.file, cube=True)
    file = out or environment.file.parent / "viewer.html"
    ours = (file.parent / "work" / "capture.json").is_file() and file.name == "viewer.html"
    previews.check_place(file, ours or force)
    header = environment.header
    text = page(header.get("name", ""), header.get("unit", ""), measured, environment.primaries)
    with previews.moving_into(file.parent) as beside:
        io.write_text(beside / file.name, text)
    return file


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
