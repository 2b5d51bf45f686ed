"""Descriptors of tracking methods: what is refused, and that a method says itself what it takes and makes."""

from __future__ import annotations

import re
import subprocess
import sys

import msgspec
import numpy as np
import pytest

from mocapella.model.arms import ArmFrame
from mocapella.model.depth import depth_frame
from mocapella.model.markers import marker_frame
from mocapella.model.part_types import PART_TYPES
from mocapella.model.poses import pose_frame
from mocapella.model.sensor_frame import SensorFrame, UnknownFrame
from mocapella.tracker import METHODS
from mocapella.tracker.method import not_taken

DEPTH = depth_frame("a", np.ones((2, 2), np.uint16), unit_m=0.001, lens=[2, 2, 1, 1], time_ns=6)


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        (
            marker_frame("a", ["red"], time_ns=6, size_px=(4, 4), positions_px=[[1, 1]]),
            "it sends markers, .*set up hands",
        ),
        (
            pose_frame("a", "vr", [], time_ns=6, positions=np.zeros((0, 3)), orientations=np.zeros((0, 4))),
            "it sends poses, .*set up hands",
        ),
        (
            depth_frame("a", np.ones((2, 2), np.uint16), unit_m=0.001, lens=[2, 2, 1, 1], time_ns=6),
            "it sends depth, .*no method",
        ),
        (ArmFrame("a", 1, 1, 6, 6, (2, 2), np.ones(9), "default", ()), "it sends arms, .*set up arms or default"),
        (UnknownFrame("a", 1, 1, 6, 6, "thermal", b""), "it sends thermal, which no installed package reads"),
    ],
)
def test_a_frame_of_another_type_is_refused_with_what_it_is_and_who_takes_it(frame: SensorFrame, said: str) -> None:
    assert re.match(said, not_taken(frame, "stand-still"))


def test_images_that_are_for_takes_are_not_refused() -> None:
    assert not_taken(msgspec.structs.replace(DEPTH, sensor="a.depth"), "stand-still") == ""


@pytest.mark.parametrize("method", METHODS)
def test_a_method_names_parts_that_there_are(method: str) -> None:
    assert set(METHODS[method].parts) <= set(PART_TYPES)


def test_descriptors_need_no_extra() -> None:
    """OpenCV is an extra: without it, only what needs it cannot be made, and says so."""
    code = """
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "cv2":
            raise ModuleNotFoundError("No module named 'cv2'")
sys.meta_path.insert(0, Blocked())
from mocapella.detectors import DETECTORS
from mocapella.model.frame_types import FRAME_TYPES
from mocapella.model.part_types import PART_TYPES
from mocapella.tracker import METHODS
print([one for table in (DETECTORS, FRAME_TYPES, PART_TYPES, METHODS) if list(table) for one in table.skipped])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout.strip() == "[]"
