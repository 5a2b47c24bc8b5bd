"""The command line: exit codes, one sentence for an error, nothing but JSON on stdout with --json."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest
from maps import labelled_map
from worlds import tiny_frames, write_scannet

from openvox import __version__
from openvox.apps.pictures import pictures
from openvox.cli import commands, main, options, progress, tables
from openvox.cli.commands import ingest, query, replay
from openvox.core.errors import InputError
from openvox.core.mapper_parameters import PRESETS
from openvox.formats.map_npz import write_map
from openvox.perception.encoder import encoder
from openvox.sources import FORMATS


def run(*words: str | Path) -> int:
    """The exit code of a command run in this process."""
    with pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    assert isinstance(end.value.code, int)
    return end.value.code


@pytest.mark.parametrize(
    "words",
    [
        ["no-such-command"],
        ["ingest", "only-a-source"],
        ["ingest", "a", "b.mcap", "--format", "kinect"],
        ["ingest", "a", "b.mcap", "--origin", "1,2"],
        ["ingest", "a", "b.mcap", "--stride", "0"],
        ["ingest", "a", "b.mcap", "--start", "-1"],
        ["perceive"],
        ["perceive", "a.mcap", "b.mcap", "--out", "c.mcap"],
        ["perceive", "a.mcap", "--frontend", "guess"],
        ["replay", "a.mcap", "--engine", "abacus"],
        ["replay", "a.mcap", "--preset", "best"],
        ["explain", "a.trace.mcap"],
        ["info"],
        ["info", "a.mcap", "--parameters"],
        ["query", "a.map.npz"],
    ],
)
def test_wrong_usage_exits_with_2_and_says_so_on_stderr(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(*words) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "Error:" in captured.err


def test_version_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--version") == 0
    assert capsys.readouterr().out == f"openvox {__version__}\n"


def test_an_input_error_is_one_sentence_and_exit_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fail_with(monkeypatch, InputError("living.mcap: no such file; make it with openvox ingest"))
    assert run("anything") == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == "openvox: living.mcap: no such file; make it with openvox ingest\n"


def test_an_error_of_the_system_names_the_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fail_with(monkeypatch, PermissionError(13, "Permission denied", "/locked"))
    assert run("anything") == 1
    assert capsys.readouterr().err == "openvox: /locked: Permission denied\n"


def test_a_fault_of_our_own_is_named_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    fail_with(monkeypatch, KeyError("surprise"))
    assert run("anything") == 1
    error = capsys.readouterr().err
    assert "KeyError" in error
    assert "--debug" in error
    assert "Traceback" not in error


@pytest.mark.parametrize("words", [["--debug", "anything"], ["anything", "--debug"]])
def test_debug_lets_the_traceback_through(monkeypatch: pytest.MonkeyPatch, words: list[str]) -> None:
    fail_with(monkeypatch, InputError("wrong"))
    with pytest.raises(InputError, match="wrong"):
        main(words)


def fail_with(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    def fail(words: list[str], prog_name: str) -> None:
        assert "--debug" not in words
        raise error

    monkeypatch.setattr("openvox.cli.commands.app", fail)


def test_a_reader_that_has_gone_is_no_error() -> None:
    command = f"{sys.executable} -m openvox --help; echo $? >&2"
    result = subprocess.run(
        ["bash", "-c", f"({command}) | true"], capture_output=True, text=True, check=False, timeout=60
    )
    assert result.stderr in ("0\n", "1\n")


def test_results_become_plain_json() -> None:
    value = {1: (Path("a/b"), float("nan"), float("inf"), 0.5, None), "flag": True}
    assert json.dumps(tables.plain(value), allow_nan=False) == '{"1": ["a/b", null, null, 0.5, null], "flag": true}'


def test_json_stands_alone_on_stdout_and_a_table_names_the_next_step(capsys: pytest.CaptureFixture[str]) -> None:
    tables.show({"frames": 3}, True, tables.pairs, "openvox", "info", "my file")
    assert json.loads(capsys.readouterr().out) == {"frames": 3}
    tables.show({"frames": 3}, False, tables.pairs, "openvox", "info", Path("my file"))
    assert capsys.readouterr().out == "frames  3\nnext: openvox info 'my file'\n"


def test_a_caption_cannot_steer_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    answer = {"instance": 1, "caption": "a \x1b[2Jchair [red]", "score": 0.5, "center": [0.0, 0.0, 0.0], "voxels": 7}
    query.print_result({"queries": [{"text": "seat", "found": True, "answers": [answer]}]})
    out = capsys.readouterr().out
    assert "a ?[2Jchair [red]" in out
    assert "\x1b[2J" not in out


def test_origin_is_three_whole_metres() -> None:
    assert options.origin("455200,-5411900,0") == (455200, -5411900, 0)


def test_progress_keeps_quiet_where_nobody_watches() -> None:
    assert progress.progress("mapping") is None  # stderr is captured here, so no terminal


def test_progress_line_tells_rate_and_time_left() -> None:
    assert progress.line("mapping", 40, 180, 0.5) == "mapping  40/180 frames  80.0/s  2 s left"
    assert progress.line("mapping", 40, 0, 0.5) == "mapping  40 frames  80.0/s"


def test_progress_on_a_terminal_is_wiped_at_the_end(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    show = progress.progress("mapping")
    assert show is not None
    show(1, 2)
    show(2, 2)
    error = capsys.readouterr().err
    assert "mapping  1/2 frames" in error
    assert error.endswith("\r\x1b[K")


def test_ingest_tells_what_it_recorded_and_what_comes_next(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write_scannet(tmp_path / "scene", tiny_frames(3))
    (scene / "pose" / "000001.txt").write_text("-inf " * 16)
    recording = tmp_path / "tiny.mcap"
    assert run("ingest", scene, recording) == 0
    captured = capsys.readouterr()
    assert captured.out.startswith("2 frames, numbers 0 to 2, ")
    assert "left out: 1 frames (pose is not finite)" in captured.out
    assert captured.out.endswith(f"wrote {recording}\nnext: openvox perceive {recording}\n")
    assert captured.err == ""
    assert run("ingest", scene, recording) == 0
    assert "an older file of that name was replaced" in capsys.readouterr().out


def test_ingest_with_json_says_the_same_to_a_program(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write_scannet(tmp_path / "scene", tiny_frames(3))
    assert run("ingest", scene, tmp_path / "tiny.mcap", "--json", "--stride", "2") == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["frames"], result["first"], result["last"]) == (2, 0, 2)
    assert result["replaced"] is False


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tiny recording with ground truth."""
    folder = tmp_path_factory.mktemp("cli")
    assert run("ingest", write_scannet(folder / "scene", tiny_frames(4)), folder / "tiny.mcap") == 0
    return folder / "tiny.mcap"


def test_perceive_tells_what_it_found(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    out = tmp_path / "own.perception.mcap"
    words = ("perceive", recording, "--frontend", "oracle", "--set", "oracle.min_pixels=1", "--out", out)
    assert run(*words) == 0
    said = capsys.readouterr().out
    assert said.startswith("4 frames looked at, ")
    assert said.endswith(f"wrote {out}\nnext: openvox replay {recording} --perception {out}\n")
    assert run(*words, "--json") == 0
    again = json.loads(capsys.readouterr().out)
    assert (again["frames"], again["reused"], again["output"]) == (4, 4, str(out))


def test_of_several_recordings_one_that_fails_does_not_stop_the_others(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good, missing = tmp_path / "good.mcap", tmp_path / "missing.mcap"
    good.write_bytes(recording.read_bytes())
    capsys.readouterr()
    assert run("perceive", missing, good, "--frontend", "oracle", "--json") == 3
    captured = capsys.readouterr()
    first, second = json.loads(captured.out)["recordings"]
    assert first == {"recording": str(missing), "error": f"there is no file {missing}"}
    assert second["frames"] == 4
    assert run("perceive", missing, good, "--frontend", "oracle") == 3
    assert capsys.readouterr().err == f"openvox: there is no file {missing}\n"


def test_an_unknown_parameter_names_the_nearest(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert run("perceive", recording, "--set", "geometry.mln_pixels=3") == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "did you mean geometry.min_pixels?" in captured.err
    assert captured.err.count("\n") == 1


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    """A map of two voxels, a chair and a cup, with features of the bundled encoder."""
    words = encoder("minilm").encode(["a chair", "a cup"])
    index = np.array([[0, 0, 0], [5, 0, 0]], np.int32)
    result = labelled_map(
        index,
        np.array([1, 2], np.int32),
        captions={1: "a chair", 2: "a cup"},
        features={1: words[0], 2: words[1]},
        meta={"encoder": "minilm"},
    )
    write_map(tmp_path / "two.map.npz", result)
    return tmp_path / "two.map.npz"


def test_query_answers_each_text_best_first(map_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("query", map_file, "somewhere to sit", "something to drink from", "--json") == 0
    sit, drink = json.loads(capsys.readouterr().out)["queries"]
    assert [answer["caption"] for answer in sit["answers"]] == ["a chair", "a cup"]
    assert [answer["caption"] for answer in drink["answers"]] == ["a cup", "a chair"]
    assert run("query", map_file, "somewhere to sit", "--top", "1") == 0
    out = capsys.readouterr().out
    assert "'somewhere to sit'" in out
    assert "a chair" in out
    assert "a cup" not in out


def test_export_says_what_it_wrote(map_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = map_file.with_name("two.csv")
    assert run("export", map_file, out) == 0
    assert capsys.readouterr().out == f"2 instances, 2 voxels\nwrote {out}\n"
    assert run("export", map_file, out.with_suffix(".obj")) == 1
    assert capsys.readouterr().err.startswith(f"openvox: {out.with_suffix('.obj')} ends in .obj; expected ")


def test_info_lists_every_parameter_with_its_reason(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("info", "--parameters") == 0
    out = capsys.readouterr().out
    assert "openvox replay --set" in out
    assert "association.threshold" in out
    assert "geometry.min_pixels" in out
    assert run("info", "--parameters", "--json") == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["parameters"]}
    assert rows["masks.min_pixels"]["range"] == "0 .. 1000000"


def test_info_tells_the_kind_of_a_file(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert run("info", recording) == 0
    assert capsys.readouterr().out.startswith("kind             recording\n")
    assert run("info", __file__) == 1
    assert "expected a recording, perception or trace (MCAP), or a map (npz)" in capsys.readouterr().err


@pytest.fixture(scope="module")
def replayed(recording: Path) -> Path:
    """The recording's map, made of its own ground truth; the trace lies beside it."""
    words = ("perceive", recording, "--frontend", "oracle", "--set", "oracle.min_pixels=1")
    assert run(*words) == 0
    assert run("replay", recording, "--set", "masks.min_pixels=0", "--set", "finish.min_voxels=1") == 0
    return recording.with_name("tiny.map.npz")


def test_replay_tells_speed_rules_digests_and_files(
    replayed: Path, recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert run("replay", recording, "--out", tmp_path / "again", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["frames"] == 4
    assert set(result["ms"]) == {"decode", "masks", "project", "associate", "evolve", "trace"}
    assert result["outputs"] == {
        "map": str(tmp_path / "again.map.npz"),
        "trace": str(tmp_path / "again.trace.mcap"),
        "times": str(tmp_path / "again.times.json"),
        "rerun": None,
    }
    assert run("replay", recording, "--out", tmp_path / "again") == 0
    out = capsys.readouterr().out
    assert out.startswith("4 frames in ")
    assert f"map digest {result['digests']['map']}" in out
    assert f"wrote {tmp_path / 'again.trace.mcap'}" in out


def test_explain_shows_each_mask_of_a_frame(replayed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    trace = replayed.with_name("tiny.trace.mcap")
    assert run("explain", trace, "--frame", "2", "--json") == 0
    decisions = json.loads(capsys.readouterr().out)["decisions"]
    assert run("explain", trace, "--frame", "2") == 0
    out = capsys.readouterr().out
    assert out.startswith(f"frame 2: {len(decisions)} masks\n")
    assert all(decision["caption"] in out for decision in decisions)
    assert run("explain", trace, "--frame", "9") == 1
    assert "frame 9 was not mapped" in capsys.readouterr().err


def test_evaluate_names_its_scores(replayed: Path, recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert run("evaluate", replayed, "--truth", recording) == 0
    out = capsys.readouterr().out
    assert "instances_in_voxel" in out
    assert "predicted " in out


def test_pictures_are_drawn_of_the_map_and_of_a_frame(replayed: Path, tmp_path: Path) -> None:
    drawn = pictures(replayed, 2, tmp_path)
    assert drawn == {"map": str(tmp_path / "map.png"), "frame": str(tmp_path / "frame.png")}
    assert all(Path(path).read_bytes().startswith(b"\x89PNG") for path in drawn.values())
    with pytest.raises(InputError, match="frame 9 was not mapped"):
        pictures(replayed, 9, tmp_path)


def test_the_choices_of_an_option_are_those_there_are() -> None:
    assert get_args(get_type_hints(replay.replay)["preset"]) == tuple(PRESETS)
    assert get_args(get_type_hints(ingest.ingest)["layout"]) == ("auto", *FORMATS)


def test_an_interrupt_inside_a_kernel_is_an_interrupt(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from openvox.cli import INTERRUPTED, main

    def interrupted(*arguments: object, **options: object) -> None:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as interrupt:
            raise SystemError("returned a result with an exception set") from interrupt

    monkeypatch.setattr(commands, "app", interrupted)
    with pytest.raises(SystemExit) as end:
        main(["replay", "x"])
    assert end.value.code == INTERRUPTED
    assert capsys.readouterr().err == "openvox: interrupted; nothing was written\n"
    with pytest.raises(SystemExit):
        main(["sweep", "x"])
    assert capsys.readouterr().err == "openvox: interrupted; what is done is kept; run again to go on\n"


def test_a_reader_that_goes_in_the_middle_of_much_output_is_no_error() -> None:
    program = "import typer, openvox.cli.commands as commands; from openvox.cli import main\n"
    program += "commands.app = typer.Typer(); commands.app.command()(lambda: print('x' * 10**7)); main([])"
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.read(10)
    process.stdout.close()
    assert (process.wait(60), process.stderr.read()) == (0, b"")
    process.stderr.close()
