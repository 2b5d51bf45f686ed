"""What a session does about what happens around it."""

from __future__ import annotations

import inspect
import threading

import pytest
from programs import free_port

from mocapella.cli.serve import LiveSession, serve, wait_while
from mocapella.live.launch import Children
from mocapella.live.server import Server, ServerSettings
from mocapella.recording.disk import GIB


def test_a_view_that_ends_by_itself_is_told_of_once_and_ends_nothing_else(capsys: pytest.CaptureFixture[str]) -> None:
    server = Server(ServerSettings(f"tcp/127.0.0.1:{free_port()}"))
    told: list[str] = []
    looks = 0

    def looked_often() -> bool:
        nonlocal looks
        looks += 1
        told.append(capsys.readouterr().err)
        return "".join(told) != "" and looks > 3

    try:
        with Children() as view, Children() as nodes:
            view.start(["--version"])
            wait_while(LiveSession(server, view, nodes, threading.Event()), 60.0, until=looked_often)
        assert "".join(told).count("the live view has ended") == 1
        assert not server.failed.is_set()
    finally:
        server.close()


def test_a_recording_leaves_the_same_room_however_the_server_is_started() -> None:
    default = inspect.signature(serve).parameters["reserve_gib"].default
    assert default * GIB == ServerSettings("tcp/127.0.0.1:7447").reserve_bytes
