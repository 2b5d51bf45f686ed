"""The configuration that every session on the bus has."""

from __future__ import annotations

import json

import pytest
from support.programs import free_port

from mocapella.wire.session import open_node, open_server


@pytest.mark.parametrize("role", ["server", "node"])
def test_messages_have_no_wall_clock_times(role: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With them, the bus complains of each message of a machine whose wall clock is ahead."""
    opened = []
    monkeypatch.setattr("zenoh.open", opened.append)
    address = f"tls/127.0.0.1:{free_port()}"
    open_server(address) if role == "server" else open_node(address)
    (config,) = opened
    assert json.loads(config.get_json("timestamping/enabled")) is False
