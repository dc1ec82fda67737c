"""The one exception that means: the input is wrong, and here is how to put it right."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Problem:
    """One thing wrong with an input, said in one line.

    found     what is there
    expected  what should be there; may be empty where `found` already says it
    remedy    what to do about it
    file      the file or folder it concerns; None until someone who knows it adds it
    """

    found: str
    expected: str
    remedy: str
    file: str | Path | None = None

    def __str__(self) -> str:
        where = f"{self.file}: " if self.file is not None else ""
        expected = f" (expected {self.expected})" if self.expected else ""
        line = f"{where}{self.found}{expected}; {self.remedy}"
        return " ".join(line.split())  # one line, whatever a file's text contained


class InputError(ValueError):
    """The input is wrong. Carries every problem found, each of which prints as one line."""

    def __init__(self, problems: Problem | Iterable[Problem]):
        self.problems = (problems,) if isinstance(problems, Problem) else tuple(problems)
        assert self.problems, "an InputError without a problem"
        super().__init__("\n".join(map(str, self.problems)))

    def at(self, file: str | Path) -> InputError:
        """The same error, naming `file` wherever no file is named yet."""
        return InputError(
            p if p.file is not None else Problem(p.found, p.expected, p.remedy, file)
            for p in self.problems
        )


def fault(found: str, expected: str, remedy: str, file: str | Path | None = None) -> InputError:
    """An InputError of one problem, ready to raise."""
    return InputError(Problem(found, expected, remedy, file))
