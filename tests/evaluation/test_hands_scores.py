"""How the method hands is scored; few frames, for rendering takes long."""

from __future__ import annotations

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
