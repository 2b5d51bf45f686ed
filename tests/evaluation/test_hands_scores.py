"""How the method hands is scored; few frames, for rendering takes long."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError
from mocapella.evaluation import hands
from mocapella.model.hand import TIPS
from mocapella.model.markers import marker_frame
from mocapella.model.observations import Arrival
from mocapella.sources.simulate.hand_camera import HandCameraFrame
from mocapella.sources.simulate.hand_motion import landmarks_of
from mocapella.sources.simulate.hand_scene import HandScene, load_hand_scene


@pytest.mark.slow
def test_a_scene_is_scored_and_the_hand_is_where_it_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hands, "LASTS_S", 0.5)
    result = hands.evaluate(["wide"], [3])
    scores = result["scenes"]["wide"]["all"]
    assert scores == result["scenes"]["wide"]["3"]
    assert scores["found_percent"] > 95
    assert scores["marker_mm_median"] < 3
    assert scores["depth_percent_mean"] < 1
    assert scores["jitter_mm"] < scores["tip_mm_p95"]
    assert all(np.isfinite(value) for value in scores.values())


FPS = 20


@cache
def demo() -> HandScene:
    return load_hand_scene("demo", seed=3)


class TopRow:
    """A camera that sees every marker in its topmost row, which is read at the image's own time."""

    down = 0.0
    off_px = 0.0
    visible = 1.0

    def __init__(self, scene: HandScene, camera: str) -> None:
        self._scene, self._camera = scene, scene.cameras[camera]

    def frames(self, start_s: float, stop_s: float) -> Iterator[HandCameraFrame]:
        names = self._scene.names
        row = self.down * (self._camera.size_px[1] - 1)
        px = np.column_stack([np.arange(len(names)), np.full(len(names), row)])
        centres = px + np.array([self.off_px, 0.0])
        shot: Any = SimpleNamespace(visible=np.full(len(names), self.visible), centres_px=centres)
        for k in range(round((stop_s - start_s) * FPS)):
            at_s = start_s + k / FPS
            frame = marker_frame(
                self._camera.name, names, time_ns=round(at_s * NS_PER_S), size_px=self._camera.size_px, positions_px=px
            )
            yield HandCameraFrame(at_s, frame, shot)


class Truthful:
    """A tracker that knows where the hand is, and how long after an image's own time its markers are read."""

    def __init__(self, scene: HandScene, late_s: float = 0.0) -> None:
        self._scene, self._late_s = scene, late_s

    def update(self, arrival: Arrival) -> Any:
        pose = self._scene.motion.at(arrival.frame.time_ns / NS_PER_S + self._late_s)
        landmarks = landmarks_of(self._scene.model, self._scene.shape, pose)
        hand = SimpleNamespace(landmarks=landmarks, angles=pose.angles)
        return SimpleNamespace(hands=(hand,), points=SimpleNamespace(positions=landmarks[list(TIPS)]))


def test_who_knows_the_truth_is_scored_perfect_in_every_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = demo()
    monkeypatch.setattr(hands, "load_hand_scene", lambda *_, **__: scene)
    monkeypatch.setattr(hands, "SimulatedHandCamera", TopRow)
    monkeypatch.setattr(hands, "HandsTracker", lambda *_, **__: Truthful(scene))
    rows = hands.run("demo", 3)
    cameras, markers = len(scene.cameras), len(scene.names)
    assert rows["found"].shape == (cameras * FPS * hands.LASTS_S, markers)
    assert rows["landmark_mm"].shape == (cameras * FPS * (hands.LASTS_S - hands.SETTLE_S), 21)
    scores = hands._scores(rows)
    assert scores.pop("found_percent") == 100
    assert scores == pytest.approx(dict.fromkeys(scores, 0.0), abs=1e-3)


def rows_seen(monkeypatch: pytest.MonkeyPatch, late_s: float = 0.0, **seen: float) -> hands.FrameRows:
    scene = demo()
    monkeypatch.setattr(hands, "load_hand_scene", lambda *_, **__: scene)
    monkeypatch.setattr(hands, "SimulatedHandCamera", type("Row", (TopRow,), seen))
    monkeypatch.setattr(hands, "HandsTracker", lambda *_, **__: Truthful(scene, late_s))
    monkeypatch.setattr(hands, "LASTS_S", 0.5)
    return hands.run("demo", 3)


@pytest.mark.parametrize("down", [0.5, 1.0])
def test_the_truth_is_that_of_the_instant_at_which_the_lowest_marker_was_read(
    monkeypatch: pytest.MonkeyPatch, down: float
) -> None:
    """The last row of an image is read a readout after the first."""
    (readout_s,) = {camera.readout_s for camera in demo().cameras.values()}
    assert readout_s > 0
    rows = rows_seen(monkeypatch, down * readout_s, down=down)
    assert rows["landmark_mm"].max() < 1e-3
    monkeypatch.undo()
    assert rows_seen(monkeypatch, 0.0, down=down)["landmark_mm"].max() > 0.1


@pytest.mark.parametrize(("off_px", "near"), [(hands.NEAR_PX, True), (hands.NEAR_PX + 0.01, False)])
def test_a_marker_is_found_or_false_by_how_far_it_is_from_its_place(
    monkeypatch: pytest.MonkeyPatch, off_px: float, near: bool
) -> None:
    rows = rows_seen(monkeypatch, off_px=off_px)
    assert (rows["found"] == near).all()
    assert (rows["false"] != near).all()
    np.testing.assert_allclose(rows["off_px"], off_px)


@pytest.mark.parametrize(
    ("visible", "wanted"), [(hands.CLEARLY, True), (hands.CLEARLY - 0.01, False), (0.95, True), (0.96, True)]
)
def test_a_marker_must_be_found_that_is_clearly_visible(
    monkeypatch: pytest.MonkeyPatch, visible: float, wanted: bool
) -> None:
    rows = rows_seen(monkeypatch, visible=visible)
    assert (rows["wanted"] == wanted).all()
    assert (rows["found"] == wanted).all()
    assert (np.isnan(rows["off_px"]) == (visible <= 0.95)).all()  # what covers a marker moves its centre


def test_what_cannot_be_scored_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"unknown scene 'wise'; known: .*wide"):
        hands.evaluate(["wise"], [0])
    with pytest.raises(SettingsError, match="no seed"):
        hands.evaluate(["wide"], [])
    with pytest.raises(SettingsError, match="grip"):
        hands.run("wide", 0, {"grip": 1})


def rows_of(**told: Any) -> hands.FrameRows:
    """Eight frames of five markers without any error, changed by what is told."""
    frames, tips = np.zeros((8, 5)), np.ones((8, 5), bool)
    return {
        "wanted": tips.copy(), "found": tips.copy(), "false": ~tips, "off_px": frames, "marker_mm": frames.copy(),
        "depth_percent": frames, "landmark_mm": np.zeros((8, 21)), "tip_off_m": np.zeros((8, 5, 3)),
        "angle_deg": np.zeros((8, 21)), "measured": tips, **told,
    }  # fmt: skip


def test_shares_are_of_what_was_asked_for_and_of_all_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    perfect, bad = rows_of(), rows_of()
    bad["wanted"][:, 4] = bad["found"][:, 4] = False  # 32 are wanted
    bad["found"][:2, :4] = False
    bad["false"][0] = True
    bad["marker_mm"][4:, 1:] = np.nan
    bad["landmark_mm"][5:] = np.nan
    bad["landmark_mm"][0, 3] = np.nan  # the hand is there
    monkeypatch.setattr(hands, "run", lambda name, seed, settings: (perfect, bad)[seed])
    scores = hands.evaluate(["wide"], [0, 1])["scenes"]["wide"]
    names = ("found_percent", "false_percent", "marker_lost_percent", "hand_lost_percent")
    assert [scores["0"][name] for name in names] == [100.0, 0.0, 0.0, 0.0]
    assert [scores["1"][name] for name in names] == [75.0, 12.5, 40.0, 37.5]
    assert [scores["all"][name] for name in names] == pytest.approx([100 * 64 / 72, 6.25, 20.0, 18.75])
