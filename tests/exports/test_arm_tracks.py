"""Arms of scenes as a table."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from support.messages import arms_scene

from mocapella.errors import SettingsError
from mocapella.exports.arm_tracks import COLUMNS, write_arm_tracks
from mocapella.model.arms import ARM_JOINT_NAMES, ARM_POINTS
from mocapella.model.scene import Scene

WORDS = ("unknown", "inferred", "measured")


def scenes() -> list[Scene]:
    """Three results 20 ms apart, the middle one without an arm."""
    one = arms_scene()
    again = msgspec.structs.replace(one, step=one.step + 2, at_ns=one.at_ns + 40_000_000)
    return [
        one,
        msgspec.structs.replace(one.with_parts(arms=()), step=one.step + 1, at_ns=one.at_ns + 20_000_000),
        again,
    ]


def of_run(run: int, some: list[Scene]) -> list[tuple[int, Scene]]:
    return [(run, scene) for scene in some]


def table(path: Path) -> list[dict[str, Any]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("all_points", [False, True])
def test_every_joint_of_every_arm_is_a_row(tmp_path: Path, all_points: bool) -> None:
    path = tmp_path / "arms.csv"
    report = write_arm_tracks(of_run(0, scenes()), path, all_points=all_points)
    rows = table(path)
    names = ARM_POINTS if all_points else ARM_JOINT_NAMES
    assert (report.scenes, report.with_arms, report.arms) == (3, 2, 2)
    assert report.rows == len(rows) == 2 * 2 * len(names)
    assert tuple(rows[0]) == COLUMNS
    assert {row["time_s"] for row in rows} == {"0.0", "0.04"}
    scene = arms_scene()
    for k, row in enumerate(rows[: 2 * len(names)]):
        arm, point = scene.arms[k // len(names)], ARM_POINTS.index(names[k % len(names)])
        assert (row["joint"], row["state"]) == (ARM_POINTS[point], WORDS[arm.states[point]])
        assert (row["arm"], row["person"]) == (str(arm.id), "" if arm.person < 0 else str(arm.person))
        assert (row["handedness"], row["cameras"]) == ("left" if arm.left else "right", " ".join(arm.cameras))
        assert row["grabbing"] == str(int(arm.grabbing))
        if arm.states[point]:
            place = [float(row[axis]) for axis in ("x_m", "y_m", "z_m")]
            np.testing.assert_allclose(place, arm.points[point], atol=1e-5)
            np.testing.assert_allclose(float(row["sd_m"]), arm.sd[point], atol=1e-5)
        else:
            assert (row["x_m"], row["sd_m"]) == ("", "")


def test_every_second_result_alone(tmp_path: Path) -> None:
    path = tmp_path / "arms.csv"
    report = write_arm_tracks(of_run(0, scenes()[::2]), path, every=2)
    assert (report.scenes, report.with_arms) == (2, 1)
    assert {row["step"] for row in table(path)} == {"7"}


def test_a_file_that_cannot_be_written_is_an_error_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="in a folder that exists"):
        write_arm_tracks(of_run(0, scenes()), tmp_path / "no" / "arms.csv")
    assert not list(tmp_path.iterdir())


def test_rows_have_the_run_and_its_labels(tmp_path: Path) -> None:
    labels = {0: {"participant": 7, "scenario": "walk"}, 1: {"participant": -9999, "scenario": "steps"}}
    write_arm_tracks([*of_run(0, scenes()), *of_run(1, scenes())], tmp_path / "a.csv", labels=labels)
    found = {(row["run"], row["participant"], row["placement"], row["scenario"]) for row in table(tmp_path / "a.csv")}
    assert found == {("0", "7", "", "walk"), ("1", "", "", "steps")}
