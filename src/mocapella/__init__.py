"""Mocapella tracks people, live, with several cheap depth sensors, and sees around occlusion.

    import mocapella

    recording = mocapella.load("walk-1.mcap")
    recording.people.to_pandas()

`load` opens a recording, `track` tracks it again, `connect` yields the results of a running server, `calibrate` and
`triangulate` are of cameras. docs/library.md describes them.
"""

from __future__ import annotations

TYPE_CHECKING = False  # importing typing here would come before Ctrl-C is handled
if TYPE_CHECKING:
    from typing import Any

    from mocapella.library.angle_tracks import AngleTracks
    from mocapella.library.calibration import calibrate
    from mocapella.library.comparing import Comparison, compare
    from mocapella.library.live import connect
    from mocapella.library.motion_tracks import MotionTracks
    from mocapella.library.people_triangulation import TriangulatedPeople, triangulate_people
    from mocapella.library.recording import Recording, load
    from mocapella.library.tracking import track
    from mocapella.library.triangulation import TriangulatedPoints, triangulate

__version__ = "0.1.0"
__all__ = [
    "AngleTracks",
    "Comparison",
    "MotionTracks",
    "Recording",
    "TriangulatedPeople",
    "TriangulatedPoints",
    "__version__",
    "calibrate",
    "compare",
    "connect",
    "load",
    "track",
    "triangulate",
    "triangulate_people",
]

_HOMES = {
    "AngleTracks": "mocapella.library.angle_tracks",
    "Comparison": "mocapella.library.comparing",
    "MotionTracks": "mocapella.library.motion_tracks",
    "Recording": "mocapella.library.recording",
    "TriangulatedPeople": "mocapella.library.people_triangulation",
    "TriangulatedPoints": "mocapella.library.triangulation",
    "calibrate": "mocapella.library.calibration",
    "compare": "mocapella.library.comparing",
    "connect": "mocapella.library.live",
    "load": "mocapella.library.recording",
    "track": "mocapella.library.tracking",
    "triangulate": "mocapella.library.triangulation",
    "triangulate_people": "mocapella.library.people_triangulation",
}
"""Module of each name, imported when the name is first used: commands start without them."""


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name not in _HOMES:
        raise AttributeError(f"module 'mocapella' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
