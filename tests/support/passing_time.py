"""Time that passes only while somebody waits, for tests of what keeps time: exact, and without a wait."""

from __future__ import annotations


class PassingTime:
    """A clock, and the event with which a loop waits and is ended."""

    def __init__(self, now_s: float = 0.0) -> None:
        self.now_s, self.ended = now_s, False

    def monotonic(self) -> float:
        return self.now_s

    def is_set(self) -> bool:
        return self.ended

    def wait(self, seconds: float) -> bool:
        if not self.ended:
            self.now_s += seconds
        return self.ended
