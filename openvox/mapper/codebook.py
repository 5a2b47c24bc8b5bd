"""What the mapper remembers of each fragment beside its voxels: the codebook, captions, and when it was seen.

A fragment is a piece that nothing has contradicted yet; an instance is one or more fragments. In preset paper they are
the same. Frames are kept as sets, so that "frames in which any of these was matched" is exact for any fragments.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from openvox.core import fixedpoint
from openvox.mapper import equations
from openvox.mapper.frameset import FrameSet

NAMELESS = 32
"""A caption that names nothing counts one in so many: it must not outvote a name."""


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
    captions: dict[str, int] = field(default_factory=dict)
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

    def observe(self, weight: int, feature: NDArray[np.int64] | None, caption: str, support: int) -> None:
        """Enter one mask: codebook by (18) and (19), caption by its support."""
        if feature is not None:
            self.total = equations.fused_feature(self.total, weight, feature)
            self.refresh()
        self.weight = equations.fused_weight(self.weight, weight)
        if caption:
            self.captions[caption] = self.captions.get(caption, 0) + support

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


def memory_of(fragments: Iterable[Fragment]) -> Memory:
    """The fragments' memories as one; at least one fragment."""
    parts = list(fragments)
    captions: dict[str, int] = {}
    matched = FrameSet.union(part.matched for part in parts)
    for part in parts:
        for text, support in part.captions.items():
            captions[text] = captions.get(text, 0) + support
    return Memory(
        total=parts[0].total if len(parts) == 1 else np.sum([part.total for part in parts], axis=0),
        weight=sum(part.weight for part in parts),
        captions=tuple(sorted(captions.items(), key=lambda item: (-item[1], item[0]))),
        matched=len(matched),
        seen=len(FrameSet.union([matched, *(part.seen for part in parts)])),
        score=sum(part.score for part in parts),
        observations=sum(part.observations for part in parts),
        first_frame=min(part.first_frame for part in parts),
        last_frame=max(part.last_frame for part in parts),
        voxels=sum(part.voxels for part in parts),
    )
