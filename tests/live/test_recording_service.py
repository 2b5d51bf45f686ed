"""Takes begun and ended from several threads, gaps that are mended, and bytes that are not what they say."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support.programs import wait_until

from mocapella.errors import NotNowError
from mocapella.live import refetch
from mocapella.live.recorder import Recorder
from mocapella.live.recording_service import RecordingService
from mocapella.live.session import Session
from mocapella.model.observations import body_frame
from mocapella.model.session import Setup
from mocapella.model.topology import topology
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_frame
from mocapella.wire.keys import NodeKey
from mocapella.wire.server import OnFrame

NODE = NodeKey("front", 1)
POSITIONS = np.random.default_rng(0).normal(size=(1, 25, 3)).astype(np.float32)


class Bus:
    """In place of the bus: remembers how far back was asked; may be slow to end the record path."""

    def __init__(self) -> None:
        self.fetched: list[float] = []
        self.open = 0
        self.may_end = threading.Event()
        self.may_end.set()

    def start_record_path(self, _on_frame: OnFrame) -> None:
        self.open = 1

    def fetch_history(self, _on_frame: OnFrame, history_s: float) -> None:
        self.fetched.append(history_s)

    def stop_record_path(self) -> None:
        assert self.may_end.wait(30.0)
        self.open -= 1


class Harness:
    """A harness, and what it was heard to say."""

    def __init__(self) -> None:
        self.bus, self.said = Bus(), []  # type: ignore[var-annotated]
        link: object = self.bus
        self.service = RecordingService(Session(Setup()), link, _ignore, self.said.append, reserve_bytes=0)  # type: ignore[arg-type]

    @property
    def recorder(self) -> Recorder:
        assert self.service.recorder is not None
        return self.service.recorder

    def record(self, *sequences: int, sensor: str = "front", node_id: int = 1) -> None:
        """Frames that were sent a second apart and all arrive now."""
        for k in sequences:
            frame = body_frame(
                sensor,
                topology("kinect_v2"),
                time_ns=k,
                positions=POSITIONS,
                node_id=node_id,
                sequence=k,
                sent_ns=k * 1_000_000_000,
            )
            self.recorder.frame(NODE, encode_frame(frame), time.monotonic_ns())


def _ignore(_node: NodeKey, _data: bytes, _arrived_ns: int) -> None:
    """Frames come from the test, not from the bus."""


@pytest.fixture
def harness(monkeypatch: pytest.MonkeyPatch) -> Iterator[Harness]:
    made = Harness()
    yield made
    made.bus.may_end.set()
    monkeypatch.setattr("mocapella.live.recording_service.CATCH_UP_S", 0.0)  # nobody sends what is still missing
    made.service.finish()


def test_a_gap_that_the_bus_left_is_asked_for_again_and_mended(
    harness: Harness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(refetch, "ASK_AFTER_S", 0.0)
    harness.service.begin(tmp_path / "a.mcap")
    harness.record(0, 1, 2, 8, 9)
    wait_until("the gap is known", lambda: harness.recorder.missing == 5)
    harness.service.fetch_missing()
    assert len(harness.bus.fetched) == 1
    assert any("5 missing frames" in text for text in harness.said)
    harness.record(*range(10))
    assert harness.service.finish().lost == 0
    (frames,) = read_take(tmp_path / "a.mcap").complete()
    assert (frames.first, frames.last, frames.missing) == (0, 9, ())


def test_a_take_begins_after_the_newest_frame_and_newcomers_are_asked_for_once(
    harness: Harness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(refetch, "ASK_AFTER_S", 0.0)
    harness.service.begin(tmp_path / "a.mcap", newest={NODE: 4})
    harness.record(3, 4, 5, 6)
    wait_until("they are there", lambda: harness.recorder.health().frames == 2)
    harness.service.fetch_missing()
    assert harness.bus.fetched == []
    harness.service.finish()
    harness.service.begin(tmp_path / "b.mcap", newest={NODE: 4})
    harness.record(6, 7)  # 5 was lost on the way, and no frame before it tells
    wait_until("they are there", lambda: harness.recorder.health().frames == 2)
    harness.service.fetch_missing()
    harness.service.fetch_missing()
    assert len(harness.bus.fetched) == 1
    harness.record(5)
    harness.service.finish()
    assert [frames.first for take in "ab" for frames in read_take(tmp_path / f"{take}.mcap").complete()] == [5, 5]


def test_frames_that_were_held_up_are_asked_for_back_to_when_they_were_sent(
    harness: Harness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As after a server that stood still: what was on the way arrives late, and just before what was sent after it."""
    monkeypatch.setattr(refetch, "ASK_AFTER_S", 0.0)
    harness.service.begin(tmp_path / "a.mcap")
    monkeypatch.setattr(harness.recorder, "_not_before", -math.inf)
    harness.record(0, 1, 2, 32)
    wait_until("the gap is known", lambda: harness.recorder.missing == 29)
    harness.service.fetch_missing()
    assert 30.0 < harness.bus.fetched[-1] < 60.0


def test_the_end_of_a_take_asks_for_what_is_missing_and_says_what_does_not_come(
    harness: Harness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(refetch, "ASK_AFTER_S", 0.0)
    monkeypatch.setattr("mocapella.live.recording_service.CATCH_UP_S", 0.5)
    harness.service.begin(tmp_path / "a.mcap")
    harness.record(0, 1, 2, 8, 9)
    health = harness.service.finish()
    assert health.lost == 5
    assert len(harness.bus.fetched) == refetch.MOST_ASKS
    assert harness.bus.open == 0
    assert harness.said[-1].endswith("a.mcap; 5 frames are missing")


def test_a_take_that_is_being_closed_is_waited_for_and_none_begins_meanwhile(harness: Harness, tmp_path: Path) -> None:
    harness.service.begin(tmp_path / "a.mcap")
    harness.record(0)
    harness.bus.may_end.clear()
    results = []
    ends = [threading.Thread(target=lambda: results.append(harness.service.finish())) for _ in range(3)]
    for thread in ends:
        thread.start()
    wait_until("one of them closes it", lambda: harness.service.recorder is None)
    with pytest.raises(NotNowError, match="being closed"):
        harness.service.begin(tmp_path / "b.mcap")
    closing = harness.service.health()  # a client that asks now hears of this take, not of the one before or of none
    assert closing.active
    assert closing.path == str(tmp_path / "a.mcap")
    harness.service.fetch_missing()
    harness.bus.may_end.set()
    for thread in ends:
        thread.join()
    assert [health.frames for health in results] == [1, 1, 1]
    assert not harness.service.health().active
    assert harness.bus.open == 0
    harness.service.begin(tmp_path / "b.mcap")
    assert harness.bus.open == 1


def test_a_frame_under_another_nodes_key_does_not_get_into_a_take(harness: Harness, tmp_path: Path) -> None:
    harness.service.begin(tmp_path / "a.mcap")
    harness.record(0)
    harness.record(1, sensor="side")
    harness.record(2, node_id=2)
    harness.recorder.truth("front", b"no truth", 1003)
    harness.record(1)
    assert harness.service.finish().frames == 2
    take = read_take(tmp_path / "a.mcap")
    assert [(frames.sensor, frames.node_id, frames.stored) for frames in take.complete()] == [("front", 1, 2)]
    assert list(take.truths("front")) == []
    told = [text for text in harness.said if "not recorded" in text]  # once a sensor, not thirty times a second
    assert [text.partition(":")[0] for text in told] == [
        "frames of front are not recorded",
        "truths of front are not recorded",
    ]


def test_a_take_that_is_removed_while_it_is_recorded_stops_loudly_and_another_can_begin(
    harness: Harness, tmp_path: Path
) -> None:
    harness.service.begin(tmp_path / "a.mcap")
    harness.record(0, 1)
    wait_until("it is stored", lambda: harness.service.health().frames == 2)
    (tmp_path / "a.mcap").unlink()
    wait_until("it is noticed", lambda: not harness.service.health().active)
    health = harness.service.finish()
    assert "was removed while it was recorded" in health.problem
    assert (health.frames, health.lost) == (0, 2)
    assert any("RECORDING STOPPED" in text for text in harness.said)
    harness.service.begin(tmp_path / "b.mcap")
    assert harness.service.health().active


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_recorder_that_fails_of_what_nobody_foresaw_says_so(
    harness: Harness, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    harness.service.begin(tmp_path / "a.mcap")

    def fails(_self: TakeWriter) -> None:
        raise ZeroDivisionError

    with monkeypatch.context() as patch:
        patch.setattr(TakeWriter, "flush", fails)
        wait_until("it is noticed", lambda: not harness.service.health().active)
    assert "failed" in harness.service.finish().problem
    assert any("RECORDING STOPPED" in text for text in harness.said)
    harness.service.begin(tmp_path / "b.mcap")
    assert harness.service.health().active
