"""Recorded depth images in real time: each when it is due, on a clock that passes only while somebody waits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.passing_time import PassingTime

from mocapella.sources.depth_files import DepthFiles
from mocapella.sources.depth_options import DepthOptions
from mocapella.sources.paced_depth import PacedDepth

COUNT, FPS = 6, 20.0


@pytest.fixture
def recording(tmp_path: Path) -> DepthFiles:
    for k in range(COUNT):
        depth = np.full((12, 16), 700 + k, np.uint16)
        (tmp_path / f"{k}.png").write_bytes(cv2.imencode(".png", depth)[1].tobytes())
    return DepthFiles([tmp_path], DepthOptions(0.001, fps=FPS))


def given_at(source: PacedDepth, time: Any, works_s: float = 0.0) -> list[float]:
    """When each image is given to a reader who works for a while after each."""
    found = []
    while (picture := source.read(time)) is not None:
        found.append(picture.ready_s)
        time.now_s += works_s
    return found


@pytest.mark.parametrize("begun_s", [0.0, 7.5, 100_000.0])
def test_an_image_is_given_when_it_is_due_whatever_the_clock_says_at_first(
    recording: DepthFiles, begun_s: float
) -> None:
    time = PassingTime(begun_s)
    source = PacedDepth(recording, clock=time.monotonic)
    source.open()
    source.begin(begun_s + 2.0)
    np.testing.assert_allclose(given_at(source, time), begun_s + 2.0 + np.arange(COUNT) / FPS, atol=1e-6)


def test_an_overdue_image_is_given_at_once_and_none_is_dropped(recording: DepthFiles) -> None:
    time = PassingTime(50.0)
    source = PacedDepth(recording, clock=time.monotonic)
    source.open()
    source.begin(50.0)
    slow_s = 3 / FPS
    np.testing.assert_allclose(given_at(source, time, slow_s), 50.0 + slow_s * np.arange(COUNT), atol=1e-6)
