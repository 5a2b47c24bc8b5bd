"""Enc from a sentence-transformers folder: pooled as the folder says, each text on its own, wrong folders told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import graphs
import numpy as np
import pytest
from graphs import STATES, WORDS

from openvox.core.errors import InputError
from openvox.perception.enc.sentences import encoder_in
from openvox.perception.encoder import ENCODERS, encoder


def states(*words: str) -> np.ndarray:
    return np.array([STATES[WORDS.index(word)] for word in ("[CLS]", *words, "[SEP]")])


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


@pytest.mark.parametrize(
    ("pooling", "pooled"),
    [
        ({"pooling_mode_mean_tokens": True, "pooling_mode_cls_token": False}, states("a", "cup").mean(0)),
        ({"pooling_mode_cls_token": True}, states("a", "cup")[0]),
        ({"pooling_mode_max_tokens": True}, states("a", "cup").max(0)),
        ({"pooling_mode": "cls", "include_prompt": True}, states("a", "cup")[0]),
    ],
)
def test_tokens_are_pooled_as_the_folder_says_and_padding_is_no_token(tmp_path, pooling, pooled):
    sentences = encoder_in(graphs.sentence_folder(tmp_path, pooling))
    np.testing.assert_allclose(sentences.encode(["A cup"])[0], unit(pooled), rtol=1e-5)
    assert sentences.dimensions == 5


def test_a_vector_depends_on_its_text_alone(tmp_path):
    sentences = encoder_in(graphs.sentence_folder(tmp_path))
    together = sentences.encode(["a cup", "a white chair", "cup"])
    assert together.dtype == np.float32
    assert (together[1] == encoder_in(tmp_path).encode(["a white chair"])[0]).all()
    assert sentences.encode([]).shape == (0, 5)


def test_a_prefix_comes_before_every_text(tmp_path):
    folder = graphs.sentence_folder(tmp_path)
    with_prefix = encoder_in(folder, prefix="query: ").encode(["a cup"])
    assert (with_prefix == encoder_in(folder).encode(["query: a cup"])).all()
    assert (with_prefix != encoder_in(folder).encode(["a cup"])).any()


def test_a_model_without_token_types_gets_none(tmp_path):
    sentences = encoder_in(graphs.sentence_folder(tmp_path, types=False))
    np.testing.assert_allclose(sentences.encode(["cup"])[0], unit(states("cup").mean(0)), atol=1e-6)


def test_real_weights_in_such_a_folder_give_the_vectors_that_come_with_openvox(tmp_path):
    """MiniLM, the one model of this family that is here with its real weights."""
    from tokenizers import BertWordPieceTokenizer

    shipped = ENCODERS["minilm"]
    BertWordPieceTokenizer(str(shipped / "vocab.txt"), lowercase=True).save(str(tmp_path / "tokenizer.json"))
    (tmp_path / "model.onnx").write_bytes((shipped / "model_int8.onnx").read_bytes())
    captions = ["a white cup", "a grey sofa"]
    np.testing.assert_allclose(encoder_in(tmp_path).encode(captions), encoder("minilm").encode(captions), atol=1e-6)


def test_the_name_is_the_folders_and_the_digest_that_of_model_and_tokenizer(tmp_path):
    first = encoder_in(graphs.sentence_folder(tmp_path / "gte-small"))
    second = encoder_in(graphs.sentence_folder(tmp_path / "other"))
    assert (first.name, second.name) == ("gte-small", "other")
    assert first.model_digest == second.model_digest
    tokenizer = tmp_path / "other" / "tokenizer.json"
    tokenizer.write_text(tokenizer.read_text() + " ")
    assert encoder_in(tmp_path / "other").model_digest != first.model_digest


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (
            {"1_Pooling/config.json": {"pooling_mode_weightedmean_tokens": True}},
            r"pools by weightedmean_tokens, .* expected Transformer, one Pooling",
        ),
        (
            {"1_Pooling/config.json": {"pooling_mode_mean_tokens": True, "pooling_mode_cls_token": True}},
            r"pools by mean_tokens and cls_token",
        ),
        ({"modules.json": [{"type": "sentence_transformers.models.Dense"}]}, r"its modules are Dense; expected"),
        ({"modules.json": {"type": 3}}, r"modules.json or 1_Pooling/config.json cannot be read"),
        ({"tokenizer.json": {"model": "?"}}, r"tokenizer.json: cannot be read as a tokenizer"),
    ],
)
def test_a_folder_that_works_otherwise_is_a_sentence(tmp_path, more: dict[str, Any], sentence):
    import json

    folder = graphs.sentence_folder(tmp_path)
    for name, content in more.items():
        (folder / name).write_text(json.dumps(content))
    with pytest.raises(InputError, match=sentence):
        encoder_in(folder)


def test_a_folder_without_a_model_or_with_one_elsewhere_is_a_sentence(tmp_path: Path):
    folder = graphs.sentence_folder(tmp_path / "a")
    (folder / "onnx" / "model.onnx").rename(tmp_path / "model.onnx")
    with pytest.raises(InputError, match=r"a: there is no model.onnx and no onnx/model.onnx in it; export the model"):
        encoder_in(folder)
    with pytest.raises(InputError, match=r"there is no ../model.onnx in it"):
        encoder_in(folder, "../model.onnx")


def test_a_model_of_another_signature_names_what_was_found(tmp_path):
    folder = graphs.sentence_folder(tmp_path)
    graphs.image_encoder(folder / "onnx" / "model.onnx")
    with pytest.raises(
        InputError, match=r"has inputs input_image float\[1,3,64,64\].*expected input_ids and attention"
    ):
        encoder_in(folder).encode(["cup"])
