"""Sweeps and perception on a Dask cluster of this machine: what it makes, what dies, what is not done twice."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from cluster_jobs import double, noted
from test_cli import run
from test_sweep import recorded

from openvox.apps.perceive import perceive
from openvox.apps.sweep import sweep
from openvox.apps.sweeping.alone import alone
from openvox.apps.sweeping.cluster import cluster
from openvox.core.errors import InputError

SETS = ["masks.min_pixels=0", "association.threshold=0.3,0.4"]


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """A scheduler on loopback with a worker of two threads, in processes of their own; no dashboard."""
    distributed = pytest.importorskip("distributed", reason='the extra "cluster" is not installed')
    with distributed.LocalCluster(
        n_workers=1,
        threads_per_worker=2,
        processes=True,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        scheduler_kwargs={"dashboard": False},
        memory_limit=0,
        silence_logs="CRITICAL",
    ) as here:
        yield here.scheduler_address


# ---- one item in a process of its own --------------------------------------------------------------------------------


def test_an_item_alone_has_a_process_of_its_own_and_may_print(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    result, error = alone(noted, (tmp_path, 4))
    assert error is None
    assert result != os.getpid()
    assert capfd.readouterr().out == ""


def test_what_goes_wrong_alone_is_a_sentence(tmp_path: Path) -> None:
    assert alone(noted, (tmp_path, 3)) == (None, "three is no number")
    result, error = alone(noted, (tmp_path, 2))
    assert result is None
    assert error is not None
    assert "died (signal 9)" in error
    assert alone(double, None) == (None, f"a fault of openvox itself (TypeError: {_message()})")


def test_what_runs_alone_ends_with_who_asked_for_it(tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    code = f"from pathlib import Path; from cluster_jobs import endless; from {alone.__module__} import alone; "
    asking = subprocess.Popen(
        [sys.executable, "-c", f"{code}alone(endless, Path({str(mark)!r}))"], env={**os.environ, "PYTHONPATH": PATHS}
    )
    assert eventually(mark.exists)
    process = Path("/proc") / mark.read_text()
    assert process.exists()
    asking.kill()
    asking.wait()
    assert eventually(lambda: not process.exists() or "Z" in (process / "stat").read_text().split()[2])


PATHS = os.pathsep.join(path for path in sys.path if path)


def eventually(happened: Callable[[], bool]) -> bool:
    """Waits for it, up to a minute on a busy machine."""
    for _ in range(600):
        if happened():
            return True
        time.sleep(0.1)
    return False


def _message() -> str:
    try:
        double(None)  # type: ignore[arg-type]
    except TypeError as error:
        return str(error)
    raise AssertionError


# ---- many on a cluster -----------------------------------------------------------------------------------------------


def test_a_dying_item_costs_only_itself_and_nothing_is_done_twice(address: str, tmp_path: Path) -> None:
    with cluster(address) as found:
        assert found.threads == 2
        outcomes = {one.place: one for one in found.each(noted, [(tmp_path, number) for number in range(6)])}
    assert sorted(outcomes) == [*range(6)]
    assert "died (signal 9)" in str(outcomes[2].error)
    assert outcomes[3].error == "three is no number"
    processes = [outcomes[place].result for place in (0, 1, 4, 5)]
    assert len(set(processes)) == 4
    assert sorted(path.name.partition("-")[0] for path in tmp_path.iterdir()) == [*"012345"]


def test_a_sweep_on_a_cluster_is_the_sweep_of_this_machine(address: str, tmp_path: Path) -> None:
    recording = recorded(tmp_path / "tiny.mcap", 4)
    there = sweep([recording], assignments=SETS, out=tmp_path / "there", dask=address, truths=[recording])
    here = sweep([recording], assignments=SETS, out=tmp_path / "here", jobs=1, truths=[recording])
    for name in ("digests", "scores", "outputs", "first_outcome", "status"):
        assert [item[name] for item in there["items"]] == [item[name] for item in here["items"]]
    assert (there["dask"], here["dask"]) == (address, None)
    again = sweep([recording], assignments=SETS, out=tmp_path / "there", dask=address, truths=[recording])
    assert again["reused"] == len(again["items"]) == 2


def test_a_sweep_names_files_from_the_root(address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorded(tmp_path / "tiny.mcap", 2)
    monkeypatch.chdir(tmp_path)  # where the worker is not
    found = sweep([Path("tiny.mcap")], assignments=SETS, out=Path("out"), dask=address)
    assert found["failed"] == 0
    assert all((tmp_path / "out" / item["outputs"]["map"]).is_file() for item in found["items"])


def test_perceive_does_each_recording_and_reports_each_failure(
    address: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second = recorded(tmp_path / "a.mcap", 2), recorded(tmp_path / "b.mcap", 3)
    expected = perceive(second, frontend="geometry").digest
    second.with_suffix(".perception.mcap").unlink()
    (tmp_path / "bad.mcap").write_bytes(b"no recording")
    words: list[Any] = [first, tmp_path / "bad.mcap", second, "--frontend", "geometry", "--dask", address, "--json"]
    assert run("perceive", *words) == 3
    one, bad, other = json.loads(capsys.readouterr().out)["recordings"]
    assert (one["frames"], other["frames"], other["digest"]) == (2, 3, expected)
    assert "bad.mcap" in bad["error"]
    assert run("perceive", *words) == 3
    assert json.loads(capsys.readouterr().out)["recordings"][2]["reused"] == 3


# ---- what cannot be --------------------------------------------------------------------------------------------------


def test_without_the_extra_one_sentence_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r'pip install "openvox\[cluster\]"'), cluster("tcp://127.0.0.1:1"):
        pass


def test_an_address_where_nobody_answers_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason='the extra "cluster" is not installed')
    monkeypatch.setattr("openvox.apps.sweeping.cluster.PATIENCE", 1)
    with pytest.raises(InputError, match="no scheduler answers there"), cluster("tcp://127.0.0.1:1"):
        pass
    with pytest.raises(InputError, match="no scheduler answers there"), cluster("nonsense://x"):
        pass


def test_workers_of_another_version_are_named(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("openvox.apps.sweeping.cluster.__version__", "99.0")
    with pytest.raises(InputError, match=r"worker tcp://127.0.0.1:\d+ has openvox .*; expected 99.0"), cluster(address):
        pass


def test_jobs_and_a_cluster_exclude_each_other(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="are both given"):
        sweep([tmp_path / "a.mcap"], assignments=SETS, out=tmp_path / "o", jobs=2, dask="tcp://127.0.0.1:1")
    assert run("sweep", "a.mcap", "--set", "a.b=1", "--out", "o", "--jobs", 2, "--dask", "tcp://x:1") == 2
    assert run("perceive", "a.mcap", "--jobs", 2, "--dask", "tcp://x:1") == 2
    assert run("perceive", "a.mcap", "--out", "b.mcap", "--dask", "tcp://x:1") == 2
