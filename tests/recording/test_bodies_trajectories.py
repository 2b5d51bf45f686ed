"""A result of silhouette tracking as trajectories: positions, angles, and what no image shows."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

import mocapella
from mocapella.errors import InputError
from mocapella.geometry.twists import exp_twist
from mocapella.model.twist_tree import TreePose
from mocapella.recording.bodies_file import FollowedBody, FollowedPeople, frame_of
from mocapella.recording.bodies_trajectories import read_bodies

NAMES = ("left knee flexion", "waist bend")


def frames(begin: int, count: int, lost: int = -1) -> list:
    rng = np.random.default_rng(begin)
    return [
        frame_of(
            k, k / 25.0, TreePose(exp_twist(rng.normal(size=6)), rng.normal(size=2)), joint_names=NAMES,
            landmarks={"nose": rng.normal(size=3), "left knee": rng.normal(size=3)}, overlap={}, left_out={},
            lost=k == lost, unsupported=("left knee",) if k % 2 else (),
        )
        for k in range(begin, begin + count)
    ]  # fmt: skip


def test_people_of_one_file_share_the_times(tmp_path: Path) -> None:
    anna, ben = FollowedBody("male", frames(0, 6, lost=4)), FollowedBody("male", frames(3, 6))
    (tmp_path / "a.json").write_bytes(msgspec.json.encode(FollowedPeople({"anna": anna, "ben": ben})))
    found = read_bodies(tmp_path / "a.json")
    assert found.individuals == ("anna", "ben")
    np.testing.assert_allclose(found.times_s, np.arange(9) / 25.0)
    assert found.rate_hz == pytest.approx(25.0)
    np.testing.assert_array_equal(found.present, [[k < 6, k >= 3] for k in range(9)])
    nose, knee = found.keypoints.index("nose"), found.keypoints.index("left knee")
    np.testing.assert_array_equal(found.positions[2, 0, nose], anna.frames[2].joints["nose"])
    assert found.states[:6, 0, nose].tolist() == [2, 2, 2, 2, 1, 2]
    assert found.states[:6, 0, knee].tolist() == [2, 1, 2, 1, 1, 1]
    bend = found.angle_names.index("waist bend")
    np.testing.assert_array_equal(found.angles[3:, 1, bend], [one.angles["waist bend"] for one in ben.frames])
    assert found.poses is not None
    np.testing.assert_allclose(found.poses[3, 1], exp_twist(np.array(ben.frames[0].root_twist)))


def test_a_body_without_a_name_is_loaded(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_bytes(msgspec.json.encode(FollowedBody("male", frames(0, 1))))
    recording = mocapella.load(tmp_path / "a.json")
    assert recording.bodies is not None
    assert recording.bodies.individuals == ("body",)
    assert np.isnan(recording.bodies.rate_hz)
    assert "angle" in recording.bodies.to_xarray()


def test_a_landmark_that_a_frame_lacks_is_unknown_there(tmp_path: Path) -> None:
    body = FollowedBody("male", frames(0, 3))
    del body.frames[1].joints["nose"]
    (tmp_path / "a.json").write_bytes(msgspec.json.encode(body))
    found = read_bodies(tmp_path / "a.json")
    nose = found.keypoints.index("nose")
    assert found.states[:, 0, nose].tolist() == [2, 0, 2]
    np.testing.assert_array_equal(np.isnan(found.positions[:, 0, nose, 0]), [False, True, False])


def test_other_json_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("{}")
    with pytest.raises(InputError, match=r"a\.json"):
        mocapella.load(tmp_path / "a.json")
