"""live on a Foxglove WebSocket server: a real one, of the foxglove-sdk package, on the loopback."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from worlds import tiny_frames

from openvox.apps.live import live
from openvox.apps.replay import replay
from openvox.core.errors import InputError
from openvox.core.types import Frame
from openvox.formats.frames import encode_frame
from openvox.formats.recording import read_frames, recording_info

foxglove = pytest.importorskip("foxglove", reason="the extra live (foxglove-sdk) is not installed")
pytest.importorskip("websockets", reason="the extra live (websockets) is not installed")
SETS = ["masks.min_pixels=0"]


@contextmanager
def server() -> Iterator[tuple[str, Any]]:
    """The address of a server of its own, and what its channels are made in."""
    context = foxglove.Context()
    running = foxglove.start_server(host="127.0.0.1", port=0, context=context)
    try:
        yield f"ws://127.0.0.1:{running.port}", (context, running)
    finally:
        running.stop()


@contextmanager
def robot(frames: list[Frame], *, seconds: float = 0.05) -> Iterator[str]:
    """A server that says everything of each frame again and again until it was asked for, then all frames once."""
    with server() as (url, (context, running)):
        channels: dict[str, Any] = {}
        done = threading.Event()

        def send(frame: Frame) -> None:
            for topic, data in encode_frame(frame):
                if topic.name not in channels:
                    schema = foxglove.Schema(name=topic.schema_name, encoding=topic.schema_encoding, data=topic.schema)
                    channels[topic.name] = foxglove.Channel(
                        topic.name, schema=schema, message_encoding=topic.message_encoding, context=context
                    )
                channels[topic.name].log(data, log_time=frame.stamp_ns)

        def work() -> None:
            send(frames[0])  # tells what there is
            deadline = time.monotonic() + 60
            while not any(channel.has_sinks() for channel in channels.values()) and time.monotonic() < deadline:
                time.sleep(0.02)
            time.sleep(0.2)
            for frame in frames:
                send(frame)
                if done.wait(seconds):
                    return
            time.sleep(0.2)
            running.stop()

        thread = threading.Thread(target=work)
        thread.start()
        try:
            yield url
        finally:
            done.set()
            thread.join()


def test_what_a_robot_sends_is_recorded_mapped_and_replays_to_the_same_map(tmp_path: Path) -> None:
    frames = tiny_frames(60)
    said: list[str] = []
    with robot(frames) as url:
        result = live(
            url, frontend="geometry", out=str(tmp_path / "run"), assignments=SETS, waiting=100, notice=said.append
        )
    recorded = list(read_frames(tmp_path / "run.mcap"))
    of_stamp = {frame.stamp_ns: frame for frame in frames}
    assert len(recorded) >= 55, "all but what came before the subscription"
    for frame in recorded:
        sent = of_stamp[frame.stamp_ns]
        assert np.array_equal(frame.depth, sent.depth)
        assert frame.color == sent.color
        assert frame.rig == sent.rig
        assert np.allclose(frame.world_from_depth.matrix(), sent.world_from_depth.matrix(), atol=1e-9)
    assert "colour from /camera/color, depth from /camera/depth" in said
    assert "poses are those of camera_depth in world" in said
    assert recording_info(tmp_path / "run.mcap").source == "foxglove-websocket"
    again = replay(tmp_path / "run.mcap", assignments=SETS, out=str(tmp_path / "again"))
    assert again["digests"] == result["digests"]


def test_a_run_can_be_stopped_while_the_robot_goes_on(tmp_path: Path) -> None:
    stop = threading.Event()
    with robot(tiny_frames(100)) as url:
        result = live(url, frontend="geometry", out=str(tmp_path / "run"), stop=stop, status=lambda status: stop.set())
    assert 1 <= result["frames"] < 100


def test_topics_that_are_not_there_are_a_sentence(tmp_path: Path) -> None:
    with robot(tiny_frames(60)) as url, pytest.raises(InputError, match="there is no topic /front"):
        live(url, frontend="geometry", out=str(tmp_path / "run"), topics={"color": "/front"})
    assert list(tmp_path.iterdir()) == []


def test_a_server_without_a_camera_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from openvox.sources import foxglove_stream

    monkeypatch.setattr(foxglove_stream, "PATIENCE", 0.5)
    with server() as (url, _), pytest.raises(InputError, match=r"sent no picture within .* is the camera on"):
        live(url, frontend="geometry", out=str(tmp_path / "run"))


def test_where_nobody_listens_or_something_else_does_is_a_sentence(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]

        def answer() -> None:
            connection, _ = other.accept()
            connection.recv(1000)
            connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\nhi")
            connection.close()

        thread = threading.Thread(target=answer)
        thread.start()
        with pytest.raises(InputError, match="cannot be reached as a Foxglove WebSocket server"):
            live(f"ws://127.0.0.1:{port}", out=str(tmp_path / "run"))
        thread.join()
    for url in (f"ws://127.0.0.1:{port}", "ws://"):
        with pytest.raises(InputError, match="cannot be reached as a Foxglove WebSocket server"):
            live(url, out=str(tmp_path / "run"))


def test_a_perception_of_frames_to_come_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="frames that nobody has seen before have none"):
        live("ws://127.0.0.1:1", perception=tmp_path / "a.perception.mcap")


# ---- and the other way: the map as others see it ---------------------------------------------------------------------


def test_boxes_captions_and_changed_voxels_are_published(tmp_path: Path) -> None:
    from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
    from websockets.sync.client import connect
    from worlds import truth_masks

    from openvox.core.mapper_parameters import PRESETS
    from openvox.core.parameters import updated
    from openvox.mapper.mapper import Mapper
    from openvox.view.foxglove_publisher import FoxglovePublisher

    sets = {"masks.min_pixels": 0, "finish.existence": False}
    mapper = Mapper(updated(PRESETS["openvox"], sets, source="test"))
    boxes, clouds = dict[str, Any](), list[PointCloud]()
    publisher = FoxglovePublisher(0, voxel_size=0.04)
    with publisher, connect(publisher.url, subprotocols=["foxglove.sdk.v1"], proxy=None) as watcher:
        offered: dict[str, int] = {}
        while len(offered) < 2:
            said = json.loads(watcher.recv(timeout=30))
            offered |= {one["topic"]: one["id"] for one in said.get("channels", [])}
        asked = [{"id": number, "channelId": number} for number in offered.values()]
        watcher.send(json.dumps({"op": "subscribe", "subscriptions": asked}))
        time.sleep(0.3)
        for frame in tiny_frames(4):
            publisher.on_step(mapper.step(frame, truth_masks(frame)))
        result = mapper.finish()
        publisher.close(result)
        while not (clouds and clouds[-1].timestamp.ToNanoseconds() == tiny_frames(4)[-1].stamp_ns and boxes):
            data = watcher.recv(timeout=30)
            if isinstance(data, str):
                continue
            number, content = int.from_bytes(data[1:5], "little"), data[13:]
            if number == offered["/openvox/voxels"]:
                clouds.append(PointCloud.FromString(content))
            else:
                boxes |= {entity.id: entity for entity in SceneUpdate.FromString(content).entities}
    clouds = [cloud for cloud in clouds if cloud.data]
    assert len(clouds) == 4
    assert {str(i) for i in result.instance_id} <= boxes.keys()
    first = int(result.instance_id[0])
    box = boxes[str(first)].cubes[0]
    assert boxes[str(first)].texts[0].text.startswith(f"{first}: thing ")
    layout = [(axis, "<f4") for axis in "xyz"] + [("instance", "<u4"), ("rgba", "<u4")]
    points = np.concatenate([np.frombuffer(cloud.data, layout) for cloud in clouds])
    assert {*result.instance_id.tolist()} <= {*points["instance"].tolist()}
    assert np.allclose(np.modf(points["x"].astype(float) / 0.04)[0] % 1, 0.5, atol=1e-3), "centres of voxels"
    mine = points[points["instance"] == first]
    sides = [abs(mine[a] - getattr(box.pose.position, a)) <= getattr(box.size, a) / 2 for a in ("x", "y", "z")]
    assert np.all(sides, axis=0).any(), "its voxels lie in its box"


def test_publishing_changes_nothing_and_a_taken_port_is_a_sentence(tmp_path: Path) -> None:
    from openvox.apps.perceive import perceive
    from openvox.formats.recording import RecordingWriter

    played = tmp_path / "tiny.mcap"
    with RecordingWriter(played, source="test", categories={7: "table", 29: "box"}) as writer:
        for frame in tiny_frames(4):
            writer.add(frame)
    perceive(played, frontend="oracle", assignments=["oracle.min_pixels=1"])
    said: list[str] = []
    result = live(str(played), rate=100.0, publish=0, notice=said.append)
    assert any(line.startswith("publishing to ws://127.0.0.1:") for line in said)
    assert replay(Path(result["outputs"]["recording"]), out=str(tmp_path / "again"))["digests"] == result["digests"]
    with socket.create_server(("127.0.0.1", 0)) as other, pytest.raises(InputError, match="choose another --publish"):
        live(str(played), rate=100.0, publish=other.getsockname()[1], out=str(tmp_path / "other"))
