"""Which landmarks of the limbs images support."""

from copy import deepcopy

import msgspec
import numpy as np
import pytest
from support.silhouette_room import Room, bent

from mocapella.conventions import NS_PER_S
from mocapella.geometry.signed_distance import signed_distance
from mocapella.kinematics.silhouette_fit import eye, figure, see
from mocapella.model.rigged_mesh import landmarks_at, posed
from mocapella.tracker.limb_support import (
    DISTINCT,
    LASTS_S,
    LEAST_NATS,
    LimbSupport,
    OutlineEvidence,
    SupportConditions,
    evidence_at,
)

ROOM = Room()
POSE = bent(ROOM.mesh, {"left knee flexion": 30.0})
MARKS = tuple(ROOM.mesh.landmarks)
LEFT_LEG = {"left knee", "left ankle", "left heel", "left toe"}


def evidence(nats_of=lambda outline: np.full(len(outline.at), 3.0)):
    """Evidence of every camera of the room about the body in `POSE`."""
    body, vertices, found = figure(ROOM.mesh), posed(ROOM.mesh, POSE), []
    for placed in ROOM.rig.cameras.values():
        by = eye(placed)
        outline = see(body, vertices, by)
        lengths = np.linalg.norm(outline.normals, axis=1) * outline.depth / by.lens[0]
        found.append(OutlineEvidence(outline, nats_of(outline), lengths))
    return found


def lacking(some, *, shown=False):
    support = LimbSupport(ROOM.mesh, 1.0)
    has = (support.shown if shown else support.supported)(landmarks_at(ROOM.mesh, POSE), some)
    return {name for name, one in zip(MARKS, has.tolist(), strict=True) if not one}


def changed(some, **fields):
    """The same evidence with other fields, each a function of the outline."""
    return [msgspec.structs.replace(one, **{name: of(one.outline) for name, of in fields.items()}) for one in some]


def of_left_leg(outline):
    names = ("left thigh", "left shank", "left foot")
    return np.isin(outline.part, [ROOM.mesh.part_names.index(name) for name in names])


def test_all_limbs_are_supported_where_all_of_the_outline_is_clear():
    assert lacking(evidence()) == set()


def test_without_evidence_no_limb_is_supported_and_the_trunk_is_not_judged():
    some = lacking(evidence(lambda outline: np.full(len(outline.at), 0.9)))
    assert some == {name for name in MARKS if any(w in name for w in ("elbow", "wrist", "hand", "finger"))} | {
        name.replace("left", side) for name in LEFT_LEG for side in ("left", "right")
    }


def test_one_image_shows_a_leg_and_most_of_the_images_support_it():
    hidden = evidence(lambda outline: np.where(of_left_leg(outline), 0.0, 3.0))
    assert lacking(hidden) == lacking(hidden, shown=True) == LEFT_LEG
    for clear in (1, 3, 4):
        some = [*evidence()[:clear], *hidden[clear:]]
        assert lacking(some, shown=True) == set()
        assert lacking(some) == (LEFT_LEG if clear == 1 else set())


def test_a_single_image_of_several_does_not_support_and_the_only_one_does():
    some = changed(evidence(), open=lambda outline: ~of_left_leg(outline))
    some[0] = evidence()[0]
    assert lacking(some) == LEFT_LEG, "its distance is unknown"
    assert lacking(some[:1]) == set()
    some[1] = evidence()[1]
    assert lacking(some) == set()


def test_images_that_cannot_show_a_limb_take_nothing_away_and_those_that_do_not_show_it_do():
    hidden = evidence(lambda outline: np.where(of_left_leg(outline), 0.0, 3.0))
    whole = evidence()
    assert {"left knee", "left ankle"} <= lacking([*whole[:2], *hidden[2:]])
    covered = changed(hidden, open=lambda outline: ~of_left_leg(outline))
    assert lacking([*whole[:2], *covered[2:]]) == set()


def test_edges_of_the_room_support_nothing():
    of_room = changed(evidence(), room=of_left_leg)
    assert lacking(of_room) == LEFT_LEG
    assert lacking(of_room, shown=True) == set()


def of_left_arm(outline):
    names = ("left upper arm", "left forearm")
    return np.isin(outline.part, [ROOM.mesh.part_names.index(name) for name in names])


def test_an_arm_is_supported_only_if_its_outline_is_distinct_and_a_leg_without_that():
    arm = {name for name in MARKS if name.startswith("left") and name.split()[1] in {"elbow", "wrist"}}
    for excess, doubted in ((DISTINCT - 0.01, True), (DISTINCT + 0.01, False)):
        some = changed(evidence(), excess=lambda outline, at=excess: np.where(of_left_arm(outline), at, 1.0))
        assert (arm <= lacking(some)) is doubted
        assert lacking(some, shown=True) == set()
    of_legs = changed(evidence(), excess=lambda outline: np.where(of_left_leg(outline), -1.0, np.nan))
    assert lacking(of_legs) == set(), "where nothing is measured, nothing is doubted"
    assert {ROOM.mesh.part_names[part] for part in np.flatnonzero(LimbSupport(ROOM.mesh).arms)} == {
        f"{side} {part}" for side in ("left", "right") for part in ("upper arm", "forearm")
    }


def test_an_edge_that_crosses_the_outline_does_not_support_it():
    def crossed(outline):
        return np.where(np.arange(len(outline.at)) % 4 == 0, 3.0, 0.0)

    assert LEFT_LEG & lacking(evidence(crossed)) == LEFT_LEG


def test_the_shown_share_is_of_the_outlines_length_and_unknown_without_any():
    one = evidence()[0]
    half = np.cumsum(one.lengths_m) <= 0.5 * one.lengths_m.sum()
    part = OutlineEvidence(one.outline, np.where(half, LEAST_NATS, 0.0), one.lengths_m)
    assert one.shown == 1.0
    assert part.shown == pytest.approx(0.5, abs=0.02)
    assert np.isnan(OutlineEvidence(one.outline, one.nats[:0], one.lengths_m[:0]).shown)


@pytest.mark.parametrize("shift", [0, 9, -9])
def test_evidence_counts_only_where_the_image_has_its_contour_at_the_models(shift):
    outline = evidence()[0].outline
    phi = signed_distance(outline.mask, 20.0, outline.step_px) + np.float32(shift)
    nats = evidence_at(outline, phi, np.full(phi.shape, 3.0, np.float32))
    assert np.median(nats) == (3.0 if shift == 0 else 0.0)


def test_evidence_for_the_other_side_takes_away_from_that_for_this_side():
    outline = evidence()[0].outline
    phi = signed_distance(outline.mask, 20.0, outline.step_px)
    dark_before_dark = np.where(phi > 0, 0.7, -0.7).astype(np.float32)
    assert np.abs(np.median(evidence_at(outline, phi, dark_before_dark))) < 1e-6


def conditions():
    return SupportConditions({"anna": {"left knee": 1, "left ankle": 2}})


def frames(said, supported, begin=0, count=60):
    return [
        text
        for k in range(begin, begin + count)
        for text in said.update(k, k * NS_PER_S // 50, {"anna": np.array(supported)})
    ]


def test_landmarks_without_support_are_reported_once_they_lack_it_for_long_and_when_they_have_it_again():
    said = conditions()
    few = int(LASTS_S * 50)
    assert frames(said, [True, False], count=few) == []
    assert said.lasting == []
    assert frames(said, [True, False], few) == [
        "from frame 0 on: images do not support anna's left ankle: predicted, not measured"
    ]
    assert said.lasting == ["images do not support anna's left ankle: predicted, not measured"]
    assert frames(said, [True, True], 100, few) == []
    assert said.lasting != [], "not before it has lasted"
    assert frames(said, [True, True], 100 + few, 5) == ["frame 100: images show all limbs of anna again"]
    assert said.lasting == []
    assert frames(said, [True, True], 130) == []


def test_a_short_time_without_support_starts_anew_after_an_image_has_shown_the_limb():
    said = conditions()
    for begin in (0, 21, 42):
        assert frames(said, [False, False], begin, 20) == []
        assert frames(said, [True, True], begin + 20, 1) == []


def test_a_limb_that_shows_now_and_then_is_said_once():
    said = conditions()
    some = frames(said, [True, False])
    for begin in range(60, 300, 30):
        some += frames(said, [True, True], begin, 10) + frames(said, [True, False], begin + 10, 20)
    assert len(some) == 1


def test_who_leaves_and_comes_again_begins_anew():
    said = conditions()
    frames(said, [True, False])
    assert said.update(60, 60 * NS_PER_S // 50, {}) == []
    assert said.lasting == []
    assert frames(said, [True, True], 61) == [], "nothing is again as it was for who has just come"
    assert frames(said, [True, False], 121, round(LASTS_S * 50)) == []


def test_a_part_of_which_one_landmark_shows_is_not_reported():
    said = SupportConditions({"": {"wrist": 3, "fingertip": 3, "knee": 4}})
    of = {"": np.array([True, False, True])}
    assert [text for k in range(60) for text in said.update(k, k * NS_PER_S // 50, of)] == []
    of = {"": np.array([False, False, True])}
    said_now = [text for k in range(60, 120) for text in said.update(k, k * NS_PER_S // 50, of)]
    assert said_now == ["from frame 60 on: images do not support wrist, fingertip: predicted, not measured"]


def test_conditions_go_on_from_their_memory():
    said, other = conditions(), conditions()
    frames(said, [False, True])
    frames(said, [True, True], 60, 20)
    other.recall(deepcopy(said.memory()))
    assert other.lasting == said.lasting != []
    assert frames(other, [True, True], 80) == frames(said, [True, True], 80) != []


def test_parts_that_no_image_shows_are_hidden_and_no_others():
    support = LimbSupport(ROOM.mesh, 1.0)
    shown = np.array([name not in LEFT_LEG for name in MARKS])
    hidden = support.hidden_parts(shown)
    names = {name for name, one in zip(ROOM.mesh.part_names, hidden.tolist(), strict=True) if one}
    assert names == {"left thigh", "left shank", "left foot"}
    assert not support.hidden_parts(np.ones(len(MARKS), bool)).any()
