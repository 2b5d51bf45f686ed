"""The published fakes behave as what they stand for."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from support.programs import wait_until

from mocapella.errors import InputError
from mocapella.model.scene import Phase, Scene, TrackerState
from mocapella.model.session import CommandReply
from mocapella.model.topology import topology
from mocapella.sources.acquisition import Acquisition, AcquisitionSettings
from mocapella.sources.picture_source import PictureSource, SourceState
from mocapella.testing import FakeCamera, FakeServer, Walker, WalkerSensor, session_status, standing_at
from mocapella.wire.node import NodeLink
from mocapella.wire.reader import Newest, send_command
from mocapella.wire.session import open_reader

QUICK = AcquisitionSettings(retry_s=0.02, longest_retry_s=0.05, silent_s=0.2, close_s=0.2)
SCENE = Scene(0, 1, "front", 1, 0, topology("kinect_v2"), TrackerState(Phase.TRACKING), {})


def test_a_pulled_plug_is_said_and_images_come_again_when_it_is_back() -> None:
    said: list[str] = []
    camera: PictureSource = FakeCamera(SourceState((4, 2), 200.0))
    assert isinstance(camera, FakeCamera)
    with Acquisition(camera, QUICK, say=said.append) as images:
        images.start()
        wait_until("images come", lambda: images.take(0.1) is not None)
        camera.plugged = False
        wait_until("it is missed", lambda: bool(said))
        with pytest.raises(InputError, match="fake camera: cannot be opened"):
            camera.open()
        camera.plugged = True
        wait_until("it is back", lambda: any("there again" in line for line in said))
        wait_until("images come again", lambda: images.take(0.1) is not None)
    assert camera.opened >= 2
    assert camera.closed >= 2


def test_images_count_up_and_a_unit_makes_a_depth_camera() -> None:
    stop = threading.Event()
    colour, depth = FakeCamera(SourceState((4, 2))), FakeCamera(SourceState((4, 2), unit_m=0.001))
    shots = [colour.read(stop) for _ in range(3)]
    assert [(shot.number, shot.image.shape, int(shot.image.max())) for shot in shots if shot] == [
        (k, (2, 4, 3), k) for k in range(3)
    ]
    assert np.diff([shot.time_ns for shot in shots if shot]).min() > 0
    one = depth.read(stop)
    assert one is not None
    assert (one.image.shape, one.image.dtype, int(one.image[0, 0])) == ((2, 4), np.uint16, 700)


def test_a_node_joins_the_fake_server_and_a_reader_gets_what_the_test_publishes() -> None:
    refuse = CommandReply(False, "not today")
    with FakeServer(obey=lambda verb, _: refuse if verb == "start" else CommandReply(True)) as server:
        with NodeLink(server.address, "front") as node:
            wait_until("it has joined", node.join)
            wait_until("a frame came", lambda: bool(node.publish(WALKED)) and bool(server.frames))
            assert server.frames[0].key == ("front", node.node.node_id, server.frames[0].sequence)
        session = open_reader(server.address)
        newest = Newest(session)
        assert send_command(session, "start", {"a": 1}) == refuse
        assert send_command(session, "stop").ok
        server.wait_for(commands=2)
        assert server.commands == [("start", {"a": 1}), ("stop", {})]

        def published() -> bool:
            server.publish(SCENE)
            server.publish_status(session_status(scenes=5))
            scene, status = newest.scene(), newest.status()
            return scene is not None and status is not None and (scene.step, status.scenes) == (0, 5)

        wait_until("it is read", published)
        session.close()
        assert server.problems == []
    with FakeServer(server.address):  # the other has left the bus
        pass


WALKED = WalkerSensor("front", standing_at(0.0, 0.0)).frame({7: Walker()}, 1.0)


def test_what_does_not_come_is_said() -> None:
    with FakeServer() as server, pytest.raises(AssertionError, match="0 of 2 frames and 0 of 0 commands came within"):
        server.wait_for(frames=2, timeout_s=0.05)


def test_a_walker_stands_on_the_floor_and_a_sensor_sees_the_truth() -> None:
    walker, T = Walker(stature=1.9), standing_at(0.0, 0.0, height=1.2)
    joints = walker.at(2.0)
    assert 1.7 < joints[:, 1].max() < 1.9
    assert 0.0 < joints[:, 1].min() < 0.1
    seen = WalkerSensor("front", T, clock=0.5).frame({7: walker}, 2.0, sequence=3)
    assert (seen.time_ns, seen.sequence, seen.tracking_ids.tolist()) == (2_500_000_000, 3, [7])
    np.testing.assert_allclose(seen.positions[0] @ T[:3, :3].T + T[:3, 3], joints, atol=1e-5)
