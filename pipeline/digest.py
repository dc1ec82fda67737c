"""Digests that say whether a result is current: of files, of values, and of the code."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.util
import inspect
import json
import re
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

_OURS = ("pipeline", "stages", "calibration", "shaders")


def of_file(path: Path) -> str:
    """SHA-256 of a file's content, in hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def changed(inputs: Mapping[str, str], folders: Iterable[Path]) -> list[str]:
    """Which of the files something was made from are no longer what they were.

    inputs   name, relative to a folder, to SHA-256
    folders  where they may lie; only text is looked at, which people correct, not photographs
    """
    return sorted(
        name
        for name, expected in inputs.items()
        if Path(name).suffix in (".csv", ".toml")
        and any((f / name).is_file() and of_file(f / name) != expected for f in folders)
    )


def of_values(values: Any) -> str:
    """SHA-256 of data, in hex: dicts, lists, numbers, text, arrays, paths and dataclasses."""
    text = json.dumps(values, sort_keys=True, default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return vars(value)
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)


def of_code(function: Callable[..., Any]) -> str:
    """SHA-256 of the project's code a function can reach.

    That is its own source, that of helpers beside it in its package and the values of constants,
    and the whole of every other module of ours that the names in these lead to, followed through
    their imports; for a package with data (shaders, calibration) its data too.
    """
    parts: dict[str, str] = {}
    reached: set[str] = set()
    waiting = [function]
    while waiting:
        beside = waiting.pop()
        parts[_full_name(beside)] = inspect.getsource(beside)
        for name in _names_in(beside.__code__) & beside.__globals__.keys():
            value = beside.__globals__[name]
            if isinstance(value, ModuleType):
                reached |= _closure(value.__name__)
            elif type(value).__module__ in ("builtins", "numpy") and not callable(value):
                parts[f"{beside.__module__}.{name}"] = of_values(value)
            elif _package_of(value) != _package_of(function):
                reached |= _closure(getattr(value, "__module__", None) or "")
            elif inspect.isclass(value):
                parts[_full_name(value)] = inspect.getsource(value)
            elif callable(value) and _full_name(value) not in parts:
                waiting.append(inspect.unwrap(value))  # a helper beside it
    told = [parts[name] for name in sorted(parts)] + [_content(m) for m in sorted(reached)]
    return hashlib.sha256("\0".join(told).encode()).hexdigest()


def _full_name(value: Any) -> str:
    return f"{value.__module__}.{value.__name__}"


def _package_of(value: Any) -> str:
    return (getattr(value, "__module__", None) or "").rpartition(".")[0]


def _names_in(code) -> set[str]:
    nested = (c for c in code.co_consts if inspect.iscode(c))
    return set(code.co_names).union(*map(_names_in, nested))


def _closure(module: str) -> set[str]:
    """Our modules that importing `module` leads to, itself included."""
    reached: set[str] = set()
    waiting = [module]
    while waiting:
        name = waiting.pop()
        if name not in reached and (imports := _imports(name)) is not None:
            reached.add(name)
            waiting += imports
    return reached


# An import statement, within a function too: what from, and names; or modules. Python's own parser
# takes a second for all that `envmap` can reach, which is longer than the rest of a run that finds
# everything current.
_IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+([\w.]+)[ \t]+import[ \t]*(\([^)]*\)|[^\n(]+)|import[ \t]+([^\n]+))", re.M
)


@cache
def _imports(module: str) -> tuple[str, ...] | None:
    """What one of our modules imports, anywhere in it; None for others' modules."""
    if module.split(".")[0] not in _OURS:
        return None
    spec = importlib.util.find_spec(module)
    if spec is None or spec.origin is None:
        return None
    names: list[str] = []
    for package, those, modules in _IMPORT.findall(Path(spec.origin).read_text(encoding="utf-8")):
        if modules:
            names += _listed(modules)
        else:
            names.append(package)
            names += [f"{package}.{name}" for name in _listed(those) if _is_module(package, name)]
    return tuple(name for name in names if name.split(".")[0] in _OURS)


def _listed(names: str) -> list[str]:
    """Names of an import statement, without what they are called here, brackets and comments."""
    bare = re.sub(r"#[^\n]*|[()]", "", names)
    return [name.split()[0] for name in bare.split(",") if name.split()]


def _is_module(package: str, name: str) -> bool:
    if package.split(".")[0] not in _OURS:
        return False
    try:
        return importlib.util.find_spec(f"{package}.{name}") is not None
    except ModuleNotFoundError:  # what should be a package is a module
        return False


@cache
def _content(module: str) -> str:
    """A module's source; for a package also its data files, by digest."""
    spec = importlib.util.find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    text = Path(spec.origin).read_text(encoding="utf-8")
    if spec.submodule_search_locations:
        folder = Path(spec.origin).parent
        data = sorted(p for p in folder.rglob("*") if p.is_file() and p.suffix[:3] != ".py")
        text += "".join(f"\n{p.relative_to(folder)} {of_file(p)}" for p in data)
    return text
