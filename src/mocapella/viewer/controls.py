"""State of the panel's controls as functions of the session's status, so that all browsers show the same."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePath

from mocapella.model.scene import Scene
from mocapella.model.session import SessionStatus
from mocapella.viewer.perspective import FREE

FIRST_TAKE = "take-1"
"""Name in the take's field before a server proposes one."""


@dataclass(frozen=True)
class Allowed:
    """Whether each command to the server is possible now, by command; the controls of the others are disabled."""

    start: bool = False
    stop: bool = False
    recalibrate: bool = False
    setup: bool = False
    name: bool = False
    record: bool = False
    record_stop: bool = False


def allowed(status: SessionStatus | None) -> Allowed:
    """Return the commands that are possible in this status of the session; None (no server) allows none.

    ``setup`` is possible even during a recording, because a take records every setup.
    """
    if status is None:
        return Allowed()
    return Allowed(
        start=not status.running and not status.getting_ready,
        stop=status.running,
        recalibrate=status.running,
        setup=True,
        name=status.running,
        record=not status.recording.active,
        record_stop=status.recording.active,
    )


def part_names(status: SessionStatus | None, scene: Scene | None) -> tuple[str, ...]:
    """Return the names of the part types that get a folder in the panel, such as ``people``.

    These are the keys of the status' ``counts``; if it has none, or there is no server (``status`` None), those of the
    scene's parts, and none without a scene.
    """
    counted = tuple(status.counts) if status is not None else ()
    return counted or (tuple(scene.parts) if scene is not None else ())


def progress_percent(status: SessionStatus | None) -> float | None:
    """Return the progress of the sensors' calibration in percent; None if none is running."""
    if status is None or status.frames_wanted <= 0 or status.frames_remaining <= 0:
        return None
    return 100.0 * min(max(1.0 - status.frames_remaining / status.frames_wanted, 0.0), 1.0)


def perspectives(status: SessionStatus | None, sensors: tuple[str, ...]) -> tuple[str, ...]:
    """Return the perspectives that a browser offers: `FREE`, then each sensor of the status or ``sensors``, sorted."""
    known = {sensor.name for sensor in status.sensors} if status else set()
    return (FREE, *sorted(known | set(sensors)))


def default_perspective(status: SessionStatus | None, sensors: tuple[str, ...]) -> str:
    """Return the default perspective: the sensor on the server's machine, else the first by name, else `FREE`."""
    rows = sorted(status.sensors, key=lambda row: row.name) if status else []
    local = [row.name for row in rows if row.local]
    return next(iter([*local, *(row.name for row in rows), *sorted(sensors)]), FREE)


def take_name(typed: str, before: SessionStatus | None, now: SessionStatus) -> str:
    """Return the new text of the take's name field: the server's proposal, unless a recording runs or a name is typed.

    A text counts as typed if it is neither the last proposal nor the name of the take that has just ended.

    Args:
        typed: present text of the field.
        before: previous status of the session; None at first.
        now: newest status of the session.
    """
    used = [before.next_take if before else FIRST_TAKE]
    if before is not None and before.recording.active and not now.recording.active:
        used.append(PurePath(now.recording.path).stem)
    return typed if now.recording.active or typed.strip() not in used else now.next_take or typed
