"""Draws the figures of docs/figures.md, and writes the page about them.

    python -m benchmarks.figures [RESULT] [-o DIR] [--only NAME ...]

RESULT (default build/room) is what `sixlight envmap sample_captures/room` wrote. Into DIR (default
docs) go figures.md, images/figure_NAME.png and images/figures.json, what was measured for them.
`--only` with no NAME writes the page alone.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path

from benchmarks.figures import page, paper
from benchmarks.figures.paper import Drawn
from benchmarks.figures.setting import Setting
from calibration.errors import InputError
from pipeline import io
from pipeline.errors import fault


def _errors(setting: Setting) -> Drawn:
    from benchmarks.figures import errors

    return errors.errors(setting)


FIGURES: dict[str, Callable[[Setting], Drawn]] = {
    "mixed_light": paper.mixed_light,
    "primaries": paper.primaries,
    "capture": paper.capture,
    "roughness": paper.roughness,
    "colorchecker": paper.colorchecker,
    "metamers": paper.metamers,
    "errors": _errors,
}
"""In the order of the page. The last needs Mitsuba; without, it is left as it was."""


def draw(setting: Setting, out: Path, names) -> None:
    """Draws some of FIGURES into a folder, and writes its page anew."""
    images = out / "images"
    images.mkdir(parents=True, exist_ok=True)
    measured = page.read(images / page.MEASURED)
    for name in names:
        try:
            drawn = FIGURES[name](setting)
        except InputError as error:
            if name != "errors":
                raise
            print(f"left out, the maps of errors: {error}", file=sys.stderr)
            continue
        drawn.sheet.save(images / page.file_of(name), f"sixlight: {page.TITLES[name]}")
        measured[name] = dict(drawn.measured)
        io.write_json(images / page.MEASURED, measured)
        print(images / page.file_of(name), flush=True)
    io.write_text(out / "figures.md", page.written(page.read(images / page.MEASURED)))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("result", nargs="?", type=Path, default=Path("build/room"))
    parser.add_argument("-o", "--out", type=Path, default=Path("docs"), help="default docs")
    parser.add_argument("--only", nargs="*", choices=FIGURES, metavar="NAME", default=list(FIGURES),
                        help=", ".join(FIGURES))  # fmt: skip
    arguments = parser.parse_args()
    try:
        if importlib.util.find_spec("matplotlib") is None:
            found, remedy = "matplotlib is not installed", "pip install -e '.[plots]'"
            raise fault(found, "the extra `plots`", remedy)
        draw(Setting.read(arguments.result), arguments.out, arguments.only)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
