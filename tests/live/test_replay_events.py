"""A replay of frames and commands: what it counts, when phases change, and that it goes on after a failure."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
from support.messages import small_scene

from mocapella.live.replay import replay
from mocapella.model.depth import depth_frame
from mocapella.model.observations import Arrival
from mocapella.model.scene import Phase, Scene, TrackerState
from mocapella.recording.take import Command

BEGAN_NS = 90_000_000_000
FRAME = depth_frame("front", np.ones((2, 2), np.uint16), unit_m=0.001, lens=[2.0, 2.0, 1.0, 1.0], time_ns=1)
PHASES = [Phase.CALIBRATING, Phase.CALIBRATING, Phase.TRACKING, Phase.TRACKING, Phase.CALIBRATING]


class Scripted:
    """A session whose phase at each step is given; it fails at the steps without one, and at every command."""

    def __init__(self, phases: list[Phase | None]) -> None:
        self.phases = list(phases)

    def step(self, event: Arrival) -> Scene:
        phase = self.phases.pop(0)
        if phase is None:
            raise ValueError("this frame is odd")
        return msgspec.structs.replace(small_scene(), at_ns=event.at_ns, state=TrackerState(phase, reason=phase.value))

    def carry_out(self, verb: str, arguments: Any) -> None:
        raise ValueError(f"{verb} cannot be")


def frames(count: int) -> list[Arrival]:
    """Half a second apart."""
    return [Arrival(FRAME, BEGAN_NS + 500_000_000 * k) for k in range(count)]


def test_changes_of_the_phase_are_said_once_in_seconds_since_the_first_frame() -> None:
    scenes: list[Scene] = []
    summary = replay(Scripted(PHASES), frames(5), scenes.append)  # type: ignore[arg-type]
    changes = [(change["at_s"], change["phase"]) for change in summary.state_changes]
    assert changes == [(0.0, "calibrating"), (1.0, "tracking"), (2.0, "calibrating")]
    assert [change["reason"] for change in summary.state_changes] == [phase for _, phase in changes]
    assert [scene.at_ns for scene in scenes] == [event.at_ns for event in frames(5)]
    assert (summary.frames_in, summary.scenes_out, summary.untracked) == (5, 5, 0)
    assert summary.began_ns == BEGAN_NS


def test_a_frame_or_command_that_fails_is_counted_or_told_and_the_rest_goes_on() -> None:
    """The first frame is the beginning, although it fails."""
    told: list[str] = []
    command = Command(1, BEGAN_NS, {"verb": "leap", "arguments": {}})
    one, *others = frames(3)
    failing: list[Phase | None] = [None, Phase.TRACKING, None]
    summary = replay(Scripted(failing), [one, command, *others], on_damage=told.append)  # type: ignore[arg-type]
    assert (summary.frames_in, summary.scenes_out, summary.untracked) == (3, 1, 2)
    assert [change["at_s"] for change in summary.state_changes] == [0.5]
    assert sum(summary.errors.values()) == 2
    (text,) = told
    assert text.startswith("a command before step 1 cannot be carried out")
    assert "leap cannot be" in text
