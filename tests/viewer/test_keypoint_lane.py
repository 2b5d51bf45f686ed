"""The lane of a webcam: skeletons within the image's border, faint where the detector is not sure."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mocapella.model.keypoints import KeypointFrame, keypoint_frame
from mocapella.model.topology import topology
from mocapella.viewer.keypoint_lane import SHOWN, SURE, lane_people
from mocapella.viewer.lanes import KEYPOINTS, lane_of
from mocapella.viewer.palette import Rgb
from mocapella.viewer.plugin_errors import PluginErrors

COCO, BLUE, ORIGIN = topology("coco_17"), Rgb(70, 110, 255), np.zeros(3)
EDGE = 4


def people_frame(size_px: tuple[int, int] = (640, 480), confidence: Any = 0.9, count: int = 1) -> KeypointFrame:
    rng = np.random.default_rng(3)
    positions = rng.uniform(0.1, 0.9, (count, 17, 2)) * np.array(size_px)
    return keypoint_frame("a", COCO, time_ns=1, size_px=size_px, positions_px=positions, confidences=confidence)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_each_bone_of_each_person_is_drawn(count: int) -> None:
    lines, balls = lane_people(people_frame(count=count), ORIGIN, BLUE)
    assert len(lines) == EDGE + count * len(COCO.bones)
    assert len(balls) == 0


def test_unsure_bones_are_faint_and_improbable_ones_not_drawn() -> None:
    sure, unsure = (lane_people(people_frame(confidence=c), ORIGIN, BLUE)[0] for c in (SURE + 0.1, SURE - 0.1))
    assert (sure.colours[EDGE:] == np.array(BLUE.paint)).all()
    assert (unsure.colours[EDGE:] == np.array(BLUE.faint)).all()
    assert unsure.scales[EDGE:, 0].max() < sure.scales[EDGE:, 0].min()
    assert len(lane_people(people_frame(confidence=0.5 * SHOWN), ORIGIN, BLUE)[0]) == EDGE


def test_bones_outside_of_the_image_are_not_drawn() -> None:
    frame = people_frame()
    frame.positions_px[0, 5] = [-30.0, 100.0]
    bones = sum(5 in bone for bone in COCO.bones)
    assert len(lane_people(frame, ORIGIN, BLUE)[0]) == EDGE + len(COCO.bones) - bones


@pytest.mark.parametrize("size_px", [(640, 480), (1280, 720), (480, 640), (1080, 1920)])
def test_an_upright_image_is_no_higher_than_a_landscape_one(size_px: tuple[int, int]) -> None:
    lines, _ = lane_people(people_frame(size_px), ORIGIN, BLUE)
    highest = lane_people(people_frame((640, 480)), ORIGIN, BLUE)[0].positions[:, 1].max()
    assert lines.positions[:, 1].max() <= highest + 1e-3


def test_the_view_finds_the_lane_of_keypoints() -> None:
    assert lane_of(people_frame(), PluginErrors()) is KEYPOINTS
    assert KEYPOINTS.size_px(people_frame()) == (640, 480)
