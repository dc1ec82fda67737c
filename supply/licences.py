"""The licence of an installed package, as its metadata and its licence's text have it."""

from __future__ import annotations

from email.message import Message
from importlib.metadata import Distribution, distributions
from pathlib import Path

from license_expression import get_spdx_licensing
from packaging.utils import canonicalize_name

SPDX = get_spdx_licensing()

CLASSIFIERS = {
    "License :: OSI Approved :: Apache Software License": "Apache-2.0",
    "License :: OSI Approved :: ISC License (ISCL)": "ISC",
    "License :: OSI Approved :: MIT License": "MIT",
    "License :: OSI Approved :: Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "License :: OSI Approved :: Python Software Foundation License": "PSF-2.0",
}
"""Trove classifiers that name one licence; "BSD License" does not."""

TEXTS = {
    "Neither the name": "BSD-3-Clause",
    "Redistributions in binary form": "BSD-2-Clause",
    "Permission is hereby granted, free of charge": "MIT",
}
"""Words that a licence's text has, the first that are found: the third clause makes BSD's three."""


def licences_of(site: Path) -> dict[tuple[str, str], str]:
    """By name and version, the SPDX expression of each package installed in a folder."""
    return {
        (canonicalize_name(found.name), found.version): licence(found)
        for found in distributions(path=[str(site)])
    }


def licence(package: Distribution) -> str:
    """The SPDX expression that a package states, or that its licence's text shows.

    PEP 639's License-Expression comes first, then a License field that is one, then a classifier
    that leaves no doubt, then the text; LookupError where none of them tells.
    """
    metadata: Message = package.metadata  # type: ignore[assignment]  # a Message at run time
    stated = metadata.get("License-Expression")
    if stated:
        return str(stated)
    field = metadata.get("License", "")
    if "\n" not in field and field and not SPDX.validate(field).errors:
        return str(SPDX.parse(field))
    classifiers = [
        line for line in metadata.get_all("Classifier", []) if " :: OSI Approved ::" in line
    ]
    named = {CLASSIFIERS.get(line) for line in classifiers}
    if len(named) == 1 and None not in named:
        return str(named.pop())
    text = "\n".join([field, *_licence_texts(package)])
    for words, expression in TEXTS.items():
        if words in text:
            return expression
    raise LookupError(f"{package.name} {package.version} does not say what its licence is")


def _licence_texts(package: Distribution) -> list[str]:
    """The package's own licence, and not those of what it bundles, which lie beside it."""
    return [
        Path(file.locate()).read_text(errors="replace")
        for file in package.files or []
        if file.stem.upper() in ("LICENSE", "LICENCE", "COPYING") and ".dist-info" in str(file)
    ]
