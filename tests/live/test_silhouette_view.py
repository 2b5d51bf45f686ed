"""How long a finished run stays in its view."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from mocapella.live import silhouette_view
from mocapella.live.silhouette_view import RunView


class Standing(RunView):
    """A view of which nothing is shown; it counts its beats."""

    def __init__(self) -> None:
        self.beats, self.ended = 0, False
        self.viewer = SimpleNamespace(end=self._end)  # type: ignore[assignment]

    def _end(self) -> None:
        self.ended = True

    def beat(self) -> None:
        assert self.ended
        self.beats += 1


@pytest.mark.parametrize(("seconds", "shown"), [(None, 10), (0.0, 1), (3.0, 4), (3.5, 5), (100.0, 10)])
def test_a_finished_run_stays_for_its_seconds_or_until_it_is_told(
    monkeypatch: pytest.MonkeyPatch, seconds: float | None, shown: int
) -> None:
    """It is told to stop after ten beats, a second apart."""

    def beats(_rate_hz: float, _stop: threading.Event) -> Iterator[float]:
        yield from (100.0 + k for k in range(10))

    monkeypatch.setattr(silhouette_view, "beats", beats)
    monkeypatch.setattr(silhouette_view, "time", SimpleNamespace(monotonic=lambda: 100.0))
    view = Standing()
    view.stay(threading.Event(), seconds)
    assert view.beats == shown
