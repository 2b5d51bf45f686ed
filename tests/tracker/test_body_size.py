"""Bodies whose segments are nobody's are reported with the likely scale."""

import pytest
from support.silhouette_room import bent, ring

from mocapella.model.body_meshes import body_mesh
from mocapella.model.body_proportions import BodyProportions, proportions_of
from mocapella.recording.bodies_file import ALONE
from mocapella.tracker.body_size import size_doubt
from mocapella.tracker.initial_body import InitialBody
from mocapella.tracker.silhouettes import SilhouettesTracker


def scaled(factor, sex="male", height_m=1.65):
    """The body that a rig scaled by a factor gives a person."""
    marks = body_mesh(sex, height_m).landmarks
    return body_mesh(sex, None, proportions_of({name: factor * mark.point for name, mark in marks.items()}))


@pytest.mark.parametrize("sex", ["male", "female"])
@pytest.mark.parametrize("height_m", [1.0, 1.5, 1.75, 2.1])
def test_people_of_all_sizes_are_not_doubted(sex, height_m):
    assert not size_doubt(body_mesh(sex, height_m))


@pytest.mark.parametrize("factor", [0.4, 1.4, 1.5])
def test_a_scaled_rig_is_reported_with_its_scale(factor):
    said = size_doubt(scaled(factor))
    assert f"may be {factor * 1.65 / 1.75:.2f} times the true ones" in said
    assert "\n" not in said


def test_a_single_segment_that_is_nobodys_is_named_with_its_length():
    said = size_doubt(body_mesh("male", None, BodyProportions(thigh=0.7, shank=0.5, trunk=0.6)), "anna's")
    assert said.startswith("anna's thigh is 0.70 m, the average 0.43 m: ")
    assert not size_doubt(body_mesh("male", None, BodyProportions(thigh=0.5, shank=0.5, trunk=0.6)))


def test_the_tracker_says_so_at_the_start_and_as_long_as_it_tracks():
    body = scaled(1.5)
    tracker = SilhouettesTracker({ALONE: InitialBody(body, bent(body, {}))}, ring())
    doubt = size_doubt(body)
    assert tracker._begin(0)[0] == doubt
    assert tracker._stand().reason.startswith(doubt.replace("; ", ", "))
