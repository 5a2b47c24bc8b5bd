"""Which words of a caption are the thing that it speaks of; the rest says where it is, or how it was seen."""

from __future__ import annotations

import re
from functools import lru_cache

_AFTER = re.compile(r"\s+(?:with|on|of(?! drawers)|in|at|under|beside|near|for|that|which)\s", re.IGNORECASE)
"""What follows the thing begins so."""
_BEFORE = re.compile(
    r"^(?:there (?:is|are) )?(?:(?:an?|the) )?"
    r"(?:(?:close ?up|pair|row|set|pile|stack|bunch|group|piece|couple) of (?:(?:an?|the) )?)?",
    re.IGNORECASE,
)
"""What captions say before the thing that they speak of."""
_HOW = {"full", "filled", "next", "made", "covered", "standing", "hanging", "sitting", "lying", "leaning", "mounted"}
"""Words that may stand between the thing and what follows it."""
_IS = {"is", "are"}
COLORS = ("black", "grey", "white", "red", "orange", "yellow", "green", "blue", "purple", "pink", "brown", "beige")
"""Words for colours, by which two things are told apart."""


def words_of_thing(caption: str) -> list[str]:
    """Words up to what follows the thing; what is said before it stays."""
    return _AFTER.split(caption, maxsplit=1)[0].replace(",", " ").split()


def thing(caption: str) -> list[str]:
    """Words of the thing: tall, white, bookcase of "there is a tall white bookcase full of books"."""
    words = words_of_thing(_BEFORE.sub("", " ".join(caption.split()).strip(" .")))
    end = next((i for i, word in enumerate(words) if i and word.lower() in _HOW | _IS), len(words))
    return words[:end]


@lru_cache(4096)
def colors_named(caption: str) -> frozenset[str]:
    """The colours of the thing: white of "a white cup on a red table"."""
    return frozenset(COLORS).intersection(word.lower() for word in thing(caption))


def short_name(caption: str, length: int) -> str:
    """The thing in so many characters: its last words, which name it; a longer word is cut with an ellipsis."""
    words = thing(caption)
    while len(words) > 1 and len(" ".join(words)) > length:
        words = words[1:]
    name = " ".join(words)
    return name if len(name) <= length else name[: length - 1] + "…"
