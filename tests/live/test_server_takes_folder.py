"""A server says at its start that takes cannot be recorded, unless nobody has to ask for one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from mocapella.live.server import Server, ServerSettings
from mocapella.model.session import Setup


class NoBus:
    """In place of a link to the bus: nobody is there."""

    refused = 0

    def serve(self, **callbacks: Any) -> None:
        self.callbacks = callbacks

    def publish_status(self, data: bytes) -> None: ...

    def close(self) -> None: ...


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
