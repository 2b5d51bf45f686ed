"""Tables of joint angles, MOT and STO hold the angles, with names, states and gaps."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.posed_person import HALPE, person, points_of

import mocapella
from mocapella.errors import SettingsError
from mocapella.exports import trajectory_tables
from mocapella.exports.angle_tables import ANGLE_COLUMNS, angles_as_pandas, angles_as_polars, write_angles
from mocapella.exports.arm_rows import STATES
from mocapella.exports.storage_file import COORDINATES, write_mot, write_sto
from mocapella.exports.trc_file import write_trc
from mocapella.library.angle_tracks import AngleTracks
from mocapella.library.motion_tracks import MotionTracks
from mocapella.model.hand import ANGLES, LANDMARKS
from mocapella.model.joint_angles import JointAngles
from mocapella.model.trajectories import Trajectories

FRAMES = 8


def walk(seed: int = 0, frames: int = FRAMES) -> Trajectories:
    """A person who bends everything, with an inferred and an unknown joint."""
    rng = np.random.default_rng(seed)
    bends = {name: rng.uniform(0.4, 0.9, frames) for name in COORDINATES}
    own = person(points_of(bends | {"pelvis_ty": np.full(frames, 0.9)}, frames))
    positions, states = own.positions.copy(), own.states.copy()
    knee, wrist = (own.keypoints.index(name) for name in ("KneeLeft", "WristRight"))
    positions[1, 0, knee], states[1, 0, knee], states[2, 0, wrist] = math.nan, 0, 1
    return replace(own, positions=positions, states=states, labels={0: {"participant": 7, "scenario": "walk"}})


def storage(path: Path) -> tuple[dict[str, str], dict[str, np.ndarray]]:
    """Header and columns of a MOT or STO."""
    head, _, body = path.read_text(encoding="utf-8").partition("endheader\n")
    rows = [line.split("\t") for line in body.splitlines()]
    values = np.array([[float(cell) for cell in row] for row in rows[1:]])
    return dict(line.split("=") for line in head.splitlines() if "=" in line), dict(zip(rows[0], values.T, strict=True))


@settings(deadline=None, max_examples=2)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_tables_have_a_row_for_each_angle_of_those_who_are_there(
    seed: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    own, path = walk(seed), tmp_path_factory.mktemp("angles") / "a.csv"
    gone = replace(own, positions=own.positions.copy())
    gone.positions[4] = math.nan
    found = JointAngles.of(gone)
    write_angles(gone, path)
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == ANGLE_COLUMNS
    tables = [rows, angles_as_pandas(found).to_dict("records"), angles_as_polars(found).to_dicts()]
    expected = [(frame, k) for frame in range(FRAMES) if frame != 4 for k in range(len(found.names))]
    for table in tables:
        assert len(table) == len(expected)
        for row, (frame, k) in zip(table, expected, strict=True):
            texts = ("7", "walk", "anna", found.names[k], STATES[found.states[frame, 0, k]])
            assert (row["participant"], row["scenario"], row["individual"], row["angle"], row["state"]) == texts
            numbers = [
                math.nan if row[name] in {"", None} else float(row[name]) for name in ("time_s", "deg", "sd_deg")
            ]
            wanted = [found.times_s[frame], *np.degrees([found.angles[frame, 0, k], found.sd[frame, 0, k]])]
            np.testing.assert_allclose(numbers, wanted, atol=1e-4)


def test_a_long_table_is_written_in_steps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_angles(walk(), tmp_path / "whole.csv")
    monkeypatch.setattr(trajectory_tables, "ROWS_AT_ONCE", 3)
    write_angles(walk(), tmp_path / "steps.csv")
    assert (tmp_path / "steps.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()


def test_a_mot_has_opensims_coordinates_in_degrees_and_metres(tmp_path: Path) -> None:
    own = walk()
    own = replace(own, times_s=own.times_s + 5.0)
    notes = write_mot(own, tmp_path / "a.mot")
    head, columns = storage(tmp_path / "a.mot")
    assert head == {"version": "1", "nRows": str(FRAMES), "nColumns": str(len(columns)), "inDegrees": "yes"}
    assert tuple(columns) == ("time", *COORDINATES)
    np.testing.assert_allclose(columns["time"], np.arange(FRAMES) / 30.0, atol=1e-6)
    found = JointAngles.of(own)
    for name in set(COORDINATES) - {"pelvis_tx", "pelvis_ty", "pelvis_tz"}:
        np.testing.assert_allclose(columns[name], np.degrees(found.angles[:, 0, found.names.index(name)]), atol=1e-5)
    np.testing.assert_allclose(columns["pelvis_ty"], 0.9)
    (note,) = notes
    assert (
        note
        == "2% of the values are unknown (NaN), most often: hip_flexion_l 12%, hip_adduction_l 12%, hip_rotation_l 12%"
    )


def test_a_sto_has_every_angle_and_names_those_that_are_never_known(tmp_path: Path) -> None:
    notes = write_sto(person(points_of({}, FRAMES)), tmp_path / "a.sto")
    _, columns = storage(tmp_path / "a.sto")
    assert {"shoulder_elevation_r", "elbow_flex_l", "pelvis_tx"} <= set(columns)
    assert "hip_rotation_r" not in columns
    assert notes[0].startswith("never known and left out: ")
    assert "hip_rotation_r" in notes[0]


def test_the_angles_of_a_hand_are_in_a_sto(tmp_path: Path) -> None:
    angles = np.random.default_rng(0).normal(size=(2, 1, len(ANGLES)))
    hand = Trajectories(
        "hands", np.arange(2.0), np.zeros(2, np.int64), ("hand_1_left",), LANDMARKS, np.zeros((2, 1, 21, 3)),
        np.full((2, 1, 21), 2, np.uint8), np.full((2, 1, 21), 0.01, np.float32), angle_names=ANGLES, angles=angles,
    )  # fmt: skip
    assert write_sto(hand, tmp_path / "a.sto") == []
    _, columns = storage(tmp_path / "a.sto")
    assert list(columns) == ["time", *(name.replace(" ", "_") for name in ANGLES)]
    wanted = np.degrees(angles[:, 0, ANGLES.index("index PIP flexion")])
    np.testing.assert_allclose(columns["index_PIP_flexion"], np.unwrap(wanted, period=360), atol=1e-5)


def test_a_turning_person_has_no_steps_of_360_degrees(tmp_path: Path) -> None:
    turn = np.linspace(0, 3 * math.pi, 40)
    own = person(points_of({"pelvis_rotation": turn}, 40))
    own.positions[10] = math.nan
    write_mot(own, tmp_path / "a.mot")
    _, columns = storage(tmp_path / "a.mot")
    known = np.arange(40) != 10
    np.testing.assert_allclose(columns["pelvis_rotation"][known], np.degrees(turn)[known], atol=1e-4)
    assert np.isnan(columns["pelvis_rotation"][10])


def test_somebody_who_is_never_seen_has_no_file(tmp_path: Path) -> None:
    own = walk()
    with pytest.raises(SettingsError, match="anna has no known joint angle in any frame"):
        write_mot(replace(own, positions=np.full_like(own.positions, math.nan)), tmp_path / "a.mot")


def test_the_points_of_another_programs_trc_have_angles(tmp_path: Path) -> None:
    """Pose2Sim writes Halpe's names."""
    write_trc(person(points_of({"knee_angle_r": np.full(FRAMES, 0.7)}, FRAMES), "halpe_26", HALPE), tmp_path / "a.trc")
    points = mocapella.load(tmp_path / "a.trc").points
    assert points is not None
    found = points.joint_angles()
    np.testing.assert_allclose(found.angles[:, 0, found.names.index("knee_angle_r")], 0.7, atol=1e-4)
    assert "ankle_angle_l" in found.names


def test_the_library_gives_angles_of_a_motion() -> None:
    found = MotionTracks.of_file(walk(), "a.mcap").joint_angles()
    assert type(found) is AngleTracks
    assert len(found.to_pandas()) == len(found.to_polars()) == FRAMES * len(found.names)
    assert repr(found).startswith(f"<joint angles of people: anna; {len(found.names)} angles, {FRAMES} frames, ")
