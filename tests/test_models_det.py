"""Det from the user's ONNX file: every usual export, coordinates exact, wrong files in a sentence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import graphs
import numpy as np
import onnx
import pytest
from worlds import tiny_frames

from openvox.core.errors import InputError
from openvox.core.parameters import Value
from openvox.core.types import Frame, Intrinsics, Pose, Rig
from openvox.formats.images import encode_png
from openvox.perception.det.yolo import Yolo, YoloOptions
from openvox.perception.parameters import PerceptionParameters
from openvox.perception.stages import Setting

RED, BLUE = (255, 0, 0), (0, 0, 255)


def frame_of(rgb: np.ndarray) -> Frame:
    """A frame that holds this picture as a PNG; nothing else of it matters to a detector."""
    camera = Intrinsics(rgb.shape[1], rgb.shape[0], 50.0, 50.0, 10.0, 10.0)
    rig = Rig(camera, camera, Pose.identity())
    depth = np.zeros(rgb.shape[:2], np.uint16)
    return Frame(0, 0, Pose.identity(), rig, depth, color=encode_png(rgb), color_format="png")


def picture(height: int, width: int, box: tuple[int, int, int, int], color: tuple[int, int, int] = RED) -> np.ndarray:
    """White with something of that colour in it."""
    rgb = np.full((height, width, 3), 255, np.uint8)
    x0, y0, x1, y1 = box
    rgb[y0:y1, x0:x1] = color
    return rgb


def yolo(folder: Path, words: str | None = "cup\nchair\n", **options: Any) -> Yolo:
    if words is not None:
        (folder / "words.txt").write_text(words)
        options["words"] = "words.txt"
    setting = Setting(None, PerceptionParameters(), "my.toml", folder)  # type: ignore[arg-type]
    detector = Yolo(YoloOptions(file="d.onnx", **options), setting)
    detector.prepare()
    return detector


# Coordinates: a 64x64 model sees the picture, and finds what is red at exact edges


@pytest.mark.parametrize(
    ("height", "width", "box"),
    [
        (64, 64, (8, 16, 24, 40)),  # as it is
        (20, 40, (5, 10, 15, 20)),  # enlarged 1.6 times, bars above and below
        (40, 20, (5, 10, 15, 20)),  # bars left and right
        (128, 64, (16, 32, 48, 80)),  # half as large
        (16, 16, (0, 0, 16, 16)),  # all of it: boxes end at the rim
    ],
)
@pytest.mark.parametrize("family", ["boxes", "output0"])
def test_edges_come_back_exactly_through_the_letterbox(tmp_path, family, height, width, box):
    if family == "boxes":
        graphs.named_detector(tmp_path / "d.onnx", [[0.9, 0.1]])
    else:
        graphs.looking_detector(tmp_path / "d.onnx", words=2)
    (found,) = yolo(tmp_path)(frame_of(picture(height, width, box)))
    assert found.corners == box
    assert found.label == "cup"
    assert found.score == pytest.approx(0.9)


def test_a_size_that_does_not_come_out_even_is_off_by_less_than_a_pixel_of_the_model(tmp_path):
    graphs.named_detector(tmp_path / "d.onnx", [[0.9, 0.1]])
    box = (211, 83, 397, 301)  # 413 x 601: 44 rows of 64 at a scale of 0.1065
    (found,) = yolo(tmp_path)(frame_of(picture(413, 601, box)))
    np.testing.assert_allclose(found.corners, box, atol=601 / 64)


def test_each_axis_is_undone_by_the_scale_that_it_really_had():
    from openvox.perception.det.boxes import letterboxed

    _, place = letterboxed(np.zeros((413, 601, 3), np.uint8), 64, 64)
    assert (place.left, place.top) == (0, 10)
    assert (place.scale_x, place.scale_y) == (64 / 601, 44 / 413)
    whole = place.undone(np.array([[0, 10, 64, 54]], np.float32), 601, 413)
    np.testing.assert_allclose(whole, [[0, 0, 601, 413]], rtol=1e-6)


@pytest.mark.parametrize(("family", "grey"), [("boxes", 0), ("output0", 114 / 255)])
def test_bars_have_the_grey_that_the_exporter_trained_with(tmp_path, family, grey):
    from openvox.perception.det.boxes import letterboxed
    from openvox.perception.det.yolo_model import padding
    from openvox.perception.onnx import Model

    make = graphs.named_detector if family == "boxes" else graphs.single_detector
    model = Model.of_user(make(tmp_path / "d.onnx", [[0.9, 0.1]]))
    square, place = letterboxed(np.full((10, 20, 3), 255, np.uint8), 40, 40, padding(model))
    assert place.top == 10
    np.testing.assert_allclose(square[0, :, :10], grey, atol=1e-6)
    assert (square[0, :, 10:30] == 1).all()


def test_red_is_the_first_channel(tmp_path):
    graphs.looking_detector(tmp_path / "d.onnx", words=2)
    (red,) = yolo(tmp_path)(frame_of(picture(64, 64, (8, 16, 24, 40), RED)))
    (blue,) = yolo(tmp_path)(frame_of(picture(64, 64, (8, 16, 24, 40), BLUE)))
    assert red.corners == (8, 16, 24, 40)
    assert blue.corners == (0, 0, 64, 64)  # nothing red: first and last place are both ends of the row


def test_a_model_with_open_sides_gets_the_side_that_is_asked_for(tmp_path):
    graphs.named_detector(tmp_path / "d.onnx", [[0.9, 0.1]], side=("h", "w"))
    (found,) = yolo(tmp_path, side=128)(frame_of(picture(32, 64, (3, 5, 7, 11))))
    assert found.corners == (3, 5, 7, 11)


def test_a_model_need_not_be_square(tmp_path):
    graphs.named_detector(tmp_path / "d.onnx", [[0.9, 0.1]], side=(32, 96))
    (found,) = yolo(tmp_path)(frame_of(picture(16, 24, (3, 5, 7, 11))))
    assert found.corners == (3, 5, 7, 11)


def test_a_frame_without_colour_has_no_boxes(tmp_path):
    graphs.looking_detector(tmp_path / "d.onnx", words=2)
    assert yolo(tmp_path)(replace(tiny_frames(1)[0], color=b"", color_format="")) == ()


# Families


def column(x: float, y: float, w: float, h: float, *scores: float) -> list[float]:
    return [x, y, w, h, *scores]


GREY = np.full((64, 64, 3), 90, np.uint8)


def found(detector: Yolo) -> list[tuple[Any, ...]]:
    return [(*box.corners, round(box.score, 3), box.label) for box in detector(frame_of(GREY))]


def test_ultralytics_columns_are_centres_sizes_and_classes(tmp_path):
    rows = np.array([column(10, 20, 8, 4, 0.1, 0.8), column(40, 40, 10, 10, 0.5, 0.2), column(9, 9, 2, 2, 0.1, 0.2)]).T
    graphs.single_detector(tmp_path / "d.onnx", rows)
    assert found(yolo(tmp_path)) == [(6, 18, 14, 22, 0.8, "chair"), (35, 35, 45, 45, 0.5, "cup")]


def test_what_a_segmenter_would_make_masks_of_is_left_out(tmp_path):
    rows = np.array([[*column(10, 20, 8, 4, 0.1, 0.8), *[9.0] * 32]]).T
    detector = onnx.load(graphs.single_detector(tmp_path / "d.onnx", rows))
    detector.graph.node.extend([graphs.constant("output1", np.zeros((1, 32, 16, 16)))])
    detector.graph.output.extend([graphs._value("output1", [1, 32, 16, 16])])
    onnx.save(detector, tmp_path / "d.onnx")
    assert found(yolo(tmp_path)) == [(6, 18, 14, 22, 0.8, "chair")]


def test_rows_of_six_are_corners_score_and_class_and_have_been_thinned_out_already(tmp_path):
    rows = [[1, 2, 30, 40, 0.9, 1], [1, 2, 30, 41, 0.8, 1], [0, 0, 0, 0, 0, 0]]
    graphs.single_detector(tmp_path / "d.onnx", rows)
    assert found(yolo(tmp_path)) == [(1, 2, 30, 40, 0.9, "chair"), (1, 2, 30, 41, 0.8, "chair")]


def test_rows_with_objectness_multiply_it_with_the_class(tmp_path):
    rows = np.zeros((3 * 84, 7))
    rows[5] = [10, 20, 8, 4, 0.5, 0.1, 0.8]
    graphs.single_detector(tmp_path / "d.onnx", rows)
    assert found(yolo(tmp_path)) == [(6, 18, 14, 22, 0.4, "chair")]


def test_one_row_a_cell_with_objectness_is_another_family_and_refused(tmp_path):
    graphs.single_detector(tmp_path / "d.onnx", np.zeros((84, 7)))
    with pytest.raises(InputError, match=r"d.onnx has inputs images float\[1,3,64,64\].*YOLOX.*not decoded"):
        yolo(tmp_path)


def test_what_was_thinned_out_inside_is_cut_at_its_count(tmp_path):
    graphs.finished_detector(tmp_path / "d.onnx", [0.7, 0.6, 0.9], [1, 0, 0], count=2)
    boxes = yolo(tmp_path)(frame_of(picture(64, 64, (8, 16, 24, 40))))
    assert [(box.corners, box.label) for box in boxes] == [((8, 16, 24, 40), "chair"), ((8, 16, 24, 40), "cup")]


def test_the_class_that_pads_the_vocabulary_is_no_word(tmp_path):
    graphs.named_detector(tmp_path / "d.onnx", [[0.1, 0.4, 0.9]])
    (box,) = yolo(tmp_path)(frame_of(picture(64, 64, (8, 16, 24, 40))))
    assert (box.label, round(box.score, 3)) == ("chair", 0.4)


def test_overlapping_boxes_of_one_word_are_thinned_out_others_are_not(tmp_path):
    rows = np.array([column(20, 20, 10, 10, 0.9, 0), column(20, 21, 10, 10, 0.8, 0), column(20, 21, 10, 10, 0, 0.7)]).T
    graphs.single_detector(tmp_path / "d.onnx", rows)
    assert [row[-1] for row in found(yolo(tmp_path))] == ["cup", "chair"]
    assert [row[-1] for row in found(yolo(tmp_path, overlap=0.9))] == ["cup", "cup", "chair"]


def test_score_and_top_k_limit_what_is_found(tmp_path):
    rows = np.array([column(10 * i, 10, 4, 4, 0.9 - 0.1 * i, 0) for i in range(5)]).T
    graphs.single_detector(tmp_path / "d.onnx", rows)
    assert [row[-2] for row in found(yolo(tmp_path, score=0.65))] == [0.9, 0.8, 0.7]
    assert [row[-2] for row in found(yolo(tmp_path, top_k=2))] == [0.9, 0.8]


def test_equal_boxes_come_in_one_order_whatever_order_the_model_has(tmp_path):
    columns = [column(40, 10, 4, 4, 0.5, 0), column(10, 10, 4, 4, 0.5, 0), column(20, 10, 4, 4, 0, 0.5)]
    graphs.single_detector(tmp_path / "d.onnx", np.array(columns).T)
    first = found(yolo(tmp_path))
    graphs.single_detector(tmp_path / "d.onnx", np.array(columns[::-1]).T)
    assert found(yolo(tmp_path)) == first
    assert [row[0] for row in first] == [8, 38, 18]


# Sizes as they really are: 640 x 640 pixels, 8400 boxes, 80 words


@pytest.mark.parametrize("family", graphs.REAL_DETECTORS)
@pytest.mark.parametrize(
    ("height", "width", "box"),
    [
        (480, 640, (17, 33, 250, 401)),  # scale 1, bars of 80 rows
        (640, 480, (17, 33, 250, 401)),
        (960, 1280, (16, 32, 250, 400)),  # half as large
        (320, 320, (0, 7, 320, 300)),  # twice as large
    ],
)
def test_every_family_at_its_real_size_finds_the_box_where_it_is(tmp_path, family, height, width, box):
    graphs.real_detector(tmp_path / "d.onnx", family)
    words = [f"word {i}" for i in range(graphs.REAL_WORDS)]
    (found,) = yolo(tmp_path, "\n".join(words))(frame_of(picture(height, width, box)))
    assert (found.corners, found.score, found.label) == (box, 0.75, "word 41")


# Words


@pytest.mark.parametrize("names", ["{0: 'cup', 1: 'chair'}", "['cup', 'chair']", "cup\nchair"])
def test_words_may_stand_in_the_model(tmp_path, names):
    graphs.looking_detector(tmp_path / "d.onnx", words=2, metadata={"names": names})
    assert yolo(tmp_path, words=None)(frame_of(GREY))[0].label == "cup"


@pytest.mark.parametrize("names", ["", "__import__('os').getpid()", "{0: 'cup', 7: 'chair'}", "[" * 5000])
def test_without_words_a_text_file_is_asked_for_and_nothing_is_run(tmp_path, names):
    graphs.looking_detector(tmp_path / "d.onnx", words=2, metadata={"names": names})
    with pytest.raises(InputError, match=r"d.onnx"):
        yolo(tmp_path, words=None)


# Wrong files


@pytest.mark.parametrize(("name", "shape"), [("class_scores", [1, 1000]), ("image_embeddings", [1, 256, 64, 64])])
def test_a_file_of_another_kind_is_told_so_before_it_is_asked_for_words(tmp_path, name, shape):
    nodes = [graphs.constant(name, np.zeros(shape))]
    graphs._model(tmp_path / "d.onnx", [graphs._value(*graphs.PICTURE)], [graphs._value(name, shape)], nodes)
    sides = ",".join(map(str, shape))
    with pytest.raises(InputError) as raised:
        yolo(tmp_path, words=None)
    assert f"inputs images float[1,3,64,64], outputs {name} float[{sides}]; expected the input" in str(raised.value)


def test_another_number_of_words_than_classes_is_a_sentence(tmp_path):
    graphs.named_detector(tmp_path / "d.onnx", [[0.9, 0.1, 0.1, 0.1]])
    with pytest.raises(InputError, match=r"expected 2 classes, as there are words, not 4; give the words it was"):
        yolo(tmp_path)
    graphs.looking_detector(tmp_path / "d.onnx", words=5)
    with pytest.raises(InputError, match=r"output0 float\[1,9,1\]; .* for 5 words, and there are 2 words"):
        yolo(tmp_path)


def test_a_class_without_a_word_is_a_sentence(tmp_path):
    graphs.finished_detector(tmp_path / "d.onnx", [0.7], [9], count=1)
    with pytest.raises(InputError, match=r"class 9 of 2 words; give the words it was exported with"):
        yolo(tmp_path)


def test_scores_before_the_sigmoid_and_numbers_that_are_none_are_sentences(tmp_path):
    graphs.named_detector(tmp_path / "d.onnx", [[4.0, -3.0]])
    with pytest.raises(InputError, match=r"scores from 4 to 4; expected 0 to 1: export with the sigmoid inside"):
        yolo(tmp_path)
    graphs.named_detector(tmp_path / "d.onnx", [[np.nan, 0.1]])
    with pytest.raises(InputError, match=r"not finite numbers"):
        yolo(tmp_path)


def test_distances_instead_of_boxes_are_a_sentence(tmp_path):
    from onnx import TensorProto, helper, load_model, save_model

    path = graphs.named_detector(tmp_path / "d.onnx", [[0.9, 0.1]] * 4)
    model = load_model(path)
    kept = [node for node in model.graph.node if node.output[0] != "boxes"]
    values = helper.make_tensor("v", TensorProto.FLOAT, [1, 4, 4], [3, 4, 5, 6, 6, 5, 4, 3, 5, 5, 1, 1, 2, 2, 9, 9])
    del model.graph.node[:]
    model.graph.node.extend([*kept, helper.make_node("Constant", [], ["boxes"], value=values)])
    save_model(model, path)
    with pytest.raises(InputError, match=r"boxes are distances, not corners; export with the box decoder inside"):
        yolo(tmp_path)


def test_a_model_that_wants_vectors_of_words_is_refused(tmp_path):
    nodes = [graphs.op("Identity", "images", "output0"), graphs.op("Identity", "txt_feats", "other")]
    inputs = [graphs._value("images", [1, 3, 64, 64]), graphs._value("txt_feats", [1, 2, 512])]
    outputs = [graphs._value("output0", [1, 3, 64, 64]), graphs._value("other", [1, 2, 512])]
    graphs._model(tmp_path / "d.onnx", inputs, outputs, nodes)
    with pytest.raises(InputError, match=r"txt_feats float\[1,2,512\].*export with the vocabulary baked in"):
        yolo(tmp_path)


def test_a_file_of_another_kind_names_what_was_found_and_expected(tmp_path):
    graphs.sentence_folder(tmp_path)
    (tmp_path / "onnx" / "model.onnx").rename(tmp_path / "d.onnx")
    with pytest.raises(InputError) as raised:
        yolo(tmp_path)
    assert "inputs input_ids int64[?,?] and attention_mask int64[?,?] and token_type_ids" in str(raised.value)
    assert "outputs last_hidden_state float[?,?,5]; expected the input images float[1,3,h,w]" in str(raised.value)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [(b"", r"0 bytes; expected a model file"), (b"PK\x03\x04 not a model", r"cannot be loaded as an ONNX model")],
)
def test_what_is_no_model_is_a_sentence(tmp_path, content, sentence):
    (tmp_path / "d.onnx").write_bytes(content)
    with pytest.raises(InputError, match=sentence):
        yolo(tmp_path)


def test_weights_may_lie_beside_the_model_but_nowhere_else(tmp_path):
    from onnx import load_model, save_model

    path = graphs.single_detector(tmp_path / "d.onnx", np.array([column(10, 20, 8, 4, *[0.5] * 300)]).T)
    words = "".join(f"w{i}\n" for i in range(300))
    model = load_model(path)
    model.graph.initializer.append(graphs.numpy_helper.from_array(np.ones(2000, np.float32), "weights"))
    save_model(model, path, save_as_external_data=True, location="d.data", size_threshold=0)
    detector = yolo(tmp_path, words)
    (tmp_path / "d.data").write_bytes((tmp_path / "d.data").read_bytes()[::-1])
    assert yolo(tmp_path, words).model_digest != detector.model_digest
    path.write_bytes(path.read_bytes().replace(b"\x0a\x08location\x12\x06d.data", b"\x0a\x08location\x12\x06../d.d"))
    with pytest.raises(InputError, match=r"wants weights from '../d.d'; expected a file in its own folder"):
        yolo(tmp_path, words)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [(" ", r"words.txt: 1 words; expected 1 to"), ("\n\n", r"words.txt: 2 words; expected 1 to")],
)
def test_a_file_without_words_is_a_sentence(tmp_path, words, sentence):
    graphs.looking_detector(tmp_path / "d.onnx", words=2)
    with pytest.raises(InputError, match=sentence):
        yolo(tmp_path, words)


# Cache


@pytest.mark.parametrize(
    "change", [{"score": 0.5}, {"top_k": 7}, {"overlap": 0.5}, {"side": 96}, {"words": "cup\nsofa\n"}]
)
def test_whatever_changes_boxes_changes_the_digest(tmp_path, change: dict[str, Value]):
    graphs.looking_detector(tmp_path / "d.onnx", words=2)
    (frame,) = tiny_frames(1)
    before = yolo(tmp_path).digest(frame)
    assert yolo(tmp_path).digest(frame) == before
    assert yolo(tmp_path, **change).digest(frame) != before


def test_another_place_of_the_same_file_does_not(tmp_path):
    (frame,) = tiny_frames(1)
    for folder in ("a", "b"):
        graphs.looking_detector(tmp_path / folder / "d.onnx", words=2)
    assert yolo(tmp_path / "a").digest(frame) == yolo(tmp_path / "b").digest(frame)


# Real weights: the one detector of these families that is here


def test_the_detector_that_comes_with_openvox_finds_the_same_as_a_file_of_the_users(tmp_path, shared_data):
    from openvox.perception.nanodet import FOLDER, NanoDet
    from openvox.perception.parameters import OfflineParameters
    from openvox.sources import open_source

    (tmp_path / "d.onnx").write_bytes((FOLDER / "nanodet_g_416_fp16w.onnx").read_bytes())
    detector, shipped = yolo(tmp_path, None, overlap=0.5), NanoDet(OfflineParameters())
    frames = [frame for frame in open_source(shared_data / "dev_living", end=41).frames if frame.index % 20 == 0]
    seen = [(shipped(frame), detector(frame)) for frame in frames]
    assert sum(len(mine) for mine, _ in seen) >= 6
    assert all(set(mine) <= set(theirs) for mine, theirs in seen)
