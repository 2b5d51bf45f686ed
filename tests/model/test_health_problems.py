"""What a server's health says of itself, and what a frame is called."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from support.messages import plain_frame

from mocapella.model.frame_types import what_it_sends
from mocapella.model.sensor_frame import UnknownFrame
from mocapella.model.session import ServerHealth


@pytest.mark.parametrize(("free", "told"), [(None, False), (2 * 10**9, False), (2 * 10**9 - 1, True), (0, True)])
def test_a_disk_with_less_than_twice_the_reserve_is_told(free: int | None, told: bool) -> None:
    problems = ServerHealth(disk_free_bytes=free, reserve_bytes=10**9).problems()
    assert any("of disk are left; a recording stops at 1.0 GB" in line for line in problems) == told
    assert len(problems) == told


def test_each_problem_is_a_line() -> None:
    health = ServerHealth(errors={"a": 2, "b": 1}, turned_away={"frames": 3}, ended=("view",))
    assert health.problems() == (
        "the view has ended",
        "3 unexpected errors; the first: a",
        "turned away: 3 frames",
    )


@pytest.mark.parametrize(
    ("frame", "name"),
    [
        (plain_frame(1), "skeletons"),
        (UnknownFrame("roof", 1, 2, 3, 4, "radar", b""), "radar"),
        (SimpleNamespace(sensor="roof"), "SimpleNamespace"),
    ],
)
def test_a_frame_is_called_by_its_type_or_what_it_says(frame: Any, name: str) -> None:
    assert what_it_sends(frame) == name
