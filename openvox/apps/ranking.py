"""How well each instance of a map answers a text: over all its captions, as often and as surely as they were given."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from openvox.apps.uses import in_short, use_of
from openvox.core.types import InstanceMap

SHARPNESS = 0.035
"""Cosines that differ by less count nearly alike: one caption of ten that fits well is worth more than ten that fit a
little."""
DOUBT = 0.1
"""The support that no caption got, as a share of what sure captions in every view would have: where all that is known
is unsure, or has no noun, the answer falls behind a named one."""


class Encoder(Protocol):
    """Texts to unit vectors."""

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        """(n, dimensions) float32."""


def likeness(result: InstanceMap, encoder: Encoder, texts: Sequence[str]) -> NDArray[np.float64]:
    """(texts, instances), about -1 to 1: how well each instance answers each text.

    A soft maximum over the instance's captions of their likeness to the text, weighted by their support. An instance
    without captions is compared by its feature."""
    queries = encoder.encode(texts)
    out = cosines(result.feature, queries)
    captions = sorted({text for one in result.instances for text, support in one.captions if text and support > 0})
    of_caption = dict(zip(captions, _caption_likeness(captions, encoder, queries), strict=True))
    row_of = {number: row for row, number in enumerate(result.instance_id.tolist())}
    for one in result.instances:
        said = [(text, support) for text, support in one.captions if text in of_caption and support > 0]
        if said:
            row = row_of[one.id]
            support = np.array([support for _, support in said])
            each = np.exp(np.array([of_caption[text] for text, _ in said]) / SHARPNESS)
            share = (support[:, None] * each).sum(0) / (support.sum() + DOUBT * float(result.feature_weight[row]))
            out[:, row] = SHARPNESS * np.log(share)
    return out


def _caption_likeness(captions: Sequence[str], encoder: Encoder, queries: NDArray[np.float32]) -> NDArray[np.float64]:
    """(captions, texts): half the caption's own cosine, half the better one of that and its use's. A dining table is a
    table too: a caption is as like a text as it would be with the shorter noun."""
    own = cosines(queries, encoder.encode(captions))
    shorter = [in_short(caption) for caption in captions]
    longer = [i for i, text in enumerate(shorter) if text]
    if longer:
        own[longer] = np.maximum(own[longer], cosines(queries, encoder.encode([shorter[i] for i in longer])))
    uses = [use_of(caption) for caption in captions]
    known = [i for i, use in enumerate(uses) if use]
    best = own.copy()
    if known:
        best[known] = np.maximum(own[known], cosines(queries, encoder.encode([uses[i] for i in known])))
    result: NDArray[np.float64] = (own + best) / 2
    return result


def cosines(feature: NDArray[np.float32], vectors: NDArray[np.float32]) -> NDArray[np.float64]:
    """(T, K): likeness of each of T texts to each of K instances; summed in float64 in a fixed order."""
    if not len(feature):  # a map without instances need not know how long its features would be
        return np.zeros((len(vectors), 0))
    return np.asarray(np.einsum("td,kd->tk", vectors.astype(np.float64), feature.astype(np.float64), optimize=False))


def ranked(scores: NDArray[np.float64]) -> NDArray[np.int64]:
    """Rows of the instances, the best first, the lower id among equals. scores: (K,), rows ascend by id."""
    return np.argsort(-scores, kind="stable").astype(np.int64)
