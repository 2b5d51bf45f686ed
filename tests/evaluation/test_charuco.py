"""Real webcams: calibrated on odd frames of a board, scored on even ones."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import numpy as np
import pytest

from mocapella.calibration.corner_quality import CornerQuality
from mocapella.errors import CalibrationError, EvaluationError, InputError
from mocapella.evaluation import charuco as module
from mocapella.evaluation.charuco import evaluate
from mocapella.model.board import Board, encode_board


@dataclass
class Report:
    """Of a calibrated camera."""

    own_px: float


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


@pytest.mark.parametrize("step", [1, 2])
def test_odd_frames_calibrate_and_even_ones_are_scored(
    step: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A limit that is just kept is met; the board is not found in every seventh frame."""
    (tmp_path / "calibration" / "extrinsic").mkdir(parents=True)
    for name in ("left", "right"):
        (tmp_path / "calibration" / "extrinsic" / f"{name}.mp4").touch()
    read: list[Path] = []
    calibrated, scored = [], []

    def quality(views: Any, instants: Any, cameras: Any, board: Any) -> CornerQuality:
        scored.append((views, instants))
        off = 1.0 if cameras == "reference" else 1.2
        return CornerQuality(1, 2, off, 0.0, 0.0, off, 0.0, 0.0)

    def calibrate(views: Any, board: Any, *, measure: bool) -> Any:
        calibrated.extend(views)
        lens = SimpleNamespace(camera=SimpleNamespace(lens=np.zeros(9)))
        report, half = Report(0.5), Report(0.75)
        return SimpleNamespace(
            rig=SimpleNamespace(cameras={"left": lens}), cameras={"left": report}, instants=3, sigma_px=0.1,
            left_out=[half] if measure else None,
        )  # fmt: skip

    def look(image: int, camera: str, frame: int) -> Any:
        assert image == frame
        return SimpleNamespace(camera=camera, frame=frame) if frame % 7 else None

    def reference(path: Path) -> Any:
        read.append(path)
        return SimpleNamespace(cameras="reference")

    monkeypatch.setattr(module, "load_board", read.append)
    monkeypatch.setattr(module, "load_camera_rig", reference)
    monkeypatch.setattr(module, "BoardDetector", lambda board: SimpleNamespace(update=look))
    monkeypatch.setattr(module, "pictures", lambda video, frames: [(k, k) for k in range(20) if frames.wants(k)])
    monkeypatch.setattr(module, "calibrate_cameras", calibrate)
    monkeypatch.setattr(module, "corner_quality", quality)
    found = evaluate(tmp_path, step=step)
    assert read == [tmp_path / "charuco.toml", tmp_path / "camera_array.toml"]
    odd, even = ([k for k in range(first, 20, 2 * step) if k % 7] for first in (1, 0))
    assert [(view.camera, view.frame) for view in calibrated] == [(side, k) for side in ("left", "right") for k in odd]
    views, instants = scored[0]
    assert [(view.camera, view.frame) for view in views] == [(side, k) for side in ("left", "right") for k in even]
    assert instants == {(side, k): k for side in ("left", "right") for k in even}
    assert found["calibration"]["views"] == 2 * len(odd)
    assert found["calibration"]["left_out"] == ([{"own_px": 0.75}] if step == 1 else None)
    assert found["calibration"]["cameras"]["left"] == {"own_px": 0.5, "lens": [0.0] * 9}
    assert found["targets"] == {
        "distance_rms_mm": {"limit": 1.2, "met": True}, "reprojection_median_px": {"limit": 1.0, "met": False}
    }  # fmt: skip


def test_two_videos_are_enough_and_one_is_not(tmp_path: Path) -> None:
    folder = tmp_path / "calibration" / "extrinsic"
    folder.mkdir(parents=True)
    (folder / "left.mp4").touch()
    with pytest.raises(EvaluationError, match="two cameras or more"):
        evaluate(tmp_path)
    (folder / "right.mp4").touch()
    with pytest.raises(InputError, match=r"charuco\.toml"):
        evaluate(tmp_path)


def test_a_folder_without_videos_is_refused(tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match="two cameras or more"):
        evaluate(tmp_path)
