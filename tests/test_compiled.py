import os
import subprocess
import sys
from pathlib import Path

import pytest

FUNCTION = """
from stages.compiled import compiled
@compiled
def twice(x):
    return 2 * x
print(twice(21))
"""


def _run(folder: Path, **environment) -> subprocess.CompletedProcess:
    (folder / "module.py").write_text(FUNCTION)
    root = Path(__file__).parents[1]
    variables = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    return subprocess.run(
        [sys.executable, "-W", "error", "module.py"],
        cwd=folder,
        env=variables | {"PYTHONPATH": str(root)} | environment,
        capture_output=True,
        text=True,
        check=False,
    )


def test_machine_code_is_kept_where_it_is_told_to(tmp_path):
    ran = _run(tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "kept"))
    assert ran.stdout == "42\n", ran.stderr
    assert list((tmp_path / "kept").rglob("*.nbc"))


def test_it_runs_where_nothing_can_be_kept(tmp_path):
    (tmp_path / "file").touch()  # no folder can be made below a file
    nowhere = str(tmp_path / "file" / "below")
    (tmp_path / "__pycache__").touch()
    ran = _run(tmp_path, HOME=nowhere, XDG_CACHE_HOME=nowhere)
    assert ran.stdout == "42\n", ran.stderr


def test_the_command_line_does_not_load_the_compiler():
    program = "import sys, pipeline.cli; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


# Every compiled function over every size that differs in what rows and columns are left over.
EDGES = """
import numpy as np
from stages import merge as merging
from stages.merge import InMemory, merge
from stages.types import Frame
rng = np.random.default_rng(1)
black = np.full((2, 2), 100.0)
sizes = [(6, 6), (6, 7), (7, 6), (9, 8), (13, 11), (23, 40), (41, 6), (6, 41), (77, 53)]
for height, width in sizes:
    world = rng.uniform(100, 2000, (height, width))
    world[height // 2 :, width // 2 :] = 9000
    world[0, -1] = world[-1, 0] = 1e6
    for count in (1, 2, 5):
        for merging.BAND in (2, 64):
            frames = []
            for k in range(count):
                seen = rng.normal(world * 2**k, 10 + np.sqrt(world * 2**k))
                seen[rng.random(seen.shape) < 0.05] += 900
                raw = np.clip(seen + 100, 0, 12100).astype(np.uint16)
                frames.append(
                    Frame(raw, np.array([[0, 1], [1, 2]]), black, black + 12000, 2.0**k, 100.0, 1.0)
                )
            merge(InMemory(frames))
print("inside")
"""


@pytest.mark.slow
def test_compiled_beforehand_and_no_index_outside_of_an_array_whatever_its_size(tmp_path):
    """Merging finds everything there, compiled to check each index."""
    environment = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    run = [sys.executable, "-m", "pipeline.compiling"]
    subprocess.run(run, env=environment, check=True, capture_output=True)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nb?")}
    ran = subprocess.run(
        [sys.executable, "-W", "error", "-c", EDGES],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.stdout == "inside\n", ran.stderr
    after = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nb?")}
    assert before
    assert after == before
