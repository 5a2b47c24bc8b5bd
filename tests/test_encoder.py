"""The shipped sentence encoder: unit vectors that depend on the text alone, and meanings where they belong."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from openvox.core.errors import InputError
from openvox.perception.encoder import ENCODERS, encoder

CAPTIONS = ["a white cup", "a grey sofa", "a brown bookcase", "a red object", "a grey office chair next to a table"]


@pytest.fixture(scope="module")
def minilm():
    return encoder("minilm")


def test_texts_become_rows_of_unit_length(minilm):
    vectors = minilm.encode(CAPTIONS)
    assert vectors.shape == (5, minilm.dimensions) == (5, 384)
    assert vectors.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, atol=1e-6)


def test_no_texts_give_no_rows(minilm):
    assert minilm.encode([]).shape == (0, 384)


def test_a_vector_depends_on_its_text_alone(minilm):
    together = minilm.encode(CAPTIONS)
    alone = np.concatenate([minilm.encode([caption]) for caption in reversed(CAPTIONS)])[::-1]
    assert (together == alone).all()
    fresh = encoder.__wrapped__("minilm").encode(CAPTIONS[::-1])[::-1]
    assert (together == fresh).all()


def test_a_padded_batch_agrees_with_single_calls(minilm):
    tokenizer = minilm._tokenizer
    rows = [tokenizer.encode(caption).ids for caption in CAPTIONS]
    ids = np.zeros((len(rows), max(map(len, rows))), np.int64)
    attention = np.zeros_like(ids)
    for i, row in enumerate(rows):
        ids[i, : len(row)], attention[i, : len(row)] = row, 1
    inputs = {"input_ids": ids, "attention_mask": attention, "token_type_ids": np.zeros_like(ids)}
    states = minilm._model.run(["last_hidden_state"], **inputs)[0].astype(np.float64)
    mean = (states * attention[..., None]).sum(1) / attention.sum(1)[:, None]
    batch = (mean / np.linalg.norm(mean, axis=1, keepdims=True)).astype(np.float32)
    np.testing.assert_allclose(batch, minilm.encode(CAPTIONS), atol=1e-6)


def test_a_use_is_nearest_to_what_it_is_for(minilm):
    cosines = minilm.encode(CAPTIONS) @ minilm.encode(["something to drink coffee from"])[0]
    assert int(np.argmax(cosines)) == 0
    assert cosines[0] == pytest.approx(0.49, abs=0.01)


def test_a_long_text_is_cut_and_an_empty_one_has_a_vector_too(minilm):
    assert (minilm.encode(["chair " * 126])[0] == minilm.encode(["chair " * 500])[0]).all()
    assert np.isfinite(minilm.encode([""])).all()


def test_equal_texts_go_through_the_model_once(minilm):
    before = minilm._vector.cache_info()
    minilm.encode(["a striped elephant"] * 7)
    after = minilm._vector.cache_info()
    assert (after.misses - before.misses, after.hits - before.hits) == (1, 6)


def test_the_digest_is_that_of_the_model_and_its_words(minilm):
    folder = ENCODERS["minilm"]
    both = (folder / "model_int8.onnx").read_bytes() + (folder / "vocab.txt").read_bytes()
    assert minilm.model_digest == hashlib.sha256(both).hexdigest()


def test_an_unknown_encoder_is_a_sentence():
    with pytest.raises(InputError, match=r"there is no encoder 'clip' here .*; known: minilm"):
        encoder("clip")


def test_a_model_that_is_not_there_is_a_sentence(monkeypatch, tmp_path):
    monkeypatch.setitem(ENCODERS, "lost", tmp_path)
    with pytest.raises(InputError, match=r"model_int8.onnx: the model's file cannot be read .*; install openvox again"):
        encoder("lost")
