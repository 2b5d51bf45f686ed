"""Real webcams: calibrated on odd frames of a board, scored on even ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NoReturn

import pytest

from mocapella.errors import CalibrationError, EvaluationError
from mocapella.evaluation import charuco as module
from mocapella.evaluation.charuco import evaluate
from mocapella.model.board import Board, encode_board


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


@pytest.mark.parametrize("step", [1, 2, 3])
def test_only_a_calibration_by_all_frames_is_cross_validated(
    step: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That takes twice as long again, and a larger step is for a quick check."""
    (tmp_path / "calibration" / "extrinsic").mkdir(parents=True)
    for name in ("left", "right"):
        (tmp_path / "calibration" / "extrinsic" / f"{name}.mp4").touch()
    (tmp_path / "charuco.toml").write_text(encode_board(Board("charuco", 5, 4, 0.05)), encoding="utf-8")
    asked: list[bool] = []

    def calibrate(views: list[Any], board: Board, *, measure: bool) -> NoReturn:
        asked.append(measure)
        raise CalibrationError("of no views")

    monkeypatch.setattr(module, "pictures", lambda video, frames: [])
    monkeypatch.setattr(module, "calibrate_cameras", calibrate)
    with pytest.raises(CalibrationError, match="of no views"):
        evaluate(tmp_path, step=step)
    assert asked == [step == 1]


def test_a_folder_without_videos_is_refused(tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match="two cameras or more"):
        evaluate(tmp_path)
