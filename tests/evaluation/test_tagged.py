"""How a tag's pose is scored; few frames, for rendering takes long."""

from __future__ import annotations

import numpy as np
import pytest

from mocapella.evaluation import tagged


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
