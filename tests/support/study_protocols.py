"""Protocols of studies for tests by example."""

from __future__ import annotations

import string
from typing import Any

from hypothesis import strategies as st

from mocapella.studies.protocol import (
    FloorBlock,
    FloorPoint,
    Instruction,
    ParticipantGroup,
    Participants,
    Placement,
    StudyProtocol,
    Task,
)

TEXTS = st.text(string.ascii_letters + string.digits + " .,;\"'\\#\näß°", max_size=20)


def names(most: int) -> Any:
    """Return a strategy of different names that files can have."""
    name = st.from_regex(r"[a-z][a-z0-9_-]{0,5}x", fullmatch=True)
    return st.lists(name, min_size=1, max_size=most, unique=True)


@st.composite
def protocols(draw: Any, most_tasks: int = 4) -> StudyProtocol:
    """Draw a valid protocol of up to three placements and ``most_tasks`` tasks."""
    points, placements, tasks = draw(names(3)), draw(names(3)), draw(names(most_tasks))
    numbers = draw(st.lists(st.integers(0, 999), min_size=1, max_size=7, unique=True))
    codes = tuple(f"P{number:03}" for number in numbers)
    middle = (len(codes) + 1) // 2
    groups = [ParticipantGroup(name, some) for name, some in (("a", codes[:middle]), ("b", codes[middle:])) if some]
    participants = draw(
        st.sampled_from([Participants(len(codes)), Participants(0, codes), Participants(groups=tuple(groups))])
    )
    group_names = [group.name for group in participants.groups]
    order = st.sampled_from(["fixed", "counterbalanced", "random"])
    somewhere = st.lists(st.sampled_from(["", *points]), max_size=2).map(tuple)
    step = st.builds(
        Instruction,
        text=TEXTS,
        seconds=st.none() | st.floats(0.1, 20),
        stand=somewhere,
        foot=somewhere,
        tone_hz=st.none() | st.floats(50, 8000),
    )
    return StudyProtocol(
        title=draw(st.text("abc ", min_size=1, max_size=9)),
        participants=participants,
        placements=tuple(
            Placement(name, place, draw(TEXTS), draw(st.integers(1, 9))) for place, name in enumerate(placements)
        ),
        tasks=tuple(
            Task(
                name=name,
                scenario=draw(st.integers(0, 9)),
                steps=tuple(draw(st.lists(step, min_size=1, max_size=3))),
                text=draw(TEXTS),
                minimum_s=draw(st.sampled_from([0.0, 1.5, 30.0])),
                pause_s=draw(st.sampled_from([0.0, 2.0])),
                repetitions=draw(st.integers(1, 3)),
                people=2,
                placements=tuple(draw(st.sets(st.sampled_from(placements), max_size=2))),
                groups=tuple(draw(st.sets(st.sampled_from(group_names), max_size=1))) if group_names else (),
            )
            for name in tasks
        ),
        seed=draw(st.integers(0, 2**63 - 1)),
        task_order=draw(order),
        placement_order=draw(order),
        retention_days=draw(st.integers(0, 4000)),
        consent=draw(TEXTS),
        block=FloorBlock(2.0, 1.5, "", tuple(FloorPoint(name, 0.5, -0.25) for name in points)),
    )
