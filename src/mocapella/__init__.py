"""Mocapella tracks people, live, with several cheap depth sensors, and sees around occlusion.

    import mocapella

    recording = mocapella.load("walk-1.mcap")
    recording.people.to_pandas()

`load` opens a recording, `connect` yields the results of a running server. docs/library.md describes both.
"""

from __future__ import annotations

TYPE_CHECKING = False  # importing typing here would come before Ctrl-C is handled
if TYPE_CHECKING:
    from typing import Any

    from mocapella.library.live import connect
    from mocapella.library.motion_tracks import MotionTracks
    from mocapella.library.recording import Recording, load

__version__ = "0.1.0"
__all__ = ["MotionTracks", "Recording", "__version__", "connect", "load"]

_HOMES = {
    "Recording": "mocapella.library.recording",
    "MotionTracks": "mocapella.library.motion_tracks",
    "connect": "mocapella.library.live",
    "load": "mocapella.library.recording",
}
"""Module of each name, imported when the name is first used: commands start without them."""


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name not in _HOMES:
        raise AttributeError(f"module 'mocapella' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
