from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocapella.errors import InputError
from mocapella.evaluation import point_references
from mocapella.evaluation.point_references import HAND_BONES, agreement, caliscope_points, variation
from mocapella.fusion.point_tracks import TracksSettings
from mocapella.model.point_tracks import SpaceTracks


@pytest.mark.slow
def test_hands_and_body_of_mediapipe_are_near_caliscopes_and_steadier(holistic: Path) -> None:
    near, steady = point_references.holistic(holistic)
    assert near.median_mm <= 8.0
    assert near.p95_mm <= 35.0
    assert near.compared > 0.8 * near.reference
    assert steady.ours < steady.reference_where_ours < steady.reference


def test_points_of_openpose_are_within_a_millimetre_of_pose2sims(single_person: Path) -> None:
    assert point_references.single_person(single_person).within_1_mm >= 0.99


def test_the_robust_method_is_another(single_person: Path) -> None:
    near = point_references.single_person(single_person, TracksSettings(sd_px=5.0))
    assert 1.0 < near.median_mm < 10.0


def test_what_is_compared() -> None:
    reference = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [np.nan] * 3])
    ours = np.array([[0, 0, 0.0005], [0, 0.003, 0], [np.nan] * 3, [0, 0, 0]])
    near = agreement(ours, reference)
    assert (near.compared, near.reference) == (2, 3)
    assert near.median_mm == pytest.approx(1.75)
    assert near.within_1_mm == pytest.approx(1 / 3)


def test_a_millimetre_is_within_a_millimetre() -> None:
    reference = np.zeros((2, 3))
    assert agreement(np.array([[0, 0, 0.001], [0, 0, 0.00101]]), reference).within_1_mm == 0.5


def test_a_hand_that_only_moves_does_not_vary() -> None:
    assert len(HAND_BONES) == 20
    assert HAND_BONES[4:6] == ((0, 5), (5, 6))
    numbers = np.array([*range(100, 121), *range(200, 221)])
    still = np.random.default_rng(0).normal(size=(42, 3))
    moving = still + np.arange(5.0)[:, None, None]
    assert variation(moving, numbers) < 1e-9
    growing = still * (1 + 0.1 * np.arange(5.0))[:, None, None]
    assert variation(growing, numbers) == pytest.approx(np.std(1 + 0.1 * np.arange(5)) / 1.2)


def test_a_file_that_is_not_caliscopes_is_refused(tmp_path: Path) -> None:
    (tmp_path / "xyz.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    space = SpaceTracks(("1",), np.array([0]), np.zeros(1), np.zeros((1, 1, 3)), *([np.zeros((1, 1))] * 4))
    with pytest.raises(InputError, match=r"xyz.csv: not Caliscope's points"):
        caliscope_points(tmp_path / "xyz.csv", space)


def test_points_are_read_by_frame_and_number(tmp_path: Path) -> None:
    """Those that are not asked for are left out, and those that the file lacks are unknown."""
    rows = ["sync_index,point_id,x_coord,y_coord,z_coord", "7,2,1,2,3", "5,1,4,5,6", "5,9,7,8,9"]
    (tmp_path / "xyz.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    nothing = [np.zeros((2, 2))] * 4
    space = SpaceTracks(("1", "2"), np.array([5, 7]), np.zeros(2), np.zeros((2, 2, 3)), *nothing)
    unknown = [np.nan] * 3
    np.testing.assert_array_equal(
        caliscope_points(tmp_path / "xyz.csv", space), [[[4, 5, 6], unknown], [unknown, [1, 2, 3]]]
    )


def test_the_landmarks_of_body_and_hands_are_compared_and_no_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files are those of the sample recording; points with other numbers are far off here."""
    landmarks = {*range(33), *range(100, 121), *range(200, 221)}
    numbers = sorted(landmarks | {33, 80, 99, 121, 180, 199, 221})
    reference = np.random.default_rng(0).normal(size=(3, len(numbers), 3))
    ours = reference + np.where([number in landmarks for number in numbers], 0.0005, 5.0)[:, None] * [0, 0, 1]
    nothing = [np.zeros((3, len(numbers)))] * 4
    space = SpaceTracks(tuple(map(str, numbers)), np.arange(3), np.zeros(3), ours, *nothing)
    read: list[Path] = []
    monkeypatch.setattr(point_references, "read_image_tracks", read.extend)
    monkeypatch.setattr(point_references, "load_camera_rig", read.append)
    monkeypatch.setattr(point_references, "triangulate_tracks", lambda *_: (space, None))
    monkeypatch.setattr(point_references, "caliscope_points", lambda path, _: (read.append(path), reference)[1])
    near, _ = point_references.holistic(Path("sample"))
    assert (near.compared, near.within_1_mm) == (3 * len(landmarks), 1.0)
    folder = "sample/recording_1/HOLISTIC"
    assert [str(path) for path in read] == [
        f"{folder}/xy_HOLISTIC.csv", "sample/config.toml", f"{folder}/xyz_HOLISTIC.csv"
    ]  # fmt: skip
