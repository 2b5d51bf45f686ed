"""How the method hands is scored; few frames, for rendering takes long."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.evaluation import hands


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
