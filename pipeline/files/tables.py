"""Reading a TOML file so that everything wrong with it is found at once."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from calibration.errors import InputError, Problem, fault

_ABSENT = object()
_LARGEST_TOML = 1 << 20  # bytes; a capture.toml of more is not one


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file; InputError where it is none."""
    try:
        if path.stat().st_size > _LARGEST_TOML:
            raise fault("more than 1 MB of TOML", "a short text file", "check the file", path)
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise fault(f"not TOML: {error}", "a TOML file", "correct that line", path) from error
    except OSError as error:
        raise fault(
            error.strerror or "unreadable", "a TOML file", "check the path", path
        ) from error


class Table:
    """One table of a TOML file. Wrong values are noted in `problems` and read as their default.

    content   the table as tomllib gives it
    problems  list shared by all tables of one reading
    file      named in the problems
    where     the table's name, for the problems: "sphere"
    origins   by "sphere.radius_mm", the file a value is from where that is another: a shoot's
              defaults.toml
    """

    def __init__(
        self,
        content: Any,
        problems: list[Problem],
        file: Path,
        where: str = "",
        origins: Mapping[str, Path] | None = None,
    ):
        self.problems, self.file, self.where = problems, file, where
        self.origins = origins or {}
        if not isinstance(content, dict):
            self.wrong("", f"{content!r}", "a table", f"write [{where}] above its values")
            content = {}
        self.content = content
        self._known: set[str] = set()

    def wrong(self, key: str, found: str, expected: str, remedy: str) -> None:
        found = f"{self._name(key)} is {found}"[:300]
        self.problems.append(Problem(found, expected, remedy, self.file_of(key)))

    def file_of(self, key: str) -> Path:
        """The file a value is from; paths in it are relative to that file's folder."""
        return self.origins.get(self._name(key), self.file)

    def _name(self, key: str) -> str:
        return ".".join(filter(None, (self.where, key)))

    def _get(self, key: str) -> Any:
        self._known.add(key)
        return self.content.get(key, _ABSENT)

    def text(self, key: str, default: str | None = None) -> str | None:
        value = self._get(key)
        if value is _ABSENT:
            return default
        if not isinstance(value, str) or not value.strip() or not value.isprintable():
            self.wrong(key, repr(value), "a line of text in quotes", "correct or remove it")
            return default
        return value

    def number(
        self, key: str, unit: str, *, low: float = -math.inf, high: float = math.inf
    ) -> float | None:
        """A number in [low, high], or None where it is absent."""
        value = self._get(key)
        if value is _ABSENT:
            return None
        good = isinstance(value, int | float) and not isinstance(value, bool)
        if not good or not math.isfinite(value) or not low <= value <= high:
            limits = f"{low:g} to {high:g}" if math.isfinite(low + high) else f"above {low:g}"
            self.wrong(key, repr(value), f"a number in {unit}, {limits}", "correct it")
            return None
        return float(value)

    def numbers(self, key: str, unit: str, count: int | None = None) -> tuple[float, ...] | None:
        """A list of `count` positive numbers, or None where it is absent."""
        value = self._get(key)
        if value is _ABSENT:
            return None
        good = isinstance(value, list) and all(
            isinstance(x, int | float) and not isinstance(x, bool) and 0 < x < math.inf
            for x in value
        )
        if not good or (count is not None and len(value) != count):
            many = f"{count} " if count is not None else ""
            self.wrong(
                key, repr(value), f"a list of {many}positive numbers in {unit}", "correct it"
            )
            return None
        return tuple(map(float, value))

    def points(self, key: str, count: int) -> list[tuple[float, float]] | None:
        """A list of `count` points [x, y] in px, or None where it is absent."""
        value = self._get(key)
        if value is _ABSENT:
            return None
        good = (
            isinstance(value, list)
            and len(value) == count
            and all(isinstance(point, list) and len(point) == 2 for point in value)
            and all(
                isinstance(x, int | float) and not isinstance(x, bool) and math.isfinite(x)
                for point in value
                for x in point
            )
        )
        if not good:
            self.wrong(key, repr(value), f"a list of {count} points [x, y] in px", "correct it")
            return None
        return [(float(x), float(y)) for x, y in value]

    def word(self, key: str) -> str | float | None:
        """A text or a number, or None where it is absent."""
        value = self._get(key)
        if value is _ABSENT:
            return None
        if isinstance(value, str):
            return self.text(key)
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not math.isfinite(value):
            self.wrong(key, repr(value), "a number, or a text in quotes", "correct it")
            return None
        return float(value)

    def vector(self, key: str, unit: str) -> tuple[float, float, float] | None:
        """A list [x, y, z], or None where it is absent."""
        value = self._get(key)
        if value is _ABSENT:
            return None
        good = (
            isinstance(value, list)
            and len(value) == 3
            and all(
                isinstance(x, int | float) and not isinstance(x, bool) and math.isfinite(x)
                for x in value
            )
        )
        if not good:
            self.wrong(key, repr(value), f"[x, y, z] in {unit}", "correct it")
            return None
        x, y, z = map(float, value)
        return x, y, z

    def flag(self, key: str) -> bool:
        """true or false; false where it is absent."""
        value = self._get(key)
        if value is not _ABSENT and not isinstance(value, bool):
            self.wrong(key, repr(value), "true or false", "correct or remove it")
        return value is True

    def raw(self, key: str) -> Any:
        """A value of any kind as tomllib gives it, or None where it is absent."""
        value = self._get(key)
        return None if value is _ABSENT else value

    @contextmanager
    def noting(self, key: str) -> Iterator[None]:
        """Notes an InputError about a key instead of raising it."""
        try:
            yield
        except InputError as error:
            for p in error.problems:
                where = f"{p.file}: " if p.file is not None else ""
                found = f"{self._name(key)}: {where}{p.found}"
                self.problems.append(Problem(found, p.expected, p.remedy, self.file_of(key)))

    def table(self, key: str) -> Table:
        value = self._get(key)
        content = {} if value is _ABSENT else value
        return Table(content, self.problems, self.file, self._name(key), self.origins)

    def tables(self, key: str) -> list[Table]:
        value = self._get(key)
        if value is _ABSENT:
            return []
        if not isinstance(value, list):
            self.wrong(key, repr(value), "a list of tables", f"write [[{key}]] above each")
            return []
        return [Table(v, self.problems, self.file, f"{key}[{i}]") for i, v in enumerate(value, 1)]

    def path(self, key: str) -> Path | None:
        """An existing file named relative to this file, never outside its folder."""
        text = self.text(key)
        if text is None:
            return None
        path = self.inside(key, text)
        if path is not None and not path.is_file():
            self.wrong(key, f"{text!r}, which is not there", "an existing file", "correct the name")
            return None
        return path

    def inside(self, key: str, text: str) -> Path | None:
        """What a text names relative to its file, links followed; None, and noted, if outside."""
        folder = self.file_of(key).parent
        try:
            within = (folder / text).resolve().is_relative_to(folder.resolve())
        except (ValueError, OSError, RuntimeError):  # a NUL, a name too long, links in a circle
            within = False
        if within:
            return folder / text
        whose = "the capture's folder" if folder == self.file.parent else f"{folder}"
        self.wrong(key, repr(text), f"a path inside {whose}", "move the file there")
        return None

    def nothing_else(self) -> None:
        """Notes every key that was not asked for: a misspelt setting must not pass in silence."""
        for key in sorted(set(self.content) - self._known):
            known = ", ".join(sorted(self._known))
            self.wrong(key, "not known here", f"one of {known}", "correct or remove it")
