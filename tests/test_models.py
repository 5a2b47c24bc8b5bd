"""perceive --models: a TOML file puts Det, SegCap and Enc together; what is wrong with it is a sentence."""

from __future__ import annotations

import re
from math import ceil, floor
from pathlib import Path
from typing import Any

import graphs
import pytest
from test_perceive import LARGE, count_calls, record
from worlds import tiny_frames

from openvox.apps.perceive import _fruitless, perceive
from openvox.apps.query import query
from openvox.apps.replay import replay
from openvox.core.errors import InputError
from openvox.formats.perception import perception_info, read_masks
from openvox.perception.det.yolo import Yolo
from openvox.perception.segcap.sam import Sam

ALL = """
[det]
stage = "yolo-world"
file = "det.onnx"
words = "words.txt"

[segcap]
stage = "sam"
encoder = "sam.encoder.onnx"
decoder = "sam.decoder.onnx"

[enc]
stage = "sentence-transformers"
folder = "mine"
"""


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return record(tmp_path / "a.mcap", tiny_frames(4, camera=LARGE))


@pytest.fixture
def models(tmp_path: Path) -> Path:
    """A folder with one model of each role, and the TOML file that names them."""
    folder = tmp_path / "models"
    graphs.looking_detector(folder / "det.onnx", words=2)
    (folder / "words.txt").write_text("cup\nchair\n")
    graphs.image_encoder(folder / "sam.encoder.onnx")
    graphs.sam_decoder(folder / "sam.decoder.onnx")
    graphs.sentence_folder(folder / "mine")
    return written(folder, ALL)


def written(folder: Path, text: str) -> Path:
    path = folder / "my.toml"
    path.write_text(text)
    return path


def test_all_three_stages_may_be_the_users(recording, models):
    result = perceive(recording, frontend="models", models=models)
    assert (result.frontend, result.frames, result.encoder, result.device) == ("models", 4, "mine", "on the CPU")
    info = perception_info(result.output)
    assert [(stage["role"], stage["name"]) for stage in info.stages] == [
        ("det", "yolo"),
        ("segcap", "sam"),
        ("enc", "mine"),
    ]
    assert (info.dimensions, info.parameters["det.file"], info.parameters["det.score"]) == (5, "det.onnx", 0.3)
    for found in read_masks(result.output, boxes=True):
        (box,), (mask,) = found.boxes, found.masks
        assert box.label == mask.label == "cup"
        x0, y0, x1, y1 = box.corners  # a pixel is in the mask if its middle is in the box
        assert mask.box == (floor(x0 + 0.5), floor(y0 + 0.5), ceil(x1 - 0.5), ceil(y1 - 0.5))


def test_models_alone_say_which_front_end(recording, models):
    assert perceive(recording, models=models).frontend == "models"


def test_what_the_file_leaves_out_is_as_offline_has_it(recording, tmp_path):
    result = perceive(recording, models=written(tmp_path, ""))
    assert result.digest == perceive(recording, out=tmp_path / "b.mcap").digest
    assert result.digest == perceive(recording, models=written(tmp_path, '[segcap]\nstage = "offline"')).digest


def test_the_users_detector_may_go_with_the_regions_from_depth(recording, models):
    written(models.parent, ALL.partition("[segcap]")[0])
    result = perceive(recording, models=models, assignments=["geometry.far=5", "offline.claim_inside=0.7"])
    stages = perception_info(result.output).stages
    assert [stage["name"] for stage in stages] == ["yolo", "offline", "minilm"]
    assert result.kinds["region"] > 0


def test_the_truth_may_stand_for_a_detector(recording, models):
    written(models.parent, '[det]\nstage = "truth"\n' + ALL[ALL.index("[segcap]") :])
    result = perceive(recording, models=models)
    assert {mask.label for found in read_masks(result.output) for mask in found.masks} == {"table", "box"}


def test_another_encoder_computes_embeddings_only(recording, models, monkeypatch):
    perceive(recording, models=models)
    calls = [count_calls(monkeypatch, kind) for kind in (Yolo, Sam)]
    written(models.parent, ALL.partition("[enc]")[0])
    result = perceive(recording, models=models)
    assert (result.encoder, result.reused, calls) == ("minilm", 0, [[], []])
    written(models.parent, ALL.replace("[segcap]", "score = 0.5\n[segcap]").partition("[enc]")[0])
    perceive(recording, models=models)
    assert [sorted(frames) for frames in calls] == [[0, 1, 2, 3], [0, 1, 2, 3]]


@pytest.mark.parametrize("frontend", ["models", "offline", "geometry", "oracle"])
def test_a_complete_cache_loads_no_model(recording, models, monkeypatch, frontend):
    import onnxruntime

    from openvox.perception.encoder import encoder

    loaded: list[str] = []
    original = onnxruntime.InferenceSession

    def session(file: Path, *rest: Any, **more: Any) -> Any:
        loaded.append(Path(file).name)
        return original(file, *rest, **more)

    monkeypatch.setattr(onnxruntime, "InferenceSession", session)
    options = {"frontend": frontend, "models": models if frontend == "models" else None}
    encoder.cache_clear()
    perceive(recording, **options)
    assert loaded  # every front end has at least an encoder
    loaded.clear()
    encoder.cache_clear()
    assert perceive(recording, **options).untouched
    assert loaded == []


def test_a_changed_encoder_loads_neither_detector_nor_segmenter(recording, models, monkeypatch):
    import onnxruntime

    perceive(recording, models=models)
    loaded: list[str] = []
    original = onnxruntime.InferenceSession
    monkeypatch.setattr(
        onnxruntime,
        "InferenceSession",
        lambda file, *rest, **more: loaded.append(Path(file).name) or original(file, *rest, **more),
    )
    graphs.sentence_folder(models.parent / "other")
    written(models.parent, ALL.replace('"mine"', '"other"'))
    result = perceive(recording, models=models)
    assert (result.encoder, result.computed) == ("other", {"det": 0, "segcap": 0, "enc": 4})
    assert loaded == ["model.onnx"]


def test_the_number_of_workers_changes_no_byte(recording, models):
    outputs = [
        perceive(recording, models=models, jobs=jobs, out=recording.with_name(f"{jobs}.mcap")) for jobs in (1, 3)
    ]
    assert outputs[0].output.read_bytes() == outputs[1].output.read_bytes()


def test_a_model_that_fails_at_a_frame_leaves_nothing_under_the_files_name(recording, models, monkeypatch):
    def fails(self: Any, *_: Any) -> Any:
        raise InputError("det.onnx: the model failed (out of memory)")

    monkeypatch.setattr(Yolo, "__call__", fails)
    with pytest.raises(InputError, match="the model failed"):
        perceive(recording, models=models)
    assert sorted(entry.name for entry in recording.parent.iterdir()) == ["a.mcap", "models"]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('[det]\nstage = "yolo"', r"my.toml: det.file is missing; expected the path of a file"),
        (
            '[det]\nstage = "yolo"\nfile = "x.onnx"',
            r"det.file is 'x.onnx', but .*x.onnx is not a file; paths count from the folder of my.toml",
        ),
        ('[det]\nstage = "yolov8"', r"my.toml: \[det\] stage is 'yolov8'; expected yolo-world, yolo, .* mean yolo\?"),
        ("[det]\nstage = 3", r"\[det\] stage is '3'; expected"),
        (
            '[detector]\nstage = "yolo"',
            r"my.toml: there is no stage \[detector\]; expected \[det\], \[segcap\], \[enc\]",
        ),
        ('[det]\nstage = "yolo"\nscor = 0.2', r"\[det\] yolo: an option is 'scor'; expected file, .* mean score\?"),
        (
            "[det]\nscore = 0.2",
            r"\[det\] nanodet has no options, but 'score' was given; use --set offline.NAME=VALUE",
        ),
        ('[det]\nstage = "none"\nscore = 0.2', r"\[det\] none has no options, but 'score' was given; leave it out"),
        ('[det]\nstage = "yolo"\nscore = 2', r"my.toml: det.score is 2; expected 0 .. 1"),
        ('[det]\nstage = "yolo"\ntop_k = "many"', r"my.toml: det.top_k is 'many'; expected a whole number"),
        ('[enc]\nstage = "sentence-transformers"\nfolder = "no"', r"enc.folder is 'no', but .* is not a folder"),
        ("stage = 3", r"my.toml: 'stage' stands outside a table"),
        ("[det", r"my.toml: cannot be read as TOML"),
    ],
)
def test_what_is_wrong_with_the_file_is_a_sentence(recording, tmp_path, text, sentence):
    with pytest.raises(InputError, match=sentence):
        perceive(recording, models=written(tmp_path, text))
    assert not recording.with_name("a.perception.mcap").exists()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (
            {"models": Path("none.toml")},
            r"none.toml is not there; --models wants a TOML file with tables \[det\]",
        ),
        ({"frontend": "models"}, r"--frontend models wants --models FILE.toml"),
        ({"frontend": "oracle", "models": Path("x")}, r"--frontend oracle and --models x are both given"),
        ({"models": Path("x"), "detections": Path("y")}, r"--models x and --detections y are both given"),
    ],
)
def test_options_that_do_not_go_together_are_a_sentence(recording, options, sentence):
    with pytest.raises(InputError, match=sentence):
        perceive(recording, **options)


def test_a_parameter_of_a_stage_that_is_not_chosen_is_a_sentence(recording, models):
    with pytest.raises(InputError, match=r"geometry.far has no effect here, because masks are found by models"):
        perceive(recording, models=models, assignments=["geometry.far=3"])


# --set over the file


def test_set_goes_over_what_the_file_says_and_is_the_same_as_saying_it_there(recording, models):
    given = perceive(
        recording, models=models, assignments=["det.score=0.5", "det.top_k=7"], out=recording.with_name("set.mcap")
    )
    assert perception_info(given.output).parameters.items() >= {("det.score", 0.5), ("det.top_k", 7)}
    written(models.parent, ALL.replace("[segcap]", "score = 0.5\ntop_k = 7\n[segcap]"))
    assert given.output.read_bytes() == perceive(recording, models=models).output.read_bytes()
    assert perceive(recording, models=models).untouched
    assert not perceive(recording, models=models, assignments=["det.score=0.6"]).untouched


def test_a_detector_or_segmenter_that_does_nothing_is_told(recording, models):
    told = perceive(recording, models=models, assignments=["det.score=1"]).notes
    assert [note for note in told if "yolo found no box in any frame" in note]
    assert not [note for note in perceive(recording, models=models).notes if "box" in note]
    assert [note.split(";")[0] for note in _fruitless("yolo", 5, 0)] == ["none of 5 boxes became a mask"]


def test_paths_of_set_count_from_the_current_folder(recording, models, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.txt").write_text("mug\nstool\n")
    result = perceive(recording, models=models, assignments=["det.words=mine.txt"])
    assert {mask.label for found in read_masks(result.output) for mask in found.masks} == {"mug"}
    with pytest.raises(InputError, match=r"--set: det.words is 'words.txt', which is not a file; paths .* current"):
        perceive(recording, models=models, assignments=["det.words=words.txt"])


def test_set_may_go_to_a_stage_and_to_parameters_at_once(recording, models):
    written(models.parent, ALL.partition("[segcap]")[0])
    result = perceive(recording, models=models, assignments=["geometry.far=5", "det.score=0.5"])
    assert perception_info(result.output).parameters.items() >= {("geometry.far", 5.0), ("det.score", 0.5)}


@pytest.mark.parametrize(
    ("assignment", "sentence"),
    [
        ("det.score=2", r"^--set: det.score is 2; expected 0 .. 1$"),
        ("det.scor=0.2", r"^--set: \[det\] yolo-world: an option is 'scor'; expected file, .* did you mean score"),
        ("segcap.score=0.2", r"^--set: \[segcap\] sam: an option is 'score'; expected encoder, decoder$"),
        ("det.stage=none", r"^--set: \[det\] yolo-world: an option is 'stage'; expected file"),
        ("enc.prefix=a", r"^--set: enc.prefix must stand in .*my.toml, because maps are asked with it as well$"),
    ],
)
def test_what_is_wrong_with_set_is_a_sentence(recording, models, assignment, sentence):
    with pytest.raises(InputError, match=sentence):
        perceive(recording, models=models, assignments=[assignment])
    assert not recording.with_name("a.perception.mcap").exists()


@pytest.mark.parametrize("frontend", [None, "geometry"])
def test_options_of_stages_want_a_file_that_chooses_them(recording, frontend):
    with pytest.raises(InputError, match=r"^--set: det.score is for the stages of --models FILE.toml; give such a"):
        perceive(recording, frontend=frontend, assignments=["det.score=0.5"])


def test_a_map_is_asked_with_the_encoder_of_the_same_file(recording, models, tmp_path):
    written(models.parent, '[det]\nstage = "truth"\n[segcap]\nstage = "truth"\n' + ALL[ALL.index("[enc]") :])
    perceive(recording, models=models)
    made = Path(replay(recording)["outputs"]["map"])
    answer = query(made, ["a cup"], models=models)["queries"][0]["answers"][0]
    assert {"caption", "score"} <= answer.keys()
    with pytest.raises(InputError, match=r"cannot be asked in words: there is no encoder 'mine' .*--models FILE.toml"):
        query(made, ["a cup"])
    with pytest.raises(
        InputError, match=r"the map's features are those of mine, .*my.toml names minilm; give the file"
    ):
        query(made, ["a cup"], models=written(models.parent, ""))
    tokens = models.parent / "mine" / "tokenizer.json"
    tokens.write_text(tokens.read_text() + " ")
    written(models.parent, ALL[ALL.index("[enc]") :])
    with pytest.raises(InputError, match=r"made by other files of a model that is called mine too; ask with the TOML"):
        query(made, ["a cup"], models=models)


def said(capsys, *words: Any) -> str:
    from openvox.cli import main

    with pytest.raises(SystemExit) as left:
        main(["perceive", *map(str, words)])
    assert not left.value.code
    return str(capsys.readouterr().out).splitlines()[0]


def test_the_command_says_only_what_ran_and_on_what(recording, models, capsys):
    def line() -> str:
        return re.sub(r"[0-9.]+ (s|frames/s)", r"N \1", said(capsys, recording, "--models", models))

    first = "4 frames looked at, 4 masks (4 objects)"
    assert line() == f"{first}, N s, N frames/s, captions encoded by mine, models on the CPU"
    assert line() == first
    written(models.parent, ALL.partition("[enc]")[0])
    assert line() == f"{first}, N s, N frames/s, new: captions encoded by minilm in 4 frames, models on the CPU"


def test_what_a_file_of_detections_brings_was_run_on_nothing(tmp_path, recording, capsys):
    from test_perceive import detected, given

    path = given(tmp_path, {0: [detected(1, 4, 120, 160, embedding=[1.0, 0.0])]}, encoder="clip")
    assert said(capsys, recording, "--detections", path).endswith(" frames/s, embeddings by clip as given")


class Placed:
    """A stage that says where it ran."""

    def __init__(self, device: str) -> None:
        self.device = device


def test_what_ran_on_a_gpu_is_said_in_one_line():
    from openvox.perception.pipeline import Pipeline

    cpu, gpu = Placed("CPU"), Placed("CUDA")
    assert Pipeline(cpu, cpu, object()).device() == "on the CPU"  # type: ignore[arg-type]
    mixed = Pipeline(gpu, gpu, cpu)  # type: ignore[arg-type]
    assert mixed.device() == "det on the GPU (CUDA), segcap on the GPU (CUDA), the rest on the CPU"
    assert mixed.device(["enc"]) == "on the CPU"
    assert mixed.device(["det"]) == "det on the GPU (CUDA)"
    assert mixed.device([]) == ""


def test_a_gpu_is_tried_first_where_there_is_one(models, monkeypatch):
    import onnxruntime

    from openvox.perception.onnx import CPU, Model

    asked: list[list[str]] = []
    original = onnxruntime.InferenceSession

    def session(file: Path, settings: Any, providers: list[str]) -> Any:
        asked.append(providers)
        return original(file, settings, providers=[CPU])

    monkeypatch.setattr(onnxruntime, "InferenceSession", session)
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: [CPU, "CUDAExecutionProvider", "Other"])
    model = Model.of_user(models.parent / "det.onnx")
    assert model.device == "CUDA"
    model.load()
    assert model.device == "CPU"  # what it fell back to
    assert asked == [["CUDAExecutionProvider", CPU]]
