"""What can be used now, as functions of the session's status: every browser shows the same."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePath

from mocapella.model.scene import Scene
from mocapella.model.session import SessionStatus
from mocapella.viewer.perspective import FREE

FIRST_TAKE = "take-1"
"""What the field of the take's name says before a server proposes one."""


@dataclass(frozen=True)
class Allowed:
    """Which commands make sense in a state; the control of any other is disabled."""

    start: bool = False
    stop: bool = False
    recalibrate: bool = False
    setup: bool = False
    name: bool = False
    record: bool = False
    record_stop: bool = False


def allowed(status: SessionStatus | None) -> Allowed:
    """What can be used now; nothing while no server answers. A take notes every setup, which may change at any time."""
    if status is None:
        return Allowed()
    return Allowed(
        start=not status.running,
        stop=status.running,
        recalibrate=status.running,
        setup=True,
        name=status.running,
        record=not status.recording.active,
        record_stop=status.recording.active,
    )


def part_names(status: SessionStatus | None, scene: Scene | None) -> tuple[str, ...]:
    """Return the names of the possible part types: the types that the status counts, or else the scene's."""
    counted = tuple(status.counts) if status is not None else ()
    return counted or (tuple(scene.parts) if scene is not None else ())


def progress_percent(status: SessionStatus | None) -> float | None:
    """How far the calibration is, 0 to 100; None where none is going on."""
    if status is None or status.frames_wanted <= 0 or status.frames_remaining <= 0:
        return None
    return 100.0 * min(max(1.0 - status.frames_remaining / status.frames_wanted, 0.0), 1.0)


def perspectives(status: SessionStatus | None, sensors: tuple[str, ...]) -> tuple[str, ...]:
    """What the perspective can be: free, or any sensor's that the status or a frame ever named."""
    known = {sensor.name for sensor in status.sensors} if status else set()
    return (FREE, *sorted(known | set(sensors)))


def default_perspective(status: SessionStatus | None, sensors: tuple[str, ...]) -> str:
    """The sensor on the server's own machine; else the first by name, so that people stand apart; else free."""
    rows = sorted(status.sensors, key=lambda row: row.name) if status else []
    local = [row.name for row in rows if row.local]
    return next(iter([*local, *(row.name for row in rows), *sorted(sensors)]), FREE)


def take_name(typed: str, before: SessionStatus | None, now: SessionStatus) -> str:
    """What stands in the field of the take's name: the server's proposal, unless another was typed and not used up."""
    used = [before.next_take if before else FIRST_TAKE]
    if before is not None and before.recording.active and not now.recording.active:
        used.append(PurePath(now.recording.path).stem)
    return typed if now.recording.active or typed.strip() not in used else now.next_take or typed
