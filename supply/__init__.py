"""What sixlight is built from: the locks, and what is made from them.

    python -m supply.lock        the locks anew: versions, hashes, licences
    python -m supply.sbom        a bill of materials of all that is locked
    python -m supply.audit       known vulnerabilities of what is locked

`locks/run.txt` is the program alone; `locks/EXTRA.txt` is what an extra of pyproject.toml needs
beyond it; `locks/licences.csv` lists every locked package. docs/supply.md tells how they are used.
"""

from __future__ import annotations

import csv
import re
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from packaging.markers import Marker
from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).parent.parent
LOCKS = ROOT / "locks"
LICENCES = LOCKS / "licences.csv"
PROGRAM = "run"
"""The lock of the program alone, beside those of its extras."""
EXTRAS_OF_USERS = ("cluster", "simulate")
"""The extras that somebody installs to use sixlight; the others are for work on it."""
PYTHONS = ("3.11", "3.12", "3.13")
"""Versions of Python that the locks are held to."""


@dataclass(frozen=True)
class Locked:
    """One version of one package, as a lock has it."""

    name: str
    version: str
    marker: Marker | None  # where it is wanted; None is everywhere
    hashes: tuple[str, ...]  # sha256 of each file of that version, any platform's

    def wanted(self, python: str) -> bool:
        """Whether that Python, "3.12", gets it on the platform this runs on."""
        place = {"python_version": python, "python_full_version": f"{python}.0"}
        return self.marker is None or self.marker.evaluate(place)


@dataclass(frozen=True)
class Listed:
    """A row of licences.csv."""

    name: str
    version: str
    licence: str  # an SPDX expression
    locks: tuple[str, ...]
    needed_by: tuple[str, ...]


def project() -> dict:
    """The table [project] of pyproject.toml."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def asked() -> dict[str, list[Requirement]]:
    """By lock, the requirements that pyproject.toml states: the program's, and each extra's."""
    table = project()
    stated = {PROGRAM: table["dependencies"], **table["optional-dependencies"]}
    return {lock: [Requirement(line) for line in lines] for lock, lines in stated.items()}


def lock(name: str) -> Path:
    return LOCKS / f"{name}.txt"


def read(path: Path) -> list[Locked]:
    """What a lock holds, in its order; a package may be there for older Pythons and for newer."""
    lines = path.read_text().replace("\\\n", " ").splitlines()
    return [_locked(line) for line in lines if line and not line.lstrip().startswith("#")]


def _locked(line: str) -> Locked:
    """From `name==version ; marker --hash=sha256:... --hash=sha256:...`."""
    stated, *hashes = re.split(r"\s+--hash=sha256:", line.strip())
    requirement = Requirement(stated)
    version = str(requirement.specifier).removeprefix("==")
    return Locked(requirement.name, version, requirement.marker, tuple(hashes))


def everything() -> dict[tuple[str, str], Locked]:
    """All that any lock holds, by name and version."""
    packages = [package for name in asked() for package in read(lock(name))]
    return {(package.name, package.version): package for package in sorted(packages, key=_key)}


def _key(package: Locked) -> tuple[str, Version]:
    return package.name, Version(package.version)


def listed() -> list[Listed]:
    """The rows of licences.csv."""
    with LICENCES.open(newline="") as file:
        return [
            Listed(
                row["name"],
                row["version"],
                row["licence"],
                tuple(row["locks"].split()),
                tuple(row["needed_by"].split()),
            )
            for row in csv.DictReader(file)
        ]


def apart(packages: Iterable[Locked]) -> list[list[Locked]]:
    """The packages in lists none of which holds two versions of one."""
    lists: list[dict[str, Locked]] = []
    for package in packages:
        home = next((held for held in lists if package.name not in held), None)
        if home is None:
            lists.append(home := {})
        home[package.name] = package
    return [list(held.values()) for held in lists]
