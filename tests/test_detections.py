"""The contract of detections in lines of JSON: what is read, and every wrong line as one sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from openvox.core.errors import InputError
from openvox.formats.detections import DetectionFile, read_detections
from openvox.formats.masks import encode_rle

CHAIR = np.zeros((4, 6), np.bool_)
CHAIR[1:3, 2:5] = True


def detection(**changes: Any) -> dict[str, Any]:
    mask = {"size": [4, 6], "counts": encode_rle(CHAIR)}
    full = {"box": [2, 1, 5, 3], "score": 0.8, "label": "chair", "caption": "a grey chair", "mask": mask, **changes}
    return {key: value for key, value in full.items() if value is not ...}


def line(frame: Any = 12, *detections: Any, **fields: Any) -> str:
    return json.dumps({"frame": frame, "detections": list(detections), **fields})


def written(folder: Path, *lines: str) -> Path:
    path = folder / "own.jsonl"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_line_gives_the_masks_of_a_frame_in_the_order_of_the_file(tmp_path):
    path = written(tmp_path, line(12, detection(), detection(label="cup", caption="a cup", score=1)), line(3))
    assert [(frame, len(masks), encoder) for frame, masks, encoder in read_detections(path)] == [
        (12, 2, ""),
        (3, 0, ""),
    ]
    chair, cup = next(read_detections(path))[1]
    assert (chair.bitmap(4, 6) == CHAIR).all()
    assert (chair.score, chair.label, chair.caption) == (0.8, "chair", "a grey chair")
    assert (cup.score, cup.caption) == (1.0, "a cup")


def test_what_is_not_said_has_defaults_and_unknown_fields_are_ignored(tmp_path):
    path = written(tmp_path, line(0, detection(track=7), camera="left"))
    (mask,) = next(read_detections(path))[1]
    assert (mask.kind, mask.named, mask.caption_score, mask.embedding) == ("object", True, 1.0, None)


def test_what_is_said_is_kept(tmp_path):
    path = written(tmp_path, line(0, detection(kind="support", named=False, caption_score=0.25)))
    (mask,) = next(read_detections(path))[1]
    assert (mask.kind, mask.named, mask.caption_score) == ("support", False, 0.25)


def test_the_box_of_a_detection_may_be_wider_than_its_mask(tmp_path):
    path = written(tmp_path, line(5, detection(box=[0.5, 0, 6, 4])))
    with DetectionFile(path) as file:
        found = file.read(5)
    assert found.boxes[0].corners == (0.5, 0.0, 6.0, 4.0)
    assert found.masks[0].box == (2, 1, 5, 3)


def test_embeddings_are_brought_to_unit_length_and_their_encoder_named(tmp_path):
    path = written(tmp_path, line(0, detection(embedding=[3, 4]), encoder="clip"), line(1), line(2))
    frames = list(read_detections(path))
    assert frames[0][2] == "clip"
    assert frames[0][1][0].embedding.dtype == np.float32
    np.testing.assert_allclose(frames[0][1][0].embedding, [0.6, 0.8], rtol=1e-6)


def test_frames_can_be_asked_for_in_any_order_and_blank_lines_do_not_count(tmp_path):
    path = written(tmp_path, line(7, detection()), "", line(2), "   ", line(9, detection(), detection()))
    with DetectionFile(path) as file:
        assert file.frames == (7, 2, 9)
        assert [len(file.read(frame).masks) for frame in (9, 2, 7)] == [2, 0, 1]


def test_an_empty_mask_is_a_mask_without_pixels(tmp_path):
    nothing = {"size": [4, 6], "counts": encode_rle(np.zeros((4, 6), np.bool_))}
    (mask,) = next(read_detections(written(tmp_path, line(0, detection(mask=nothing, box=[0, 0, 0, 0])))))[1]
    assert (mask.box, mask.area) == ((0, 0, 0, 0), 0)


WRONG_LINES = {
    "no_json": ("{", r"own.jsonl:1: line is no JSON \(.*\); expected one object a line"),
    "deep": ("[" * 100_000, r"own.jsonl:1: line is no JSON \(nested too deeply\)"),
    "nan": ('{"frame": 0, "detections": [], "x": NaN}', r"own.jsonl:1: line is no JSON \(NaN is no JSON number\)"),
    "list": ("[1, 2]", r"own.jsonl:1: line is \[1, 2\]; expected an object"),
    "no_frame": ('{"detections": []}', "own.jsonl:1: frame is missing; expected the frame's number, from 0"),
    "bool_frame": (line(True), "own.jsonl:1: frame is true; expected the frame's number"),
    "float_frame": (line(1.5), "own.jsonl:1: frame is 1.5"),
    "negative_frame": (line(-1), "own.jsonl:1: frame is -1"),
    "no_list": ('{"frame": 4}', 'own.jsonl:1: frame 4: "detections" is missing'),
    "twice": (line(3) + "\n" + line(3), "own.jsonl:2: frame 3 comes twice, first in line 1"),
    "no_object": (line(4, 7), r"own.jsonl:1: frame 4, mask 0: mask size is missing; expected \[height, width\]"),
    "no_mask": (line(4, detection(mask=...)), "frame 4, mask 0: mask size is missing"),
    "bad_size": (line(4, detection(mask={"size": [4, "6"], "counts": ""})), r'mask size is \[4, "6"\]'),
    "no_counts": (line(4, detection(mask={"size": [4, 6]})), "frame 4, mask 0: mask counts are missing"),
    "list_counts": (line(4, detection(mask={"size": [4, 6], "counts": [24]})), r"mask counts are \[24\]; expected the"),
    "short_counts": (
        line(4, detection(), detection(mask={"size": [4, 6], "counts": "5"})),
        "own.jsonl:1: frame 4, mask 1: mask counts cover 5 pixels; expected 24",
    ),
    "two_sizes": (
        line(4, detection(), detection(mask={"size": [240, 320], "counts": ""})),
        "frame 4, mask 1: mask is 320x240, mask 0 6x4; export masks at the colour image's size",
    ),
    "huge": (line(4, detection(mask={"size": [1 << 40, 1 << 40], "counts": ""})), "too many for a frame"),
    "many": (line(4, *[detection(mask={"size": [8000, 8000], "counts": ""})] * 99), "99 masks of 8000x8000 pixels are"),
    "no_box": (line(4, detection(box=...)), r"frame 4, mask 0: box is missing; expected \[x0, y0, x1, y1\]"),
    "text_box": (line(4, detection(box=[1, 2, 3, "4"])), r'frame 4, mask 0: box is \[1, 2, 3, "4"\]; expected'),
    "outside": (line(4, detection(box=[2, 1, 7, 3])), r"box \[2, 1, 7, 3\] does not lie within the mask's 6x4 pixels"),
    "inverted": (line(4, detection(box=[5, 1, 2, 3])), r"box \[5, 1, 2, 3\] does not lie within"),
    "score": (line(4, detection(score=1.01)), "frame 4, mask 0: score is 1.01; expected a number between 0 and 1"),
    "no_score": (line(4, detection(score=...)), "frame 4, mask 0: score is missing"),
    "bool_score": (line(4, detection(score=True)), "frame 4, mask 0: score is true"),
    "endless_score": (
        '{"frame": 4, "detections": [' + json.dumps(detection()).replace("0.8", "1e999") + "]}",
        "score is",
    ),
    "caption_score": (line(4, detection(caption_score=-1)), "frame 4, mask 0: caption_score is -1"),
    "no_label": (line(4, detection(label=...)), "frame 4, mask 0: label is missing; expected a text"),
    "no_caption": (line(4, detection(caption=...)), "frame 4, mask 0: caption is missing; expected a text"),
    "half_character": (line(4, detection(caption="\ud800")), r'caption is "\\ud800"; expected a text'),
    "kind": (line(4, detection(kind="thing")), 'kind is "thing"; expected one of object, region, support'),
    "list_kind": (line(4, detection(kind=["object"])), r'kind is \["object"\]; expected one of'),
    "named": (line(4, detection(named="no")), 'frame 4, mask 0: named is "no"; expected true or false'),
    "some_embeddings": (
        line(4, detection(embedding=[1]), detection(), encoder="clip"),
        "frame 4, mask 1: embedding is missing; give it on all detections or none",
    ),
    "nameless_encoder": (line(4, detection(embedding=[1])), 'detections have embeddings, but the line no "encoder"'),
    "no_embedding": (
        line(4, detection(embedding=[]), encoder="clip"),
        r"mask 0: embedding is \[\]; expected a list of",
    ),
    "text_embedding": (
        line(4, detection(embedding=["1"]), encoder="clip"),
        r'embedding is \["1"\]; expected 1 numbers',
    ),
    "zero_embedding": (line(4, detection(embedding=[0, 0]), encoder="clip"), "embedding has length 0; expected"),
    "endless_embedding": (line(4, detection(embedding=[1e200]), encoder="clip"), "embedding has length inf; expected"),
    "two_dimensions": (
        line(4, detection(embedding=[1]), detection(embedding=[1, 0]), encoder="clip"),
        r"frame 4, mask 1: embedding is \[1, 0\]; expected 1 numbers, as on the others",
    ),
    "other_encoder": (
        line(4, detection(embedding=[1]), encoder="clip") + "\n" + line(5, detection()),
        "own.jsonl:2: frame 5: no embeddings, line 1 has embeddings of clip with 1 dimensions; expected the same",
    ),
}


@pytest.mark.parametrize("case", sorted(WRONG_LINES))
def test_a_wrong_line_is_one_sentence_with_file_line_frame_and_mask(tmp_path, case):
    text, sentence = WRONG_LINES[case]
    with pytest.raises(InputError, match=sentence):
        list(read_detections(written(tmp_path, text)))


def test_masks_that_are_not_of_the_size_of_the_colour_image_are_refused_before_they_are_decoded(tmp_path):
    path = written(tmp_path, line(12, *[detection()] * 3, detection(mask={"size": [240, 320], "counts": "?"})))
    with (
        DetectionFile(path) as file,
        pytest.raises(InputError, match="frame 12, mask 0: mask is 6x4, the colour image 640x480; export masks"),
    ):
        file.read(12, (480, 640))


def test_a_file_that_is_not_there_is_a_sentence(tmp_path):
    with pytest.raises(InputError, match=r"none.jsonl: cannot be read"):
        list(read_detections(tmp_path / "none.jsonl"))
    with pytest.raises(InputError, match="cannot be read"):
        list(read_detections(tmp_path))


def test_the_digest_is_that_of_the_bytes(tmp_path):
    with DetectionFile(written(tmp_path, line(1))) as a:
        first = a.digest
    with DetectionFile(written(tmp_path, line(1), "")) as b:
        assert b.digest != first


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(["size", "counts"]), inner, max_size=2),
    max_leaves=6,
)


@given(st.sampled_from(sorted([*detection(), "kind", "named", "embedding", "caption_score"])), json_values)
def test_any_value_in_any_field_is_read_or_refused_in_a_sentence(tmp_path_factory, field, value):
    path = written(tmp_path_factory.mktemp("fields"), line(0, detection(**{field: value}), encoder="clip"))
    try:
        ((_, masks, _),) = read_detections(path)
    except InputError:
        return
    assert len(masks) == 1


def test_the_simulated_detections_of_a_room_are_read_whole(shared_data):
    path = shared_data / "dev_living" / "detections_noisy.jsonl"
    frames = list(read_detections(path))
    assert [frame for frame, _, _ in frames] == list(range(180))
    assert sum(len(masks) for _, masks, _ in frames) == 1628
    assert all(mask.area >= 25 for _, masks, _ in frames for mask in masks)
