"""What the view shows beside arms: a scene counts once, and the stage goes when the arms have gone."""

from __future__ import annotations

import numpy as np

from mocapella.conventions import NS_PER_S
from mocapella.live.arm_show import GONE_AFTER_S, ArmShow
from mocapella.model.scene import Phase, Scene, SensorPlace, TrackedArm, TrackerState
from mocapella.model.topology import topology

POINTS = np.random.default_rng(2).normal(0, 0.05, (23, 3)) + np.array([0.0, 0.0, 0.8])


def scene(at_s: float, arms: int = 1, *, grabbing: bool = False) -> Scene:
    made = TrackedArm(0, False, POINTS, np.full(23, 2, np.uint8), np.full(23, 0.004, np.float32), np.zeros(21), None,
                      "open", 0.9, grabbing)  # fmt: skip
    return Scene(round(30 * at_s), round(at_s * NS_PER_S), "arm", 0, 0, topology("hand"), TrackerState(Phase.TRACKING),
                 {"arms": (made,) * arms}, (SensorPlace("arm", np.eye(4)),))  # fmt: skip


def test_a_scene_that_was_shown_already_changes_nothing() -> None:
    show = ArmShow()
    for k in range(40):
        now = scene(k / 30)
        shown = show.update(now)
        assert show.update(now) is shown
    assert shown is not None
    assert shown.quality is not None
    np.testing.assert_allclose(shown.quality.seen_s, 39 / 30)
    assert shown.cloth is None


def test_the_cloth_hangs_before_the_hand_and_swings_while_the_hand_holds_it() -> None:
    show = ArmShow(cloth=True)
    first = show.update(scene(0.0))
    assert first is not None
    assert first.cloth is not None
    assert first.cloth[..., 2].max() < POINTS[:, 2].max()  # the camera is at the origin
    for k in range(1, 10):
        last = show.update(scene(k / 30, grabbing=True))
    assert last is not None
    assert last.cloth is not None
    assert first.cloth is not last.cloth
    assert np.abs(first.cloth - last.cloth).max() > 1e-4


def test_where_there_are_no_arms_there_is_nothing_and_after_the_last_the_stage_stays_a_while() -> None:
    show = ArmShow(cloth=True)
    assert show.update(None) is None
    assert show.update(scene(0.0, arms=0)) is None
    assert show.update(scene(0.1)) is not None
    assert show.update(scene(1.0, arms=0)) is not None
    assert show.update(scene(0.2 + GONE_AFTER_S, arms=0)) is None
    assert show.update(scene(0.3 + GONE_AFTER_S, arms=0)) is None
    assert show.update(scene(0.4 + GONE_AFTER_S)) is not None
