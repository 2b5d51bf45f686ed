"""Real webcams: calibrated on odd frames of a board, scored on even ones."""

from __future__ import annotations

from pathlib import Path

import pytest

from mocapella.errors import EvaluationError
from mocapella.evaluation.charuco import evaluate


@pytest.mark.slow
def test_real_webcams_are_calibrated_by_every_second_odd_frame(camera_recordings: Path) -> None:
    """Half of what the command uses, to be quick: still within the figures of the whole."""
    result = evaluate(camera_recordings / "charuco_4cam", step=2)
    ours, reference = result["scored"]["ours"], result["scored"]["reference"]
    assert ours["points"] == reference["points"] > 150
    assert ours["distance_rms_mm"] < 1.5
    assert ours["reprojection_median_px"] < 1.2
    assert abs(ours["scale_percent"]) < 0.5
    assert reference["distance_rms_mm"] < 1.5
    assert all(report["own_px"] < 0.3 for report in result["calibration"]["cameras"].values())


def test_a_folder_without_videos_is_refused(tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match="two cameras or more"):
        evaluate(tmp_path)
