"""sweep: every recording with every combination of parameter values, and what the parameters do."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from openvox.apps.compare import first_outcome
from openvox.apps.cores import cores
from openvox.apps.replay import warm_up
from openvox.apps.report import report
from openvox.apps.scoring.instances import ELSEWHERE, FAR
from openvox.apps.sweeping.cluster import cluster
from openvox.apps.sweeping.item import MAPPED, run_item
from openvox.apps.sweeping.plan import Item, ParameterSet, Run, Source, elsewhere, items, parameter_sets, sources
from openvox.apps.sweeping.pool import Outcome, in_processes
from openvox.apps.sweeping.summary import MEASURES, Row, best, described_sets, effects, table
from openvox.core.digest import digest_of
from openvox.core.errors import InputError, OutputError
from openvox.core.mapper_parameters import preset
from openvox.formats.atomic import partial_file
from openvox.formats.map_npz import SUFFIX as MAP_SUFFIX
from openvox.formats.trace import SUFFIX as TRACE_SUFFIX

FORMAT_VERSION = 1
RESULT, TABLE, PAGE, PLAN, ITEMS = "sweep.json", "table.csv", "index.html", "plan.json", "items"


def sweep(
    recordings: Sequence[Path],
    *,
    assignments: Sequence[str],
    out: Path,
    perceptions: Sequence[Path] = (),
    truths: Sequence[Path] = (),
    preset_name: str = "openvox",
    params: Path | None = None,
    engine: str = "cpu",
    jobs: int | None = None,
    dask: str | None = None,
    start: int | None = None,
    end: int | None = None,
    stride: int = 1,
    progress: Callable[[int, int], None] | None = None,
    notice: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """What docs/comparing.md says of sweep.json, which is written to `out` with a table and each item's map and trace.

    assignments: `group.name=value,value` texts. perceptions: one a recording, or none. truths: one a recording, or one
    for all. jobs: processes, the cores by default. dask: address of a scheduler, whose workers do the items instead.
    Raises InputError, OutputError; an item that fails is reported."""
    began = time.perf_counter()
    if jobs is not None and jobs < 1:
        raise InputError(f"--jobs is {jobs}; expected 1 or more")
    if jobs is not None and dask is not None:
        raise InputError(
            f"--jobs {jobs} and --dask {dask} are both given; a cluster has as many as it has: leave one out"
        )
    run = Run(preset_name, params, engine, start, end, stride)
    varied, sets = parameter_sets(run, assignments)
    found = sources(recordings, perceptions, truths)
    todo = list(items(run, found, sets, out / ITEMS))
    fixed = [text for text in assignments if text.partition("=")[0].strip() not in varied]
    _prepare(out, {"recordings": [one.digests["recording"] for one in found], **_about(run), "fixed": sorted(fixed)})
    warm_up(preset(preset_name), engine, notice)  # compiled once, so that the processes find it done
    outcomes: dict[int, Outcome[dict[str, Any]]] = {}
    with _workers(len(todo), jobs, dask) as (each, workers):
        for outcome in each(run_item, todo if dask is None else [elsewhere(item) for item in todo]):
            outcomes[outcome.place] = outcome
            if progress is not None:
                progress(len(outcomes), len(todo))
    rows = _with_first([_row(item, outcomes[item.number], out) for item in todo], out)
    described = described_sets(sets, rows)
    result = {
        "format_version": FORMAT_VERSION,
        **_about(run),
        "fixed": fixed,
        "varied": varied,
        "default": next(dict(one.values) for one in sets if one.default),
        "recordings": [_source(one, out) for one in found],
        "items": rows,
        "sets": described,
        "measure": MEASURES[0] if truths else None,
        "effects": effects(varied, described),
        "best": best(described),
        "failed": sum(row["status"] == "failed" for row in rows),
        "reused": sum(bool(row["reused"]) for row in rows),
        "seconds": time.perf_counter() - began,
        "jobs": workers,
        "dask": dask,
        "notes": _notes(rows),
    }
    _write(out / TABLE, table(rows, list(varied)))
    _write(out / RESULT, json.dumps(result, indent=1, allow_nan=False) + "\n")
    report(out, None, out / PAGE)
    outputs = {"folder": out, "result": out / RESULT, "table": out / TABLE, "page": out / PAGE}
    return {**result, "outputs": {name: str(path) for name, path in outputs.items()}}


@contextmanager
def _workers(items: int, jobs: int | None, dask: str | None) -> Iterator[tuple[Callable[..., Any], int]]:
    """What does items, here or on a cluster, and how many at a time. Raises InputError."""
    if dask is None:
        here = min(items, jobs or cores())
        yield partial(in_processes, jobs=here), here
        return
    with cluster(dask) as found:
        yield found.each, min(items, found.threads)


def _notes(rows: Sequence[Row]) -> list[str]:
    """Recordings whose truth no set can have met."""
    scores = {row["recording"]: [one["scores"] for one in rows if one["recording"] == row["recording"]] for row in rows}
    return [
        f"{name}: {ELSEWHERE}"
        for name, known in scores.items()
        if any(known) and all(one is None or one["missed_share"] > FAR for one in known)
    ]


def _about(run: Run) -> dict[str, Any]:
    return {**asdict(run), "params": None if run.params is None else str(run.params)}


def _prepare(out: Path, plan: dict[str, Any]) -> None:
    """The folder, which must be new, empty or of a sweep with the same plan. Raises InputError, OutputError.

    Values may be added and taken away: what was mapped before is found again."""
    plan = {name: value for name, value in plan.items() if name != "engine"}  # which changes no byte
    plan["plan"] = digest_of(plan)
    noted = out / PLAN
    try:
        if noted.is_file():
            (out / ITEMS).mkdir(exist_ok=True)
            if json.loads(noted.read_text(encoding="utf-8")).get("plan") != plan["plan"]:
                raise InputError(
                    f"{out} holds a sweep of other recordings, preset, fixed parameters or frames; "
                    "name another folder with --out"
                )
            return
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise InputError(f"{out} holds something that is no sweep; name a new folder with --out")
        (out / ITEMS).mkdir(parents=True, exist_ok=True)
    except (ValueError, AttributeError) as error:
        raise InputError(f"{noted} cannot be read ({error}); name another folder with --out") from None
    except OSError as error:
        raise OutputError(f"{out} cannot be made ({error.strerror or error})") from error
    _write(noted, json.dumps(plan, indent=1) + "\n")


def _write(path: Path, text: str) -> None:
    with partial_file(path) as partial:
        partial.write_text(text, encoding="utf-8")


def _row(item: Item, outcome: Outcome[dict[str, Any]], out: Path) -> dict[str, Any]:
    done = outcome.result
    one: ParameterSet = item.set
    names = {"map": MAP_SUFFIX, "trace": TRACE_SUFFIX}
    return {
        "item": item.number,
        "name": item.stem.name,
        "recording": item.source.name,
        "set": one.number,
        "parameters": dict(one.values),
        "default": one.default,
        "status": "failed" if done is None else "done",
        "error": outcome.error,
        **{name: None if done is None else done[name] for name in ("reused", *MAPPED, "digests", "scores")},
        "outputs": None
        if done is None
        else {
            name: Path(f"{item.stem}{suffix}").relative_to(out).as_posix()  # so that the folder can be moved
            for name, suffix in names.items()
        },
    }


def _with_first(rows: list[dict[str, Any]], out: Path) -> list[dict[str, Any]]:
    """Each row with the first mask that went another way than with the default set of its recording."""
    traces = {row["recording"]: out / row["outputs"]["trace"] for row in rows if row["default"] and row["outputs"]}
    found = []
    for row in rows:
        default = traces.get(row["recording"])
        known = default is not None and row["outputs"] is not None and not row["default"]
        first = first_outcome(default, out / row["outputs"]["trace"]) if default is not None and known else None
        found.append({**row, "first_outcome": None if first is None else asdict(first)})
    return found


def _source(one: Source, out: Path) -> dict[str, Any]:
    return {
        "name": one.name,
        "path": _relative(one.path, out),
        "perception": _relative(one.perception, out),
        "truth": None if one.truth is None else _relative(one.truth, out),
        "digests": dict(one.digests),
    }


def _relative(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
