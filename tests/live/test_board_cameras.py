"""Cameras of this machine that look for a board: what they see, and how long they wait; without a camera."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from mocapella.live.board_cameras import LocalCameras
from mocapella.model.board import Board
from mocapella.sensing.boards import draw_board
from mocapella.sources import video

BOARD = Board("charuco", 5, 4, 0.05, dictionary="DICT_4X4_50")
PERIOD_S = 0.125


class Cameras:
    """Cameras that give images without end, one a period on their own clock."""

    now_s = 20.0

    def __init__(self, numbers: Mapping[str, int]) -> None:
        self.lost = dict.fromkeys(numbers, 0)
        self.images = dict.fromkeys(numbers, np.full((240, 320, 3), 90, np.uint8))
        self.reads = 0
        self.closed = False

    def read(self) -> dict[str, Any]:
        at_s = self.now_s
        self.now_s, self.reads = at_s + PERIOD_S, self.reads + 1
        return {name: (at_s, image) for name, image in self.images.items()}

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def cameras(monkeypatch: pytest.MonkeyPatch) -> Cameras:
    made = Cameras({"left": 0, "right": 1})
    monkeypatch.setattr(video, "LiveCameras", lambda _numbers: made)
    return made


def local(cameras: Cameras) -> LocalCameras:
    return LocalCameras({"left": 0, "right": 1}, BOARD, clock=lambda: cameras.now_s)


@pytest.mark.parametrize(
    ("seconds", "images"),
    [(-1.0, 0), (0.0, 0), (0.25 * PERIOD_S, 1), (PERIOD_S, 1), (1.25 * PERIOD_S, 2), (4 * PERIOD_S, 4)],
)
def test_images_are_discarded_until_the_time_is_over_and_none_if_there_is_no_time(
    cameras: Cameras, seconds: float, images: int
) -> None:
    local(cameras).wait(seconds)
    assert cameras.reads == images


def test_each_camera_says_what_it_sees_and_one_without_an_image_how_often_it_had_none(cameras: Cameras) -> None:
    shown = draw_board(BOARD, 60)
    cameras.images["left"] = np.repeat(shown[..., None], 3, axis=2)
    source = local(cameras)
    both = source.look()
    assert {name: look.at_s for name, look in both.items()} == {"left": 20.0, "right": 20.0}
    assert both["left"].view is not None
    assert both["left"].view.ids.tolist() == list(range(BOARD.corners))
    assert (both["right"].view, both["right"].problem) == (None, "")
    del cameras.images["right"]
    cameras.lost["right"] = 3
    assert source.look()["right"].problem == "camera right gave no picture 3 times"
    source.close()
    assert cameras.closed
