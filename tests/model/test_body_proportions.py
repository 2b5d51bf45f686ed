"""Segments of a person: filled in from the height, and measured off joints that were seen."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.rigged_meshes import any_pose

from mocapella.errors import SettingsError
from mocapella.model.body_meshes import body_mesh
from mocapella.model.body_proportions import AVERAGE, UPRIGHT, BodyProportions, body_shape, lengths_of, proportions_of
from mocapella.model.rigged_mesh import RiggedMesh, landmarks_at, rest
from mocapella.model.twist_tree import TreePose

sexes = st.sampled_from(["female", "male"])


def frames(mesh: RiggedMesh, count: int, seed: int = 0) -> dict[str, np.ndarray]:
    """Of all landmarks, in any poses: (count, 3) by name."""
    rng = np.random.default_rng(seed)
    poses = [any_pose(rng, mesh) for _ in range(count)]
    batch = TreePose(np.array([at.T_world_model for at in poses]), np.array([at.angles for at in poses]))
    return dict(zip(mesh.landmarks, np.moveaxis(landmarks_at(mesh, batch), 1, 0), strict=True))


@given(sexes, st.floats(0.5, 2.5))
def test_segments_add_up_to_the_height(sex: str, height: float) -> None:
    lengths = lengths_of(sex, height, AVERAGE)  # type: ignore[arg-type]
    assert lengths.height == pytest.approx(height)
    table = dataclasses.asdict(body_shape(sex).lengths)  # type: ignore[arg-type]
    total = sum(table[name] for name in UPRIGHT)
    assert lengths.forearm / height == pytest.approx(table["forearm"])
    assert lengths.shank / height == pytest.approx(table["shank"] / total)


@pytest.mark.parametrize("sex", ["female", "male"])
def test_the_tables_segments_add_up_to_one_height(sex: str) -> None:
    assert body_shape(sex).lengths.height == pytest.approx(1.0)  # type: ignore[arg-type]


@given(sexes, st.floats(1.6, 1.8), st.floats(0.40, 0.46), st.floats(0.22, 0.28))
def test_known_segments_stay_and_the_others_make_up_the_height(
    sex: str, height: float, thigh: float, forearm: float
) -> None:
    lengths = lengths_of(sex, height, BodyProportions(thigh=thigh, forearm=forearm))  # type: ignore[arg-type]
    assert (lengths.thigh, lengths.forearm) == (thigh, forearm)
    assert lengths.height == pytest.approx(height)


def test_without_a_height_it_is_the_median_of_what_segments_say() -> None:
    table = body_shape("male").lengths
    known = BodyProportions(thigh=1.8 * table.thigh, shank=1.8 * table.shank, upper_arm=1.5 * table.upper_arm)
    lengths = lengths_of("male", None, known)
    assert lengths.height == pytest.approx(1.8)
    assert lengths.foot == pytest.approx(1.8 * table.foot)
    assert lengths.upper_arm == pytest.approx(1.5 * table.upper_arm)


@settings(max_examples=10, deadline=None)
@given(sexes, st.floats(1.2, 2.0), st.integers(0, 99))
def test_a_tracked_skeleton_gives_the_body_that_moved_it(sex: str, height: float, seed: int) -> None:
    mesh = body_mesh(sex, height)  # type: ignore[arg-type]
    found = proportions_of(frames(mesh, 9, seed)).known
    true = dataclasses.asdict(lengths_of(sex, height, AVERAGE))  # type: ignore[arg-type]
    bends = ("trunk", "head")  # shoulders and hips are apart by less where the waist bends; the head is straight on
    for name in set(true) - {"ankle_height", *bends}:
        assert found[name] == pytest.approx(true[name], rel=1e-9)
    assert found["head"] == pytest.approx(true["head"], rel=1e-9)
    assert found["trunk"] <= true["trunk"] * (1 + 1e-9)
    assert "ankle_height" not in found


@pytest.mark.parametrize("sex", ["female", "male"])
def test_a_single_frame_at_rest_gives_the_same_person_again(sex: str) -> None:
    mesh = body_mesh(sex, 1.83)  # type: ignore[arg-type]
    joints = dict(zip(mesh.landmarks, landmarks_at(mesh, rest(mesh)), strict=True))
    again = body_mesh(sex, 1.83, proportions_of(joints))  # type: ignore[arg-type]
    np.testing.assert_allclose(again.vertices, mesh.vertices, atol=1e-9)


def test_frames_that_went_wrong_and_joints_that_are_not_seen_do_not_count() -> None:
    mesh = body_mesh("female", 1.7)
    joints = frames(mesh, 21)
    true = proportions_of(joints).known
    joints["left knee"][:5] += 1.0
    joints["left wrist"][3:] = np.nan
    joints["right wrist"][:] = np.nan
    joints["head"][:] = np.nan
    found = proportions_of(joints).known
    assert "head" not in found
    assert "hand" in found, "of three frames of one side"
    for name, value in found.items():
        assert value == pytest.approx(true[name], rel=1e-6), name


def test_both_sides_count_alike() -> None:
    joints = {"left knee": np.zeros(3), "left ankle": [0, 0.38, 0], "right knee": np.zeros(3),
              "right ankle": [0, 0.42, 0]}  # fmt: skip
    assert proportions_of(joints).known == {"shank": pytest.approx(0.40)}


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (lambda: dataclasses.replace(body_shape("male").lengths, foot=0.0), "foot is 0.0; it must be above 0"),
        (lambda: BodyProportions(thigh=43.0), "thigh is 43.0; it must be 0.01 to 1.5 m"),
        (lambda: BodyProportions(thigh=float("nan")), "thigh is nan"),
        (lambda: BodyProportions(girth=2.0), "girth is 2.0; it must be 0.75 to 1.5"),
        (lambda: lengths_of("male", None, AVERAGE), "height_m is None; it must be given, where no segment is"),
        (
            lambda: lengths_of("male", 1.7, BodyProportions(shank=0.6, thigh=0.6)),
            "height_m is 1.7; .* with shank 0.600 m",
        ),
        (lambda: lengths_of("male", 1.8, BodyProportions(forearm=0.05)), "forearm is 0.05; it must be 0.158 to 0.42"),
        (
            lambda: lengths_of("male", 2.0, BodyProportions(0.07, 0.43, 0.43, 0.5, 0.3)),
            "height_m is 2.0; it must be 1.7300, the sum of ankle_height, shank, thigh, trunk, head",
        ),
        (lambda: lengths_of("male", None, BodyProportions(thigh=0.1)), "height_m is 0.408.* it must be 0.5 to 2.5 m"),
        (lambda: proportions_of({}), "both ends of a segment"),
        (lambda: proportions_of({"left knee": np.zeros(3)}), "both ends of a segment"),
        (lambda: proportions_of({"left knee": np.zeros(2)}), r"shapes of joints is \[\(1, 2\)\]"),
        (lambda: proportions_of({"left knee": np.zeros((4, 3)), "head": np.zeros(3)}), "shapes of joints"),
    ],
)
def test_what_no_person_has_is_said(build, said: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(SettingsError, match=said):
        build()
