"""What a node's command says at its end."""

from __future__ import annotations

import threading
from contextlib import contextmanager, nullcontext
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from mocapella.cli.nodes import serve_frames
from mocapella.live import node, node_disk, signals
from mocapella.live.node import NodeSummary

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.mark.parametrize(
    ("served", "published", "words"),
    [
        (True, 7, "front: 7 frames published, 2 of them late"),
        (False, 0, "front: no server was at tls/lab:7447; the sensor has sent no frame"),
        (False, 1, "front: no server was at tls/lab:7447; nobody received its 1 frame"),
        (False, 7, "front: no server was at tls/lab:7447; nobody received its 7 frames"),
    ],
)
def test_how_many_frames_were_received_is_said(
    served: bool, published: int, words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    @contextmanager
    def link(*_: Any, **__: Any) -> Iterator[Any]:
        yield SimpleNamespace(address="tls/lab:7447")

    summary = NodeSummary("front", "0" * 16, served, published, late=2, worst_delay=0.1, seconds=1.0)
    monkeypatch.setattr(node_disk, "open_link", link)
    monkeypatch.setattr(signals, "stop_on_signals", lambda: nullcontext(threading.Event()))
    monkeypatch.setattr(node, "run_node", lambda *_, **__: summary)
    serve_frames(lambda: [], "front", "tls/lab:7447", None, None, wait=True)
    assert capsys.readouterr().err == f"{words}\n"
