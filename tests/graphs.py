"""Tiny ONNX graphs with the signatures of detectors, segmenters and encoders, for tests of what runs them.

The detectors look: what is red in their picture becomes a box whose edges are exact. The segmenters answer a box with
exactly the pixels in it, in the size that their exporters write.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from onnx import TensorProto, helper, numpy_helper, save_model

SIDE = 64
Nodes = list[Any]


def _value(name: str, shape: Sequence[Any], kind: int = TensorProto.FLOAT) -> Any:
    return helper.make_tensor_value_info(name, kind, shape)


def _model(
    path: Path, inputs: Sequence[Any], outputs: Sequence[Any], nodes: Nodes, metadata: Mapping[str, str] | None = None
) -> Path:
    graph = helper.make_graph(nodes, "tiny", inputs, outputs)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, dict(metadata or {}))
    path.parent.mkdir(parents=True, exist_ok=True)
    save_model(model, path)
    return path


def constant(name: str, value: Any, dtype: Any = np.float32) -> Any:
    return helper.make_node("Constant", [], [name], value=numpy_helper.from_array(np.asarray(value, dtype)))


def op(kind: str, inputs: str, output: str, **attributes: Any) -> Any:
    return helper.make_node(kind, inputs.split(), [output], **attributes)


def _extent(axis: int, name: str) -> Nodes:
    """First and one past the last place along an axis of the picture where something is bright, as [1,1] floats."""
    return [
        op("ReduceMax", "bright", f"{name}_line", axes=[2 if axis == 3 else 3], keepdims=0),
        op("ArgMax", f"{name}_line", f"{name}_first", axis=2, keepdims=0),
        op("ArgMax", f"{name}_line", f"{name}_last", axis=2, keepdims=0, select_last_index=1),
        op("Cast", f"{name}_first", f"{name}0", to=TensorProto.FLOAT),
        op("Cast", f"{name}_last", f"{name}_end", to=TensorProto.FLOAT),
        op("Add", f"{name}_end one", f"{name}1"),
    ]


def seen(side: int = SIDE, picture: str = "images") -> Nodes:
    """Makes `corners` [1,1,4]: x0, y0, x1, y1 of what is bright in the first channel and dark in the third."""
    return [
        constant("zero", [0], np.int64),
        constant("c1", [1], np.int64),
        constant("c2", [2], np.int64),
        constant("c3", [3], np.int64),
        constant("one", 1.0),
        constant("half", 0.5),
        constant("hole", [1, 1, 4], np.int64),
        op("Slice", f"{picture} zero c1 c1", "red"),
        op("Slice", f"{picture} c2 c3 c1", "blue"),
        op("Sub", "red blue", "reddish"),
        op("Greater", "reddish half", "is_bright"),
        op("Cast", "is_bright", "bright", to=TensorProto.FLOAT),
        *_extent(3, "x"),
        *_extent(2, "y"),
        op("Concat", "x0 y0 x1 y1", "corners_flat", axis=1),
        op("Reshape", "corners_flat hole", "corners"),
    ]


PICTURE = ("images", [1, 3, SIDE, SIDE])


def named_detector(
    path: Path, scores: Sequence[Sequence[float]], side: Sequence[Any] = (SIDE, SIDE), **more: Any
) -> Path:
    """YOLO-World's own export without NMS: `boxes` [1,n,4], `scores` [1,n,c]; every box is what is red."""
    n, c = np.shape(scores)
    nodes = [
        *seen(),
        constant("many", [1, n, 4], np.int64),
        op("Expand", "corners many", "boxes"),
        constant("scores", [scores]),
    ]
    outputs = [_value("scores", [1, n, c]), _value("boxes", [1, n, 4])]
    return _model(path, [_value("images", [1, 3, *side])], outputs, nodes, **more)


def finished_detector(path: Path, scores: Sequence[float], labels: Sequence[int], count: int) -> Path:
    """YOLO-World's own export with NMS; behind `count` there is rubbish."""
    n = len(scores)
    nodes = [
        *seen(),
        constant("many", [1, n, 4], np.int64),
        op("Expand", "corners many", "boxes"),
        constant("scores", [scores]),
        constant("labels", [labels], np.int32),
        constant("num_dets", [[count]], np.int32),
    ]
    outputs = [
        _value("labels", [1, n], TensorProto.INT32),
        _value("num_dets", [1, 1], TensorProto.INT32),
        _value("boxes", [1, n, 4]),
        _value("scores", [1, n]),
    ]
    return _model(path, [_value(*PICTURE)], outputs, nodes)


def single_detector(path: Path, rows: Any, side: Sequence[Any] = (SIDE, SIDE), **more: Any) -> Path:
    """One output `output0` of constant rows, whatever is seen."""
    rows = np.asarray(rows, np.float32)[None]
    nodes = [
        constant("rows", rows),
        constant("none", 0.0),
        op("ReduceMax", "images", "peak", keepdims=0),
        op("Mul", "peak none", "nothing"),
        op("Add", "rows nothing", "output0"),
    ]
    return _model(path, [_value("images", [1, 3, *side])], [_value("output0", rows.shape)], nodes, **more)


def looking_detector(path: Path, words: int, **more: Any) -> Path:
    """Ultralytics' export: `output0` [1,4+c,1], centre and size of what is red, its first class surely."""
    nodes = [
        *seen(),
        *_centred(),
        constant("classes", [[[0.9, *[0.0] * (words - 1)]]]),
        op("Concat", "centred classes", "row", axis=2),
        op("Transpose", "row", "output0", perm=[0, 2, 1]),
    ]
    return _model(path, [_value(*PICTURE)], [_value("output0", [1, 4 + words, 1])], nodes, **more)


REAL_SIDE, REAL_WORDS = 640, 80
REAL_DETECTORS: Mapping[str, Mapping[str, tuple[int, ...]]] = {
    "yolo-world": {"scores": (1, 8400, REAL_WORDS), "boxes": (1, 8400, 4)},
    "yolo-world, suppressed": {"num_dets": (1, 1), "boxes": (1, 100, 4), "scores": (1, 100), "labels": (1, 100)},
    "yolo-world, no batch": {"num_dets": (1,), "boxes": (100, 4), "scores": (100,), "labels": (100,)},
    "ultralytics": {"output0": (1, 4 + REAL_WORDS, 8400)},
    "ultralytics, suppressed": {"output0": (1, 300, 6)},
    "yolov5": {"output0": (1, 25200, 5 + REAL_WORDS)},
}
"""Outputs of a detector of 640x640 pixels and 80 words, as each exporter writes them."""


def real_detector(path: Path, family: str, word: int = 41, score: float = 0.75) -> Path:
    """Zeros, but for one box around what is red: the first where suppression has sorted them, else in the middle."""
    shapes = REAL_DETECTORS[family]
    single = shapes.get("output0", (0,))
    if "boxes" in shapes:
        named = "labels" in shapes
        row = {
            "boxes": ["corners"],
            "scores": [np.full((1, 1, 1), score) if named else score * np.eye(REAL_WORDS)[None, word : word + 1]],
            "labels": [np.full((1, 1, 1), word)],
            "num_dets": [np.ones((1, 1, 1))],
        }
    elif single[-1] == 6:
        row = {"output0": ["corners", np.array([[[score, word]]])]}
    else:
        surely = [1.0] if family == "yolov5" else []
        row = {"output0": ["centred", np.array([[[*surely, *score * np.eye(REAL_WORDS)[word]]]])]}
    nodes = [*seen(), *_centred()]
    for name, shape in shapes.items():
        parts = []
        for i, part in enumerate(row[name]):
            parts.append(part if isinstance(part, str) else f"{name}_{i}")
            nodes += [] if isinstance(part, str) else [constant(f"{name}_{i}", part)]
        nodes.append(op("Concat", " ".join(parts), f"{name}_row", axis=2))
        turned = family == "ultralytics"
        rows = shape[2] if turned else shape[0 if len(shape) == 1 or shape[0] > 1 else 1]
        before = 0 if "num_dets" in shapes or single[-1] == 6 else rows // 2
        nodes += [
            constant(f"{name}_pads", [0, before, 0, 0, rows - 1 - before, 0], np.int64),
            op("Pad", f"{name}_row {name}_pads", f"{name}_rows"),
            constant(f"{name}_shape", shape, np.int64),
            *([op("Transpose", f"{name}_rows", f"{name}_turned", perm=[0, 2, 1])] if turned else []),
            op("Reshape", f"{name}_{'turned' if turned else 'rows'} {name}_shape", f"{name}_floats"),
            op("Cast", f"{name}_floats", name, to=_kind(name)),
        ]
    outputs = [_value(name, shape, _kind(name)) for name, shape in shapes.items()]
    return _model(path, [_value("images", [1, 3, REAL_SIDE, REAL_SIDE])], outputs, nodes)


def _kind(name: str) -> int:
    return int(TensorProto.INT32 if name in ("labels", "num_dets") else TensorProto.FLOAT)


def _centred() -> Nodes:
    """`centred` [1,1,4] of `corners`: middle and size."""
    return [
        constant("c4", [4], np.int64),
        op("Slice", "corners zero c2 c2", "low"),
        op("Slice", "corners c2 c4 c2", "high"),
        op("Sub", "high low", "size"),
        op("Mul", "size half", "reach"),
        op("Add", "low reach", "middle"),
        op("Concat", "middle size", "centred", axis=2),
    ]


def image_encoder(path: Path, kind: str = "sam", side: int = SIDE) -> Path:
    """What goes in comes out as the embedding, so that a decoder can look at it."""
    name, shape = {
        "sam": ("input_image", [1, 3, side, side]),
        "raw": ("input_image", ["h", "w", 3]),
        "efficient": ("batched_images", ["b", 3, "h", "w"]),
        "sam2": ("image", [1, 3, side, side]),
        "edge": ("image", [1, 3, side, side]),
    }[kind]
    main = "image_embed" if kind == "sam2" else "image_embeddings"
    nodes, outputs = [op("Identity", name, main)], [_value(main, shape)]
    if kind == "raw":
        nodes = [constant("at0", [0], np.int64), op("Unsqueeze", f"{name} at0", main)]
        outputs = [_value(main, [1, *shape])]
    if kind == "sam2":
        for more in ("high_res_feats_0", "high_res_feats_1"):
            nodes.append(op("Identity", name, more))
            outputs.append(_value(more, shape))
    return _model(path, [_value(name, shape)], outputs, nodes)


EMBEDDING = [1, 256, 64, 64]
HIGH = {"high_res_feats_0": [1, 32, 256, 256], "high_res_feats_1": [1, 64, 128, 128]}


def real_image_encoder(path: Path, kind: str) -> Path:
    """Of the sizes they really have: a picture of 1024 pixels, or any, to 256 channels of 64 x 64, mostly zeros."""
    name, shape = {
        "raw": ("input_image", ["h", "w", 3]),
        "efficient": ("batched_images", ["b", 3, "h", "w"]),
    }.get(kind, ("input_image" if kind in ("sam", "many") else "image", [1, 3, 1024, 1024]))
    main = {"image_embed" if kind == "sam2" else "image_embeddings": EMBEDDING}
    outputs = {**main, **(HIGH if kind == "sam2" else {})}
    nodes = [op("Identity", name, "picture")]
    if kind == "raw":
        nodes = [
            op("Transpose", name, "channels", perm=[2, 0, 1]),
            constant("at0", [0], np.int64),
            op("Unsqueeze", "channels at0", "picture"),
        ]
    for output, (_, channels, height, width) in outputs.items():
        nodes += [
            constant(f"{output}_size", [1, 3, height, width], np.int64),
            constant(f"{output}_pads", [0, 0, 0, 0, 0, channels - 3, 0, 0], np.int64),
            op("Resize", f"picture   {output}_size".replace("   ", " none none "), f"{output}_small", mode="nearest"),
            op("Pad", f"{output}_small {output}_pads", output),
        ]
    nodes.insert(0, constant("none", []))
    return _model(path, [_value(name, shape)], [_value(*output) for output in outputs.items()], nodes)


def _inside(height: str, width: str) -> Nodes:
    """`logits` [k,h,w] of `points` [k,2,2]: 1 where a pixel's middle is in the box, else -1. Sides: int64 scalars."""
    nodes = [
        constant("i0", 0, np.int64),
        constant("i1", 1, np.int64),
        constant("half", 0.5),
        constant("first", [0], np.int64),
        constant("second", [1], np.int64),
        constant("third", [2], np.int64),
        constant("axis2", [2], np.int64),
        constant("row", [-1, 1, 1], np.int64),
        constant("column", [1, -1, 1], np.int64),
        constant("line", [1, 1, -1], np.int64),
        constant("two", 2.0),
        constant("one", 1.0),
        op("Range", f"i0 {height} i1", "rows_i"),
        op("Cast", "rows_i", "rows_f", to=TensorProto.FLOAT),
        op("Add", "rows_f half", "rows_m"),
        op("Reshape", "rows_m column", "rows"),
        op("Range", f"i0 {width} i1", "columns_i"),
        op("Cast", "columns_i", "columns_f", to=TensorProto.FLOAT),
        op("Add", "columns_f half", "columns_m"),
        op("Reshape", "columns_m line", "columns"),
    ]
    for corner, (start, end) in (("low", ("first", "second")), ("high", ("second", "third"))):
        nodes.append(op("Slice", f"points {start} {end} second", corner))
        for side, (a, b) in (("x", ("first", "second")), ("y", ("second", "third"))):
            nodes += [
                op("Slice", f"{corner} {a} {b} axis2", f"{corner}_{side}_"),
                op("Reshape", f"{corner}_{side}_ row", f"{corner}_{side}"),
            ]
    return [
        *nodes,
        op("Greater", "columns low_x", "a"),
        op("Less", "columns high_x", "b"),
        op("Greater", "rows low_y", "c"),
        op("Less", "rows high_y", "d"),
        op("And", "a b", "ab"),
        op("And", "c d", "cd"),
        op("And", "ab cd", "in"),
        op("Cast", "in", "in_f", to=TensorProto.FLOAT),
        op("Mul", "in_f two", "in_2"),
        op("Sub", "in_2 one", "logits"),
    ]


def _rescaled(height: str, width: str, side: float) -> Nodes:
    """`points` in the picture's own pixels from `scaled` ones, whose longest side is `side`."""
    return [
        op("Max", f"{height} {width}", "longest_i"),
        op("Cast", "longest_i", "longest", to=TensorProto.FLOAT),
        constant("side", side),
        op("Div", "longest side", "factor"),
        op("Mul", "scaled factor", "points"),
    ]


def _sizes(kind: int) -> Nodes:
    return [
        constant("z", [0], np.int64),
        constant("o", [1], np.int64),
        constant("t", [2], np.int64),
        constant("scalar", np.zeros(0), np.int64),
        op("Slice", "orig_im_size z o", "h_"),
        op("Slice", "orig_im_size o t", "w_"),
        op("Squeeze", "h_", "h_s"),
        op("Squeeze", "w_", "w_s"),
        op("Cast", "h_s", "h", to=TensorProto.INT64),
        op("Cast", "w_s", "w", to=TensorProto.INT64),
    ]


def sam_decoder(path: Path, many: bool = False, side: int = SIDE, extra: str = "", masks: int = 2) -> Path:
    """SAM's and MobileSAM's: masks [k,2,h,w], of which the last is the best and holds the box's pixels."""
    k = "k" if many else 1
    nodes = [
        *_sizes(TensorProto.FLOAT),
        op("Identity", "point_coords", "scaled"),
        *_rescaled("h", "w", float(side)),
        *_inside("h", "w"),
        op("Neg", "logits", "wrong"),
        constant("at1", [1], np.int64),
        op("Unsqueeze", "logits at1", "right_1"),
        op("Unsqueeze", "wrong at1", "wrong_1"),
        op("Concat", "wrong_1 " * (masks - 1) + "right_1", "masks", axis=1),
        op("ReduceMax", "point_labels", "label", axes=[1], keepdims=1),
        op("Neg", "label", "low_label"),
        op("Concat", "low_label " * (masks - 1) + "label", "iou_predictions", axis=1),
    ]
    inputs = [
        _value("image_embeddings", [1, "c", "eh", "ew"]),
        _value("point_coords", [k, "n", 2]),
        _value("point_labels", [k, "n"]),
        _value("mask_input", [1, 1, 256, 256]),
        _value("has_mask_input", [1]),
        _value("orig_im_size", [2]),
        *([_value(extra, [1])] if extra else []),
    ]
    outputs = [_value("masks", [k, masks, "h_out", "w_out"]), _value("iou_predictions", [k, masks])]
    return _model(path, inputs, outputs, nodes)


def efficient_decoder(path: Path, points: Any = "n", channels: int = 3) -> Path:
    """EfficientSAM's: points in the picture's own pixels, output_masks [1,q,1,h,w]."""
    nodes = [
        *_sizes(TensorProto.INT64),
        constant("drop", [0], np.int64),
        op("Squeeze", "batched_point_coords drop", "points"),
        *_inside("h", "w"),
        constant("at", [0, 2], np.int64),
        op("Unsqueeze", "logits at", "output_masks"),
        op("ReduceMax", "batched_point_labels", "iou_predictions", axes=[2], keepdims=1),
    ]
    inputs = [
        _value("image_embeddings", ["b", channels, "eh", "ew"]),
        _value("batched_point_coords", ["b", "q", points, 2]),
        _value("batched_point_labels", ["b", "q", points]),
        _value("orig_im_size", [2], TensorProto.INT64),
    ]
    outputs = [_value("output_masks", [1, "q", 1, "mh", "mw"]), _value("iou_predictions", [1, "q", 1])]
    return _model(path, inputs, outputs, nodes)


def small_decoder(path: Path, kind: str, side: int = SIDE, shrink: int = 1) -> Path:
    """SAM 2's or EdgeSAM's: masks in the encoder's square, padding or stretching included, perhaps smaller."""
    k, side = ("k" if kind == "sam2" else 1), side // shrink
    nodes = [
        constant("side_i", side, np.int64),
        constant("shrink", 1 / shrink),
        op("Mul", "point_coords shrink", "points"),
        *_inside("side_i", "side_i"),
        constant("at1", [1], np.int64),
        op("Unsqueeze", "logits at1", "masks"),
        op("ReduceMax", "point_labels", "iou_predictions" if kind == "sam2" else "scores", axes=[1], keepdims=1),
    ]
    names = ["image_embed", "high_res_feats_0", "high_res_feats_1"] if kind == "sam2" else ["image_embeddings"]
    inputs = [
        *(_value(name, [1, "c", "eh", "ew"] if shrink == 1 else HIGH.get(name, EMBEDDING)) for name in names),
        _value("point_coords", [k, "n", 2]),
        _value("point_labels", [k, "n"]),
    ]
    if kind == "sam2":
        inputs += [_value("mask_input", ["k", 1, 256, 256]), _value("has_mask_input", [1])]
    outputs = [_value("masks", [k, 1, side, side]), _value("iou_predictions" if kind == "sam2" else "scores", [k, 1])]
    return _model(path, inputs, outputs, nodes)


WORDS = ("[PAD]", "[UNK]", "[CLS]", "[SEP]", "a", "white", "cup", "chair", "query", ":")
STATES = np.random.default_rng(0).normal(size=(len(WORDS), 5)).round(2)


def sentence_folder(folder: Path, pooling: Mapping[str, Any] | None = None, *, types: bool = True, **more: Any) -> Path:
    """A folder as sentence-transformers writes it: each word has a fixed vector; model, tokenizer, pooling."""
    from tokenizers import Tokenizer, models, normalizers, pre_tokenizers, processors

    tokenizer = Tokenizer(models.WordLevel({word: i for i, word in enumerate(WORDS)}, unk_token="[UNK]"))
    tokenizer.normalizer = normalizers.Lowercase()  # type: ignore[assignment]
    tokenizer.pre_tokenizer = pre_tokenizers.Whitespace()  # type: ignore[assignment]
    tokenizer.post_processor = processors.TemplateProcessing("[CLS] $A [SEP]", None, [("[CLS]", 2), ("[SEP]", 3)])  # type: ignore[assignment]
    tokenizer.enable_padding(length=40)
    folder.mkdir(parents=True, exist_ok=True)
    tokenizer.save(str(folder / "tokenizer.json"))
    for name, content in {"1_Pooling/config.json": pooling or {"pooling_mode_mean_tokens": True}, **more}.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(json.dumps(content))
    inputs = ["input_ids", "attention_mask", *(["token_type_ids"] if types else [])]
    nodes = [constant("table", STATES), op("Gather", "table input_ids", "last_hidden_state")]
    values = [_value(name, ["b", "n"], TensorProto.INT64) for name in inputs]
    _model(folder / "onnx" / "model.onnx", values, [_value("last_hidden_state", ["b", "n", 5])], nodes)
    return folder
