"""A stand-in for the server and the view's loop: a session that obeys, and a thread that shows it."""

from __future__ import annotations

import dataclasses
import threading
import time
from typing import Any

import msgspec
from support.walkers import Room, status

from mocapella.model.scene import Scene
from mocapella.model.session import CommandReply, RecordingHealth, SessionStatus, Setup
from mocapella.settings import parse
from mocapella.viewer import Viewer


class StandIn:
    """Carries out the view's commands on a status of its own, and remembers them.

    Attributes:
        commands: all that came, in order.
        gate: while it is closed, a command waits, as with a slow server.
        empty: show no people and no frames.
        answers: whether the server answers at all.
        held: while it is set, the loop shows nothing, as when the view's process hangs.
    """

    def __init__(self, room: Room, at_s: float = 1.0) -> None:
        self.room = room
        self.frames = room.frames(at_s)
        self.scene: Scene = room.scene(at_s, self.frames)
        self.status: SessionStatus = status(running=False, phase="stopped")
        self.commands: list[tuple[str, dict[str, Any]]] = []
        self.gate = threading.Event()
        self.gate.set()
        self.empty, self.answers = False, True
        self.held = threading.Event()
        self.viewer = Viewer("127.0.0.1", 0, command=self.command)
        self.names: dict[int, str] = {}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._show)
        self._thread.start()

    def command(self, verb: str, arguments: dict[str, Any]) -> CommandReply:
        self.commands.append((verb, arguments))
        self.gate.wait(10.0)
        if verb == "name":
            self.names[arguments["person"]] = arguments["name"]
            self.change()
            return CommandReply(True)
        changes = self._changes(verb, arguments)
        if changes is None:
            return CommandReply(False, f"{arguments['name']} is taken; take another name")
        self.change(**changes)
        return CommandReply(True)

    def change(self, **changes: Any) -> None:
        """A new status, as after a command of somebody else."""
        self.status = dataclasses.replace(self.status, revision=self.status.revision + 1, **changes)

    def named(self) -> Scene:
        """The scene with the names that were given to its people."""
        people = (msgspec.structs.replace(who, name=self.names.get(who.id, "")) for who in self.scene.people)
        return self.scene.with_parts(people=tuple(people))

    def close(self) -> None:
        self.gate.set()
        self._stop.set()
        self._thread.join()
        self.viewer.close()

    def _changes(self, verb: str, arguments: dict[str, Any]) -> dict[str, Any] | None:
        if verb == "record":
            if arguments["name"] == "taken":
                return None
            return {"recording": RecordingHealth(active=True, path=f"/takes/{arguments['name']}.mcap")}
        return {
            "start": {"running": True, "phase": "tracking"},
            "stop": {"running": False, "phase": "stopped", "reason": ""},
            "recalibrate": {
                "phase": "calibrating",
                "frames_remaining": 30,
                "frames_wanted": 120,
                "reason": "asked for",
            },
            "record-stop": {
                "recording": dataclasses.replace(self.status.recording, active=False),
                "next_take": "walk-2",
            },
            "setup": {"setup": parse(Setup, arguments) if verb == "setup" else None},
        }[verb]

    def _show(self) -> None:
        while not self._stop.is_set():
            frames = {} if self.empty else self.frames
            if self.held.is_set():
                time.sleep(0.05)
                continue
            self.viewer.show(None if self.empty else self.named(), frames, self.status if self.answers else None)
            time.sleep(0.05)
