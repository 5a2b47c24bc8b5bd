"""SegCap from the user's files: masks exactly where the boxes are, captions of word and colour, wrong files told."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import graphs
import numpy as np
import pytest
from test_models_det import frame_of

from openvox.core.errors import InputError
from openvox.formats.detections import Box
from openvox.perception.onnx import Model
from openvox.perception.parameters import PerceptionParameters
from openvox.perception.segcap.sam import Sam, SamOptions
from openvox.perception.segcap.sam_picture import DEVIATION, MEAN, picture_of
from openvox.perception.segcap.tap import Tap, TapOptions
from openvox.perception.stages import Setting

DECODERS: dict[str, Any] = {
    "sam": lambda path: graphs.sam_decoder(path),
    "many": lambda path: graphs.sam_decoder(path, many=True),
    "raw": lambda path: graphs.sam_decoder(path, side=1024),
    "efficient": graphs.efficient_decoder,
    "sam2": lambda path: graphs.small_decoder(path, "sam2"),
    "edge": lambda path: graphs.small_decoder(path, "edge"),
}


def setting(folder: Path) -> Setting:
    return Setting(None, PerceptionParameters(), "my.toml", folder)  # type: ignore[arg-type]


def sam(folder: Path, kind: str = "sam") -> Sam:
    graphs.image_encoder(folder / "e.onnx", {"many": "sam"}.get(kind, kind))
    DECODERS[kind](folder / "d.onnx")
    return Sam(SamOptions(encoder="e.onnx", decoder="d.onnx"), setting(folder))


def two_things(height: int, width: int) -> np.ndarray:
    rgb = np.full((height, width, 3), 255, np.uint8)
    rgb[: height // 2] = (200, 20, 20)
    return rgb


BOXES = (Box((4, 2, 20, 12), 0.75, "cup"), Box((10, 20, 30, 30), 0.5, "chair"), Box((0, 0, 40, 32), 0.25, ""))


@pytest.mark.parametrize("kind", ["sam", "many", "raw", "efficient"])
@pytest.mark.parametrize(("height", "width"), [(32, 40), (40, 32), (64, 64), (33, 47)])
def test_a_mask_is_exactly_what_the_decoder_says_in_the_pictures_own_pixels(tmp_path, kind, height, width):
    limits = (width, height, width, height)
    corners = [tuple(map(min, box.corners, limits)) for box in BOXES]
    boxes = tuple(Box(inside, 0.5, "cup") for inside in corners)
    masks = sam(tmp_path, kind)(frame_of(two_things(height, width)), boxes)
    assert [mask.box for mask in masks] == [box.corners for box in boxes]
    assert all(mask.crop().all() for mask in masks)


@pytest.mark.parametrize("kind", ["sam2", "edge"])
@pytest.mark.parametrize(("height", "width"), [(64, 64), (32, 64), (64, 32), (128, 64)])
def test_small_masks_of_the_square_are_brought_back_without_its_padding(tmp_path, kind, height, width):
    box = Box((8, 16, 24, 28), 0.5, "cup")  # at every size here its edges are edges of the square's pixels
    (mask,) = sam(tmp_path, kind)(frame_of(two_things(height, width)), (box,))
    # Linear between middles of pixels: the edge, at logit 0, is where the decoder has put it.
    assert mask.box == box.corners
    assert mask.area == 16 * 12


# Sizes as they really are: a square of 1024 pixels, 256 x 64 x 64 embeddings, small masks of 256


REAL_DECODERS: dict[str, Any] = {
    "sam": lambda path: graphs.sam_decoder(path, side=1024, masks=4),
    "many": lambda path: graphs.sam_decoder(path, many=True, side=1024),
    "raw": lambda path: graphs.sam_decoder(path, side=1024, masks=4),
    "efficient": lambda path: graphs.efficient_decoder(path, channels=256),
    "sam2": lambda path: graphs.small_decoder(path, "sam2", 1024, shrink=4),
    "edge": lambda path: graphs.small_decoder(path, "edge", 1024, shrink=4),
}


def real_sam(folder: Path, kind: str) -> Sam:
    encoder = graphs.real_image_encoder(folder / "e.onnx", kind)
    REAL_DECODERS[kind](folder / "d.onnx")
    shapes = {name: shape for name, (_, shape) in Model(encoder).outputs.items()}
    assert shapes["image_embed" if kind == "sam2" else "image_embeddings"] == [1, 256, 64, 64]
    return Sam(SamOptions(encoder="e.onnx", decoder="d.onnx"), setting(folder))


@pytest.mark.parametrize("kind", REAL_DECODERS)
@pytest.mark.parametrize(("height", "width"), [(480, 640), (640, 480), (720, 1280)])
def test_every_family_at_its_real_size_gives_the_box_as_mask(tmp_path, kind, height, width):
    # At all these sizes its edges are edges of pixels of 256 in 1024, stretched or not.
    box = Box((120, 45, 300, 405), 0.5, "cup")
    (mask,) = real_sam(tmp_path, kind)(frame_of(two_things(height, width)), (box,))
    assert mask.box == box.corners
    bitmap = mask.crop()
    if kind in ("sam2", "edge"):  # enlarged linearly, the box loses its corners
        for corner in (bitmap[:3, :3], bitmap[:3, -3:], bitmap[-3:, :3], bitmap[-3:, -3:]):
            corner[:] = True
    assert bitmap.all()


def test_an_export_for_single_points_cannot_take_boxes_and_is_told_what_to_export(tmp_path):
    graphs.image_encoder(tmp_path / "e.onnx", "efficient")
    graphs.efficient_decoder(tmp_path / "d.onnx", points=1)
    with pytest.raises(InputError) as raised:
        Sam(SamOptions(encoder="e.onnx", decoder="d.onnx"), setting(tmp_path)).prepare()
    assert "batched_point_coords float[?,?,1,2]" in str(raised.value)
    assert "expected two points a prompt, the corners of a box, or their number left open in batched" in str(
        raised.value
    )


def test_captions_are_colour_and_word_and_scores_are_the_detectors(tmp_path):
    masks = sam(tmp_path)(frame_of(two_things(32, 40)), BOXES)
    assert [mask.caption for mask in masks] == ["a red cup", "a white chair", "a white and red object"]
    assert [(mask.label, mask.named, mask.kind) for mask in masks] == [
        ("cup", True, "object"),
        ("chair", True, "object"),
        ("object", False, "object"),
    ]
    assert [(mask.score, mask.caption_score) for mask in masks] == [(0.75, 0.75), (0.5, 0.5), (0.25, 0.25)]


def test_a_box_in_which_nothing_is_found_has_no_mask(tmp_path):
    between = Box((5.6, 5.6, 6.4, 6.4), 0.5, "crumb")  # no pixel's middle is in it
    masks = sam(tmp_path)(frame_of(two_things(32, 40)), (BOXES[0], between, BOXES[1]))
    assert [mask.label for mask in masks] == ["cup", "chair"]


def test_no_boxes_run_no_model(tmp_path, monkeypatch):
    stage = sam(tmp_path)
    monkeypatch.setattr(Model, "run", lambda *_, **__: pytest.fail("nothing is to be run"))
    assert stage(frame_of(two_things(32, 40)), ()) == ()


@pytest.mark.parametrize(("kind", "calls"), [("sam", [1, 5]), ("many", [1, 1]), ("efficient", [1, 1])])
def test_the_encoder_runs_once_a_frame_and_the_decoder_as_seldom_as_it_can(tmp_path, monkeypatch, kind, calls):
    stage = sam(tmp_path, kind)
    ran: list[str] = []
    original = Model.run_all
    monkeypatch.setattr(Model, "run_all", lambda self, values: ran.append(self.file.name) or original(self, values))
    stage(frame_of(two_things(32, 40)), (BOXES[0],) * 5)
    assert [ran.count("e.onnx"), ran.count("d.onnx")] == calls


def test_many_boxes_are_done_in_parts_and_come_in_order(tmp_path):
    boxes = tuple(Box((i % 30, i // 30, i % 30 + 3, i // 30 + 2), 0.5, "cup") for i in range(75))
    masks = sam(tmp_path, "many")(frame_of(two_things(32, 40)), boxes)
    assert [mask.box for mask in masks] == [box.corners for box in boxes]


# What the encoder is given


def prepared(tmp_path: Path, kind: str, rgb: np.ndarray) -> Any:
    return picture_of(Model.of_user(graphs.image_encoder(tmp_path / "e.onnx", kind)), rgb)


def test_sam_gets_red_green_blue_normalised_zeros_to_the_right_and_below(tmp_path):
    rgb = np.full((16, 32, 3), (200, 100, 50), np.uint8)
    picture = prepared(tmp_path, "sam", rgb)
    assert picture.array.shape == (1, 3, 64, 64)
    np.testing.assert_allclose(picture.array[0, :, 10, 20], (np.array((200, 100, 50)) - MEAN) / DEVIATION, rtol=1e-5)
    assert (picture.array[0, :, 32:] == 0).all()
    assert picture.scale == (2.0, 2.0)


def test_a_side_that_comes_out_at_a_half_is_rounded_up(tmp_path):
    picture = prepared(tmp_path, "sam", np.zeros((35, 320, 3), np.uint8))  # 64 / 320 * 32.5 would be 6.5
    assert picture.inner == (7, 64)
    assert picture.scale == (64 / 320, 7 / 35)


def test_the_encoder_that_normalises_itself_gets_levels_to_255(tmp_path):
    picture = prepared(tmp_path, "raw", np.full((16, 32, 3), (200, 100, 50), np.uint8))
    assert picture.array.shape == (512, 1024, 3)
    assert picture.array[5, 5].tolist() == [200, 100, 50]


def test_efficient_sam_gets_the_picture_as_it_is_from_0_to_1(tmp_path):
    picture = prepared(tmp_path, "efficient", np.full((17, 31, 3), (255, 51, 0), np.uint8))
    assert picture.array.shape == (1, 3, 17, 31)
    np.testing.assert_allclose(picture.array[0, :, 3, 3], (1, 0.2, 0), rtol=1e-6)
    assert picture.scale == (1.0, 1.0)


def test_sam_2_gets_it_stretched(tmp_path):
    picture = prepared(tmp_path, "sam2", np.full((16, 32, 3), 255, np.uint8))
    assert picture.scale == (2.0, 4.0)
    assert (picture.array[0, 0] > 2).all()


# Wrong files


def test_a_decoder_that_wants_more_is_told_with_what_there_is(tmp_path):
    graphs.image_encoder(tmp_path / "e.onnx")
    graphs.sam_decoder(tmp_path / "d.onnx", extra="temperature")
    with pytest.raises(InputError) as raised:
        Sam(SamOptions(encoder="e.onnx", decoder="d.onnx"), setting(tmp_path)).prepare()
    assert "temperature float[1]" in str(raised.value)
    assert "; the encoder has inputs input_image float[1,3,64,64], outputs image_embeddings" in str(raised.value)


def test_encoder_and_decoder_the_wrong_way_round_are_told(tmp_path):
    graphs.image_encoder(tmp_path / "e.onnx")
    graphs.sam_decoder(tmp_path / "d.onnx")
    with pytest.raises(InputError, match=r"d.onnx has inputs image_embeddings .*expected an image encoder with one"):
        Sam(SamOptions(encoder="d.onnx", decoder="e.onnx"), setting(tmp_path)).prepare()
    with pytest.raises(InputError, match=r"e.onnx has inputs input_image .* expected the decoder that belongs to the"):
        Sam(SamOptions(encoder="e.onnx", decoder="e.onnx"), setting(tmp_path)).prepare()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"decoder": "d.onnx"}, r"my.toml: segcap.encoder is missing; expected the path of a file"),
        (
            {"encoder": "none.onnx"},
            r"my.toml: segcap.encoder is 'none.onnx', but .*none.onnx is not a file; paths count",
        ),
    ],
)
def test_a_file_that_is_not_there_is_a_sentence(tmp_path, options, sentence):
    with pytest.raises(InputError, match=sentence):
        Sam(SamOptions(**options), setting(tmp_path))


# TAP: a stand-in for the authors' package, since neither it nor its weights can be had here


class Tensor:
    """As much of a torch tensor as the adapter touches."""

    def __init__(self, values: Any) -> None:
        self.values = np.asarray(values)

    def __getitem__(self, key: Any) -> Tensor:
        return Tensor(self.values[key])

    def cpu(self) -> Tensor:
        return self

    float = cpu

    def numpy(self) -> np.ndarray:
        return self.values


class FakeTap:
    """Answers a box with the pixels in it as first mask; the other three are wrong. Remembers what it was given."""

    pixel_mean_value = (103.53, 116.28, 123.675)

    def __init__(self) -> None:
        self.text_decoder = SimpleNamespace(reset_cache=lambda max_batch_size: None)
        self.pictures: list[np.ndarray] = []

    def load_state_dict(self, tensors: Any) -> None:
        if tensors != {"weight": 1}:
            raise RuntimeError("Missing key(s) in state_dict: weight")

    def get_inputs(self, inputs: dict[str, Any]) -> dict[str, Any]:
        self.pictures.append(inputs["img"])
        return inputs

    def get_features(self, inputs: Any) -> dict[str, Any]:
        return {"features": len(self.pictures)}

    def get_outputs(self, inputs: Any) -> dict[str, Tensor]:
        assert inputs["features"]
        rows, columns = np.mgrid[:1024, :1024] + 0.5
        masks = []
        for (x0, y0, upper), (x1, y1, lower) in inputs["points"].tolist():
            assert (upper, lower) == (2, 3)
            logits = np.where((columns > x0) & (columns < x1) & (rows > y0) & (rows < y1), 1.0, -1.0)
            masks.append([logits, -logits, -logits, -logits])
        return {"mask_pred": Tensor(np.array(masks, np.float32)), "sem_tokens": Tensor(inputs["points"][:, :1])}

    def upscale_masks(self, masks: Tensor, size: tuple[int, int]) -> Tensor:
        assert size == (1024, 1024)
        return masks

    def generate_text(self, tokens: Tensor) -> np.ndarray:
        return np.array([f" something at {int(row[0, 0])} " for row in tokens.values])


@pytest.fixture
def package(monkeypatch: pytest.MonkeyPatch) -> list[FakeTap]:
    made: list[FakeTap] = []

    def load(path: str, map_location: str, weights_only: bool) -> Any:
        assert weights_only, "a pickle can run anything"
        if Path(path).read_bytes() != b"tensors":
            raise RuntimeError("Weights only load failed.\nmore")
        return {"weight": 1}

    torch = ModuleType("torch")
    torch.__dict__.update(load=load, inference_mode=nullcontext, cuda=SimpleNamespace(is_available=lambda: False))
    tokenize = ModuleType("tokenize_anything")
    tokenize.__dict__["model_registry"] = {"tap_vit_l": lambda: made.append(FakeTap()) or made[-1]}
    for name, module in (("torch", torch), ("tokenize_anything", tokenize), ("flash_attn", ModuleType("flash_attn"))):
        monkeypatch.setitem(sys.modules, name, module)
    return made


def test_tap_answers_boxes_with_masks_and_sentences(tmp_path, package):
    (tmp_path / "w.pt").write_bytes(b"tensors")
    stage = Tap(TapOptions(weights="w.pt"), setting(tmp_path))
    masks = stage(frame_of(two_things(256, 512)), (Box((10, 20, 60, 80), 0.5, "cup"), Box((0, 0, 512, 256), 0.25, "")))
    assert [(mask.box, mask.caption) for mask in masks] == [
        ((10, 20, 60, 80), "something at 20"),
        ((0, 0, 512, 256), "something at 0"),
    ]
    assert [(mask.label, mask.named, mask.score) for mask in masks] == [("cup", True, 0.5), ("object", True, 0.25)]
    (picture,) = package[0].pictures
    assert picture.shape == (1, 1024, 1024, 3)
    assert picture[0, 100, 100].tolist() == [20, 20, 200]  # blue, green, red
    np.testing.assert_allclose(picture[0, 600, 100], FakeTap.pixel_mean_value)
    assert stage(frame_of(two_things(256, 512)), ()) == ()


def test_weights_that_are_more_than_tensors_are_refused(tmp_path, package):
    (tmp_path / "w.pt").write_bytes(b"a pickle")
    with pytest.raises(InputError, match=r"w.pt: cannot be read as tensors only \(Weights only load failed.\); docs/"):
        Tap(TapOptions(weights="w.pt"), setting(tmp_path)).prepare()


def test_an_architecture_that_the_package_lacks_is_a_sentence(tmp_path, package):
    (tmp_path / "w.pt").write_bytes(b"tensors")
    with pytest.raises(InputError, match=r"tokenize-anything has no model tap_vit_h; it has tap_vit_l"):
        Tap(TapOptions(weights="w.pt", model="tap_vit_h"), setting(tmp_path)).prepare()


def test_without_the_authors_package_tap_is_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "flash_attn", None)
    (tmp_path / "w.pt").write_bytes(b"tensors")
    with pytest.raises(
        InputError, match=r"tap needs the packages tokenize-anything, torch and flash-attn .* stage sam"
    ):
        Tap(TapOptions(weights="w.pt"), setting(tmp_path)).prepare()


def test_an_input_of_a_type_that_these_models_do_not_have_is_a_sentence(tmp_path):
    from onnx import TensorProto

    shape = ["h", "w", 3]
    inputs, outputs = ([graphs._value(name, shape, TensorProto.UINT8)] for name in ("input_image", "image_embeddings"))
    graphs._model(tmp_path / "e.onnx", inputs, outputs, [graphs.op("Identity", "input_image", "image_embeddings")])
    graphs.sam_decoder(tmp_path / "d.onnx")
    with pytest.raises(
        InputError, match=r"input_image uint8\[\?,\?,3\].* expected inputs of type float, float16, int32"
    ):
        Sam(SamOptions(encoder="e.onnx", decoder="d.onnx"), setting(tmp_path)).prepare()
