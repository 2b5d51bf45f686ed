"""Replay a recording through the same `Session` as the live run, at full speed, without thread, clock or bus."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from mocapella.live.session import Session
from mocapella.live.summary import RunSummary
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene
from mocapella.recording.take import Command


def replay(
    session: Session,
    events: Iterable[Arrival | Command],
    on_scene: Callable[[Scene], None] = lambda scene: None,
    summary: RunSummary | None = None,
) -> RunSummary:
    """Pass every frame and command to the session in order; return ``summary`` with the results added."""
    summary = summary or RunSummary()
    phase, began_ns = "", None
    for event in events:
        if isinstance(event, Command):
            session.carry_out(event.values["verb"], event.values["arguments"])
            continue
        began_ns = event.at_ns if began_ns is None else began_ns
        summary.began_ns = began_ns
        summary.frames_in += 1
        scene = session.step(event)
        if scene is None:
            continue
        on_scene(scene)
        summary.scene(scene, None, event.at_ns)
        if scene.state.phase.value != phase:
            phase = scene.state.phase.value
            summary.state((event.at_ns - began_ns) / 1e9, phase, scene.state.reason)
    return summary
