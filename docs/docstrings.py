"""For mkdocstrings: our docstrings' columns of names and what they mean, as definition lists.

radiance     (..., C) float32, reflected, relative
reflectance  (C,) reflectance factor in (0, 1], at the angle it
             was measured
"""

from __future__ import annotations

import html
import re

import griffe

_ENTRY = re.compile(r"(\*{0,2}[A-Za-z_][\w, ()]*?)  +(\S.*)")


class Columns(griffe.Extension):
    """Finds such columns in every docstring."""

    def on_instance(self, *, obj: griffe.Object, **kwargs: object) -> None:
        if obj.docstring is not None:
            obj.docstring.value = as_lists(obj.docstring.value)


def as_lists(text: str) -> str:
    """A docstring with its columns as HTML."""
    return "\n\n".join(_block(block) for block in text.split("\n\n"))


def _block(block: str) -> str:
    lines = block.split("\n")
    if not _ENTRY.fullmatch(lines[0]):
        return block
    entries: list[list[str]] = []
    for line in lines:
        entry = _ENTRY.fullmatch(line)
        if entry:
            entries.append([entry[1], entry[2]])
        elif line.startswith("   "):
            entries[-1][1] += " " + line.strip()
        else:
            return block
    items = "".join(f"<dt>{html.escape(n)}</dt><dd>{html.escape(t)}</dd>" for n, t in entries)
    return f'<dl class="fields">{items}</dl>'
