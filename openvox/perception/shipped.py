"""The stages that come with openvox and take their numbers from --set, made as a row of `stages.py` makes them."""

from __future__ import annotations

from openvox.core.errors import InputError
from openvox.formats.recording import RecordingInfo
from openvox.perception.captions import CaptionEncoder
from openvox.perception.stage import Detector, Encoder, Segmenter
from openvox.perception.stages import Setting


def no_boxes(_: None, setting: Setting) -> Detector:
    """Det of `geometry`: none."""
    from openvox.perception.geometry import NoBoxes

    return NoBoxes()


def nanodet(_: None, setting: Setting) -> Detector:
    """Det of `offline`."""
    from openvox.perception.nanodet import NanoDet

    return NanoDet(setting.parameters.offline)


def truth_boxes(_: None, setting: Setting) -> Detector:
    """Det of `oracle`. Raises InputError without truth."""
    from openvox.perception.oracle import OracleBoxes

    return OracleBoxes(setting.parameters.oracle, _categories(setting))


def geometry(_: None, setting: Setting) -> Segmenter:
    """SegCap of `geometry`; it looks for the planes of the room first."""
    from openvox.perception.geometry import Geometry, room_of

    chosen = setting.parameters.geometry
    return Geometry(chosen, room_of(_recording(setting), chosen))


def offline(_: None, setting: Setting) -> Segmenter:
    """SegCap of `offline`; it looks for the planes of the room first."""
    from openvox.perception.geometry import room_of
    from openvox.perception.offline import Offline

    chosen = setting.parameters.geometry
    return Offline(chosen, setting.parameters.offline, room_of(_recording(setting), chosen))


def truth_masks(_: None, setting: Setting) -> Segmenter:
    """SegCap of `oracle`. Raises InputError without truth."""
    from openvox.perception.oracle import OracleMasks

    return OracleMasks(setting.parameters.oracle, _categories(setting))


def minilm(_: None, setting: Setting) -> Encoder:
    """Enc of all of them."""
    from openvox.perception.encoder import encoder

    return CaptionEncoder(encoder("minilm"))


def _recording(setting: Setting) -> RecordingInfo:
    assert setting.recording is not None, "only encoders are made without one"
    return setting.recording


def _categories(setting: Setting) -> dict[int, str]:
    recording = _recording(setting)
    if not recording.has_truth:
        raise InputError(
            f"{recording.path} has no ground truth, which {setting.asked_by} takes its masks from; "
            "use --frontend offline or --detections FILE"
        )
    return dict(recording.categories)
