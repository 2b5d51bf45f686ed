"""Report which cameras are left out for which bodies, once that has lasted for some frames.

A camera is left out for a body while its image is missing or fails `image_rejection`, or the body is outside of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from mocapella.model.camera import CameraRig
from mocapella.tracker.silhouette_views import SeenBody, called

SAID_AFTER: Final = 3
"""Rejections of a camera's image are reported after this number of consecutive frames."""


class CameraConditions:
    """Counts for how many consecutive frames each camera is left out for each body.

    Args:
        rig: the cameras.
    """

    def __init__(self, rig: CameraRig) -> None:
        self._cameras = tuple(rig.cameras)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._since: dict[tuple[str, str], tuple[int, int, str]] = {}

    def memory(self) -> dict[tuple[str, str], tuple[int, int, str]]:
        """Return all state, for `recall` and a tracker's snapshot; its mutable values are shared, not copied."""
        return self._since

    def recall(self, memory: dict[tuple[str, str], tuple[int, int, str]]) -> None:
        """Restore the state that `memory` returned, without copying it."""
        self._since = memory

    @property
    def lasting(self) -> Sequence[str]:
        """The reported conditions that still last, as clauses of a sentence, one for each camera."""
        clauses: dict[str, None] = {}  # one clause for several bodies
        for (camera, _), (_, count, reason) in self._since.items():
            if count >= SAID_AFTER:
                clauses[f"{camera}: {reason}"] = None
        return list(clauses)

    def update(self, number: int, bodies: Mapping[str, SeenBody]) -> list[str]:
        """Count the rejections of a frame; return messages about conditions that begin to last, or that end.

        Args:
            number: number of the frame, for the messages.
            bodies: all bodies in this frame, by name.
        """
        notes: list[str] = []
        for camera in self._cameras:
            own: dict[str, None] = {}  # one message for several bodies
            reasons = {one.fit.left_out.get(camera) for one in bodies.values()}
            of_all = len(reasons) == 1 and None not in reasons
            for name, one in bodies.items():
                now = self._reason(camera, name, one)
                begun, count, _ = self._since.get((camera, name), (number, 0, ""))
                whom = f" for {name}" if name and not of_all else ""
                if now:
                    self._since[camera, name] = begun, count + 1, now
                    if count + 1 == SAID_AFTER:
                        own[f"{camera} does not count{whom} from frame {begun} on: {now}"] = None
                elif count:
                    del self._since[camera, name]
                    if count >= SAID_AFTER:
                        own[f"{camera} counts again{whom} from frame {number} on"] = None
            notes += own
        return notes

    @staticmethod
    def _reason(camera: str, name: str, body: SeenBody) -> str:
        """Return why a camera is left out for a body; empty if it is not. A lost body counts as inside the image."""
        silent = camera in body.fit.seen or body.lost
        return body.fit.left_out.get(camera, "" if silent else f"{called(name)} is outside of its image")
