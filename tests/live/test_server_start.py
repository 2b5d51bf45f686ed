"""How a server begins and ends, in place of a bus: what it says of its folder, and what it uses that is given to it."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import pytest

from mocapella.errors import BusError
from mocapella.live.server import Server, ServerSettings
from mocapella.model.session import Setup


class NoBus:
    """In place of a link to the bus: nobody is there."""

    refused = 0
    closed = False

    def serve(self, **callbacks: Any) -> None:
        self.callbacks = callbacks

    def publish_status(self, data: bytes) -> None: ...

    def close(self) -> None:
        self.closed = True


class Broken(NoBus):
    def serve(self, **callbacks: Any) -> None:
        raise BusError("no bus")


def settings_of(folder: Path) -> ServerSettings:
    return ServerSettings("", takes=folder, setup=Setup("stand-still"), reserve_bytes=0)


def test_a_server_uses_the_link_and_the_event_that_it_is_given_and_closes_the_link_at_the_end(tmp_path: Path) -> None:
    link, failed = NoBus(), threading.Event()
    server = Server(settings_of(tmp_path), link=link, failed=failed)  # type: ignore[arg-type]
    try:
        assert server.failed is failed
        assert not link.closed
    finally:
        server.close()
    assert link.closed
    assert not failed.is_set()  # it has ended as it should


def test_a_server_that_cannot_begin_leaves_the_link_that_it_is_given_and_no_thread(tmp_path: Path) -> None:
    before, link = set(threading.enumerate()), Broken()
    with pytest.raises(BusError, match="no bus"):
        Server(settings_of(tmp_path), link=link)  # type: ignore[arg-type]
    assert not link.closed
    assert not set(threading.enumerate()) - before


@pytest.mark.parametrize(("usable", "recorded"), [(True, False), (False, False), (False, True)])
def test_a_folder_that_cannot_be_used_is_told_of_if_no_take_is_recorded_yet(
    tmp_path: Path, usable: bool, recorded: bool
) -> None:
    takes = tmp_path / "takes"
    if not usable:
        takes.write_text("a file where the folder should be")
    record = tmp_path / "a.mcap" if recorded else None
    settings = ServerSettings("", takes=takes, setup=Setup("stand-still"), record=record, reserve_bytes=0)
    server = Server(settings, link=NoBus())  # type: ignore[arg-type]
    try:
        told = any("takes cannot be recorded" in notice for notice in server.status().notices)
    finally:
        health = server.close()
    assert told == (not usable and not recorded)
    assert bool(health.path) == recorded
