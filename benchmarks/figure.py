"""What a benchmark finds: a number, and what it ought to be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Figure:
    """One figure.

    name, unit  for people; a unit of "" where there is none, "times" for a ratio
    value       as measured
    low, high   what it ought to be at least and at most; None: no bound
    """

    name: str
    value: float
    unit: str = ""
    low: float | None = None
    high: float | None = None

    @property
    def holds(self) -> bool | None:
        """Whether the bounds hold; None where there is none."""
        if self.low is None and self.high is None:
            return None
        above = self.low is None or self.value >= self.low
        return bool(above and (self.high is None or self.value <= self.high))

    @property
    def bound(self) -> str:
        """The bounds in words."""
        if self.low is not None and self.high is not None:
            return f"{self.low:g} to {self.high:g}"
        if self.low is not None:
            return f"at least {self.low:g}"
        return "" if self.high is None else f"at most {self.high:g}"

    def row(self) -> dict[str, Any]:
        """For build/bench/NAME.json."""
        value = float(self.value)
        return {
            "name": self.name,
            "value": value,
            "unit": self.unit,
            "bound": self.bound,
            "holds": self.holds,
        }

    def __str__(self) -> str:
        mark = {None: "", True: "ok", False: "NO"}[self.holds]
        value = f"{self.value:10.4g}"
        return f"{self.name:60s} {value} {self.unit:8s} {self.bound:16s} {mark}".rstrip()
