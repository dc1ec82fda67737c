"""What the documentation tells people to type exists, and all that exists is told."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest
import typer

from pipeline import cli

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
GROUP = typer.main.get_command(cli.app)


def options_of(command: str) -> set[str]:
    return {opt for p in GROUP.commands[command].params for opt in getattr(p, "opts", ())}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_that_are_told_exist(page):
    typed = re.findall(r"(?:^    |`|^\$ )sixlight ([a-z]+)\b([^`\n]*)", page.read_text(), re.M)
    for command, rest in typed:
        assert command in GROUP.commands, f"{page.name}: sixlight {command}"
        rest = rest.split("  #")[0]
        for option in re.findall(r"(?<![\w-])--?[a-z][\w-]*", rest):
            assert option in options_of(command) | {"--help"}, f"{page.name}: {command} {option}"


def test_make_targets_that_are_told_exist():
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.M))
    for page in PAGES:
        for target in re.findall(r"(?:^    |`)make ([a-z-]+)", page.read_text(), re.M):
            assert target in targets, f"{page.name}: make {target}"


def test_the_page_of_commands_has_every_command_and_option():
    spec = importlib.util.spec_from_file_location("hooks", ROOT / "docs" / "hooks.py")
    hooks = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hooks)
    page = hooks.commands()
    assert hooks.COMMANDS in (ROOT / "docs" / "commands.md").read_text()
    for command in GROUP.commands:
        _, section = page.split(f"## sixlight {command}\n", 1)
        section = section.split("\n## ")[0]
        for option in options_of(command) - {"--help"}:
            if option.startswith("-"):
                assert option in section, f"{command} {option}"


def test_every_page_is_in_the_contents():
    contents = (ROOT / "mkdocs.yml").read_text()
    for page in PAGES[1:]:
        assert page.name in contents, page.name
