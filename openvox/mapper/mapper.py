"""The mapper: associate, then evolve. One instance is one map; `step` is the only thing that changes it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import replace
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from openvox.core import fixedpoint
from openvox.core.errors import InputError
from openvox.core.mapper_parameters import MapperParameters
from openvox.core.types import Decision, Event, Frame, InstanceMap, Mask, Step, VoxelChanges
from openvox.core.voxels import voxel_key
from openvox.mapper import state
from openvox.mapper.associate import Association, associate_frame
from openvox.mapper.codebook import Fragment, said_of
from openvox.mapper.cut import Nesting, count_omissions, count_pairs, cuts
from openvox.mapper.engines.engine import Engine, Look, Region
from openvox.mapper.engines.pixels import EMPTY
from openvox.mapper.equations import FULL_WEIGHT
from openvox.mapper.evidence import Evidence
from openvox.mapper.finish import finished_map
from openvox.mapper.life import Life

MIN_SEEN = 4
"""Voxels of a fragment that must be in view for a frame to count as having seen it."""
Features = Sequence[NDArray[np.int64] | None]


class Stopwatch(Protocol):
    """Told when a stage of a step begins; the mapper itself knows no clock."""

    def lap(self, stage: str) -> None:
        """`stage` begins: masks, project, associate, evolve, or "" at the end."""


class Mapper:
    """The probabilistic voxel map of the OpenVox paper, with the rules that its parameters switch on."""

    def __init__(self, parameters: MapperParameters, stopwatch: Stopwatch | None = None, engine: str = "cpu") -> None:
        self.parameters = parameters
        self._engine = Engine(parameters, engine)
        self._watch = stopwatch
        self._fragments: dict[int, Fragment] = {}
        self._evidence = Evidence(parameters.lifecycle)
        self._life = Life(parameters.finish)
        self._looked = 0
        self._dimensions: int | None = None
        self._untold = False  # voxels of an earlier run, which no step has told yet

    @property
    def voxels(self) -> int:
        """Voxels of the map."""
        return self._engine.voxels

    @property
    def fragments(self) -> int:
        """Fragments that were ever founded or cut off."""
        return len(self._fragments)

    @property
    def bytes(self) -> int:
        """Memory of the voxels and their votes."""
        return self._engine.bytes

    def step(self, frame: Frame, masks: Sequence[Mask] | None) -> Step:
        """Associate the frame's masks with the map before it, then let the map evolve.

        The first step of a resumed mapper tells the whole map as its changes, so that observers begin with all of it.
        masks: None if perception did not look at this frame (nothing changes), () if it looked and found nothing.
        Raises InputError if the frame leaves the map's range or a mask does not fit the colour picture."""
        if masks is None:
            return self._result(frame, (), False, (), (), _no_changes(self._engine.voxels))
        self._check(frame, masks)
        self._lap("masks")
        large = [mask if mask.area >= self.parameters.masks.min_pixels else None for mask in masks]
        painted = self._engine.label_image(large, frame.rig)
        kept = painted.masks
        self._lap("project")
        region = self._engine.observe(frame, painted)
        self._lap("associate")
        look = self._engine.look(region, len(self._fragments))
        features = [None if mask.embedding is None else fixedpoint.quantised(mask.embedding) for mask in masks]
        if self.parameters.association.one_by_one:
            associations, abstained, events = self._one_by_one(frame, masks, kept, features, region)
            pieces: list[int] = []
        else:
            associations = self._associate(kept, features, region, look)
            self._lap("evolve")
            nesting = Nesting(kept, self.parameters.lifecycle.nested)
            events = self._found(frame, masks, associations)
            look, pieces = self._cut(frame, kept, associations, region, look, nesting, events)
            self._count_pairs(kept, associations, nesting, look)
            abstained = self._vote(region, look, associations)
            self._learn(frame, masks, features, associations)
        changes = self._settle(region, look)
        self._see(look)
        touched = self._cluster(associations, pieces)
        events += self._life.follow(frame.index, self._evidence, self._fragments, touched)
        self._looked += 1
        self._lap("")
        decisions = tuple(self._decision(one, abstained) for one in associations)
        return self._result(frame, tuple(masks), True, decisions, tuple(events), changes)

    def finish(self) -> InstanceMap:
        """The map as it stands; no vote is altered, and mapping may go on."""
        return self._finishing(self._fragments, self._life)()

    def frozen(self) -> Callable[[], InstanceMap]:
        """What makes the map as it stands now, later and in any thread: mapping may go on meanwhile. It takes
        milliseconds itself, where to finish a large map takes a tenth of a second."""
        return self._finishing(deepcopy(self._fragments), deepcopy(self._life))

    def _finishing(self, fragments: dict[int, Fragment], life: Life) -> Callable[[], InstanceMap]:
        keys, row, fragment, count = self._engine.votes()
        votes, instance_of = (keys.copy(), row, fragment, count), dict(self._evidence.instance_of)
        dimensions = self._dimensions or 0
        kept = {
            "key": votes[0],
            **state.fragment_arrays(fragments, dimensions),
            **state.evidence_arrays(self._evidence),
            **state.life_arrays(life, self._looked, self._dimensions),
        }
        parameters = self.parameters
        return lambda: replace(finished_map(votes, fragments, instance_of, life, dimensions, parameters), state=kept)

    def look_again(self) -> None:
        """Begin a pass over the same frames: the map stays, as the prior, but frames count anew, each once.

        The next step tells the whole map as its changes, as that of a resumed mapper does."""
        for fragment in self._fragments.values():
            fragment.forget_frames()
        self._life.confirmed.clear()
        self._looked, self._untold = 0, True

    @classmethod
    def resumed(
        cls,
        earlier: InstanceMap,
        parameters: MapperParameters,
        stopwatch: Stopwatch | None = None,
        engine: str = "cpu",
    ) -> Self:
        """A mapper that goes on where `earlier` stopped; the parameters must be those of its run.

        Raises InputError if the map has no state, or one of another version."""
        mapper = cls(parameters, stopwatch, engine)
        try:
            mapper._looked, mapper._dimensions = state.restore_life(mapper._life, earlier.state)
            mapper._fragments = state.restored_fragments(earlier.state)
            keys = earlier.state["key"]
            _check_state(earlier, keys, len(mapper._fragments))
            number = np.argsort(keys)[np.searchsorted(np.sort(keys), voxel_key(earlier.voxel_index.astype(np.int64)))]
            row = np.repeat(number, np.diff(earlier.vote_offset)).astype(np.int32)
            mapper._engine.restore(keys, row, earlier.vote_fragment, earlier.vote_count)
            mapper._untold = True
            state.restore_evidence(mapper._evidence, earlier.state, mapper._fragments)
        except (KeyError, ValueError, IndexError, TypeError) as error:
            raise InputError(f"the map holds no state to resume from ({error}); replay from the beginning") from None
        return mapper

    def _lap(self, stage: str) -> None:
        if self._watch is not None:
            self._watch.lap(stage)

    def _check(self, frame: Frame, masks: Sequence[Mask]) -> None:
        camera = frame.rig.color
        for m, mask in enumerate(masks):
            if mask.box[2] > camera.width or mask.box[3] > camera.height:
                raise InputError(
                    f"frame {frame.index}, mask {m}: its box {mask.box} leaves the colour image of "
                    f"{camera.width}x{camera.height}; was it made for another recording?"
                )
            dimensions = 0 if mask.embedding is None else len(mask.embedding)
            if self._dimensions not in (None, dimensions):
                raise InputError(
                    f"frame {frame.index}, mask {m}: its embedding has {dimensions} numbers, earlier ones "
                    f"{self._dimensions}; run perceive with one encoder for the whole recording"
                )
            self._dimensions = dimensions

    def _associate(
        self, kept: Sequence[Mask | None], features: Features, region: Region, look: Look
    ) -> list[Association]:
        return associate_frame(
            kept, features, region.voxels_of_mask, look.fragments, look.theta_sum, look.overlap,
            self._fragments, self._evidence.instance_of, self._evidence.members, self.parameters,
        )  # fmt: skip

    def _one_by_one(
        self,
        frame: Frame,
        masks: Sequence[Mask],
        kept: Sequence[Mask | None],
        features: Features,
        region: Region,
    ) -> tuple[list[Association], NDArray[np.int64], list[Event]]:
        """Large to small, each mask meets the map with the votes of those before; what lies under none comes last."""
        order = sorted(range(len(masks)), key=lambda m: (-masks[m].area, m))
        done: dict[int, Association] = {}
        abstained, events = np.zeros(len(masks) + 1, np.int64), []
        for m in [*order, len(masks)]:
            part = region.under(m)
            look = self._engine.look(part, len(self._fragments))
            alone = [mask if i == m else None for i, mask in enumerate(kept)]
            here = self._associate(alone, features, part, look)[m : m + 1]
            events += self._found(frame, masks, here)
            abstained += self._vote(part, look, here or list(done.values()))
            self._learn(frame, masks, features, here)
            done.update((one.mask, one) for one in here)
        return [done[m] for m in range(len(masks))], abstained, events

    # ---- evolution ---------------------------------------------------------------------------------------------------

    def _found(self, frame: Frame, masks: Sequence[Mask], associations: Sequence[Association]) -> list[Event]:
        """Masks that hold nothing found fragments, numbered by area (down), then position."""
        events = []
        new = [one for one in associations if one.by == "new"]
        for one in sorted(new, key=lambda one: (-masks[one.mask].area, one.mask)):
            one.main = self._new_fragment(frame)
            one.held = {one.main}
            events.append(Event(frame.index, "new", one.main, (), f"mask {one.mask} holds nothing that the map knows"))
        return events

    def _new_fragment(self, frame: Frame) -> int:
        f = len(self._fragments) + 1
        self._fragments[f] = Fragment(f, frame.index, frame.index, np.zeros(self._dimensions or 0, np.int64))
        self._evidence.add_fragment(f)
        return f

    def _cut(
        self,
        frame: Frame,
        kept: Sequence[Mask | None],
        associations: Sequence[Association],
        region: Region,
        look: Look,
        nesting: Nesting,
        events: list[Event],
    ) -> tuple[Look, list[int]]:
        """Move votes of a fragment that lies under two masks to a new fragment under the smaller one.

        Returns the map after it, and the fragments that were cut and cut off."""
        changed: list[int] = []
        if not self.parameters.evolution.cut:
            return look, changed
        inheritance = fixedpoint.millionths(self.parameters.evolution.cut_inheritance)
        for cut in cuts(
            kept, associations, region.voxels_of_mask, look.fragments, look.overlap, nesting, self.parameters
        ):
            piece = self._new_fragment(frame)
            self._fragments[cut.fragment].pass_on(self._fragments[piece])
            voxels, votes = self._engine.move(region, look, cut.mask, cut.fragment, piece)
            changed += [cut.fragment, piece]
            one = associations[cut.mask]
            one.held = (one.held - {cut.fragment}) | {piece}
            if one.main == cut.fragment:
                one.main, one.by = piece, "cut"
                one.visibility, one.credibility = fixedpoint.Q20, FULL_WEIGHT
            inherited = inheritance * votes // (fixedpoint.MILLION * max(1, voxels))
            inherited = max(inherited, self.parameters.evolution.cut_least)
            self._evidence.add_together(cut.fragment, piece, inherited)
            instance = self._evidence.instance_of[cut.fragment]
            text = f"it lies under masks {cut.keeper} and {cut.mask}: {voxels} voxels go to fragment {piece}"
            events.append(Event(frame.index, "cut", instance, (piece,), text))
        if changed:
            owner = look.owner
            look = self._engine.look(region, len(self._fragments))
            look.owner = owner
        return look, changed

    def _count_pairs(
        self, kept: Sequence[Mask | None], associations: Sequence[Association], nesting: Nesting, look: Look
    ) -> None:
        lifecycle = self.parameters.lifecycle
        if lifecycle.evidence:
            count_pairs(kept, associations, look.fragments, look.overlap, nesting, self._evidence, lifecycle)
            if lifecycle.omission:
                count_omissions(kept, associations, look.fragments, look.overlap, self._evidence, lifecycle)

    def _vote(self, region: Region, look: Look, associations: Sequence[Association]) -> NDArray[np.int64]:
        """Every (voxel, mask) pair votes; returns how many voxels of each mask abstained."""
        column = {f: c for c, f in enumerate(look.fragments.tolist())}
        held = np.zeros((region.masks, len(column)), np.bool_)
        main = np.full(region.masks, EMPTY, np.int32)
        undecided = np.zeros(region.masks, np.bool_)
        for one in associations:
            held[one.mask, [column[f] for f in sorted(one.held) if f in column]] = True
            main[one.mask] = one.main or EMPTY
            undecided[one.mask] = self._is_undecided(one)
        return self._engine.vote(region, look, held, main, undecided)

    def _settle(self, region: Region, look: Look) -> VoxelChanges:
        """The votes of the frame are counted: fragments learn the voxels that they won and lost."""
        changes, owner = self._engine.settle(region, look)
        for ids, sign in ((look.owner, -1), (owner, 1)):
            won, voxels = np.unique(ids[look.owner != owner], return_counts=True)
            for f, n in zip(won.tolist(), voxels.tolist(), strict=True):
                if f:
                    self._fragments[f].voxels += sign * n
        return changes

    def _is_undecided(self, one: Association) -> bool:
        if not self.parameters.evolution.abstention:
            return False
        held = sorted(one.held)
        return any(self._evidence.kept_apart(f, g) for i, f in enumerate(held) for g in held[i + 1 :])

    def _see(self, look: Look) -> None:
        """Which fragments were in view."""
        for f, voxels in zip(look.fragments.tolist(), look.overlap.sum(0).tolist(), strict=True):
            if voxels >= MIN_SEEN:
                self._fragments[f].seen.add(self._looked)

    def _learn(
        self, frame: Frame, masks: Sequence[Mask], features: Features, associations: Sequence[Association]
    ) -> None:
        """What the masks add to the fragments' memories: features, captions, scores, when they were matched."""
        for one in associations:
            if not one.main:
                continue
            mask, fragment = masks[one.mask], self._fragments[one.main]
            fragment.observe(one.credibility, features[one.mask], said_of(mask, one.credibility))
            fragment.score += round(mask.score * 4096)
            fragment.observations += 1
            for f in sorted(one.held):
                self._fragments[f].matched.add(self._looked)
                self._fragments[f].last_frame = frame.index

    def _cluster(self, associations: Sequence[Association], pieces: Sequence[int]) -> list[int]:
        """Instances from the evidence so far; returns the fragments that the frame changed. pieces: of cuts."""
        changed = sorted({f for one in associations for f in one.held} | set(pieces))
        if self.parameters.lifecycle.evidence:
            self._evidence.update(changed, self._fragments)
        return changed

    # ---- results -----------------------------------------------------------------------------------------------------

    def _decision(self, one: Association, abstained: NDArray[np.int64]) -> Decision:
        chosen = one.chosen if one.by in ("containment", "threshold") else None
        return Decision(
            mask=one.mask,
            by=one.by,
            instance=self._evidence.instance_of[one.main] if one.main else 0,
            fragment=one.main,
            held=tuple(sorted(one.held)),
            voxels=one.voxels,
            abstained=int(abstained[one.mask]),
            s_geo=chosen.s_geo if chosen else 0,
            s_fea=chosen.s_fea if chosen else 0,
            a=chosen.a if chosen else 0,
            threshold=fixedpoint.q20(self.parameters.association.threshold),
            visibility=one.visibility if one.main else 0,
            credibility=one.credibility if one.main else 0,
            candidates=one.candidates,
        )

    def _result(
        self,
        frame: Frame,
        masks: tuple[Mask, ...],
        looked: bool,
        decisions: tuple[Decision, ...],
        events: tuple[Event, ...],
        changes: VoxelChanges,
    ) -> Step:
        if self._untold:
            changes, self._untold = self._engine.whole(), False
        instance_of = self._evidence.snapshot()
        return Step(frame, masks, looked, decisions, events, changes, instance_of, self._engine.voxels)


def _check_state(earlier: InstanceMap, keys: NDArray[np.int64], fragments: int) -> None:
    """Raises ValueError where the state is not that of the map's votes."""
    if not np.isin(voxel_key(earlier.voxel_index.astype(np.int64)), keys).all():
        raise ValueError("its voxels are not those of the map")
    if earlier.vote_fragment.max(initial=0) > fragments:
        raise ValueError("it knows fewer fragments than the votes")


def _no_changes(voxels: int) -> VoxelChanges:
    none = np.zeros(0, np.int32)
    return VoxelChanges(voxels, np.zeros((0, 3), np.int32), none, none, none, none, none, none)
