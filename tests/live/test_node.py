"""A node waits for its server, and says when none was there."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np
import pytest
from msgspec import ValidationError
from support.programs import free_port, wait_until
from zenoh import ZError

from mocapella.errors import NoServerError
from mocapella.live.node import DueFrame, Membership, NodeSummary, run_node
from mocapella.live.server import Server, ServerSettings
from mocapella.model.observations import body_frame
from mocapella.model.topology import topology
from mocapella.wire.keys import NodeKey
from mocapella.wire.node import NodeLink


class Source:
    """Three frames, all due when the run begins."""

    def __init__(self) -> None:
        self.begun = threading.Event()

    def frames(self) -> Iterator[DueFrame]:
        self.begun.set()
        for k in range(3):
            yield DueFrame(0.0, body_frame("front", topology("kinect_v2"), time_ns=k, positions=np.zeros((1, 25, 3))))


def test_the_first_frame_waits_for_a_server() -> None:
    address, source, said, stop = f"tcp/127.0.0.1:{free_port()}", Source(), list[str](), threading.Event()
    done: list[NodeSummary] = []
    with NodeLink(address, "front") as link:

        def serve() -> None:
            done.append(run_node(link, source.frames, epoch=None, stop=stop, say=said.append))

        node = threading.Thread(target=serve)
        node.start()
        try:
            wait_until("it says that it waits", lambda: any("waiting for a server" in line for line in said))
            assert not source.begun.is_set()
            server = Server(ServerSettings(address))
            try:
                node.join(60.0)
            finally:
                server.close()
        finally:
            stop.set()
            node.join()
    assert done[0].served
    assert done[0].published == 3


def test_frames_that_nobody_was_there_to_receive_are_an_error() -> None:
    address = f"tcp/127.0.0.1:{free_port()}"
    with NodeLink(address, "front") as link, pytest.raises(NoServerError, match="3 frames went nowhere"):
        run_node(link, Source().frames, epoch=0.0, stop=threading.Event(), wait=False)


def test_a_node_that_is_stopped_while_it_waits_has_published_nothing() -> None:
    source, stop = Source(), threading.Event()
    stop.set()
    with NodeLink(f"tcp/127.0.0.1:{free_port()}", "front") as link:
        summary = run_node(link, source.frames, epoch=None, stop=stop)
    assert (summary.served, summary.published) == (False, 0)
    assert not source.begun.is_set()


def test_a_membership_goes_on_after_an_error() -> None:
    """Anybody on the bus may answer its question, also with what is no answer."""
    answers = [ValidationError("no answer"), ZError("no link")]
    said, stop = list[str](), threading.Event()

    class Link:
        node, address = NodeKey("front", 1), "tcp/127.0.0.1:1"

        def join(self) -> bool:
            if answers:
                raise answers.pop()
            return True

        def server_is_there(self) -> bool:
            return True

    membership = Membership(Link(), stop, said.append)  # type: ignore[arg-type]
    wait_until("it has joined", membership.served.is_set)
    stop.set()
    membership.close()
    assert sum(membership.errors.counts.values()) == 2
    assert said[:2] == [
        "front: unexpected error (server): ZError: no link",
        "front: unexpected error (server): ValidationError: no answer",
    ]
