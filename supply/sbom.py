"""A software bill of materials, CycloneDX 1.6 in JSON, of all that the locks hold.

    python -m supply.sbom [-o FILE]

A component is one version of one package: its licence, the hashes of its files, who needs it, and
in `scope` whether the program needs it (required), an extra that a user installs (optional), or
only work on sixlight (excluded).
"""

from __future__ import annotations

import argparse
import sys
from importlib.metadata import version
from pathlib import Path

from cyclonedx.contrib.license.factories import LicenseFactory
from cyclonedx.contrib.this.builders import this_component
from cyclonedx.model import (
    ExternalReference,
    ExternalReferenceType,
    HashAlgorithm,
    HashType,
    Property,
    XsUri,
)
from cyclonedx.model.bom import Bom
from cyclonedx.model.component import Component, ComponentScope, ComponentType
from cyclonedx.output.json import JsonV1Dot6
from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
from packageurl import PackageURL

from supply import EXTRAS_OF_USERS, PROGRAM, ROOT, Listed, Locked, everything, listed, project


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "build/sbom.json")
    out = parser.parse_args().output
    text = sbom()
    errors = JsonStrictValidator(SchemaVersion.V1_6).validate_str(text)
    assert errors is None, errors
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(text)
    print(out)
    return 0


def sbom() -> str:
    """The bill as JSON: sixlight, every locked package, and which needs which."""
    bom = Bom()
    bom.metadata.tools.components.add(this_component())
    bom.metadata.component = root = _sixlight()
    locked, rows = everything(), listed()
    components = {
        (row.name, row.version): _component(row, locked[row.name, row.version]) for row in rows
    }
    bom.components.update(components.values())
    named: dict[str, list[Component]] = {root.name: [root]}
    for (name, _), component in components.items():
        named.setdefault(name, []).append(component)
    for row in rows:
        for needer in (component for name in row.needed_by for component in named[name]):
            bom.register_dependency(needer, [components[row.name, row.version]])
    return JsonV1Dot6(bom).output_as_string(indent=2)


def _sixlight() -> Component:
    table = project()
    return Component(
        name=table["name"],
        version=version(table["name"]),
        type=ComponentType.APPLICATION,
        bom_ref=table["name"],
        description=table["description"],
        licenses=[LicenseFactory().make_from_string(table["license"])],
    )


def _component(row: Listed, package: Locked) -> Component:
    """One version of one package; its files are told by hash, wherever an index keeps them."""
    purl = PackageURL("pypi", name=row.name, version=row.version)
    return Component(
        name=row.name,
        version=row.version,
        bom_ref=str(purl),
        purl=purl,
        scope=_scope(row.locks),
        licenses=[LicenseFactory().make_from_string(row.licence)],
        external_references=[
            ExternalReference(
                type=ExternalReferenceType.DISTRIBUTION,
                url=XsUri(str(purl)),
                hashes=[HashType(alg=HashAlgorithm.SHA_256, content=h) for h in package.hashes],
            )
        ],
        properties=[Property(name="sixlight:lock", value=name) for name in row.locks],
    )


def _scope(locks: tuple[str, ...]) -> ComponentScope:
    if PROGRAM in locks:
        return ComponentScope.REQUIRED
    users = any(extra in locks for extra in EXTRAS_OF_USERS)
    return ComponentScope.OPTIONAL if users else ComponentScope.EXCLUDED


if __name__ == "__main__":
    sys.exit(main())
