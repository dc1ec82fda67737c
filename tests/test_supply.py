"""The locks hold what pyproject.toml asks for, by hash; licences and the bill of materials fit."""

from __future__ import annotations

import functools
import http.server
import importlib.util
import json
import re
import subprocess
import sys
import threading
from collections import Counter

import pytest
from packaging.utils import canonicalize_name

import supply
from supply import EXTRAS_OF_USERS, PROGRAM, PYTHONS, ROOT

ALLOWED = {
    *("0BSD", "Apache-2.0", "Apache-2.0 WITH LLVM-exception", "BSD-2-Clause", "BSD-3-Clause"),
    *("CC0-1.0", "ISC", "MIT", "MIT-CMU", "PSF-2.0", "Zlib"),
}
"""For what a user installs: licences that ask for no more than their notice to be kept."""


@functools.cache
def spdx():
    """SPDX's licences, which take a second to read."""
    from license_expression import get_spdx_licensing

    return get_spdx_licensing()


def allowed(expression: str) -> bool:
    """Whether keeping to licences that are allowed suffices."""

    def suffices(term) -> bool:
        if isinstance(term, spdx().OR):
            return any(map(suffices, term.args))
        if isinstance(term, spdx().AND):
            return all(map(suffices, term.args))
        return str(term) in ALLOWED

    return suffices(spdx().parse(expression, validate=True))


@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize("name", supply.asked())
def test_all_that_is_asked_for_is_locked(name, python):
    packages = [*supply.read(supply.lock(PROGRAM)), *supply.read(supply.lock(name))]
    locked = {package.name: package.version for package in packages if package.wanted(python)}
    for requirement in supply.asked()[name]:
        version = locked.get(canonicalize_name(requirement.name))
        assert version is not None, f"{requirement} is not locked: run `make lock`"
        assert requirement.specifier.contains(version), f"{requirement}, but {version} is locked"


@pytest.mark.parametrize("name", supply.asked())
def test_a_python_gets_one_version_of_a_package_and_every_file_has_a_hash(name):
    packages = supply.read(supply.lock(name))
    assert packages
    assert all(package.hashes for package in packages)
    for python in PYTHONS:
        count = Counter(package.name for package in packages if package.wanted(python))
        assert set(count.values()) == {1}, count


def test_locks_agree_on_versions_and_name_no_index():
    held: dict[str, set[tuple[str, str]]] = {}
    for name in supply.asked():
        assert not re.search(r"://|--(extra-)?index|--find-links", supply.lock(name).read_text())
        for package in supply.read(supply.lock(name)):
            held.setdefault(package.name, set()).add((str(package.marker), package.version))
    for name, versions in held.items():
        assert len(versions) == len({marker for marker, _ in versions}), f"{name}: {versions}"


def test_make_installs_nothing_that_is_not_held_to_a_hash():
    text = (ROOT / "Makefile").read_text().replace("\\\n", " ")
    installs = re.findall(r"^.*(?:pip|PIP)\)? install\b.*$", text, flags=re.M)
    assert len(installs) == 2
    for line in installs:
        assert "--require-hashes --only-binary :all:" in line or "--no-deps" in line, line


def test_pip_refuses_a_file_that_is_not_the_one_locked(tmp_path):
    wheel = tmp_path / "locked-1.0-py3-none-any.whl"
    wheel.write_bytes(b"not what was locked")
    lock = tmp_path / "lock.txt"
    lock.write_text(f"locked==1.0 \\\n    --hash=sha256:{'0' * 64}\n")
    makefile = (ROOT / "Makefile").read_text()
    (recipe,) = re.findall(r"^locked = \$\(PIP\) (install .*?) \$\(", makefile, flags=re.M)
    places = ["--find-links", str(tmp_path), "--target", str(tmp_path / "site"), "-r", str(lock)]
    done = subprocess.run(
        [sys.executable, "-m", "pip", *recipe.split(), "--no-index", *places],
        capture_output=True,
        text=True,
    )
    assert done.returncode
    assert "DO NOT MATCH THE HASHES" in done.stderr
    assert not (tmp_path / "site").exists()


def test_the_list_of_licences_fits_the_locks():
    rows = supply.listed()
    assert [(row.name, row.version) for row in rows] == list(supply.everything())
    for name in supply.asked():
        held = {(package.name, package.version) for package in supply.read(supply.lock(name))}
        assert held == {(row.name, row.version) for row in rows if name in row.locks}


def test_what_a_user_installs_is_under_licences_that_are_allowed():
    for row in supply.listed():
        assert not spdx().validate(row.licence).errors, row
        if {PROGRAM, *EXTRAS_OF_USERS} & set(row.locks):
            assert allowed(row.licence), f"{row.name} {row.version}: {row.licence}"
    assert not allowed("MIT AND GPL-3.0-only")
    assert allowed("MIT OR GPL-3.0-only")


@pytest.mark.slow
def test_the_bill_of_materials_is_valid_and_whole():
    from cyclonedx.schema import SchemaVersion
    from cyclonedx.validation.json import JsonStrictValidator

    from supply.sbom import sbom

    text = sbom()
    assert JsonStrictValidator(SchemaVersion.V1_6).validate_str(text) is None
    bill = json.loads(text)
    told = {(part["name"], part["version"]): part for part in bill["components"]}
    assert set(told) == set(supply.everything())
    for key, package in supply.everything().items():
        (files,) = told[key]["externalReferences"]
        assert {entry["content"] for entry in files["hashes"]} == set(package.hashes)
        assert told[key]["licenses"]
    needs = {entry["ref"]: entry.get("dependsOn", []) for entry in bill["dependencies"]}
    reached, ahead = set(), ["sixlight"]
    while ahead:
        ref = ahead.pop()
        if ref not in reached:
            reached.add(ref)
            ahead += needs[ref]
    assert reached == {"sixlight", *(part["bom-ref"] for part in bill["components"])}


class Advisories(http.server.BaseHTTPRequestHandler):
    """Answers as OSV's server does, for the packages that it knows ill of."""

    known: frozenset[str] = frozenset()

    def do_POST(self):
        query = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        vuln = {
            "id": "TEST-1",
            "details": "made up",
            "affected": [{"package": query["package"], "ranges": []}],
        }
        found = {"vulns": [vuln]} if query["package"]["name"] in self.known else {}
        self.send_response(200)
        self.end_headers()
        self.wfile.write(json.dumps(found).encode())

    def log_message(self, *_):
        pass


@pytest.mark.slow
@pytest.mark.skipif(not importlib.util.find_spec("pip_audit"), reason="the extra supply is absent")
@pytest.mark.parametrize(
    ("known", "status", "said"),
    [
        (set(), 0, "nothing was audited"),
        ({"jinja2"}, 1, r"jinja2 \S+: TEST-1"),
        ({"jinja2", "numpy"}, 1, r"numpy \S+: TEST-1"),
    ],
)
def test_an_audit_tells_what_a_database_knows_and_trusts_none_that_knows_nothing(
    known, status, said
):
    Advisories.known = frozenset(known)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Advisories) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"http://127.0.0.1:{server.server_port}/v1/query"
        done = subprocess.run(
            [sys.executable, "-m", "supply.audit", "--osv", url],
            capture_output=True,
            text=True,
            cwd=ROOT,
        )
        server.shutdown()
    assert (done.returncode, done.stderr) == (status, "")
    assert re.search(said, done.stdout)
