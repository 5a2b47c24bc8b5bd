"""The things that travel through openvox: frames, masks, decisions, steps, maps.

All are frozen and checked at construction. Frames of reference: `world` (metres, z up by convention),
`camera_depth` (x right, y down, z forward) and `camera_color` likewise. A transform named
`world_from_camera` takes camera coordinates to world coordinates (a camera-to-world pose).

Fixed point: a number "in Q20" is an integer holding value * 2**20.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from openvox.core.errors import InputError

DepthImage = NDArray[np.uint16]
"""(height, width), millimetres along the camera's z axis, 0 = no measurement."""
IdImage = NDArray[np.uint16]
"""(height, width), an id per colour pixel, 0 = background."""
Bitmap = NDArray[np.bool_]
"""(height, width), True where the mask is."""
Embedding = NDArray[np.float32]
"""(dimensions,), unit length."""

MaskKind = Literal["object", "region", "support"]
MASK_KINDS: tuple[MaskKind, ...] = ("object", "region", "support")
Alternative = tuple[str, str, float]
MAX_IMAGE_SIDE = 32767


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A pinhole camera without distortion: size and focal lengths in pixels, integer coordinates = pixel centres."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        if not (0 < self.width <= MAX_IMAGE_SIDE and 0 < self.height <= MAX_IMAGE_SIDE):
            found = f"{self.width}x{self.height} pixels"
            raise InputError(f"camera is {found}; expected sides between 1 and {MAX_IMAGE_SIDE}")
        values = (self.fx, self.fy, self.cx, self.cy)
        if not (min(self.fx, self.fy) >= 0.01 and all(abs(value) <= 1e6 for value in values)):
            raise InputError(f"intrinsics fx, fy, cx, cy are {values}; expected pixels, focal lengths of 0.01 to 1e6")


@dataclass(frozen=True, slots=True)
class Pose:
    """A rigid transform: unit quaternion (x, y, z, w) and translation in metres. These numbers *are* the pose."""

    quaternion: tuple[float, float, float, float]
    translation: tuple[float, float, float]

    def __post_init__(self) -> None:
        numbers = (*self.quaternion, *self.translation)
        if not all(math.isfinite(number) and abs(number) <= 1e12 for number in numbers):
            raise InputError(f"pose holds a number that is not finite, or beyond 1e12: {numbers}")
        norm = math.sqrt(sum(q * q for q in self.quaternion))
        if abs(norm - 1.0) > 1e-3:
            raise InputError(f"pose quaternion has length {norm:.6f}; expected 1")

    @classmethod
    def identity(cls) -> Self:
        """No rotation, no translation."""
        return cls((0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0))

    @classmethod
    def from_matrix(cls, matrix: NDArray[np.float64]) -> Self:
        """From a 4x4 rigid transform in metres; refuses what is no rotation (tolerance 1e-2, then normalised)."""
        m = [[float(matrix[row][column]) for column in range(4)] for row in range(4)]
        if not all(math.isfinite(value) for row in m for value in row):
            raise InputError("pose matrix holds a number that is not finite")
        for i in range(3):
            for j in range(i, 3):
                product = sum(m[k][i] * m[k][j] for k in range(3))
                if abs(product - (i == j)) > 1e-2:
                    raise InputError("pose matrix is not a rotation: its columns are not orthonormal within 0.01")
        determinant = (
            m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
            - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
            + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
        )
        if determinant < 0:
            raise InputError("pose matrix mirrors space (determinant below 0); expected a rotation")
        return cls(_quaternion(m), (m[0][3], m[1][3], m[2][3]))

    def rotation(self) -> tuple[tuple[float, float, float], ...]:
        """Rows of the 3x3 rotation, scalar float64 in fixed order, so that every machine gets the same bits."""
        x, y, z, w = self.quaternion
        s = 2.0 / (x * x + y * y + z * z + w * w)
        return (
            (1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)),
            (s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w)),
            (s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y)),
        )

    def matrix(self) -> NDArray[np.float64]:
        """(4, 4) float64; for drawing and float work (the mapper's geometry is integers)."""
        out = np.eye(4)
        out[:3, :3] = self.rotation()
        out[:3, 3] = self.translation
        return out


def _quaternion(m: list[list[float]]) -> tuple[float, float, float, float]:
    """Unit quaternion (x, y, z, w), w >= 0, of a rotation matrix; the largest component first for accuracy."""
    trace = m[0][0] + m[1][1] + m[2][2]
    sizes = (*(2.0 * m[i][i] - trace for i in range(3)), trace)
    largest = max(range(4), key=lambda i: (sizes[i], -i))
    r = math.sqrt(max(0.0, 1.0 + sizes[largest]))
    s = 0.5 / r
    parts = [(m[2][1] - m[1][2]) * s, (m[0][2] - m[2][0]) * s, (m[1][0] - m[0][1]) * s, 0.5 * r]
    if largest < 3:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        parts[3] = (m[k][j] - m[j][k]) * s
        parts[i], parts[j], parts[k] = 0.5 * r, (m[j][i] + m[i][j]) * s, (m[k][i] + m[i][k]) * s
    x, y, z, w = parts
    norm = math.copysign(math.sqrt(x * x + y * y + z * z + w * w), w)
    return (x / norm, y / norm, z / norm, w / norm)


@dataclass(frozen=True, slots=True)
class Rig:
    """The two cameras of a frame. `depth_from_color` is identity where depth is registered to colour."""

    depth: Intrinsics
    color: Intrinsics
    depth_from_color: Pose = field(default_factory=Pose.identity)

    @property
    def registered(self) -> bool:
        """True if depth pixel (u, v) and colour pixel (u, v) see the same ray."""
        return self.depth == self.color and self.depth_from_color == Pose.identity()


@dataclass(frozen=True, eq=False)
class Frame:
    """One instant of a recording.

    `color` holds the source's compressed bytes, unchanged; empty where the recording has no colour.
    """

    index: int
    """Frame number: the index in the source, from 0; dropped frames leave gaps."""
    stamp_ns: int
    world_from_depth: Pose
    rig: Rig
    depth: DepthImage
    color: bytes = b""
    color_format: Literal["jpeg", "png", ""] = ""
    truth_instances: IdImage | None = None
    truth_categories: IdImage | None = None

    def __post_init__(self) -> None:
        where = f"frame {self.index}"
        if self.depth.dtype != np.uint16 or self.depth.ndim != 2:
            found = f"{self.depth.dtype} with {self.depth.ndim} axes"
            raise InputError(f"{where}: depth is {found}; expected a uint16 image")
        _check_size(where, "depth", self.depth, self.rig.depth)
        for name, image in (("truth instances", self.truth_instances), ("truth categories", self.truth_categories)):
            if image is not None:
                if image.dtype != np.uint16:
                    raise InputError(f"{where}: {name} are {image.dtype}; expected uint16")
                _check_size(where, name, image, self.rig.color)


def _check_size(where: str, name: str, image: NDArray[Any], camera: Intrinsics) -> None:
    if image.shape != (camera.height, camera.width):
        found = f"{image.shape[1]}x{image.shape[0]}, its camera {camera.width}x{camera.height}"
        raise InputError(f"{where}: {name} image is {found}; expected equal sizes")


@dataclass(frozen=True, eq=False, slots=True)
class Mask:
    """One 2D detection in colour pixels: a box (x1, y1 exclusive) and the packed bits of its crop.

    `bits`: uint8, row-major over the box, most significant bit first, rows not padded (numpy.packbits of the crop).
    """

    box: tuple[int, int, int, int]
    bits: NDArray[np.uint8]
    score: float = 1.0
    label: str = ""
    caption: str = ""
    caption_score: float = 1.0
    named: bool = True
    kind: MaskKind = "object"
    embedding: Embedding | None = None
    alternatives: tuple[Alternative, ...] = ()
    """What it may be as well: a label, a caption and its score."""

    def __post_init__(self) -> None:
        x0, y0, x1, y1 = self.box
        if not (0 <= x0 <= x1 <= MAX_IMAGE_SIDE and 0 <= y0 <= y1 <= MAX_IMAGE_SIDE):
            raise InputError(f"mask box is {self.box}; expected 0 <= x0 <= x1 and 0 <= y0 <= y1")
        expected = ((x1 - x0) * (y1 - y0) + 7) // 8
        if self.bits.dtype != np.uint8 or self.bits.shape != (expected,):
            found = f"{self.bits.dtype} of shape {self.bits.shape}"
            raise InputError(f"mask bits are {found}; expected {expected} bytes for box {self.box}")
        if len(self.bits) and self.bits[-1] & ((1 << (-(x1 - x0) * (y1 - y0) % 8)) - 1):
            raise InputError(f"mask bits go on behind its box {self.box}; expected zeros")
        if self.kind not in MASK_KINDS:
            raise InputError(f"mask kind is {self.kind!r}; expected one of {', '.join(MASK_KINDS)}")
        scores = (self.score, self.caption_score, *(score for _, _, score in self.alternatives))
        if not all(0.0 <= score <= 1.0 for score in scores):
            raise InputError(f"mask scores are {', '.join(map(str, scores))}; expected numbers between 0 and 1")

    @classmethod
    def from_bitmap(cls, bitmap: Bitmap, **fields: Any) -> Self:
        """From a full-size bitmap; the box is cut tight (an empty mask has box 0, 0, 0, 0)."""
        rows, columns = np.flatnonzero(bitmap.any(1)), np.flatnonzero(bitmap.any(0))
        if not len(rows):
            return cls((0, 0, 0, 0), np.zeros(0, np.uint8), **fields)
        x0, y0, x1, y1 = int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1
        return cls((x0, y0, x1, y1), np.packbits(bitmap[y0:y1, x0:x1]), **fields)

    def crop(self) -> Bitmap:
        """The bits inside the box, (y1 - y0, x1 - x0)."""
        x0, y0, x1, y1 = self.box
        flat = np.unpackbits(self.bits, count=(y1 - y0) * (x1 - x0))
        return flat.reshape(y1 - y0, x1 - x0).astype(np.bool_)

    def bitmap(self, height: int, width: int) -> Bitmap:
        """The mask in a picture of that size, which must hold its box."""
        x0, y0, x1, y1 = self.box
        out = np.zeros((height, width), np.bool_)
        out[y0:y1, x0:x1] = self.crop()
        return out

    @property
    def area(self) -> int:
        """Colour pixels of the mask."""
        return int(np.bitwise_count(self.bits).sum())


@dataclass(frozen=True, slots=True)
class Candidate:
    """One instance that a mask could belong to, as it was before the frame. Scores in Q20."""

    instance: int
    overlap: int
    """C: voxels of the mask whose label is this instance."""
    s_geo: int
    """Geometric similarity, eq. (8)."""
    s_fea: int
    """Feature similarity, eq. (9); may be negative."""
    a: int
    """Association probability A = weighted fusion of both."""


@dataclass(frozen=True, slots=True)
class Decision:
    """Where one mask went and why. Scores in Q20, credibility in Q12; of the chosen instance, 0 if it is new."""

    mask: int
    """Position in the frame's list of masks, from 0."""
    by: str
    """The rule that decided: new, threshold, containment, small (too few pixels), empty (no voxel)."""
    instance: int
    """Instance after this frame; 0 = none."""
    fragment: int
    """Fragment that takes the mask's new voxels; 0 = none. In preset paper the instance itself."""
    held: tuple[int, ...]
    """Fragments that the mask holds, ascending."""
    voxels: int
    """|V_m|: voxels of the mask."""
    abstained: int
    """Voxels of the mask that voted for nothing because the evidence keeps the held fragments apart."""
    s_geo: int
    s_fea: int
    a: int
    threshold: int
    visibility: int
    """R, eq. (17), clipped to 1."""
    credibility: int
    """w, eq. (16)."""
    candidates: tuple[Candidate, ...]
    """Best A first, the lowest id first among equals."""


@dataclass(frozen=True, slots=True)
class Event:
    """A change in the life of an instance, with its reason in words."""

    frame: int
    kind: Literal["new", "confirmed", "merged", "split", "cut", "dropped"]
    instance: int
    others: tuple[int, ...]
    text: str


@dataclass(frozen=True, eq=False)
class VoxelChanges:
    """What one frame changed in the voxels; enough to rebuild every voxel's votes after any frame.

    Voxels are numbered from 0 in the order of their first vote (within a frame by x, then y, then z).
    The first step of a resumed run tells the whole map, as if it had made it.
    """

    first_new: int
    """Number of voxels before this frame = number of the first new one."""
    new_index: NDArray[np.int32]
    """(n, 3): index of each new voxel, floor(world / voxel_size)."""
    voxel: NDArray[np.int32]
    """(c,): voxel number of each changed count, ascending, then by fragment."""
    fragment: NDArray[np.int32]
    """(c,): fragment id of each changed count, 0 = background."""
    count: NDArray[np.int32]
    """(c,): the count after this frame, 0 = none left."""
    touched: NDArray[np.int32]
    """(t,): numbers of the voxels that changed, ascending."""
    owner: NDArray[np.int32]
    """(t,): fragment with most votes there if it beats background, else 0; the lowest id on a tie."""
    share: NDArray[np.int32]
    """(t,): the owner's share of all votes there (background's share where owner is 0), Q20."""


@dataclass(frozen=True, eq=False)
class Step:
    """All that one frame did to the map. Observers read it and can change nothing."""

    frame: Frame
    masks: tuple[Mask, ...]
    looked: bool
    """False: perception did not look at this frame; the map is untouched."""
    decisions: tuple[Decision, ...]
    events: tuple[Event, ...]
    changes: VoxelChanges
    instance_of: Mapping[int, int]
    """Instance of every fragment after this frame."""
    voxels: int
    """Voxels of the map after this frame."""


@dataclass(frozen=True, slots=True)
class InstanceSummary:
    """What a person wants to know about one instance."""

    id: int
    caption: str
    """The best of the label with most support; if that is too little for a name, the best that names nothing."""
    captions: tuple[tuple[str, float], ...]
    """Captions with their support, most first."""
    observations: int
    """Frames in which a mask was matched to it."""
    first_frame: int
    last_frame: int
    state: Literal["tentative", "confirmed"]
    confirmed_frame: int | None
    bounds: tuple[tuple[float, float, float], tuple[float, float, float]]
    """Lower and upper corner of its voxels, metres."""
    voxels: int
    named: bool = True
    """Whether the caption says what it is."""


@dataclass(frozen=True, eq=False)
class InstanceMap:
    """A finished map, as the design's contract has it. Rows of `voxel_index` ascend by x, then y, then z."""

    voxel_index: NDArray[np.int32]
    """(N, 3): floor(world / voxel_size)."""
    vote_offset: NDArray[np.int64]
    """(N + 1,): votes of voxel i are vote_*[vote_offset[i]:vote_offset[i + 1]]."""
    vote_fragment: NDArray[np.int32]
    """(M,): ascending within a voxel, 0 = background."""
    vote_count: NDArray[np.int32]
    """(M,): in units of vote_unit votes; a look from near is several (`evolution.near`)."""
    fragment_id: NDArray[np.int32]
    fragment_instance: NDArray[np.int32]
    """(F,): instance of each fragment, 0 = dropped."""
    voxel_instance: NDArray[np.int32]
    """(N,): 0 = background."""
    voxel_confidence: NDArray[np.float32]
    instance_id: NDArray[np.int32]
    instance_confidence: NDArray[np.float32]
    feature: Embedding
    """(K, D), each row unit length."""
    feature_weight: NDArray[np.float64]
    voxel_size: float
    vote_unit: float
    instances: tuple[InstanceSummary, ...] = ()
    """As instance_id."""
    events: tuple[Event, ...] = ()
    """What finishing dropped, and why; not in the file."""
    meta: Mapping[str, Any] = field(default_factory=dict)
    """Format and tool version, encoder, preset, parameters, digests."""
    state: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """Integer state that a resumed replay needs, by name without `state_`; no contract."""
