"""What the scoring of the study logs sums up over sessions."""

from __future__ import annotations

import math

from mocapella.evaluation.kinectmultitrack import Tally


def test_a_figure_is_the_mean_of_the_sessions_that_have_it() -> None:
    tally = Tally()
    tally.fused["90"] = [{"lag_ms": 1.0, "jitter_mm": 4.0}, {"lag_ms": 3.0, "slide_cm_s": math.nan}]
    tally.fused["45"] = [{"lag_ms": 8.0, "jitter_mm": math.nan}]
    assert tally.fused_json() == {
        "all": {"sessions": 3, "lag_ms": 4.0, "jitter_mm": 4.0, "slide_cm_s": None},
        "90": {"sessions": 2, "lag_ms": 2.0, "jitter_mm": 4.0, "slide_cm_s": None},
        "45": {"sessions": 1, "lag_ms": 8.0, "jitter_mm": None},
    }


def test_without_a_session_there_is_no_figure() -> None:
    assert Tally().fused_json() == {}
