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


CENTRE_M = (0.1, 0.2, 0.3)
SOMEWHERE: Any = SimpleNamespace(settings=SimpleNamespace(motion=SimpleNamespace(centre_m=CENTRE_M)))


@pytest.mark.parametrize("seed", range(3))
def test_a_tag_swings_about_the_hands_place_as_fast_as_it_is_said_to(seed: int) -> None:
    step_s = 0.01
    poses = np.array([tagged.place_at(SOMEWHERE, seed, step_s * k) for k in range(400)])
    assert np.abs(poses[:, :3, 3] - CENTRE_M).max() <= 0.05 + 1e-12
    speeds = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=-1) / step_s
    R = np.swapaxes(poses[:-1, :3, :3], -1, -2) @ poses[1:, :3, :3]
    rates = np.degrees(np.arccos(np.clip((np.trace(R, axis1=1, axis2=2) - 1) / 2, -1, 1))) / step_s
    assert 0.1 < speeds.max() <= 0.6 + 1e-6
    assert 50 < rates.max() <= 210 + 1e-3
    assert speeds.mean() > 0.1
    assert rates.mean() > 30


class Fake:
    """What one run with two cameras draws, detects and tracks; each second image of a camera shows the whole tag."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.drawn: list[Any] = []
        self.updates: list[Any] = []
        Displaced.truth = lambda at_s: tagged.place_at(self.scene, 3, at_s)
        self.scene: Any = SimpleNamespace(
            settings=SOMEWHERE.settings,
            rig=None,
            cameras={
                name: SimpleNamespace(
                    name=name, phase_s=phase_s, fps=20.0, size_px=(4, 3), lens=None, image=None,
                    T_camera_world=rigid(np.eye(3), [0, 0, away_m]),
                )
                for name, phase_s, away_m in (("a", 0.0, 1.0), ("b", 0.025, 2.0))
            },
        )  # fmt: skip
        keeps = self

        class Poses(Displaced):
            def update(self, *told: Any) -> None:
                keeps.updates.append(told)

        def detector(*_: Any) -> Any:
            seen: list[float] = []

            def update(_: Any, at_s: float) -> Any:
                seen.append(at_s)
                names = tagged.corner_names(7)
                return SimpleNamespace(
                    names=names if len(seen) % 2 else names[:3], positions_px=np.zeros((4, 2)), sd_px=np.full(4, 0.24)
                )

            return SimpleNamespace(update=update)

        def draw(linear: Any, lens: Any, T_camera_tag: Any, **_: Any) -> None:
            self.drawn.append((linear.shape, T_camera_tag[7]))

        monkeypatch.setattr(tagged, "LASTS_S", 1.0)
        monkeypatch.setattr(tagged, "ObjectPoses", Poses)
        monkeypatch.setattr(tagged, "TagDetector", detector)
        monkeypatch.setattr(tagged, "draw_tags", draw)
        monkeypatch.setattr(tagged, "camera_image", lambda *_: None)


@pytest.mark.parametrize(("one", "cameras"), [(False, "ab"), (True, "a")])
def test_poses_are_scored_at_the_instants_of_all_frames_after_they_have_settled(
    monkeypatch: pytest.MonkeyPatch, one: bool, cameras: str
) -> None:
    """The whole tag alone is given to the tracker, with the scatter of the image and of the corners together."""
    fake = Fake(monkeypatch)
    scored = tagged._run(fake.scene, 3, one)
    times = sorted((phase_s + k / 20, name) for name, phase_s in (("a", 0.0), ("b", 0.025)) for k in range(20))
    times = [(at_s, name) for at_s, name in times if name in cameras]
    assert [shape for shape, _ in fake.drawn] == [(3, 4, 3)] * len(times)
    for (at_s, name), (_, T) in zip(times, fake.drawn, strict=True):
        np.testing.assert_allclose(T, fake.scene.cameras[name].T_camera_world @ tagged.place_at(fake.scene, 3, at_s))
    whole = [pair for k, pair in enumerate(times) if (k // len(cameras)) % 2 == 0]
    assert [(at_s, name) for name, _, _, at_s in fake.updates] == whole
    np.testing.assert_allclose([sd_px for _, _, sd_px, _ in fake.updates], 0.26)
    assert len(scored) == sum(at_s >= tagged.SETTLE_S for at_s, _ in times)
    known = scored[np.isfinite(scored[:, 0])]
    np.testing.assert_allclose(known[:, :2], np.broadcast_to([5.0, 2.0], (len(known), 2)), atol=1e-6)
    assert known[:3, 2].tolist() == [0.0, 1.0, 1.0]
    assert (scored[3] == [np.nan, np.nan, 0.0]).tolist() == [False, False, True]


def test_only_scenes_of_tags_are_scored_with_all_cameras_and_with_one(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr(tagged, "load_hand_scene", lambda name, *, seed: name)
    monkeypatch.setattr(tagged, "_run", lambda scene, seed, one: np.full((2, 3), 10.0 * seed + one))
    found = tagged.evaluate_tag(["tight", "wide", "demo"], [1, 3], said.append)
    assert {name: scores["mm_median"] for name, scores in found.items()} == {"wide": 20.0, "wide, one camera": 21.0}
    assert said[:2] == ["a tag, wide, seed 1", "a tag, wide, seed 3"]
