"""A node waits for its server, and says when none was there."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import ValidationError
from support.passing_time import PassingTime
from support.programs import free_port, wait_until
from zenoh import ZError

from mocapella.errors import BusError, NoServerError
from mocapella.live import node
from mocapella.live.due_frame import DueFrame
from mocapella.live.node import _LOOK_EVERY_S, ANSWER_S, ASK_AFTER_S, Membership, NodeSummary, run_node
from mocapella.live.server import Server, ServerSettings
from mocapella.model.observations import body_frame
from mocapella.model.session import Setup
from mocapella.model.topology import topology
from mocapella.supervision import Boundary
from mocapella.wire.keys import NodeKey
from mocapella.wire.node import NodeLink
from mocapella.wire.questions import AskReport, ask_node


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


def published_s(
    monkeypatch: pytest.MonkeyPatch, began_s: float, epoch_s: float | None, due_s: list[float]
) -> list[float]:
    """When a node publishes frames that are due so, on the wall clock; in time that passes only while it waits."""

    class Passing(PassingTime):
        """Its monotonic clock has a zero of its own."""

        def time(self) -> float:
            return began_s + self.now_s

        def monotonic(self) -> float:
            return self.now_s + 7.0 * began_s

        def set(self) -> None:
            self.ended = True

    class Served:
        served, errors = threading.Event(), Boundary()

        def __init__(self, *_: Any) -> None:
            self.served.set()

        def close(self) -> None:
            pass

    class Link:
        node, published = NodeKey("front", 1), 0

        def publish(self, *_: Any) -> None:
            found.append(passing.time())

    found, passing, (frame, *_) = list[float](), Passing(), Source().frames()
    monkeypatch.setattr(node, "time", passing)
    monkeypatch.setattr(node, "Membership", Served)
    frames = [DueFrame(due, frame.frame) for due in due_s]
    run_node(Link(), lambda: frames, epoch=epoch_s, stop=passing, wait=False)  # type: ignore[arg-type]
    return found


@given(st.floats(0.0, 50.0), st.lists(st.floats(0.0, 9.0), max_size=5))
def test_nodes_of_one_epoch_publish_together_whenever_they_began(before_s: float, due_s: list[float]) -> None:
    due_s, epoch_s = sorted(due_s), 1000.0
    with pytest.MonkeyPatch.context() as patch:
        found = published_s(patch, epoch_s - before_s, epoch_s, due_s)
    np.testing.assert_allclose(found, [epoch_s + due for due in due_s], atol=1e-6)


def test_a_node_without_an_epoch_publishes_from_its_beginning_on(monkeypatch: pytest.MonkeyPatch) -> None:
    assert published_s(monkeypatch, 500.0, None, [0.0, 0.5, 2.0]) == [500.0, 500.5, 502.0]


def test_a_node_that_begins_after_its_epoch_publishes_what_it_has_missed_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert published_s(monkeypatch, 1001.0, 1000.0, [0.0, 0.5, 1.0, 3.0]) == [1001.0, 1001.0, 1001.0, 1003.0]


def test_a_membership_goes_on_after_an_error() -> None:
    """Anybody on the bus may answer its question, also with what is no answer."""
    answers = [ValidationError("no answer"), ZError("no link")]
    said, stop = list[str](), threading.Event()

    class Link:
        node, address, heard_s, put_off = NodeKey("front", 1), "tcp/127.0.0.1:1", 0.0, ""
        errors = Boundary(lambda text: said.append(f"front: {text}"))

        def join(self, timeout: float = 1.0) -> bool:
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


class StandingLink:
    """A node's link to a server that answers, or stands still; it is connected all the time."""

    node, address, errors = NodeKey("front", 1), "tcp/127.0.0.1:1", Boundary()
    answers, heard_s, asked, put_off = True, 0.0, 0, ""

    def join(self, timeout: float = 1.0) -> bool:
        self.asked += 1
        return self.answers

    def server_is_there(self) -> bool:
        return True


def test_a_server_that_stands_still_is_told_of_once_and_so_is_its_return() -> None:
    """Its connection stays open for ten seconds."""
    link, said, stop, now_s = StandingLink(), list[str](), threading.Event(), [0.0]
    membership = Membership(link, stop, said.append, clock=lambda: now_s[0])  # type: ignore[arg-type]
    try:
        wait_until("it has joined", lambda: said == ["front: serving tcp/127.0.0.1:1"])
        asked = link.asked
        membership._hear()
        assert link.asked == asked  # a server that asks is not asked
        link.answers, now_s[0] = False, ASK_AFTER_S + 0.01
        wait_until("it is told", lambda: len(said) > 1)
        wait_until("it asks again", lambda: link.asked > asked + 2)
        assert said[1:] == [
            "front: the server at tcp/127.0.0.1:1 does not answer (it stands still, or the link is down); "
            "frames are kept for it"
        ]
        link.answers = True
        wait_until("it is back", lambda: len(said) > 2)
        assert said[2:] == ["front: the server at tcp/127.0.0.1:1 answers again"]
    finally:
        stop.set()
        membership.close()
    assert ASK_AFTER_S + _LOOK_EVERY_S + ANSWER_S <= 3.0  # the longest time until it is told


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    running = Server(ServerSettings(f"tcp/127.0.0.1:{free_port()}", setup=Setup("stand-still"), reserve_bytes=0))
    running.record_to(tmp_path / "a.mcap")
    yield running
    running.close()


def test_a_question_or_an_answer_of_the_server_is_heard(server: Server) -> None:
    with NodeLink(server._settings.listen, "front") as link:
        assert link.heard_s == float("-inf")
        wait_until("it joins", link.join)
        joined_s = link.heard_s
        assert joined_s > 0
        wait_until("a question is heard", lambda: link.heard_s > joined_s)


def test_no_question_of_a_server_and_no_answer_ends_a_callback(server: Server) -> None:
    def fail(*_: object) -> None:
        raise KeyError("planted")

    with NodeLink(server._settings.listen, "front") as link:
        link.answer(fail)
        wait_until("it joins", link.join)
        with pytest.MonkeyPatch.context() as planted:
            planted.setattr(NodeLink, "heard_s", property(lambda link: 0.0, fail), raising=False)
            for what in ("clock probe", "request for frames"):
                wait_until(what, lambda: any(reason.startswith(what) for reason in link.errors.counts))  # noqa: B023
            with pytest.raises(BusError):
                ask_node(server._link._session, "front", AskReport(), timeout=0.5)
        assert any(reason.startswith("question") for reason in link.errors.counts)
        wait_until("its clock is known", lambda: server.status().sensors[0].clock_offset is not None)
        link.publish(next(Source().frames()).frame)
    assert server.close().frames == 1
