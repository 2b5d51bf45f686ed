"""Videos in real time: each frame at the video's own time, on a clock that passes only while somebody waits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.passing_time import PassingTime
from support.silhouette_pictures import write_video

from mocapella.sources.paced_pictures import PacedPictures
from mocapella.sources.picture_source import Picture

COUNT = 5
BEGUN_S = 1000.0


def shown(path: Path, hz: float, works_s: float = 0.0) -> list[Picture]:
    """The pictures of a video of a rate, given to a reader who works for a while after each."""
    write_video(path, [np.full((48, 64, 3), 40 * k, np.uint8) for k in range(COUNT)], hz)
    time: Any = PassingTime(BEGUN_S)
    source = PacedPictures(path, clock=time.monotonic)
    source.open()
    source.begin(BEGUN_S)
    found = []
    while (picture := source.read(time)) is not None:
        found.append(picture)
        time.now_s += works_s
    source.close()
    return found


@pytest.mark.parametrize("hz", [10.0, 25.0, 60.0])
def test_frames_have_the_videos_own_times_and_come_at_them(tmp_path: Path, hz: float) -> None:
    found = shown(tmp_path / "a.avi", hz)
    due_s = np.arange(COUNT) / hz
    np.testing.assert_allclose([(one.time_ns - 1) / 1e9 for one in found], due_s, atol=1e-4)
    np.testing.assert_allclose([one.ready_s - BEGUN_S for one in found], due_s, atol=1e-4)


def test_overdue_frames_come_at_once_with_their_own_times(tmp_path: Path) -> None:
    found = shown(tmp_path / "a.avi", 25.0, works_s=0.5)
    np.testing.assert_allclose([(one.time_ns - 1) / 1e9 for one in found], np.arange(COUNT) / 25, atol=1e-4)
    np.testing.assert_allclose([one.ready_s - BEGUN_S for one in found], 0.5 * np.arange(COUNT), atol=1e-6)
