"""Steps of the wall clock are noticed; a slewed clock and a busy machine are none."""

from __future__ import annotations

import pytest

from mocapella.live.wall_clock import STEP_NS, WallClock

S = 10**9


class Clocks:
    """Wall clock and monotonic clock, which advance by ``looking_ns`` whenever one is looked at."""

    def __init__(self) -> None:
        self.now_ns, self.offset_ns, self.looking_ns = 50 * S, 10**18, 1000

    def wall(self) -> int:
        return self.monotonic() + self.offset_ns

    def monotonic(self) -> int:
        self.now_ns += self.looking_ns
        return self.now_ns


@pytest.fixture
def clocks() -> Clocks:
    return Clocks()


@pytest.fixture
def watch(clocks: Clocks) -> WallClock:
    return WallClock(wall_ns=clocks.wall, monotonic_ns=clocks.monotonic)


@pytest.mark.parametrize("step_s", [5.0, -5.0, 30.0, -30.0, 7200.0, -7200.0, 0.11, -0.11])
def test_a_step_is_told_of_once(clocks: Clocks, watch: WallClock, step_s: float) -> None:
    assert watch.step() == ""
    clocks.offset_ns += round(step_s * S)
    assert watch.step().startswith(f"the wall clock of this machine stepped by {step_s:+.1f} s")
    assert watch.step() == ""


def test_a_slewed_clock_does_not_step(clocks: Clocks, watch: WallClock) -> None:
    for _ in range(10_000):
        clocks.now_ns += S // 5
        clocks.offset_ns += S // 5 * 500 // 10**6
        assert watch.step() == ""


@pytest.mark.parametrize("looking_ns", [STEP_NS, S, 60 * S])
def test_a_busy_machine_does_not_step(clocks: Clocks, watch: WallClock, looking_ns: int) -> None:
    """Whatever time passes between two looks at the clocks."""
    for pace_ns in (looking_ns, 1000, looking_ns, looking_ns, 1000):
        clocks.looking_ns = pace_ns
        assert watch.step() == ""
    clocks.offset_ns -= 5 * S
    assert watch.step()
