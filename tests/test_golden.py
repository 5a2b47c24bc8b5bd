"""The bundled recording gives the same map and trace, bit by bit, however and wherever it is replayed."""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
RECORDING = ROOT / "recordings" / "living_demo.mcap"
GOLDEN = json.loads((ROOT / "tests" / "golden.json").read_text())


def replayed(folder: Path, *options: str, **environment: str) -> dict[str, str]:
    """Digests of a replay in a fresh process."""
    command = [sys.executable, "-m", "openvox", "replay", str(RECORDING), "--out", str(folder / "run"), "--json"]
    done = subprocess.run([*command, *options], capture_output=True, text=True, env={**os.environ, **environment})
    assert done.returncode == 0, done.stderr
    digests: dict[str, str] = json.loads(done.stdout)["digests"]
    return digests


@pytest.mark.parametrize("preset", ["openvox", "official", "paper"])
def test_the_bundled_recording_gives_the_golden_map_and_trace(tmp_path: Path, preset: str) -> None:
    assert replayed(tmp_path, "--preset", preset) == GOLDEN[preset]


@pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="needs torch; tools/test --torch")
@pytest.mark.parametrize("preset", ["openvox", "official", "paper"])
def test_the_torch_engine_gives_the_golden_map_and_trace(tmp_path: Path, preset: str) -> None:
    assert replayed(tmp_path, "--preset", preset, "--engine", "torch") == GOLDEN[preset]


def test_neither_hash_seed_nor_threads_nor_watching_changes_a_bit(tmp_path: Path) -> None:
    watched = replayed(
        tmp_path, "--rerun", str(tmp_path / "run.rrd"), PYTHONHASHSEED="7", NUMBA_NUM_THREADS="1", OMP_NUM_THREADS="1"
    )
    assert watched == GOLDEN["openvox"]


def test_an_install_that_cannot_be_written_compiles_every_time_says_so_and_gives_the_same(tmp_path: Path) -> None:
    package, home = tmp_path / "site" / "openvox", tmp_path / "home"
    shutil.copytree(ROOT / "openvox", package, ignore=shutil.ignore_patterns("__pycache__", "models"))
    home.mkdir()
    for folder in (*(path for path in (package, *package.rglob("*")) if path.is_dir()), home):
        (folder / ("__pycache__" if folder != home else ".cache")).touch()  # no folder can be made, by root neither
        folder.chmod(0o555)
    command = ["-m", "openvox", "replay", str(RECORDING), "--end", "4", "--out", str(tmp_path / "run"), "--json"]
    places = {"PYTHONPATH": str(package.parent), "HOME": str(home), "XDG_CACHE_HOME": str(home / ".cache")}
    environment = {**{name: os.environ[name] for name in os.environ if name != "NUMBA_CACHE_DIR"}, **places}
    done = subprocess.run(
        [sys.executable, *command], capture_output=True, text=True, cwd=package.parent, env=environment
    )
    for folder in (home, *package.rglob("*"), package):
        folder.chmod(0o755)  # so that pytest can clear up
    assert done.returncode == 0, done.stderr
    assert "no folder to keep the compiled kernels in" in done.stderr
    assert "Traceback" not in done.stderr
    assert json.loads(done.stdout)["digests"] == replayed(tmp_path, "--end", "4")


def test_other_parameters_give_another_map(tmp_path: Path) -> None:
    assert replayed(tmp_path, "--set", "map.voxel_size=0.08")["map"] != GOLDEN["openvox"]["map"]
