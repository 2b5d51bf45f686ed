"""Registers the keypoint detector ``mediapipe``: BlazePose, one instance for each person.

The package of the extra ``mediapipe`` ships its models. Later versions do not; they take a model's file (``.task``).
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from mocapella.detectors.keypoint_detector import KeypointDetector, PeopleDetector

if TYPE_CHECKING:
    from mocapella.detectors.people_slots import SlotSettings

EXTRA: Final = "uv sync --extra mediapipe (elsewhere: install 'mocapella[mediapipe]')"


def _settings() -> type[SlotSettings]:
    from mocapella.detectors.people_slots import SlotSettings

    return SlotSettings


def _make(settings: Any, model: Path | None) -> PeopleDetector:
    from mocapella.detectors.mediapipe_people import MediaPipePeople, MediaPipeTask

    return MediaPipePeople(settings) if model is None else MediaPipeTask(settings, model)


def missing(installed: Mapping[str, bool] | None = None) -> str:
    """Return why the detector cannot be used on this machine, with the remedy; else empty.

    Args:
        installed: whether each module is installed, by name; None to look.
    """
    there = installed or {name: importlib.util.find_spec(name) is not None for name in ("cv2", "mediapipe")}
    if not there["mediapipe"]:
        return f"MediaPipe is not installed: {EXTRA}"
    return "" if there["cv2"] else "OpenCV is not installed: uv sync --extra cameras"


MEDIAPIPE: Final = KeypointDetector(
    interface=1,
    name="mediapipe",
    summary="MediaPipe's BlazePose: 33 keypoints of each person, with depth of its own; fast on a processor.",
    settings=_settings,
    make=_make,
    missing=missing,
    model="optional",
)
