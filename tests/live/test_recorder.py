"""What a recorder takes for the take, of frames on the live path and of those that are sent again."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import msgspec
import pytest
from support.take_making import SECOND, frame, info

from mocapella.live import recorder as recorders
from mocapella.live.record_path import hear_answer
from mocapella.live.recorder import Recorder
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_frame
from mocapella.wire.delivery import FrameAnswer
from mocapella.wire.keys import NodeKey

FRONT = NodeKey("front", 1)


def encoded(number: int) -> bytes:
    return encode_frame(msgspec.structs.replace(frame("front", 1), sequence=number))


def test_a_frame_that_was_on_its_way_as_the_take_began_belongs_to_it(tmp_path: Path) -> None:
    """Its node has sent it before, so the node's first frame of the take is the next one: 14."""
    recorder = Recorder(TakeWriter.create(tmp_path / "walk.mcap", info=info(), reserve_bytes=0), lambda text: None)
    answer = FrameAnswer(next=16, oldest=0, first=14, leaving=False)
    recorder.account(FRONT, partial(hear_answer, answer=answer, first=14, end=None))
    for number in (13, 14, 15):
        recorder.frame(FRONT, encoded(number), SECOND, number)
    recorder.sent_again([(0, 9)], FRONT, encoded(9), SECOND)  # of a node that sends more than it was asked for
    recorder.account(FRONT, partial(hear_answer, answer=answer, first=None, end=16))
    health = recorder.close()
    assert (health.frames, health.lost) == (3, 0)


def test_what_was_tracked_before_the_take_does_not_belong_to_it(tmp_path: Path) -> None:
    writer = TakeWriter.create(tmp_path / "walk.mcap", info=info(), reserve_bytes=0)
    recorder = Recorder(writer, lambda text: None, {FRONT: 14})
    for number in (12, 13, 14):
        recorder.frame(FRONT, encoded(number), SECOND, number)
    health = recorder.close()
    assert (health.frames, health.lost) == (1, 0)


def test_a_disk_that_is_too_slow_costs_no_command_and_what_it_costs_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames can be asked for again; what changed the session cannot, and without it the take replays differently."""
    said: list[str] = []
    writer = TakeWriter.create(tmp_path / "walk.mcap", info=info(), reserve_bytes=0)
    recorder = Recorder(writer, said.append)
    monkeypatch.setattr(recorders, "_QUEUE_BYTES", -1)  # nothing has room
    for _ in range(3):
        recorder.scene(b"a scene", SECOND)
        recorder.truth("front", b"a truth", SECOND)
    recorder.command("recalibrate", {}, SECOND, before_step=1, by="the view")
    health = recorder.close()
    assert (health.problem, health.scenes) == ("", 0)
    assert [line.partition(": ")[0] for line in said] == [
        "scenes of the session are not recorded",
        "ground truths of front are not recorded",
    ]
    assert [command.values["verb"] for command in read_take(tmp_path / "walk.mcap").commands()] == ["recalibrate"]
