"""For mkdocs: links into the checkout, and the page of commands, from the program itself."""

from __future__ import annotations

import re

import typer

from pipeline import cli

COMMANDS = "<!-- commands -->"


def on_page_markdown(markdown: str, page, config, files) -> str:
    """Fills in the commands, and makes links that leave docs/ plain text: the site has no code."""
    if COMMANDS in markdown:
        markdown = markdown.replace(COMMANDS, commands())
    return re.sub(r"\[([^\]]+)\]\(\.\./[^)]*\)", r"`\1`", markdown)


def commands() -> str:
    """Markdown of all commands: what each does, its example, its arguments and options."""
    group = typer.main.get_command(cli.app)
    return "\n\n".join(_command(name, group.commands[name]) for name in sorted(group.commands))


def _command(name: str, command) -> str:
    text, *examples = re.split(r"\n\s*Example: ", command.help or "")
    lines = [f"## sixlight {name}", " ".join(text.split())]
    if examples:
        lines.append("\n".join(f"    {' '.join(example.split())}" for example in examples))
    rows = [_row(p) for p in command.params if p.name != "help"]
    if rows:
        lines.append("\n".join(["| argument or option | |", "| --- | --- |", *rows]))
    return "\n\n".join(lines)


def _row(parameter) -> str:
    if parameter.param_type_name == "argument":
        name = parameter.name.upper()
    else:
        name = ", ".join(option for option in parameter.opts if option)
    said = " ".join((parameter.help or "").split()).replace("|", "\\|")
    default = parameter.default
    if isinstance(default, int | float | str) and not isinstance(default, bool) and default != "":
        said += f" Default: {default}."
    return f"| `{name}` | {said} |"
