"""Runs benchmarks: a table on stdout, build/bench/NAME.json for machines.

    python -m benchmarks [NAME ...]

Ends with status 1 when a bound does not hold, so that a script can tell.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from pathlib import Path

NAMES = {
    "batch": "batch",
    "capture": "capture",
    "colour": "channels",  # not colour.py, which would hide colour-science from scripts beside it
    "merge": "merge",
    "render": "render",
    "unwrap": "unwrap",
}
"""By name, the module of each."""
OUT = Path("build/bench")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(NAMES))
    wanted = parser.parse_args().names or list(NAMES)
    unknown = [name for name in wanted if name not in NAMES]
    if unknown:
        print(f"no benchmark is called {', '.join(unknown)}: {', '.join(NAMES)}", file=sys.stderr)
        return 2
    all_hold = True
    for name in wanted:
        module = importlib.import_module(f"benchmarks.{NAMES[name]}")
        print(f"\n{module.__doc__.splitlines()[0]}")
        figures = []
        for figure in module.measure():
            print(figure, flush=True)
            figures.append(figure)
        OUT.mkdir(parents=True, exist_ok=True)
        rows = [figure.row() for figure in figures]
        (OUT / f"{name}.json").write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
        all_hold &= all(figure.holds is not False for figure in figures)
    return 0 if all_hold else 1


if __name__ == "__main__":
    sys.exit(main())
