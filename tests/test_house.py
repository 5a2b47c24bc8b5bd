"""House rules: short modules, each equation in one place, a project that speaks of itself only."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "openvox"
LONGEST_MODULE = 400
EQUATIONS = (1, 6, 8, 9, 14, 15, 16, 17, 18, 19)
SKIPPED = {"build", "dist", "demo", "recordings", "models"}
# Put together here, so that this file does not hold the words that it looks for.
FOREIGN = tuple("".join(parts) for parts in (("/wo", "rk/"), (".lib", "rary"), ("/ro", "ot/")))


def project_files() -> Iterator[Path]:
    """Texts of the project: what was not made by tools."""
    for path in sorted(ROOT.rglob("*")):
        parts = path.relative_to(ROOT).parts
        made = any(part in SKIPPED or part.endswith(("__", ".egg-info")) for part in parts[:-1])
        hidden = parts[0].startswith(".") and parts[0] not in {".ci", ".gitignore"}
        if path.is_file() and not (made or hidden) and path.suffix in {"", ".py", ".md", ".toml", ".txt"}:
            yield path


def function_docstrings(package: Path) -> Iterator[str]:
    """Docstrings of all functions and methods of a package."""
    for path in sorted(package.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                yield ast.get_docstring(node) or ""


def equations(package: Path) -> Counter[int]:
    """How many functions claim each equation by "eq. (N)" or "eqs. (N), (M)"."""
    found: Counter[int] = Counter()
    for text in function_docstrings(package):
        claims = re.findall(r"eqs?\. ((?:\(\d+\)(?:, | and )?)+)", text)
        found.update({int(number) for claim in claims for number in re.findall(r"\d+", claim)})
    return found


def test_no_module_is_long() -> None:
    lines = {
        str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines())
        for path in PACKAGE.rglob("*.py")
    }
    assert {name: count for name, count in lines.items() if count > LONGEST_MODULE} == {}


def test_each_equation_of_the_paper_is_one_function() -> None:
    assert {number: equations(PACKAGE)[number] for number in EQUATIONS} == dict.fromkeys(EQUATIONS, 1)


def test_the_count_of_equations_sees_functions_only_and_every_claim(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text(
        '"""eq. (1)"""\nclass A:\n    """eq. (2)"""\n    def f(self):\n        """Both of eqs. (3), (4)."""\n'
        'def g():\n    """eq. (4) and eq. (5), after eq. (5)."""\n'
    )
    assert equations(tmp_path) == {3: 1, 4: 2, 5: 1}


def test_no_file_speaks_of_the_place_where_it_was_written() -> None:
    found = [
        f"{path.relative_to(ROOT)}: {word}"
        for path in project_files()
        for word in FOREIGN
        if word in path.read_text(encoding="utf-8", errors="replace")
    ]
    assert found == []


@pytest.mark.parametrize("name", ["README.md", "pyproject.toml", "openvox/core/types.py", "tools/setup", ".ci/run"])
def test_the_search_covers_every_kind_of_file(name: str) -> None:
    assert ROOT / name in set(project_files())


def test_the_recordings_that_come_along_are_small() -> None:
    size = sum(path.stat().st_size for path in (ROOT / "recordings").rglob("*") if path.is_file())
    assert size < 15_000_000
