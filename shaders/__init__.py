"""The shaders, and the little that GLSL lacks: files that include files, errors that name them.

`.vert` and `.frag` beside this file are compiled, `include/*.glsl` are included. The sources say
no `#version`: it is put in front here, so that one source serves OpenGL 3.3 and OpenGL ES 3.00.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib import resources

VERSION = "#version 330 core"
ES_VERSION = "#version 300 es"

# What GLSL ES leaves without a default, or with too coarse a one.
_ES_PRECISION = tuple(
    f"precision highp {kind};" for kind in ("float", "int", "sampler2D", "samplerCube")
)

_INCLUDE = re.compile(r'\s*#include\s+"([^"]+)"\s*$')
# Mesa says "0:12(5): error: ...", NVIDIA "0(12) : error C1008: ...". The number before the line
# is that of the source string, always 0 here; Mesa ignores the one a #line could set.
_MESSAGE = re.compile(r"^\d+(?::(\d+)\(\d+\)|\((\d+)\))\s*:\s*(.*)$")


class ShaderError(RuntimeError):
    """A shader does not compile or link; says where, in the files as they were written."""


@dataclass(frozen=True)
class Source:
    """A shader with its includes put in.

    text   what the compiler gets, `#version` first
    lines  where each line of `text` came from: (file, line counted from 1)
    """

    text: str
    lines: tuple[tuple[str, int], ...]


def names() -> tuple[str, ...]:
    """The files that are compiled, sorted."""
    files = (entry.name for entry in resources.files(__name__).iterdir())
    return tuple(sorted(name for name in files if name.endswith((".vert", ".frag"))))


def load(name: str, version: str = VERSION, folder=None, defines=None) -> Source:
    """A shader file with every `#include "name.glsl"` expanded, each file once.

    name     file in this package, e.g. "surface.frag"
    version  the first line of the expanded text
    folder   where the files are; this package unless told
    defines  numbers by name, for `#define`s after the first line
    """
    folder = resources.files(__name__) if folder is None else folder
    text: list[str] = [version]
    text += _ES_PRECISION if version == ES_VERSION else ()
    text += [f"#define {word} {number}" for word, number in (defines or {}).items()]
    lines: list[tuple[str, int]] = [(name, 0)] * len(text)
    seen: set[str] = set()

    def expand(file: str, included_at: str) -> None:
        if file in seen:
            return
        seen.add(file)
        try:
            source = folder.joinpath(file).read_text(encoding="utf-8")
        except FileNotFoundError:
            raise ShaderError(f"{included_at}there is no shader file {file}") from None
        for number, line in enumerate(source.splitlines(), start=1):
            include = _INCLUDE.match(line)
            if include:
                expand(f"include/{include[1]}", f"{file}:{number}: ")
            else:
                text.append(line)
                lines.append((file, number))

    expand(name, "")
    return Source("\n".join(text) + "\n", tuple(lines))


def program(
    context, vertex: str, fragment: str, folder=None, *, version: str = VERSION, defines=None
):
    """Compile and link two shader files into a moderngl program.

    context           moderngl.Context
    vertex, fragment  files in `folder`, which is this package unless told
    version, defines  as `load` takes them
    Raises ShaderError naming file and line as they were written.
    """
    import moderngl

    sources = {
        "vertex_shader": load(vertex, version, folder, defines),
        "fragment_shader": load(fragment, version, folder, defines),
    }
    try:
        return context.program(**{stage: source.text for stage, source in sources.items()})
    except moderngl.Error as error:
        raise ShaderError(where_written(str(error), sources)) from None


def where_written(log: str, sources: dict[str, Source]) -> str:
    """A compiler's log with its line numbers turned into files and lines as they were written.

    log      as moderngl words it: a heading with the stage's name, then the driver's own lines
    sources  by stage, "vertex_shader" and "fragment_shader"
    """
    stage = next((stage for stage in sources if stage in log), next(iter(sources)))
    lines = sources[stage].lines
    said = []
    for line in log.splitlines():
        message = _MESSAGE.match(line.strip())
        if message:
            number = int(message[1] or message[2])
            if 1 <= number <= len(lines):
                file, written = lines[number - 1]
                line = f"{file}:{written}: {message[3]}"
        said.append(line)
    return "\n".join(line for line in said if line.strip())
