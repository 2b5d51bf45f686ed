"""Which cameras do not count for which bodies, from when on and why, once it has lasted for some instants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from mocapella.model.camera import CameraRig
from mocapella.tracker.silhouette_views import SeenBody, called

SAID_AFTER: Final = 3
"""Consecutive instants for which a camera is left out before this is reported."""


class CameraConditions:
    """Counts for how long each camera does not count for each body.

    Args:
        rig: of the cameras.
    """

    def __init__(self, rig: CameraRig) -> None:
        self._cameras = tuple(rig.cameras)
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._since: dict[tuple[str, str], tuple[int, int, str]] = {}

    def memory(self) -> dict[tuple[str, str], tuple[int, int, str]]:
        """All that `recall` wants."""
        return self._since

    def recall(self, memory: dict[tuple[str, str], tuple[int, int, str]]) -> None:
        """Be as when `memory` was made."""
        self._since = memory

    @property
    def lasting(self) -> Sequence[str]:
        """The reported conditions that still last, a clause for each camera."""
        clauses: dict[str, None] = {}  # the same of several bodies once
        for (camera, _), (_, count, reason) in self._since.items():
            if count >= SAID_AFTER:
                clauses[f"{camera}: {reason}"] = None
        return list(clauses)

    def update(self, number: int, bodies: Mapping[str, SeenBody]) -> list[str]:
        """What has changed and lasted with an instant, in words.

        Args:
            number: of the instant.
            bodies: by name.
        """
        told: list[str] = []
        for camera in self._cameras:
            said: dict[str, None] = {}  # the same of several bodies once
            reasons = {one.fit.left_out.get(camera) for one in bodies.values()}
            of_all = len(reasons) == 1 and None not in reasons
            for name, one in bodies.items():
                now = self._reason(camera, name, one)
                begun, count, _ = self._since.get((camera, name), (number, 0, ""))
                whom = f" for {name}" if name and not of_all else ""
                if now:
                    self._since[camera, name] = begun, count + 1, now
                    if count + 1 == SAID_AFTER:
                        said[f"{camera} does not count{whom} from frame {begun} on: {now}"] = None
                elif count:
                    del self._since[camera, name]
                    if count >= SAID_AFTER:
                        said[f"{camera} counts again{whom} from frame {number} on"] = None
            told += said
        return told

    @staticmethod
    def _reason(camera: str, name: str, body: SeenBody) -> str:
        """Why a camera does not count for a body; empty where it does, or where the body is lost."""
        silent = camera in body.fit.seen or body.lost
        return body.fit.left_out.get(camera, "" if silent else f"{called(name)} is outside of its image")
