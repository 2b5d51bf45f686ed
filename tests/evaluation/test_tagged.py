"""How a tag's pose is scored; few frames, for rendering takes long."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mocapella.evaluation import tagged
from mocapella.evaluation.tagged import RayState, exp_twist, load_hand_scene, rigid


@pytest.mark.slow
def test_a_tag_is_where_it_is_drawn_for_one_camera_and_for_two(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tagged, "LASTS_S", 0.6)
    result = tagged.evaluate_tag(["wide", "wide-fast"], [3])
    assert list(result) == ["wide", "wide, one camera"]
    for scores in result.values():
        assert all(np.isfinite(value) for value in scores.values())
        assert scores["lost_percent"] == 0
        assert scores["mm_median"] < 3
        assert scores["deg_median"] < 2
    assert result["wide"]["mm_median"] < result["wide, one camera"]["mm_median"]


class Displaced:
    """In place of the tracker: the true pose moved and turned by known amounts, not tracked, or none, in turns."""

    truth: Callable[[float], Any]

    def __init__(self, *_: Any, **__: Any) -> None:
        self.asked = 0

    def update(self, *_: Any) -> None:
        """Nothing is detected."""

    def at(self, at_s: float) -> Any:
        self.asked += 1
        kind = self.asked % 4
        if kind == 0:
            return SimpleNamespace(T_world_object=None, state=RayState.LOST)
        off = rigid(exp_twist([0, 0, 0, 0, 0, math.radians(2.0)])[:3, :3], [0.003, 0.0, 0.004])
        pose = Displaced.truth(at_s) @ off
        return SimpleNamespace(T_world_object=pose, state=RayState.INFERRED if kind == 1 else RayState.TRACKED)


@pytest.fixture
def rows(monkeypatch: pytest.MonkeyPatch) -> Callable[[bool], Any]:
    """What is scored of a run without pictures."""
    scene = load_hand_scene("wide", seed=3)
    monkeypatch.setattr(tagged, "LASTS_S", 2.0)
    monkeypatch.setattr(tagged, "ObjectPoses", Displaced)
    monkeypatch.setattr(tagged, "TagDetector", lambda *_: SimpleNamespace(update=lambda *_: SimpleNamespace(names=())))
    monkeypatch.setattr(tagged, "draw_tags", lambda *_, **__: None)
    monkeypatch.setattr(tagged, "camera_image", lambda *_: None)
    Displaced.truth = lambda at_s: tagged.place_at(scene, 3, at_s)
    return lambda one: tagged._run(scene, 3, one)


@pytest.mark.slow
@pytest.mark.parametrize("one", [False, True])
def test_a_run_is_scored_by_distance_and_angle_after_it_has_settled(rows: Callable[[bool], Any], one: bool) -> None:
    scored = rows(one)
    cameras = list(load_hand_scene("wide", seed=3).cameras.values())[: 1 if one else None]
    assert len(cameras) == (1 if one else 2)
    times = [c.phase_s + k / c.fps for c in cameras for k in range(math.ceil(2.0 * c.fps))]
    assert len(scored) == sum(at_s >= tagged.SETTLE_S for at_s in times)
    known = scored[np.isfinite(scored[:, 0])]
    np.testing.assert_allclose(known[:, :2], np.broadcast_to([5.0, 2.0], (len(known), 2)), atol=1e-6)
    assert set(known[:, 2]) == {0.0, 1.0}
    lost = scored[~np.isfinite(scored[:, 0])]
    assert abs(4 * len(lost) - len(scored)) < 4
    assert np.isnan(lost[:, 1]).all()
    assert (lost[:, 2] == 0).all()


def test_scores_are_of_known_poses_and_shares_of_all() -> None:
    rows = np.array([[1.0, 10.0, 1.0], [3.0, 30.0, 0.0], [np.nan, np.nan, 0.0], [2.0, 20.0, 1.0], [101.0, 20.0, 1.0]])
    scores = tagged._scores(rows)
    assert scores["mm_median"] == 2.5
    assert scores["deg_median"] == 20.0
    assert (scores["tracked_percent"], scores["lost_percent"]) == (60.0, 20.0)
    assert scores["mm_p95"] == pytest.approx(3 + 0.85 * 98)
    assert scores["deg_p95"] == pytest.approx(20 + 0.85 * 10)
