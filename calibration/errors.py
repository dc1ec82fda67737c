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
        return legible(" ".join(line.split()))  # one line, whatever a file's text contained


_MOST_TEXT_BYTES = 64 << 20  # of a table; finely sampled spectra by the hundred take a tenth


def read_text(path: Path, expected: str) -> str:
    """A text file of the user's, UTF-8 with or without a mark; not one of gigabytes.

    raises  InputError that names no file; UnicodeDecodeError
    """
    try:
        size = path.stat().st_size
        if size > _MOST_TEXT_BYTES:
            raise fault(
                f"{size / 1e6:.0f} MB of text", f"{expected} of less than 64 MB", "check the file"
            )
        return path.read_text(encoding="utf-8-sig")  # spreadsheets write a byte order mark
    except OSError as error:
        found = (error.strerror or "cannot be read").lower()
        raise fault(found, expected, "correct its permissions, or the path") from None


def legible(text: str) -> str:
    """Text as a terminal may be given it, whoever chose it: names of files, what files say.

    Control characters, those that turn the direction of writing, and bytes that are no text are
    written as escapes; letters of every script stay as they are.
    """
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class InputError(ValueError):
    """The input is wrong. Carries every problem found, each of which prints as one line."""

    def __init__(self, problems: Problem | Iterable[Problem]):
        self.problems = (problems,) if isinstance(problems, Problem) else tuple(problems)
        assert self.problems, "an InputError without a problem"
        super().__init__("\n".join(map(str, self.problems)))

    def __reduce__(self):
        return type(self), (self.problems,)  # as one process tells another

    def at(self, file: str | Path) -> InputError:
        """The same error, naming `file` wherever no file is named yet."""
        return InputError(
            p if p.file is not None else Problem(p.found, p.expected, p.remedy, file)
            for p in self.problems
        )


def fault(found: str, expected: str, remedy: str, file: str | Path | None = None) -> InputError:
    """An InputError of one problem, ready to raise."""
    return InputError(Problem(found, expected, remedy, file))
