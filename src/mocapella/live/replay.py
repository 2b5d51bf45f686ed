"""Replay a recording through the same `Session` as the live run, at full speed, without thread, clock or bus."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from mocapella.decoding import FAULTS
from mocapella.errors import MocapellaError
from mocapella.live.session import Session
from mocapella.live.summary import RunSummary
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene
from mocapella.recording.take import Command
from mocapella.supervision import Boundary


def replay(
    session: Session,
    events: Iterable[Arrival | Command],
    on_scene: Callable[[Scene], None] = lambda scene: None,
    summary: RunSummary | None = None,
    on_damage: Callable[[str], None] = lambda text: None,
) -> RunSummary:
    """Pass every frame and command to the session in order; return ``summary`` with the results added.

    A frame whose tracking fails unexpectedly is counted, and the replay goes on. A frame that failed in the live run is
    not among the events; a command that restores the tracker's snapshot after it is.

    Args:
        session: a new session with the recording's setup.
        events: frames and commands, such as of `mocapella.recording.take_reader.Take.replay_run`.
        on_scene: called with each scene.
        summary: changed in place; None for a new one.
        on_damage: called with a description of each command that cannot be carried out, and is left out.
    """
    summary = summary or RunSummary()
    errors = Boundary()
    phase, began_ns = "", None
    for event in events:
        if isinstance(event, Command):
            try:
                session.carry_out(event.values["verb"], event.values["arguments"])
            except (MocapellaError, *FAULTS) as error:
                on_damage(f"a command before step {event.before_step} cannot be carried out ({error!r})")
            continue
        began_ns = event.at_ns if began_ns is None else began_ns
        summary.began_ns = began_ns
        summary.frames_in += 1
        scene = _step(session, event, errors)
        if scene is None:
            summary.untracked += 1
            continue
        on_scene(scene)
        summary.scene(scene, None, event.at_ns)
        if scene.state.phase.value != phase:
            phase = scene.state.phase.value
            summary.state((event.at_ns - began_ns) / 1e9, phase, scene.state.reason)
    summary.errors = errors.counts
    return summary


def _step(session: Session, event: Arrival, errors: Boundary) -> Scene | None:
    scenes: list[Scene | None] = [None]
    errors.run("frame", lambda: scenes.append(session.step(event)))
    return scenes[-1]
