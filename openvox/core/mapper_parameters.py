"""All parameters of the mapper, and the presets as named sets of them.

`paper` is the plain method of the OpenVox paper; `openvox` adds rules, each with a switch of its own. With every
switch off, `openvox` is `paper`, digest and all (a test holds this). `official` makes the choices of the authors' code.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from openvox.core.errors import InputError
from openvox.core.parameters import parameter


@dataclass(frozen=True, kw_only=True)
class MapParameters:
    voxel_size: float = parameter(0.04, "m", 0.002, 1.0, why="edge of a voxel; the paper's 4 cm")
    max_depth: float = parameter(6.0, "m", 0.1, 65.0, why="depth beyond it is ignored: noise grows with its square")


@dataclass(frozen=True, kw_only=True)
class MaskParameters:
    min_pixels: int = parameter(60, "px", 0, 1_000_000, why="smaller masks are skipped: mostly fragments of noise")
    one_vote: bool = parameter(
        True, "", why="the smaller mask wins a pixel, and a voxel takes one label a frame: doubles must not vote twice"
    )
    erosion: int = parameter(
        0,
        "px",
        0,
        20,
        needs="masks.one_vote",
        why="pixels this near to another label vote for nothing; small things are all rim, so none by default",
    )
    step_margin: int = parameter(
        3, "px", 0, 20, needs="masks.one_vote", why="pixels this near to a depth step (60 mm + 2 %) vote for nothing"
    )
    disjoint: bool = parameter(
        False,
        "",
        without="masks.one_vote",
        why="the smaller mask wins a pixel, but a voxel may lie under several; authors' code",
    )
    window: int = parameter(
        2,
        "px",
        0,
        20,
        needs="masks.disjoint",
        why="a mask keeps the pixels whose square of this radius lies in it, and must keep min_pixels; authors' code",
    )
    inliers: bool = parameter(
        False,
        "",
        needs="masks.disjoint",
        why="a mask's voxels whose ten nearest lie farther than the mean by two deviations are left out; authors' code",
    )


@dataclass(frozen=True, kw_only=True)
class AssociationParameters:
    threshold: float = parameter(
        0.4,
        "probability",
        0.0,
        1.0,
        why="a mask joins its best instance if A exceeds it; authors' code, the paper gives none",
    )
    weight_geometry: float = parameter(0.8, "share", 0.0, 1.0, why="of S_geo in A; authors' code")
    weight_feature: float = parameter(0.2, "share", 0.0, 1.0, why="of S_fea in A; authors' code")
    containment: bool = parameter(
        True, "", why="a mask holds what lies in it and what it lies in; S_geo alone falls with every newly seen voxel"
    )
    hidden_evidence: int = parameter(
        4,
        "factor",
        1,
        16,
        needs="evolution.background",
        why="for association a voxel keeps its id while factor x count > background; 1 = as in the output",
    )
    one_by_one: bool = parameter(
        False,
        "",
        without="association.containment",
        why="the masks of a frame, large to small, each meet the map with the votes of those before; authors' code",
    )
    slots: int = parameter(
        0,
        "ids",
        0,
        1000,
        needs="association.one_by_one",
        why="a voxel counts so many ids, first come, first kept; later ones are nameless votes; 0 = no limit",
    )


@dataclass(frozen=True, kw_only=True)
class EvolutionParameters:
    background: bool = parameter(
        True, "", why="a voxel seen under no mask votes for background; without it spill can never be undone"
    )
    halving: int = parameter(
        100,
        "votes",
        0,
        1_000_000,
        needs="evolution.background",
        why="above so many votes a voxel halves its counts; 0 = never",
    )
    voxel_votes: bool = parameter(
        True, "", needs="association.containment", why="a voxel votes for its own fragment if the mask holds it"
    )
    abstention: bool = parameter(
        True,
        "",
        needs="lifecycle.evidence",
        why="where a mask holds fragments that the evidence keeps apart, undecided voxels do not vote: no welding",
    )
    near: float = parameter(
        6.0,
        "m",
        0.0,
        100.0,
        why="a vote counts near / distance, rounded down, from 1 to 4: what is near is seen finer; 0 = all count 1",
    )
    cut: bool = parameter(
        True, "", needs="lifecycle.evidence", why="a fragment under two masks is cut: a weld is undone in the map"
    )
    cut_share: float = parameter(
        0.03,
        "share",
        0.0,
        1.0,
        needs="evolution.cut",
        why="least share of the fragment's masked voxels on either side of a cut",
    )
    cut_inheritance: float = parameter(
        1.1,
        "factor",
        0.0,
        100.0,
        needs="evolution.cut",
        why="togetherness of the two sides, times the mean moved votes: about what they had counted as two from the start",
    )
    cut_least: int = parameter(
        20,
        "counts",
        0,
        1_000_000,
        needs="evolution.cut",
        why="togetherness of the two sides at least: ten frames apart undo it, and a detector splits a thing for fewer",
    )
    veto: bool = parameter(
        False,
        "",
        without="evolution.background",
        why="a voxel seen more often under no mask than voted for shows nothing; the simplest cure for spill",
    )


@dataclass(frozen=True, kw_only=True)
class LifecycleParameters:
    evidence: bool = parameter(
        True,
        "",
        needs="association.containment",
        why="fragments seen together and apart are counted, and clustered into instances by the counts",
    )
    contradiction: float = parameter(
        1.0, "factor", 0.0, 100.0, needs="lifecycle.evidence", why="weight of apart against together"
    )
    halving: int = parameter(
        200,
        "counts",
        0,
        1_000_000,
        needs="lifecycle.evidence",
        why="above so many counts of a pair, together and apart are halved: a camera that stands still proves nothing for ever; "
        "0 = never",
    )
    nested: float = parameter(
        0.7,
        "share",
        0.0,
        1.0,
        needs="lifecycle.evidence",
        why="masks nested to this share contradict each other half as much",
    )
    omission: int = parameter(
        2,
        "counts",
        0,
        16,
        needs="lifecycle.evidence",
        why="apart, where a mask covers one fragment and leaves its neighbour in view out; 0 = says nothing",
    )
    captions: bool = parameter(True, "", needs="lifecycle.evidence", why="unlike captions weaken togetherness")
    kinds: bool = parameter(
        True,
        "",
        needs="lifecycle.evidence",
        why="evidence by kind of mask: two regions contradict each other half, or not at all where the frame has other masks; "
        "what stands on a support twice; a detector's mask joins threefold where the frame has regions too",
    )
    colors: bool = parameter(
        True,
        "",
        needs="lifecycle.kinds",
        why="two regions, or two that stand on something, whose captions share no colour contradict each other half: "
        "pieces of one thing are mostly of one colour",
    )
    clear_pixels: int = parameter(
        1000,
        "px",
        0,
        1_000_000,
        needs="lifecycle.kinds",
        why="together in a frame with regions counts half below it: from afar small things are one with what they are on",
    )


@dataclass(frozen=True, kw_only=True)
class FinishParameters:
    smoothing: int = parameter(
        3,
        "weight",
        0,
        100,
        why="a voxel decides on weight x its own counts + those of its six neighbours; 0 = on its own alone",
    )
    rounds: int = parameter(
        2,
        "rounds",
        0,
        100,
        why="at borders of things and background voxels decide again so often, on own counts and what neighbours show",
    )
    min_votes: int = parameter(0, "votes", 0, 1_000_000, why="a voxel with fewer votes shows nothing; authors' code: 4")
    existence: bool = parameter(True, "", why="objects that too few frames matched are dropped")
    min_frames: int = parameter(
        2, "frames", 0, 1000, needs="finish.existence", why="matched frames an object must have"
    )
    brief: bool = parameter(
        True,
        "",
        needs="finish.existence",
        why="what fewer frames than min_frames saw must be matched in all of them: a slow detector loses nothing",
    )
    min_share: float = parameter(
        0.15,
        "share",
        0.0,
        1.0,
        needs="finish.existence",
        why="of the frames that saw it, an object must be matched in so many",
    )
    min_voxels: int = parameter(10, "voxels", 0, 1_000_000, needs="finish.existence", why="smaller objects are dropped")
    min_part: float = parameter(
        0.05,
        "share",
        0.0,
        1.0,
        needs="finish.existence",
        why="loose parts below this share of their object are dropped",
    )
    holes: float = parameter(
        0.05,
        "share",
        0.0,
        1.0,
        why="a patch that shows nothing, with one object alone around it and at most so much of its voxels, is of it; 0 = no",
    )
    min_confidence: float = parameter(
        0.22, "confidence", 0.0, 1.0, needs="finish.existence", why="phantoms are judged as objects, not voxel by voxel"
    )
    ranking: str = parameter(
        "overlap",
        "",
        choices=("share", "matches", "existence", "overlap"),
        needs="finish.existence",
        why="confidence: mean share of votes; times k/(k+2) of k frames matched; how surely it exists; or how much of it is "
        "right, as errors lie at the outline",
    )


@dataclass(frozen=True, kw_only=True)
class MapperParameters:
    """Everything the mapper can be told, in groups."""

    map: MapParameters = field(default_factory=MapParameters)
    masks: MaskParameters = field(default_factory=MaskParameters)
    association: AssociationParameters = field(default_factory=AssociationParameters)
    evolution: EvolutionParameters = field(default_factory=EvolutionParameters)
    lifecycle: LifecycleParameters = field(default_factory=LifecycleParameters)
    finish: FinishParameters = field(default_factory=FinishParameters)


OPENVOX = MapperParameters()
PAPER = MapperParameters(
    masks=replace(OPENVOX.masks, min_pixels=0, one_vote=False),
    association=replace(OPENVOX.association, containment=False),
    evolution=replace(OPENVOX.evolution, background=False, voxel_votes=False, abstention=False, near=0.0, cut=False),
    lifecycle=replace(OPENVOX.lifecycle, evidence=False, captions=False, kinds=False, colors=False),
    finish=replace(OPENVOX.finish, smoothing=0, rounds=0, existence=False, brief=False, holes=0.0),
)
OFFICIAL = replace(
    PAPER,
    masks=replace(PAPER.masks, min_pixels=100, disjoint=True, inliers=True),
    association=replace(PAPER.association, one_by_one=True, slots=3),
    finish=replace(
        PAPER.finish, existence=True, min_votes=4, min_frames=3, min_share=0.0, min_voxels=15, min_part=0.0,
        min_confidence=0.0, ranking="share",
    ),
)  # fmt: skip
PRESETS = {"openvox": OPENVOX, "official": OFFICIAL, "paper": PAPER}


def preset(name: str) -> MapperParameters:
    """The preset of that name. Raises InputError."""
    if name not in PRESETS:
        raise InputError(f"there is no preset {name!r}; known: {', '.join(PRESETS)}")
    return PRESETS[name]
