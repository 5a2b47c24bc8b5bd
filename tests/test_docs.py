"""Docs cannot rot: help has examples, docs/commands.md is the help, and the README's commands run."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from worlds import write_scannet

from openvox.cli.commands import app
from openvox.formats.recording import read_frames

ROOT = Path(__file__).resolve().parents[1]
COMMANDS = sorted(typer.main.get_command(app).commands)  # type: ignore[attr-defined]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def test_the_page_of_commands_is_the_help() -> None:
    script = ROOT / "tools" / "write_commands.py"
    made = subprocess.run([sys.executable, script, "--stdout"], capture_output=True, text=True, check=True, timeout=120)
    page = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    assert page == made.stdout, "docs/commands.md is stale; tools/check --fix writes it anew"


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_a_chapter_with_an_example_of_itself(command: str) -> None:
    page = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    chapter = page.partition(f"## openvox {command}\n")[2].partition("\n## ")[0]
    assert f"Example:\n    openvox {command} " in chapter


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_stands_in_the_readme(command: str) -> None:
    assert f"`openvox {command}" in (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(document: Path) -> None:
    links = re.findall(r"\]\((?!https?:|#)([^)#]+)", document.read_text(encoding="utf-8"))
    assert [link for link in links if not (document.parent / link).exists()] == []


def readme_commands() -> list[list[str]]:
    """Every `openvox ...` line of the README's code blocks, as words, without its comment."""
    blocks = re.findall(r"```sh\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL)
    lines = [line for block in blocks for line in block.splitlines()]
    return [shlex.split(line, comments=True) for line in lines if line.startswith("openvox ")]


def test_the_commands_of_the_readme_run_one_after_another(tmp_path: Path) -> None:
    write_scannet(tmp_path / "scans" / "living", list(read_frames(ROOT / "recordings" / "living_demo.mcap", end=5)))
    for truth in (ROOT / "recordings" / "living_demo_truth").iterdir():
        shutil.copy(truth, tmp_path / "scans" / "living")
    commands = readme_commands()
    whole_way = ["ingest", "perceive", "replay", "query", "evaluate"]
    assert [words[1] for words in commands] == [*whole_way, "explain", "explain", "replay", "compare", "report"]
    for words in commands:
        command = [sys.executable, "-m", *words]
        result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300)
        assert result.returncode == 0 or (words[1] == "compare" and result.returncode == 3), f"{words}: {result.stderr}"
