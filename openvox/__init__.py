"""openvox: instance-level, open-vocabulary, probabilistic voxel maps from RGB-D logs.

The names below are the library; each is imported when it is used first, so that `openvox --help` stays light.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from openvox.apps.live import live
    from openvox.apps.query import query
    from openvox.core.digest import map_digest
    from openvox.core.errors import InputError, OutputError
    from openvox.core.mapper_parameters import MapperParameters, preset
    from openvox.core.types import Frame, InstanceMap, Intrinsics, Mask, Pose, Rig, Step
    from openvox.formats.map_npz import read_map, write_map
    from openvox.formats.perception import read_masks
    from openvox.formats.recording import RecordingWriter, read_frames
    from openvox.mapper.mapper import Mapper
    from openvox.perception.encoder import encoder

__version__ = "0.6.0"
_MODULES = {
    "openvox.apps.live": ("live",),
    "openvox.apps.query": ("query",),
    "openvox.core.digest": ("map_digest",),
    "openvox.core.errors": ("InputError", "OutputError"),
    "openvox.core.mapper_parameters": ("MapperParameters", "preset"),
    "openvox.core.types": ("Frame", "InstanceMap", "Intrinsics", "Mask", "Pose", "Rig", "Step"),
    "openvox.formats.map_npz": ("read_map", "write_map"),
    "openvox.formats.perception": ("read_masks",),
    "openvox.formats.recording": ("RecordingWriter", "read_frames"),
    "openvox.mapper.mapper": ("Mapper",),
    "openvox.perception.encoder": ("encoder",),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}
__all__ = [
    "Frame",
    "InputError",
    "InstanceMap",
    "Intrinsics",
    "Mapper",
    "MapperParameters",
    "Mask",
    "OutputError",
    "Pose",
    "RecordingWriter",
    "Rig",
    "Step",
    "encoder",
    "live",
    "map_digest",
    "preset",
    "query",
    "read_frames",
    "read_map",
    "read_masks",
    "write_map",
]


def __getattr__(name: str) -> Any:
    """One of the library's names, from where it stands."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_MODULE_OF[name]), name)
