"""What the mapper remembers of each fragment beside its voxels: the codebook, captions, and when it was seen.

A fragment is a piece that nothing has contradicted yet; an instance is one or more fragments. In preset paper they are
the same. Frames are kept as sets, so that "frames in which any of these was matched" is exact for any fragments.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from openvox.core import fixedpoint
from openvox.core.types import Mask
from openvox.mapper import equations
from openvox.mapper.frameset import FrameSet

NAMELESS = 32
"""A caption that names nothing counts one in so many: it must not outvote a name."""
NAMED = 8
"""A name has at least one in so many of what a sure name, given in every view, would have. Words that are given rarely,
or never surely, are mostly wrong."""
Said = tuple[str, str]
"""A label, "" = the caption names nothing, and the caption."""


@dataclass(eq=False)
class Fragment:
    """One entry of the codebook; the mapper alone changes it."""

    id: int
    first_frame: int
    last_frame: int
    total: NDArray[np.int64]
    """(D,): sum of w f, w in Q12 and f as rint(127 f)."""
    weight: int = 0
    """W in Q12."""
    captions: dict[Said, int] = field(default_factory=dict)
    """Support of each caption: sum of w times its score, Q12."""
    matched: FrameSet = field(default_factory=FrameSet)
    """The frames, numbered by those looked at, in which a mask held the fragment."""
    seen: FrameSet = field(default_factory=FrameSet)
    score: int = 0
    """Sum of detection scores in Q12, over `observations` masks."""
    observations: int = 0
    voxels: int = 0
    """Voxels whose owner it is."""
    direction: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    """`total` shortened to 20 bits a component, for cosines."""
    square: int = 0

    def observe(self, weight: int, feature: NDArray[np.int64] | None, said: Iterable[tuple[Said, int]]) -> None:
        """Enter one mask: codebook by (18) and (19), captions with their support."""
        if feature is not None:
            self.total = equations.fused_feature(self.total, weight, feature)
            self.refresh()
        self.weight = equations.fused_weight(self.weight, weight)
        for what, support in said:
            self.captions[what] = self.captions.get(what, 0) + support

    def refresh(self) -> None:
        """Derive `direction` and `square` from `total`."""
        self.direction = fixedpoint.shortened(self.total)
        self.square = int(self.direction @ self.direction)

    def forget_frames(self) -> None:
        """Forget when it was seen and how surely, so that frames that come again count once; what it is stays."""
        self.matched, self.seen, self.score, self.observations = FrameSet(), FrameSet(), 0, 0

    def pass_on(self, piece: Fragment) -> None:
        """Tell a piece that is cut off when it was seen: with the whole. What was said of the whole is no memory of it:
        the next masks' captions show whether the two are alike."""
        piece.first_frame = self.first_frame
        piece.matched, piece.seen = self.matched.copy(), self.seen.copy()


@dataclass(frozen=True, eq=False)
class Memory:
    """The codebook entry of an instance, from its fragments."""

    total: NDArray[np.int64]
    weight: int
    caption: str
    named: bool
    captions: tuple[tuple[str, int], ...]
    """Most support first, then by text."""
    matched: int
    """Frames in which a mask held it."""
    seen: int
    """Frames in which it was in view, or matched."""
    score: int
    """Sum of detection scores, Q12, over `observations` masks."""
    observations: int
    first_frame: int
    last_frame: int
    voxels: int


def feature_of(fragments: Sequence[Fragment]) -> tuple[NDArray[np.int64], int]:
    """The codebook feature of an instance from its fragments, shortened to 20 bits, and its square; at least one."""
    if len(fragments) == 1:
        return fragments[0].direction, fragments[0].square
    direction = fixedpoint.shortened(np.sum([part.total for part in fragments], axis=0))
    return direction, int(direction @ direction)


def said_of(mask: Mask, weight: int) -> list[tuple[Said, int]]:
    """The captions of a mask of that credibility (Q12), and their support; one that names nothing has little."""
    label = mask.label or mask.caption if mask.named else ""
    said = [(label, mask.caption, mask.caption_score), *mask.alternatives]
    supports = [weight * round(score * 4096) >> 12 for _, _, score in said]
    return [
        ((label, text), support if label else support // NAMELESS)
        for (label, text, _), support in zip(said, supports, strict=True)
        if text
    ]


def name_of(said: Mapping[Said, int], weight: int) -> tuple[str, bool]:
    """The caption of an instance, and whether it names it. said: support; weight: that of a sure name in every view.

    The label with most support decides, and of its captions that with most; if it has too little to be a name, the best
    caption that names nothing. Equals go by text."""
    labels = _sums((label, support) for (label, _), support in said.items() if label)
    best, support = min(labels.items(), key=_most, default=("", 0))
    named = bool(best) and support * NAMED >= weight
    captions = {text: support for (label, text), support in said.items() if label == (best if named else "")}
    captions = captions or {text: support for (label, text), support in said.items() if label == best}
    return min(captions.items(), key=_most, default=("", 0))[0], named


def _sums(items: Iterable[tuple[str, int]]) -> dict[str, int]:
    out: dict[str, int] = {}
    for text, support in items:
        out[text] = out.get(text, 0) + support
    return out


def _most(item: tuple[str, int]) -> tuple[int, str]:
    """Sorts by support, most first, then by text."""
    return -item[1], item[0]


def memory_of(fragments: Iterable[Fragment]) -> Memory:
    """The fragments' memories as one; at least one fragment."""
    parts = list(fragments)
    said: dict[Said, int] = {}
    matched = FrameSet.union(part.matched for part in parts)
    for part in parts:
        for what, support in part.captions.items():
            said[what] = said.get(what, 0) + support
    weight = sum(part.weight for part in parts)
    caption, named = name_of(said, weight)
    return Memory(
        total=parts[0].total if len(parts) == 1 else np.sum([part.total for part in parts], axis=0),
        weight=weight,
        caption=caption,
        named=named,
        captions=tuple(sorted(_sums((text, support) for (_, text), support in said.items()).items(), key=_most)),
        matched=len(matched),
        seen=len(FrameSet.union([matched, *(part.seen for part in parts)])),
        score=sum(part.score for part in parts),
        observations=sum(part.observations for part in parts),
        first_frame=min(part.first_frame for part in parts),
        last_frame=max(part.last_frame for part in parts),
        voxels=sum(part.voxels for part in parts),
    )
