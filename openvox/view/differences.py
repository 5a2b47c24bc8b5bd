"""The kinds of differences between two maps, and their colours; without Rerun, which is heavy."""

from __future__ import annotations

SAME, ELSEWHERE, SPLIT, MERGED, GONE, NEW = range(6)
COLORS = ((188, 188, 192), (240, 190, 20), (240, 110, 20), (175, 100, 240), (235, 60, 60), (40, 180, 95))
"""Red, green, blue of each kind, 0 .. 255."""
WORDS = (
    "the same instance in both maps",
    "belongs to another instance, or to none, in the other map",
    "of an instance of A that is in pieces in B",
    "of instances of A that are one in B",
    "of an instance that B lacks",
    "of an instance that A lacks",
)
NAMES = ("grey", "yellow", "orange", "violet", "red", "green")
