"""Registers the keypoint detector ``onnx``: pose networks of the RTMPose and RTMO family, from the user's file."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from mocapella.detectors.keypoint_detector import KeypointDetector, PeopleDetector

if TYPE_CHECKING:
    from mocapella.detectors.onnx_people import OnnxSettings


def _settings() -> type[OnnxSettings]:
    from mocapella.detectors.onnx_people import OnnxSettings

    return OnnxSettings


def _make(settings: Any, model: Path | None) -> PeopleDetector:
    from mocapella.detectors.onnx_people import open_model, people_of

    assert model is not None  # as the descriptor says
    return people_of(open_model(model, settings.threads), settings)


def missing(installed: Mapping[str, bool] | None = None) -> str:
    """Return why the detector cannot be used on this machine, with the remedy; else empty.

    Args:
        installed: whether each module is installed, by name; None to look.
    """
    there = installed or {name: importlib.util.find_spec(name) is not None for name in ("cv2", "onnxruntime")}
    if not there["onnxruntime"]:
        return "ONNX Runtime is not installed: uv sync --extra onnx (elsewhere: install 'mocapella[onnx]')"
    return "" if there["cv2"] else "OpenCV is not installed: uv sync --extra cameras"


ONNX: Final = KeypointDetector(
    interface=1,
    name="onnx",
    summary="An RTMPose or RTMO network (17, 26, 133 or 136 keypoints) from a file of yours.",
    settings=_settings,
    make=_make,
    missing=missing,
    model="required",
)
