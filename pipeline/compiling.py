"""Compiles, once for all runs to come, what merges and unwraps: `make setup` calls it."""

from __future__ import annotations

import time

from stages.compiled import compile_all


def main() -> None:
    began = time.perf_counter()
    compile_all()
    took = time.perf_counter() - began
    print(f"compiled what merges and unwraps, for all runs to come: {took:.0f} s")


if __name__ == "__main__":
    main()
