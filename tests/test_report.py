"""Pages to keep: what stands in them, that nothing in a file can run in them, and that they work in a browser."""

from __future__ import annotations

import base64
import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import Browser, browser_path, opened
from maps import labelled_map, small_map
from numpy.typing import NDArray
from worlds import tiny_frames

from openvox.apps.explaining.run import read_run as told_run
from openvox.apps.perceive import perceive
from openvox.apps.replay import replay
from openvox.apps.report import report
from openvox.apps.reporting.first_look import first_look
from openvox.apps.reporting.run import confirmed_before, counted
from openvox.core.digest import map_digest
from openvox.core.errors import InputError, OutputError
from openvox.formats.map_npz import read_map, write_map
from openvox.formats.recording import RecordingWriter
from openvox.formats.times import Times, times_path, write_times
from openvox.formats.trace import trace_info
from openvox.view.page import cubes
from openvox.view.page.document import Html, escaped, page, tag
from openvox.view.page.plots import areas, bars, dots, histogram, lines

HOSTILE = "</script><script>document.title = 'stolen'</script><img src=http://example.com/x onerror=alert(1)> \u202ecba"


def data_of(text: str) -> Any:
    """What the page's scripts read."""
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    assert found
    return json.loads(found[1])


def cells_of(scene: dict[str, Any]) -> NDArray[Any]:
    return np.frombuffer(base64.b64decode(scene["cells"]), cubes.CELL)


def row_map(**changes: Any) -> Any:
    """Four voxels in a row along x: floor, two of instance 3, one of 8."""
    index = np.array([[5, 0, 0], [6, 0, 0], [7, 0, 0], [8, 0, 0]], np.int32)
    return labelled_map(index, np.array([0, 3, 3, 8], np.int32), **changes)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with tiny.mcap, its perception, map and trace."""
    folder = tmp_path_factory.mktemp("report")
    with RecordingWriter(folder / "tiny.mcap", source="test") as recording:
        for frame in tiny_frames(6):
            recording.add(frame)
    perceive(folder / "tiny.mcap", frontend="oracle", assignments=["oracle.min_pixels=1"])
    replay(folder / "tiny.mcap", assignments=["map.voxel_size=0.1", "masks.min_pixels=1"])
    return folder


# --- what stands in a page -------------------------------------------------------------------------------------------


def test_texts_are_escaped_and_what_is_not_printable_is_shown_as_a_question_mark() -> None:
    assert escaped("a<b>&\"'\x1b\u202e") == "a&lt;b&gt;&amp;&quot;&#x27;??"
    assert tag("p", "<i>", Html("<b>"), 3, None, ["&"]) == "<p>&lt;i&gt;<b>3&amp;</p>"
    assert tag("td", data_x='"', class_="a", hidden=True, id=None) == '<td data-x="&quot;" class="a" hidden></td>'
    assert tag("img", alt="") == '<img alt="">'


def test_data_cannot_end_their_script() -> None:
    text = page("t", [], {"caption": "</script><!--"})
    assert data_of(text) == {"caption": "</script><!--"}
    assert text.count("</script>") == 2


def test_a_page_allows_only_its_own_scripts_and_nothing_from_a_network() -> None:
    text = page("t", [], {})
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)
    assert policy
    rules = dict(rule.strip().split(" ", 1) for rule in policy[1].split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["img-src"] == "data:"
    assert re.fullmatch(r"'sha256-[^']+'", rules["script-src"])
    assert "unsafe" not in policy[1]
    assert not re.search(r"""(src|href)=["']?(https?:|//)|url\(|@import""", text)


def test_bars_are_as_long_as_their_numbers() -> None:
    widths = [float(w) for w in re.findall(r'<rect [^>]*width="([\d.]+)"', bars("t", [("a", 4), ("b", 1), ("c", 0)]))]
    assert widths[1] == pytest.approx(widths[0] / 4, abs=0.1)
    assert widths[2] == 0


def test_dots_lie_between_the_least_and_the_largest_number() -> None:
    x = [
        float(x) for x in re.findall(r'<circle [^>]*cx="([\d.]+)"', dots("t", [("a", 0.81), ("b", 0.82), ("c", 0.83)]))
    ]
    assert x[0] < x[1] < x[2]
    assert x[1] - x[0] == pytest.approx(x[2] - x[1], abs=0.2)
    assert len(set(re.findall(r'cx="([\d.]+)"', dots("t", [("a", 0.81), ("b", 0.81)])))) == 1


def test_a_histogram_counts_each_value_once_and_those_beyond_it_at_its_ends() -> None:
    found = re.findall(r"<title>[^<]*: (\d+)</title>", histogram("t", [-9, -1, -0.5, 0.0, 0.99, 1, 7], -1, 1, bins=4))
    assert found == ["2", "1", "1", "3"]


def test_a_line_ends_at_the_right_at_its_last_value() -> None:
    text = lines("t", [0, 10], [("a", [0, 4])])
    assert re.search(r'points="44,156 330,10"', text)
    assert "a ends at 4" in text


def test_areas_stand_on_one_another() -> None:
    text = areas("t", [0, 10], [("a", [4, 2]), ("b", [0, 2])])
    assert re.findall(r'points="([^"]*)"', text) == ["44,10 330,83 330,156 44,156", "44,10 330,10 330,83 44,10"]


def test_of_many_frames_the_slowest_of_each_few_is_drawn() -> None:
    values = [1.0] * 2000
    values[777] = 8.0
    points = re.findall(r'points="([^"]*)"', areas("t", range(2000), [("a", values)]))[0].split()
    assert len(points) == 2 * 250  # eight frames each
    assert sum(point.endswith(",10") for point in points) == 1


@pytest.mark.parametrize(
    "plot", [bars("t", []), dots("t", []), histogram("t", [], 0, 1), lines("t", [], [("a", [])]), areas("t", [], [])]
)
def test_plots_of_nothing_are_empty(plot: str) -> None:
    assert "<svg" in plot


# --- the map for the scene -------------------------------------------------------------------------------------------


def test_a_face_is_open_where_no_voxel_of_the_same_instance_lies_behind_it() -> None:
    scene = cubes.scene(row_map())
    cells = cells_of(scene)
    assert (scene["low"], scene["ids"], scene["joined"]) == ([5, 0, 0], [3, 8], 1)
    assert cells["x"].tolist() == [0, 1, 2, 3]
    assert cells["place"].tolist() == [0, 1, 1, 2]
    assert cells["faces"].tolist() == [0b111111, 0b111101, 0b111110, 0b111111]


def test_a_voxel_among_its_own_is_left_out() -> None:
    index = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), -1).reshape(-1, 3)
    assert len(cells_of(cubes.scene(labelled_map(index, np.ones(27, np.int32))))) == 26


def test_a_large_map_is_joined_eight_to_one_and_keeps_its_instances(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cubes, "MOST_CELLS", 2)
    scene = cubes.scene(row_map())  # cells 5 | 6 7 | 8 become 2 | 3 | 4, then 1 1 | 2
    cells = cells_of(scene)
    assert (scene["joined"], scene["size"]) == (4, pytest.approx(0.16))
    assert cells["place"].tolist() == [1, 2]


def test_an_empty_map_has_a_page(tmp_path: Path) -> None:
    empty = labelled_map(np.zeros((0, 3), np.int32), np.zeros(0, np.int32))
    write_map(tmp_path / "a.map.npz", empty)
    assert report(tmp_path / "a.map.npz", None, tmp_path / "a.html").instances == 0


# --- what a trace tells ----------------------------------------------------------------------------------------------


def test_a_run_is_counted_frame_by_frame(made: Path) -> None:
    run = counted(told_run(made / "tiny.trace.mcap").frames)
    result = read_map(made / "tiny.map.npz")
    assert run.frames == [0, 1, 2, 3, 4, 5]
    assert run.voxels[-1] == len(result.voxel_index)
    assert sum(run.rules.values()) == sum(run.masks)
    assert run.rules["new"] == run.events["new"]
    assert run.instances[-1] >= len(result.instances)
    assert len(run.above_second) <= len(run.above_threshold) <= sum(run.masks)


def test_a_resumed_run_does_not_grow_from_nothing(made: Path, tmp_path: Path) -> None:
    sets = ["map.voxel_size=0.1", "masks.min_pixels=1", "finish.min_voxels=1"]
    half = replay(made / "tiny.mcap", assignments=sets, end=4, out=str(tmp_path / "half"))
    replay(made / "tiny.mcap", assignments=sets, resume=Path(half["outputs"]["map"]), out=str(tmp_path / "rest"))
    told, result = told_run(tmp_path / "rest.trace.mcap").frames, read_map(tmp_path / "rest.map.npz")
    whole = counted(told_run(Path(half["outputs"]["trace"])).frames)
    run = counted(told, confirmed_before(told, result))
    assert (run.frames[0], run.instances[0]) == (4, whole.instances[-1])
    assert run.confirmed[0] == whole.confirmed[-1] > 0
    assert confirmed_before(told_run(Path(half["outputs"]["trace"])).frames, result) == set()


# --- the report ------------------------------------------------------------------------------------------------------


def test_a_report_shows_every_instance_with_a_picture_and_its_caption(made: Path, tmp_path: Path) -> None:
    found = report(made / "tiny.map.npz", None, tmp_path / "a.html")
    text = (tmp_path / "a.html").read_text("utf-8")
    result = read_map(made / "tiny.map.npz")
    assert found.instances == len(result.instances) == text.count("<tr data-select=")
    assert (found.trace, found.recording) == (made / "tiny.trace.mcap", made / "tiny.mcap")
    assert found.notes == ()
    assert found.bytes == (tmp_path / "a.html").stat().st_size
    assert text.count('class="crops"') == len(result.instances)
    for part in ("Decisions by rule", "Growth", "Parameters", *result.meta["digests"].values()):
        assert part in text
    assert all(summary.caption in text for summary in result.instances)


def test_every_heading_can_be_reached_from_the_top(made: Path, tmp_path: Path) -> None:
    report(made / "tiny.map.npz", made / "tiny.trace.mcap", tmp_path / "a.html")
    text = (tmp_path / "a.html").read_text("utf-8")
    headings = re.findall(r'<h2 id="(part-\d+)">(.*?)</h2>', text)
    assert len(headings) > 4
    assert "<h2>" not in text
    assert re.findall(r'<a href="#(part-\d+)">(.*?)</a>', text) == headings


def test_times_beside_the_trace_are_drawn_with_median_and_95_percent(made: Path, tmp_path: Path) -> None:
    shutil.copytree(made, tmp_path / "run")
    trace, page = tmp_path / "run" / "tiny.trace.mcap", tmp_path / "a.html"
    stages = {"masks": [1.0] * 6, "evolve": [None, 2.0, 2.0, 2.0, 2.0, 7.0], "trace": [0.5] * 6}
    write_times(times_path(trace), Times(trace_info(trace).digest, range(6), stages))
    report(tmp_path / "run" / "tiny.map.npz", None, page)
    rows = re.findall(r'<tr><th scope="row">([^<]*)</th>(.*?)</tr>', page.read_text("utf-8"))
    figures = {name: re.findall(r">([\d.]+)</td>", cells) for name, cells in rows}
    assert figures["masks"] == ["1.00", "1.00", "1.00", "0"]
    assert figures["trace"] == ["0.50", "0.50", "0.50", "0"]


@pytest.mark.parametrize("left", ["none", "broken", "of another run"])
def test_without_its_times_the_page_says_how_to_get_them(made: Path, tmp_path: Path, left: str) -> None:
    shutil.copytree(made, tmp_path / "run")
    times = tmp_path / "run" / "tiny.times.json"
    if left == "none":
        times.unlink()
    elif left == "broken":
        times.write_text("{")
    else:
        write_times(times, Times("ab", [0], {"masks": [1.0]}))
    report(tmp_path / "run" / "tiny.map.npz", None, tmp_path / "a.html")
    assert "replay and live write them to tiny.times.json" in (tmp_path / "a.html").read_text("utf-8")


def test_decisions_most_likely_wrong_are_listed_with_a_way_to_their_instance() -> None:
    one = {"frame": 4, "mask": 2, "instance": 3, "score": 0.5, "reason": HOSTILE, "caption": "a cup"}
    text = "".join(first_look({"rule": "score = a x b", "decisions": [one, {**one, "instance": 9}]}, {3}))
    assert text.count("<tr>") == 3  # with the headings
    assert re.findall(r'href="([^"]*)"', text) == ["#instance-3"]  # 9 has no row
    assert "Score = a x b." in text
    assert HOSTILE not in text
    assert first_look({"rule": "", "decisions": []}, {3}) == []


def test_the_same_files_give_the_same_bytes(made: Path, tmp_path: Path) -> None:
    for name in ("a.html", "b.html"):
        report(made / "tiny.map.npz", made / "tiny.trace.mcap", tmp_path / name)
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()


def test_without_trace_and_recording_the_page_says_what_is_missing(tmp_path: Path) -> None:
    write_map(tmp_path / "a.map.npz", small_map())
    found = report(tmp_path / "a.map.npz", None, tmp_path / "a.html")
    text = (tmp_path / "a.html").read_text("utf-8")
    assert [note[:10] for note in found.notes] == ["No statist", "No picture"]
    assert all(note in text for note in found.notes)
    assert "ein grüner Stuhl" in text


def test_another_recording_is_not_taken_by_itself_and_refused_when_named(made: Path, tmp_path: Path) -> None:
    write_map(tmp_path / "a.map.npz", replace(small_map(), meta={**small_map().meta, "recording": "tiny.mcap"}))
    (tmp_path / "tiny.mcap").write_bytes((made / "tiny.mcap").read_bytes())
    assert report(tmp_path / "a.map.npz", None, tmp_path / "a.html").recording is None
    with pytest.raises(InputError, match=r"tiny\.mcap is not the recording of"):
        report(tmp_path / "a.map.npz", None, tmp_path / "a.html", recording=tmp_path / "tiny.mcap")


def test_a_trace_of_another_run_is_refused(made: Path, tmp_path: Path) -> None:
    write_map(tmp_path / "a.map.npz", small_map())
    with pytest.raises(InputError, match=r"tiny\.trace\.mcap is of another run"):
        report(tmp_path / "a.map.npz", made / "tiny.trace.mcap", tmp_path / "a.html")
    assert not (tmp_path / "a.html").exists()


def test_only_a_web_page_is_ever_written(made: Path) -> None:
    trace = made / "tiny.trace.mcap"
    before = trace.read_bytes()
    with pytest.raises(OutputError, match=r"end with \.html"):
        report(made / "tiny.map.npz", None, trace)
    assert trace.read_bytes() == before


def test_what_is_no_map_is_refused(made: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a recording; a report begins with a map"):
        report(made / "tiny.mcap", None, tmp_path / "a.html")


def test_a_map_of_a_newer_format_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("openvox.formats.map_npz.FORMAT_VERSION", 2)
    write_map(tmp_path / "a.map.npz", small_map())
    monkeypatch.undo()
    with pytest.raises(InputError, match="use a newer openvox"):
        report(tmp_path / "a.map.npz", None, tmp_path / "a.html")


def test_a_page_that_cannot_be_written_is_a_sentence_and_an_older_one_is_replaced(tmp_path: Path) -> None:
    write_map(tmp_path / "a.map.npz", small_map())
    with pytest.raises(OutputError, match="could not be written"):
        report(tmp_path / "a.map.npz", None, tmp_path / "none" / "a.html")
    assert not report(tmp_path / "a.map.npz", None, tmp_path / "a.html").replaced
    assert report(tmp_path / "a.map.npz", None, tmp_path / "a.html").replaced


# --- two maps, and a sweep -------------------------------------------------------------------------------------------


def pair_of_maps(folder: Path) -> tuple[Path, Path]:
    """A: 1 on cells 0 to 3, 2 on 6 and 7, 3 on 9. B: 4 and 5 share A's 1, 6 is A's 2 renamed, 7 is new on 20."""

    def along(cells: dict[int, int]) -> NDArray[np.int32]:
        return np.array([[x, 0, 0] for x in cells], np.int32)

    one = {0: 1, 1: 1, 2: 1, 3: 1, 4: 1, 6: 2, 7: 2, 9: 3}
    other = {0: 4, 1: 4, 2: 4, 3: 5, 4: 5, 6: 6, 7: 6, 9: 0, 20: 7}
    paths = (folder / "a.map.npz", folder / "b.map.npz")
    for path, cells, captions in zip(paths, (one, other), ({2: "cup"}, {6: HOSTILE}), strict=True):
        write_map(path, labelled_map(along(cells), np.array(list(cells.values()), np.int32), captions=captions))
    return paths


def test_two_maps_show_what_became_of_each_instance(tmp_path: Path) -> None:
    a, b = pair_of_maps(tmp_path)
    assert report(a, b, tmp_path / "both.html").kind == "maps"
    text = (tmp_path / "both.html").read_text("utf-8")
    rows = re.findall(r'<tr data-select="([^"]*)".*?</svg>(\w+)</button>', text)
    assert rows == [
        ("[[1], [4, 5]]", "split"),
        ("[[3], []]", "vanished"),
        ("[[], [7]]", "appeared"),
        ("[[2], [6]]", "renamed"),
    ]
    colors = [scene["palettes"][0] for scene in data_of(text)["maps"]]
    assert [palette["name"] for palette in colors] == ["difference", "difference"]
    assert [len(palette["colors"]) for palette in colors] == [3, 4]
    foot = text[text.index("<footer>") :]
    assert all(f"<code>{map_digest(read_map(path))[:16]}</code>" in foot for path in (a, b))
    assert HOSTILE not in text


def small_sweep(folder: Path, **changes: Any) -> Path:
    """A sweep of one recording with two thresholds, as sweep.json says it; the second run failed."""
    done = {"recording": "tiny", "status": "done", "error": None, "first_outcome": None}
    done |= {"digests": {"map": "ab" * 32}, "set": 0, "default": True, "parameters": {"association.threshold": 0.4}}
    failed = {**done, "status": "failed", "error": HOSTILE, "digests": {"map": None}, "set": 1, "default": False}
    figures = {"instances": 3.0, "voxels": 12345.0, "seconds": 1.5, "failed": 0, "scores": {"ap": 0.25}}
    means = [{"value": 0.4, "mean": 0.25, "items": 1}, {"value": 0.5, "mean": None, "items": 0}]
    content = {
        "format_version": 1,
        "preset": "openvox",
        "engine": "cpu",
        "fixed": [],
        "failed": 1,
        "measure": "ap",
        "varied": {"association.threshold": [0.4, 0.5]},
        "recordings": [{"name": "tiny", "digests": {"recording": "cd" * 32}}],
        "items": [done, failed],
        "sets": [
            {"set": 0, "parameters": {"association.threshold": 0.4}, "default": True, **figures},
            {"set": 1, "parameters": {"association.threshold": 0.5}, "default": False, **dict.fromkeys(figures)},
        ],
        "effects": [{"parameter": "association.threshold", "measure": "ap", "means": means, "range": 0.0}],
        "best": {"set": 0, "parameters": {"association.threshold": 0.4}, "score": 0.25, "default_score": 0.25},
    }
    folder.mkdir(exist_ok=True)
    (folder / "sweep.json").write_text(json.dumps({**content, **changes}))
    return folder


def test_a_sweep_shows_its_best_set_every_set_and_what_failed(tmp_path: Path) -> None:
    assert report(small_sweep(tmp_path / "s"), None, tmp_path / "s.html").kind == "sweep"
    text = (tmp_path / "s.html").read_text("utf-8")
    for part in (
        "The best set",
        "association.threshold = 0.4",
        "association.threshold: ap",
        "What failed",
        "abababababab",
    ):
        assert part in text
    assert HOSTILE not in text


def test_sets_stand_by_rank_and_ties_are_told(tmp_path: Path) -> None:
    made = json.loads((small_sweep(tmp_path / "s") / "sweep.json").read_text())
    one, other = made["sets"]
    ranked = [{**one, "scores": {"ap": 0.2}}, {**other, **one, "set": 7, "scores": {"ap": 0.2004}, "default": False}]
    best = {**made["best"], "set": 7, "score": 0.2004, "ties": [0]}
    report(small_sweep(tmp_path / "s", sets=ranked, best=best), None, tmp_path / "s.html")
    text = (tmp_path / "s.html").read_text("utf-8")
    assert "1 more, less than 0.001 behind, as good: set 0." in text
    rows = re.findall(r'data-value="(\d)">\d(?: default)?</td>', text)
    assert rows[:2] == ["7", "0"]


def test_a_sweep_without_truth_has_no_best_set(tmp_path: Path) -> None:
    report(small_sweep(tmp_path / "s", best=None, measure=None, effects=[]), None, tmp_path / "s.html")
    assert "Without ground truth" in (tmp_path / "s.html").read_text("utf-8")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("{", "is no JSON"),
        ("[]", "no format version"),
        ('{"format_version": 2}', "use a newer openvox"),
        ('{"format_version": 1}', "not as a sweep writes it"),
    ],
)
def test_what_is_no_sweep_is_a_sentence(tmp_path: Path, text: str, sentence: str) -> None:
    with pytest.raises(InputError, match=r"holds no sweep\.json"):
        report(tmp_path, None, tmp_path / "s.html")
    (tmp_path / "sweep.json").write_text(text)
    with pytest.raises(InputError, match=sentence):
        report(tmp_path, None, tmp_path / "s.html")


# --- in a browser ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    if browser_path() is None:
        pytest.skip("no chromium, chromium-browser or google-chrome on PATH")
    with opened(tmp_path_factory.mktemp("profile")) as found:
        yield found


@pytest.fixture
def shown(browser: Browser, tmp_path: Path) -> Browser:
    """The page of three blocks on a floor, the middle one with a hostile caption."""
    index = np.stack(np.meshgrid(np.arange(30), np.arange(10), np.arange(4), indexing="ij"), -1).reshape(-1, 3)
    x, y, z = index.T
    label = np.where((z > 0) & (y > 2) & (y < 8) & (x % 10 > 2) & (x % 10 < 8), 1 + x // 10, 0)
    kept = (z == 0) | (label > 0)
    captions = {1: "zebra", 2: HOSTILE, 3: "apple"}
    result = labelled_map(
        index[kept], label[kept].astype(np.int32), captions=captions, confidence={1: 0.5, 2: 0.9, 3: 0.1}
    )
    write_map(tmp_path / "hostile.map.npz", result)
    report(tmp_path / "hostile.map.npz", None, tmp_path / "hostile.html")
    browser.messages.clear()
    browser.requests.clear()
    browser.open(tmp_path / "hostile.html")
    return browser


ORDER = "[...document.querySelectorAll('tr[data-select]')].filter(r => !r.hidden).map(r => r.dataset.select)"
CHOSEN = "document.querySelector('tr[aria-selected=true]')?.dataset.select ?? null"


def test_a_page_loads_without_a_complaint_and_asks_for_nothing(shown: Browser) -> None:
    assert shown.messages == []
    assert [url[:5] for url in shown.requests if not url.startswith("data:")] == ["file:"]
    assert shown.ask("document.title") == "hostile \u2013 openvox"
    assert HOSTILE.replace("\u202e", "?") in shown.ask("document.body.textContent")


def test_rows_are_sorted_by_their_headings(shown: Browser) -> None:
    def press(title: str) -> Any:
        shown.ask(f"[...document.querySelectorAll('th button')].find(b => b.textContent === '{title}').click()")
        return shown.ask(ORDER)

    assert press("Confidence") == ["[[2]]", "[[1]]", "[[3]]"]
    assert press("Confidence") == ["[[3]]", "[[1]]", "[[2]]"]
    assert press("Caption") == ["[[2]]", "[[3]]", "[[1]]"]
    assert shown.ask("document.querySelector('th[aria-sort]').textContent") == "Caption"


def test_rows_are_searched_by_every_word(shown: Browser) -> None:
    field = "document.querySelector('input[type=search]')"
    type_in = f"(t => {{ {field}.value = t; {field}.dispatchEvent(new Event('input')) }})"
    shown.ask(f"{type_in}('ZEB 1')")
    assert shown.ask(ORDER) == ["[[1]]"]
    assert shown.ask("document.querySelector('output').textContent") == "1 of 3"
    shown.ask(f"{type_in}('')")
    assert len(shown.ask(ORDER)) == 3


def drawn(browser: Browser) -> None:
    """Skip where the browser has no WebGL 2; then the page must say so."""
    if browser.ask("document.getElementById('scenes').dataset.state") != "drawn":
        assert browser.ask("document.getElementById('no-scene').hidden") is False
        pytest.skip("the browser has no WebGL 2")


def middle(browser: Browser) -> tuple[float, float]:
    x, y = browser.ask(
        "(r => [r.x + r.width / 2, r.y + r.height / 2])(document.querySelector('canvas').getBoundingClientRect())"
    )
    return x, y


def test_the_map_is_turned_by_dragging_and_by_keys(shown: Browser) -> None:
    drawn(shown)
    x, y = middle(shown)
    before = shown.screenshot()
    shown.drag((x, y), (x + 80, y + 20))
    turned = shown.screenshot()
    assert turned != before
    assert shown.ask(CHOSEN) is None, "dragging chooses nothing"
    shown.ask("document.querySelector('canvas').dispatchEvent(new KeyboardEvent('keydown', {key: 'Home'}))")
    shown.settle()
    assert shown.screenshot() != turned


def test_a_click_on_a_thing_chooses_its_row_and_a_click_beside_it_none(shown: Browser) -> None:
    drawn(shown)
    shown.ask("document.querySelector('button[data-do=above]').click()")
    shown.settle()
    shown.drag(middle(shown), middle(shown))
    assert shown.ask(CHOSEN) == "[[2]]"
    corner = shown.ask("(r => [r.x + 8, r.y + 8])(document.querySelector('canvas').getBoundingClientRect())")
    shown.drag(tuple(corner), tuple(corner))
    assert shown.ask(CHOSEN) is None


def test_the_link_of_a_decision_chooses_the_row_of_its_instance(browser: Browser, made: Path, tmp_path: Path) -> None:
    report(made / "tiny.map.npz", None, tmp_path / "a.html")
    text = (tmp_path / "a.html").read_text("utf-8")
    link = '<a class="suspect" href="#instance-1">1</a></main>'  # this run has no decision to suspect
    (tmp_path / "a.html").write_text(text.replace("</main>", link), "utf-8")
    browser.open(tmp_path / "a.html")
    browser.ask("document.querySelector('a.suspect').click()")
    browser.settle()
    assert browser.ask("document.querySelector('tr[aria-selected=true]').id") == "instance-1"


def test_a_row_shows_its_thing_and_says_its_name(shown: Browser) -> None:
    drawn(shown)
    before = shown.screenshot()
    shown.ask("document.querySelector('tr[data-select=\"[[3]]\"] button').click()")
    shown.settle()
    assert shown.ask(CHOSEN) == "[[3]]"
    assert shown.ask("document.getElementById('status').textContent") == "3: apple"
    assert shown.screenshot() != before


def test_without_webgl_the_page_says_so_and_the_rest_works(shown: Browser, tmp_path: Path) -> None:
    block = "HTMLCanvasElement.prototype.getContext = () => null"
    script = shown.call("Page.addScriptToEvaluateOnNewDocument", source=block)["identifier"]
    shown.open(tmp_path / "hostile.html")
    shown.call("Page.removeScriptToEvaluateOnNewDocument", identifier=script)
    assert shown.ask("document.getElementById('no-scene').hidden") is False
    assert "WebGL" in shown.ask("document.getElementById('no-scene').textContent")
    assert shown.ask("getComputedStyle(document.getElementById('status')).display") == "none"  # nothing is to be turned
    shown.ask("document.querySelector('tr[data-select=\"[[3]]\"] button').click()")
    assert shown.ask(CHOSEN) == "[[3]]"
    assert shown.messages == []


@pytest.mark.parametrize("width", [360, 1280])
def test_a_page_is_never_wider_than_its_window(shown: Browser, tmp_path: Path, width: int) -> None:
    shown.open(tmp_path / "hostile.html", width=width, height=740, touch=width < 700)
    assert shown.ask("document.documentElement.scrollWidth <= innerWidth")


def test_everything_that_can_be_used_has_a_name(shown: Browser) -> None:
    nameless = (
        "[...document.querySelectorAll('button, select, input, canvas, img, svg[role=img]')].filter(e => !("
        "e.textContent.trim() && e.matches('button') || e.ariaLabel || e.alt || e.labels?.length)).length"
    )
    assert shown.ask(nameless) == 0


def test_two_maps_turn_together_and_a_row_shows_its_thing_in_both(browser: Browser, tmp_path: Path) -> None:
    a, b = pair_of_maps(tmp_path)
    report(a, b, tmp_path / "both.html")
    browser.messages.clear()
    browser.open(tmp_path / "both.html")
    assert browser.messages == []
    drawn(browser)
    browser.ask("document.querySelector('tr[data-select] button').click()")
    assert browser.ask("JSON.stringify(scenes.map(s => [...s.selected].map(p => s.map.ids[p - 1])))") == "[[1],[4,5]]"
    before = browser.screenshot()
    x, y = middle(browser)
    browser.drag((x, y), (x + 60, y))
    assert browser.screenshot() != before


def test_the_page_of_a_sweep_loads_and_sorts(browser: Browser, tmp_path: Path) -> None:
    report(small_sweep(tmp_path / "s"), None, tmp_path / "s.html")
    browser.messages.clear()
    browser.open(tmp_path / "s.html", width=360, height=740)
    assert browser.messages == []
    browser.ask("[...document.querySelectorAll('#sets th button')].find(b => b.textContent === 'ap').click()")
    assert browser.ask("document.querySelector('#sets tbody tr td').dataset.value") == "0"
    assert browser.ask("document.documentElement.scrollWidth <= innerWidth")
