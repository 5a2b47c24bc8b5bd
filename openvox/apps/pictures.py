"""pictures: a map and one of its frames as PNG files, without a screen."""

from __future__ import annotations

from pathlib import Path

from openvox.apps.origin import named_digest
from openvox.apps.retrace import decision_of
from openvox.core.errors import InputError
from openvox.core.types import InstanceMap
from openvox.formats.map_npz import SUFFIX as MAP_SUFFIX
from openvox.formats.map_npz import read_map
from openvox.formats.perception import perception_info, read_masks
from openvox.formats.recording import read_frames, recording_info
from openvox.formats.trace import SUFFIX as TRACE_SUFFIX
from openvox.formats.trace import read_trace


def pictures(map_file: Path, frame: int, folder: Path) -> dict[str, str]:
    """Write map.png, and frame.png with the detected masks beside those of the map; their paths by name.

    map_file: STEM.map.npz with STEM.trace.mcap beside it; the recording and its perception are found as the map names
    them. frame: its number. Raises InputError, OutputError."""
    from openvox.view.pictures import draw_frame, draw_map  # cv2, numba

    result = read_map(map_file)
    trace = map_file.with_name(map_file.name.removesuffix(MAP_SUFFIX) + TRACE_SUFFIX)
    recording, perception = (_named(map_file, result, name) for name in ("recording", "perception"))
    digests = {"recording": recording_info(recording).digest, "perception": perception_info(perception).digest}
    for name, digest in digests.items():
        if digest != named_digest(result, name):
            raise InputError(f"{map_file} was made from another {name} than lies there now; replay it")
    seen = next(read_frames(recording, start=frame, end=frame + 1, truth=False), None)
    masks = next(read_masks(perception, start=frame, end=frame + 1), None)
    step = next(read_trace(trace, frame), None)
    if seen is None or masks is None or step is None or step.frame != frame:
        raise InputError(f"{map_file}: frame {frame} was not mapped, or nobody looked for masks in it; choose another")
    out = {"map": folder / "map.png", "frame": folder / "frame.png"}
    draw_map(result, out["map"])
    draw_frame(seen, masks.masks, [decision_of(row) for row in step.decisions], result, out["frame"])
    return {name: str(path) for name, path in out.items()}


def _named(map_file: Path, result: InstanceMap, name: str) -> Path:
    """The file that a map names; relative to the map, as replay writes it."""
    path = result.meta.get(name)
    if not isinstance(path, str) or not path or Path(path).is_absolute():
        raise InputError(f"{map_file} names no {name} relative to itself; replay it")
    return map_file.parent / path
