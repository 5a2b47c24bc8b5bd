"""Writes docs/commands.md from the help of every command: python tools/write_commands.py [--stdout]."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import typer

from openvox.cli.commands import app

PAGE = Path(__file__).resolve().parents[1] / "docs" / "commands.md"


def help_of(*words: str) -> str:
    """What `openvox WORDS --help` prints on a terminal of 100 columns."""
    environment = {**os.environ, "COLUMNS": "100", "NO_COLOR": "1"}
    command = [sys.executable, "-m", "openvox", *words, "--help"]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout.rstrip()


def page() -> str:
    """The whole page: the overview, then a chapter a command."""
    names = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    chapters = [f"## openvox {name}\n\n```\n{help_of(name)}\n```" for name in names]
    head = f"# Commands\n\nMade from `--help` by `tools/check --fix`.\n\n```\n{help_of()}\n```"
    return "\n\n".join([head, *chapters]) + "\n"


if __name__ == "__main__":
    if sys.argv[1:] == ["--stdout"]:
        sys.stdout.write(page())
    else:
        PAGE.write_text(page(), encoding="utf-8")
