"""Sets of frames: as Python's sets, but small however long the recording."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from strategies import rectangle, wall

from openvox.core.mapper_parameters import OPENVOX
from openvox.core.parameters import updated
from openvox.core.types import Pose
from openvox.mapper.frameset import BITS, FrameSet
from openvox.mapper.mapper import Mapper

FRAMES = st.sets(st.integers(0, 5 * BITS))


def frameset(frames: set[int]) -> FrameSet:
    out = FrameSet()
    for frame in frames:
        out.add(frame)
    return out


@given(sets=st.lists(FRAMES, max_size=4))
def test_it_counts_and_unites_as_sets_do(sets: list[set[int]]) -> None:
    made = [frameset(one) for one in sets]
    assert [len(one) for one in made] == [len(one) for one in sets]
    assert len(FrameSet.union(made)) == len(set().union(*sets))
    assert FrameSet.union(made).blocks == frameset(set().union(*sets)).blocks


def test_a_copy_is_a_set_of_its_own() -> None:
    first = frameset({1})
    second = first.copy()
    second.add(2)
    assert (len(first), len(second)) == (1, 2)


def test_a_late_frame_costs_no_more_than_an_early_one() -> None:
    assert [len(frameset({frame}).blocks) for frame in (0, 10**9)] == [1, 1]


def test_what_a_map_keeps_does_not_grow_with_frames_that_see_other_places() -> None:
    mapper = Mapper(updated(OPENVOX, {"masks.min_pixels": 0, "masks.erosion": 0}, source="test"))
    sizes = []
    for i in range(2 * BITS):
        away = Pose((0.0, 0.0, 0.0, 1.0), (0.0 if i < 2 else 50.0, 0.0, 0.0))
        mapper.step(wall(i, pose=away), (rectangle(0, 0, 8, 10),) if i < 2 else ())
        if i in (2, 2 * BITS - 1):
            sizes.append(sum(array.nbytes for array in mapper.finish().state.values()))
    assert sizes[0] == sizes[1]
