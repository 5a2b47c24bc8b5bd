"""Storeys of one piece of furniture: broad segments one above the other with the same outline seen from above.

To depth the boards and book rows of a bookcase are segments each. What is as broad as furniture and stands exactly
above something as broad is built, not put there: a box on a stool is neither."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations

from openvox.perception.bodies import Body

BROAD = 0.5
"""m; smaller things are put on each other."""
SAME = 0.6
"""Of either outline that must lie within the other one."""
MARGIN = 0.04
"""m around an outline that count as within."""
GAP = 0.4
"""m, beyond the noise: the clear height between two boards, and so much may two storeys overlap."""
LEAST = 300
"""Pixels; the outline of fewer is too rough."""


def stacks(bodies: Sequence[Body]) -> Iterator[tuple[int, int]]:
    """Each pair of storeys, as positions in `bodies`."""
    broad = [i for i, body in enumerate(bodies) if len(body.height) >= LEAST and body.width >= BROAD]
    for lower, upper in permutations(broad, 2):
        a, b = bodies[lower], bodies[upper]
        if b.levels[1] < a.levels[1] or abs(b.levels[0] - a.levels[2]) > GAP + a.slack:
            continue
        if min(a.share_within(b, margin=MARGIN), b.share_within(a, margin=MARGIN)) >= SAME:
            yield lower, upper
