"""A recording session whose disk is full, or writes while the session is ended."""

from __future__ import annotations

import errno
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from support.programs import free_port, wait_until

from mocapella.errors import UnstoredFramesError
from mocapella.live.server import Server, ServerSettings
from mocapella.live.signals import stop_on_signals
from mocapella.model.observations import body_frame
from mocapella.model.session import Setup
from mocapella.model.topology import topology
from mocapella.recording import disk
from mocapella.recording.take import TakeReport
from mocapella.recording.take_reader import read_take
from mocapella.recording.take_writer import TakeWriter
from mocapella.wire.node import NodeLink

POSITIONS = np.random.default_rng(0).normal(size=(1, 25, 3)).astype(np.float32)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.mcap"


@pytest.fixture
def server(path: Path) -> Iterator[Server]:
    address = f"tcp/127.0.0.1:{free_port()}"
    running = Server(ServerSettings(address, setup=Setup("stand-still"), reserve_bytes=0, record=path))
    yield running
    running.close()


@pytest.fixture
def front(server: Server) -> Iterator[NodeLink]:
    with suppress(UnstoredFramesError), NodeLink(server._settings.listen, "front") as link:
        wait_until("it joins", link.join)
        yield link
        link.farewell_s = 0.0


def until(what: str, link: NodeLink, holds: Callable[[], bool]) -> None:
    """Publish frames until something holds."""

    def published() -> bool:
        k = link.published + 1
        link.publish(body_frame("", topology("kinect_v2"), time_ns=k * 33_000_000, positions=POSITIONS))
        return holds()

    wait_until(what, published)


def test_tracking_goes_on_when_the_disk_is_full(
    server: Server, front: NodeLink, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_fd: int, _data: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    until("frames are stored", front, lambda: server.status().recording.frames > 3)
    with monkeypatch.context() as patch:
        patch.setattr(disk, "write_all", full)
        until("the recording stops", front, lambda: not server.status().recording.active)
        before = server.summary.scenes_out
        until("frames are tracked", front, lambda: server.summary.scenes_out > before + 3)
    status = server.status()
    assert "the disk is full" in status.recording.problem
    assert any("RECORDING STOPPED" in notice for notice in status.notices)
    assert read_take(path).frame_count == status.recording.frames > 3


def test_a_signal_during_a_write_loses_nothing(
    server: Server, front: NodeLink, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """During that of frames, and then during the last one, which closes the take."""
    sync, close = disk._data_sync, TakeWriter.close
    syncing, may_sync, closing, may_close = (threading.Event() for _ in range(4))

    def slow_sync(fd: int) -> None:
        syncing.set()
        assert may_sync.wait(60.0)
        sync(fd)

    def slow_close(writer: TakeWriter, **how: bool) -> TakeReport:
        closing.set()
        assert may_close.wait(60.0)
        return close(writer, **how)

    with monkeypatch.context() as patch, stop_on_signals() as stop:
        patch.setattr(disk, "_data_sync", slow_sync)
        patch.setattr(TakeWriter, "close", slow_close)
        until("a write is under way", front, syncing.is_set)
        signal.raise_signal(signal.SIGTERM)
        assert stop.wait(60.0)
        ending = threading.Thread(target=server.close, daemon=True)
        ending.start()
        wait_until("it ends", server._ended.is_set)
        may_sync.set()
        assert closing.wait(60.0)
        ending.join(1.0)
        assert ending.is_alive()  # it waits for the take
        may_close.set()
        ending.join(60.0)
        assert not ending.is_alive()
    take = read_take(path)
    (frames,) = take.complete()
    assert (take.clean, frames.stored, frames.lost) == (True, front.published, 0)
