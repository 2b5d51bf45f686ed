"""Which stage is shown, and what the arms' remembers: a scene counts once, and it goes when the arms have gone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mocapella.conventions import NS_PER_S
from mocapella.errors import PluginError
from mocapella.model.scene import Phase, Scene, SensorPlace, TrackedArm, TrackerState
from mocapella.model.topology import topology
from mocapella.tracker import METHODS
from mocapella.viewer import layout
from mocapella.viewer.plugin_errors import PluginErrors
from mocapella.viewer.stage import Stage, TrackingDrawing
from mocapella.viewer.stage_arms import GONE_AFTER_S, ArmsMemory
from mocapella.viewer.stages import ARMS, HANDS, ROOM, StageChoice

POINTS = np.random.default_rng(2).normal(0, 0.05, (23, 3)) + np.array([0.0, 0.0, 0.8])
CLOTH = "mocapella.sources.simulate.cloth:ClothBeforeHand"
STAGES = {name: method.stages for name, method in METHODS.items()}


def scene(at_s: float, arms: int = 1, *, grabbing: bool = False) -> Scene:
    made = TrackedArm(0, False, POINTS, np.full(23, 2, np.uint8), np.full(23, 0.004, np.float32), np.zeros(21), None,
                      "open", 0.9, grabbing)  # fmt: skip
    return Scene(round(30 * at_s), round(at_s * NS_PER_S), "arm", 0, 0, topology("hand"), TrackerState(Phase.TRACKING),
                 {"arms": (made,) * arms}, (SensorPlace("arm", np.eye(4)),))  # fmt: skip


def with_cloth() -> ArmsMemory:
    from mocapella.sources.simulate.cloth import ClothBeforeHand

    return ArmsMemory({"cloth": ClothBeforeHand})


def test_a_scene_that_was_shown_already_changes_nothing() -> None:
    memory = ArmsMemory({})
    for k in range(40):
        now = scene(k / 30)
        shown = memory.update(now)
        assert memory.update(now) is shown
    assert shown is not None
    assert shown.quality is not None
    np.testing.assert_allclose(shown.quality.seen_s, 39 / 30)
    assert shown.cloth is None


def test_the_cloth_hangs_before_the_hand_and_swings_while_the_hand_holds_it() -> None:
    memory = with_cloth()
    first = memory.update(scene(0.0))
    assert first is not None
    assert first.cloth is not None
    assert first.cloth[..., 2].max() < POINTS[:, 2].max()  # the camera is at the origin
    for k in range(1, 10):
        last = memory.update(scene(k / 30, grabbing=True))
    assert last is not None
    assert last.cloth is not None
    assert first.cloth is not last.cloth
    assert np.abs(first.cloth - last.cloth).max() > 1e-4


def test_where_there_are_no_arms_there_is_nothing_and_after_the_last_the_stage_stays_a_while() -> None:
    memory = with_cloth()
    assert memory.update(None) is None
    assert memory.update(scene(0.0, arms=0)) is None
    assert memory.update(scene(0.1)) is not None
    assert memory.update(scene(1.0, arms=0)) is not None
    assert memory.update(scene(0.2 + GONE_AFTER_S, arms=0)) is None
    assert memory.update(scene(0.3 + GONE_AFTER_S, arms=0)) is None
    assert memory.update(scene(0.4 + GONE_AFTER_S)) is not None


@pytest.mark.parametrize("method", METHODS)
def test_every_method_has_stages_that_can_be_imported(method: str) -> None:
    troubles = PluginErrors()
    stage, _ = StageChoice(STAGES, {}, troubles).update(None, method)
    assert troubles.lines == ()
    assert stage is (HANDS if method == "hands" else ROOM)


def test_the_first_stage_that_has_something_to_show_is_shown_and_the_last_always() -> None:
    choice = StageChoice(STAGES, {"cloth": CLOTH}, PluginErrors())
    for method in ("default", "arms"):
        assert choice.update(scene(0.0, arms=0), method)[0] is ROOM
        stage, shown = choice.update(scene(1.0), method)
        assert stage is ARMS
        assert shown.cloth is not None
        assert choice.update(scene(2.0 + GONE_AFTER_S, arms=0), method)[0] is ROOM
    assert choice.update(scene(0.0), "stand-still")[0] is ROOM
    assert choice.update(scene(0.0), "a method that is not installed here")[0] is ROOM


class Broken:
    def update(self, shown: Scene | None) -> Any:
        raise ZeroDivisionError("of a plug-in")


def _empty(*_: Any) -> TrackingDrawing:
    return TrackingDrawing()


BROKEN = Stage("broken", _empty, lambda *_: "", layout.tracking_box(), 0.0, lambda props: Broken())
NO_STAGE = "text"


def test_a_stage_that_raises_or_is_none_is_passed_over_and_told_once() -> None:
    troubles = PluginErrors()
    here = f"{__name__}:"
    choice = StageChoice(
        {"theirs": (f"{here}BROKEN", f"{here}NO_STAGE", "nowhere:AT_ALL", STAGES["arms"][0])}, {}, troubles
    )
    for k in range(3):
        assert choice.update(scene(k / 30), "theirs")[0] is ARMS
    assert len(troubles.lines) == 3
    assert "stage broken cannot be drawn: ZeroDivisionError: of a plug-in" in troubles.lines
    assert any("a str, and a Stage is wanted" in line for line in troubles.lines)
    assert StageChoice({"theirs": ("nowhere:AT_ALL",)}, {}, troubles).update(None, "theirs")[0] is ROOM


def test_a_prop_that_cannot_be_imported_is_refused() -> None:
    with pytest.raises(PluginError, match="nowhere"):
        StageChoice({}, {"cloth": "nowhere:AT_ALL"}, PluginErrors())
