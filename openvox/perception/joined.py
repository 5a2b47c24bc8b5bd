"""Segments that are one thing though depth parts them: a stem and what it bears, the storeys of furniture."""

from __future__ import annotations

import numpy as np

from openvox.core.types import Pose
from openvox.perception.bodies import bodies_of
from openvox.perception.parameters import GeometryParameters
from openvox.perception.planes import Room
from openvox.perception.segments import Labels, join, renumbered, root
from openvox.perception.stacks import stacks
from openvox.perception.stems import stems
from openvox.perception.surface import Surface


def joined(
    labels: Labels, pieces: int, surface: Surface, room: Room, pose: Pose, geometry: GeometryParameters
) -> Labels:
    """The labels with what is one thing as one. pieces: labels above it are left-overs; those of them that are too
    small for regions stay only as parts of something."""
    bodies = bodies_of(labels, surface, room, pose, geometry)
    scraps = [i >= pieces and len(body.height) < geometry.residue_pixels for i, body in enumerate(bodies)]
    parent = list(range(len(bodies) + 1))
    for a, b in (*stems(bodies, scraps), *stacks(bodies)):
        join(parent, a + 1, b + 1)
    table = np.array([root(parent, i) for i in range(len(parent))], np.int32)
    whole = np.zeros(len(parent), np.bool_)
    whole[[int(table[i]) for i, scrap in enumerate(scraps, 1) if not scrap]] = True
    whole[0] = False
    return renumbered(table[labels], whole)
