"""Notices about the tracker's state: each change of the phase, and conditions while tracking."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from mocapella.live.summary import RunSummary
from mocapella.model.scene import Phase, TrackerState

CONDITION_AGAIN_S: Final = 10.0
"""A condition that returns within this time is not reported again [s]."""


class StateNotices:
    """Reports changes of the tracker's state, and adds them to the summary.

    Args:
        summary: receives each change of the phase; formulates the texts about sensors.
        say: receives the notices.
    """

    def __init__(self, summary: RunSummary, say: Callable[[str], None]) -> None:
        self._summary, self._say = summary, say
        self._phase = self._reason = ""
        self._reported: dict[str, float] = {}

    def update(self, state: TrackerState, uptime_s: float) -> None:
        """Report a change of phase, or new conditions; ``uptime_s`` is the time since the server's start [s]."""
        if state.phase.value != self._phase:
            self._phase = state.phase.value
            self._summary.state(uptime_s, self._phase, state.reason)
            self._say(self._phase + (f": {self._summary.in_words(state.reason)}" if state.reason else ""))
        elif state.phase is Phase.TRACKING and state.reason != self._reason:
            self.conditions(state.reason, uptime_s)
        self._reason = state.reason

    def conditions(self, reason: str, now_s: float) -> None:
        """Report conditions while tracking; one that returns within `CONDITION_AGAIN_S` is not reported again.

        Args:
            reason: the state's reason: conditions separated by ``"; "``.
            now_s: the present time on any clock that rises [s].
        """
        self._reported = {text: at_s for text, at_s in self._reported.items() if now_s - at_s < CONDITION_AGAIN_S}
        for text in self._summary.in_words(reason).split("; "):
            if text and not text.endswith(": silent") and text not in self._reported:  # silence: see the registry
                self._reported[text] = now_s
                self._say(text)
