"""The house keeps its own rules: arrows, names, help, and what is shipped."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import QUICK

from pipeline.steps import STEPS

ROOT = Path(__file__).parent.parent
ORDER = ("shaders", "calibration", "stages", "pipeline")  # each may import those before it
MAY_IMPORT = {
    "shaders": {"shaders"},
    "calibration": {"calibration"},
    "stages": {"stages", "calibration", "shaders"},
    "pipeline": set(ORDER),
}


def modules(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


@pytest.mark.parametrize("package", ORDER)
def test_imports_run_one_way(package):
    for path in modules(package):
        for node in ast.walk(ast.parse(path.read_text())):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path}: relative import"
                names = [node.module or ""]
            for name in names:
                top = name.split(".")[0]
                assert top not in ORDER or top in MAY_IMPORT[package], f"{path} imports {name}"


def test_stages_open_no_files_and_print_nothing():
    allowed = {"meshes.py"}  # reads the teapot that lies beside it
    for path in modules("stages"):
        calls = {
            node.func.id
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        }
        assert not calls & {"open", "print"} or path.name in allowed, path


def test_glsl_lives_in_shaders_alone():
    for package in ("pipeline", "stages", "calibration"):
        for path in modules(package):
            assert not re.search(r"\bvoid\s+main\s*\(|gl_Position|#version", path.read_text()), path


PAGES = {"report", "view"}  # steps that write a page, and are no stages


def test_a_stage_is_a_file_named_by_its_verb():
    for step in STEPS:
        if step.name not in PAGES:
            text = (ROOT / "stages" / f"{step.name}.py").read_text()
            assert f"\ndef {step.name}(" in text


def test_steps_are_printed_from_the_list(sixlight):
    said = sixlight("steps").out
    for step in STEPS:
        assert f"{step.name}: {step.about}" in said
        assert all(name in said for name in step.reads + step.makes)


def test_every_step_reads_what_an_earlier_one_made():
    made = {"raw", "dark", "flat", "result.json"}
    for step in STEPS:
        assert set(step.reads) <= made, step.name
        made |= set(step.makes)


def test_every_command_has_an_example(sixlight):
    listed = re.findall(r"^  (\w+)  ", sixlight("--help").out.split("Commands:")[1], re.M)
    assert {"envmap", "fit", "preview", "inspect", "simulate", "primaries"} <= set(listed)
    for command in listed:
        assert re.search(rf"Example: sixlight {command}\b", sixlight(command, "--help").out)


def test_no_machine_paths_or_hosts():
    tracked = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.split("\n")
    if not any(tracked):
        pytest.skip("not a git checkout")
    for name in filter(None, tracked):
        path = ROOT / name
        if path.suffix in {".py", ".toml", ".md", ".txt", ".glsl", ".frag", ".vert", ""}:
            assert not re.search(r"/(home|root)/\w|files\.pythonhosted", path.read_text()), name


def test_help_does_not_wait_for_slow_imports():
    """What takes longest to import must not be imported to print the help."""
    program = (
        "import sys; from pipeline import cli; cli.status(['--help']);"
        "print([m for m in ('numpy', 'scipy', 'cv2', 'colour', 'rawpy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "[]", done.stderr


@pytest.mark.slow
def test_the_wheel_runs_elsewhere(small_capture_once, tmp_path):
    """Built, installed into a folder of its own, and run there: no file may be left behind."""
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "-o", tmp_path, ROOT]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    elsewhere = tmp_path / "elsewhere"
    install = [sys.executable, "-m", "pip", "install", "--no-deps", "-q", "--target", elsewhere]
    subprocess.run([*install, wheel], check=True, capture_output=True)
    environment = os.environ | {"PYTHONPATH": str(elsewhere)}
    where = "import pipeline, shaders; print(pipeline.__file__, shaders.__file__)"
    found = subprocess.run(
        [sys.executable, "-c", where], env=environment, cwd=tmp_path, capture_output=True, text=True
    )
    assert found.stdout.count(str(elsewhere)) == 2
    done = subprocess.run(
        [sys.executable, "-m", "pipeline", "envmap", small_capture_once, "-o", "out", *QUICK],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "preview_teapot.png").is_file()
    assert not (elsewhere / "sample_captures").exists()
