"""A server tells the nodes of cameras where it expects people, over the bus, and their detectors search there."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np
import pytest
from support.known_people import RIG, KnownPeople, brightness, joints_at, placed
from support.programs import free_port, wait_until

from mocapella.conventions import NS_PER_S
from mocapella.detectors.keypoint_detector import frame_of
from mocapella.live.camera_node import CameraNodeSettings
from mocapella.live.camera_service import CameraService
from mocapella.live.keypoint_node import run_keypoint_node
from mocapella.live.keypoint_work import KeypointWork
from mocapella.live.server import Server, ServerSettings
from mocapella.model.camera_rig_file import encode_camera_rig
from mocapella.model.observations import JointState
from mocapella.model.scene import Person
from mocapella.model.session import Setup
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import SourceState
from mocapella.testing import FakeCamera, FakeServer
from mocapella.tracker import warm_up
from mocapella.tracker.expected_regions import expected_regions
from mocapella.wire.expected import ExpectedPeople, read_expected, write_expected
from mocapella.wire.node import NodeLink

SIZE = (640, 480)


@pytest.mark.slow
def test_nodes_that_want_to_know_are_told_their_own_boxes() -> None:
    """Each camera's node is told the box of the person in its own image; one that does not ask is told nothing."""
    warm_up("webcams")  # frames that wait for the compilation would be too late
    address = f"tls/127.0.0.1:{free_port()}"
    used: dict[str, Any] = {"rig": encode_camera_rig(RIG)}
    server = Server(ServerSettings(address, setup=Setup("webcams", 3), method_settings=used))
    told: dict[str, list[ExpectedPeople]] = {name: [] for name in RIG.cameras}
    links = {name: NodeLink(address, name) for name in RIG.cameras}
    try:
        names = list(RIG.cameras)
        for name in names[:2]:
            links[name].expect(lambda data, name=name: told[name].append(read_expected(data)))  # type: ignore[misc]
        for link in links.values():
            wait_until("the server accepts the node", link.join)
        finds, sent = KnownPeople(), 0

        def known() -> bool:
            nonlocal sent
            at_s = 0.05 * sent
            for k, name in enumerate(names):
                image = np.full((4, 4, 3), brightness(k), np.uint8)
                seen = finds.update(image, at_s)
                links[name].publish(frame_of(seen, finds.topology, name, 1 + round(at_s * NS_PER_S), SIZE))
            sent += 1
            time.sleep(0.05)
            return all(told[name] and len(told[name][-1].boxes) for name in names[:2])

        wait_until("the boxes", known)
        for k, name in enumerate(names[:2]):
            last = told[name][-1]
            states = np.full(26, JointState.TRACKED, np.uint8)
            person = Person(0, joints_at(last.time_ns / NS_PER_S), states, ())
            (truth,) = expected_regions((person,), placed(k))
            np.testing.assert_allclose(last.boxes, [truth], atol=25.0)
        assert told[names[2]] == []
    finally:
        for link in links.values():
            link.hurry = threading.Event()
            link.hurry.set()
            link.close()
        server.close()


def test_a_running_node_hands_the_boxes_to_its_detector() -> None:
    finds, stop = KnownPeople(), threading.Event()
    box = np.array([[10, 20, 30, 40]], np.float32)
    with FakeServer() as server, Acquisition(FakeCamera(SourceState((64, 48), 10.0))) as acquisition:
        work = KeypointWork("left", acquisition, finds)
        with CameraService(work) as service, NodeLink(server.address, "left") as link:
            settings = CameraNodeSettings(drop_after_s=100.0)

            def run() -> None:
                run_keypoint_node(link, acquisition, work, service, settings, stop=stop)

            node = threading.Thread(target=run)
            node.start()
            try:

                def told() -> bool:
                    if server.frames and server._link.awaits_expected(link.node):
                        server._link.publish_expected(link.node, write_expected(server.frames[-1].time_ns, box))
                    return work.with_expected > 0

                wait_until("an image that is searched where a person is expected", told)
            finally:
                stop.set()
                node.join(60.0)
    assert any(one is not None and one.tolist() == box.tolist() for one in finds.regions)
