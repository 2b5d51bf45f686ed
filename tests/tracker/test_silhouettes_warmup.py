"""The synthetic images that make the silhouettes' tracker ready are those of a scene, at its rate."""

from __future__ import annotations

import numpy as np

from mocapella.model.images import ImageFrame
from mocapella.tracker.silhouettes_warmup import warm_up_arrivals, warm_up_tracker

HZ = 30


def test_the_images_come_at_their_rate_and_show_both_bodies_except_for_a_while() -> None:
    arrivals = list(warm_up_arrivals())
    frames = [arrival.frame for arrival in arrivals]
    assert all(isinstance(frame, ImageFrame) for frame in frames)
    names = {frame.sensor for frame in frames}
    assert names == set(warm_up_tracker().rig.cameras)
    for name in names:
        own = [frame for frame in frames if frame.sensor == name]
        assert [frame.empty_room for frame in own] == [True] + [False] * (len(own) - 1)
        np.testing.assert_allclose([frame.time_ns for frame in own], np.arange(len(own)) / HZ * 1e9, atol=1)
        room = np.asarray(own[0].data).astype(float)
        changed = [float((np.abs(np.asarray(frame.data) - room).max(axis=2) > 30).mean()) for frame in own[1:]]
        away = [share < 0.001 for share in changed]
        assert any(away)
        assert not away[0]
        assert not away[-1]
        assert min(share for share, gone in zip(changed, away, strict=True) if not gone) > 0.03
        assert len(own) - 1 == HZ
        white = np.array([float((np.asarray(frame.data) == 255).all(axis=2).mean()) for frame in own])
        assert ((white < 0.001) | ((white > 0.1) & (white < 0.2))).all(), "single wrong pixels, or none"
        assert np.diff(np.flatnonzero(white > 0.1)).tolist() == [1, 1, 1], "in four frames after each other"
    assert [arrival.at_ns for arrival in arrivals] == [frame.time_ns for frame in frames]
