"""Known vulnerabilities of every locked package, by pip-audit.

    python -m supply.audit [--osv URL]

Ends with status 1 when there are any. A database is trusted only once it has told what is wrong
with a release that everybody knows to be vulnerable: an index without advisories, a mirror for
example, answers as if all were well. Where none can be reached it says so, and ends with status 0.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from supply import apart, everything

KNOWN = ("jinja2", "3.1.2")
"""Has advisories since January 2024, CVE-2024-22195 the first."""
DATABASES = (["-s", "pypi"], ["-s", "osv"])
"""pip-audit's options for each: advisories of the index itself, Open Source Vulnerabilities."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--osv", metavar="URL", help="ask this server of OSV's, and no other")
    osv = parser.parse_args().osv
    databases = [["-s", "osv", "--osv-url", osv]] if osv else DATABASES
    trusted = next((d for d in databases if any(p["vulns"] for p in _ask(d, [KNOWN]))), None)
    if trusted is None:
        asked = ", ".join(options[-1] for options in databases)
        print(f"nothing was audited: no advisory database could be reached (tried: {asked})")
        return 0
    answers = [
        answer
        for some in apart(everything().values())
        for answer in _ask(trusted, [(package.name, package.version) for package in some])
    ]
    found = 0
    for answer in answers:
        for vuln in answer["vulns"]:
            found += 1
            names = " ".join([vuln["id"], *vuln.get("aliases", [])])
            remedy = ", ".join(vuln["fix_versions"]) or "no version yet"
            print(f"{answer['name']} {answer['version']}: {names}; mended by {remedy}")
    print(f"{len(answers)} of {len(everything())} locked packages audited: {found} advisories")
    return 1 if found or len(answers) < len(everything()) else 0


def _ask(database: Sequence[str], packages: Sequence[tuple[str, str]]) -> list[dict]:
    """{name, version, vulns} of the packages that a database knows; none where none is reached."""
    with tempfile.TemporaryDirectory() as folder:
        pinned = Path(folder) / "pinned.txt"
        pinned.write_text("".join(f"{name}=={version}\n" for name, version in packages))
        options = ["--no-deps", "--disable-pip", "-f", "json", "--progress-spinner", "off"]
        done = subprocess.run(
            [sys.executable, "-m", "pip_audit", "-r", str(pinned), *options, *database],
            capture_output=True,
            text=True,
        )
    if not done.stdout:  # pip-audit ends with a traceback where it reaches nobody
        return []
    return [answer for answer in json.loads(done.stdout)["dependencies"] if "vulns" in answer]


if __name__ == "__main__":
    sys.exit(main())
