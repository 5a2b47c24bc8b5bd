"""The house plan holds: imports go down only, siblings are strangers, heavy packages stay in their rooms."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "openvox"

# Each room and the rooms that it may import. A new folder must be declared here.
ROOMS = {
    "core": set[str](),
    "formats": {"core"},
    "sources": {"core", "formats"},
    "perception": {"core", "formats"},
    "mapper": {"core"},
    "view": {"core", "formats"},
    "apps": {"core", "formats", "sources", "perception", "mapper", "view"},
    "cli": {"core", "apps"},
    "__init__": {"core", "formats", "perception", "mapper", "apps"},  # the library's names, each when it is used
    "__main__": {"cli"},
}
# Packages that only some rooms may import.
OWNERS = {
    "rerun": {"view"},
    "mcap": {"formats"},
    "google": {"formats"},
    "foxglove_schemas_protobuf": {"formats"},
    "zstandard": {"formats"},
    "rosbags": {"sources"},
    "websockets": {"sources"},
    "foxglove": {"view"},
    "typer": {"cli"},
    "rich": {"cli"},
}
# All that the mapper may use beside the standard library.
MAPPER_USES = {"openvox", "numpy", "numba", "torch"}
HEAVY = ("torch", "rerun", "numba", "cv2", "numpy", "onnxruntime")


def imports(source: str, package: str) -> Iterator[str]:
    """Dotted names of everything that a module imports, wherever it does, also as text "openvox.room.file"."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parent = package.split(".")[: -node.level + 1 or None] if node.level else []
            base = ".".join([*parent, *([node.module] if node.module else [])])
            yield from (f"{base}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            named = re.fullmatch(r"(openvox(\.\w+){2,})(:\w+)?", node.value)
            if named:
                yield named[1]


def violations(package: Path) -> list[str]:
    """What breaks the plan in a package named openvox, one sentence each."""
    found = []
    for path in sorted(package.rglob("*.py")):
        where = path.relative_to(package)
        room = where.parts[0].removesuffix(".py")
        if room not in ROOMS:
            found.append(f"{where}: room {room!r} is not declared")
            continue
        for name in imports(path.read_text(encoding="utf-8"), ".".join(["openvox", *where.parts[:-1]])):
            top, _, rest = name.partition(".")
            target = rest.split(".")[0]
            if top == "openvox" and target in ROOMS and target != room and target not in ROOMS[room]:
                found.append(f"{where}: {room} must not import {target} ({name})")
            if room not in OWNERS.get(top, {room}):
                found.append(f"{where}: {top} belongs to {', '.join(sorted(OWNERS[top]))}")
            if room == "mapper" and top not in MAPPER_USES | sys.stdlib_module_names:
                found.append(f"{where}: the mapper must not use {top}")
    return found


def test_imports_go_down_only() -> None:
    assert violations(PACKAGE) == []


@pytest.mark.parametrize(
    ("module", "line", "complaint"),
    [
        ("core/types.py", "from openvox.formats import recording", "core must not import formats"),
        ("core/types.py", "def f():\n    import openvox.apps.replay", "core must not import apps"),
        ("mapper/mapper.py", "from ..view import render", "mapper must not import view"),
        ("mapper/mapper.py", "from openvox import formats", "mapper must not import formats"),
        ("mapper/mapper.py", "import cv2", "the mapper must not use cv2"),
        ("sources/table.py", 'X = "openvox.perception.oracle:read"', "sources must not import perception"),
        ("apps/replay.py", "import typer", "typer belongs to cli"),
        ("apps/replay.py", "from mcap.reader import make_reader", "mcap belongs to formats"),
        ("apps/replay.py", "def f():\n    import rerun as rr", "rerun belongs to view"),
        ("attic/old.py", "", "room 'attic' is not declared"),
        ("helpers.py", "", "room 'helpers' is not declared"),
    ],
)
def test_the_check_finds_what_breaks_the_plan(tmp_path: Path, module: str, line: str, complaint: str) -> None:
    path = tmp_path / "openvox" / module
    path.parent.mkdir(parents=True)
    path.write_text(line)
    assert [complaint in sentence for sentence in violations(tmp_path / "openvox")] == [True]


def test_the_check_lets_good_imports_pass(tmp_path: Path) -> None:
    path = tmp_path / "openvox" / "apps" / "loop.py"
    path.parent.mkdir(parents=True)
    path.write_text("from openvox.mapper import mapper\nfrom . import replay\nimport numpy\nX = 'openvox.cli'")
    assert violations(tmp_path / "openvox") == []


def imported_by(code: str) -> set[str]:
    """Top-level names in sys.modules after a fresh interpreter ran the code."""
    script = f"import sys\ntry:\n    {code}\nexcept SystemExit:\n    pass\nprint(*sys.modules, file=sys.stderr)"
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60)
    return {name.partition(".")[0] for name in result.stderr.split()}


def test_the_package_itself_is_light() -> None:
    assert imported_by("import openvox").isdisjoint({*HEAVY, "typer", "mcap"})


@pytest.mark.parametrize("words", [["--help"], ["--version"], ["replay", "--help"], ["no-such-command"]])
def test_what_only_talks_is_light(words: list[str]) -> None:
    loaded = imported_by(f"from openvox.cli import main; main({words!r})")
    assert "typer" in loaded
    assert loaded.isdisjoint(HEAVY)


def test_the_check_of_lightness_sees_heavy_imports() -> None:
    assert not imported_by("import openvox.core.types").isdisjoint(HEAVY)
