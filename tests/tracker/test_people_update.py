"""A frame's assignment and fusion in one call, and in two where the tracks decide between its parts."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.association.tracks import MAY_BE_ONE, UNASSIGNED, Tracks
from mocapella.geometry.rigid import rigid, rotation_about_y
from mocapella.model.bodies import Bodies, tracked_bodies
from mocapella.model.observations import BodyFrame, body_frame
from mocapella.model.skeleton import SKELETON
from mocapella.tracker.people import People, PeopleSettings
from mocapella.tracker.people_memory import SensorBodies
from mocapella.tracker.people_update import associate_and_fuse

JOINTS, DT = 4, 1 / 30
T = rigid(rotation_about_y(0.7), np.array([1.0, 2.0, 3.0]))
TOPOLOGY: Any = SimpleNamespace(noise=0.3, scale_sd=0.2)


class Noted:
    """Tracks and people of a tracker, which note what they are given; the first call ends with these events."""

    def __init__(self, rows: list[int], events: int) -> None:
        self.rows, self.events = np.array(rows, np.int64), events
        self.people = self.numbers = (7, 9)
        self.merged = ((7, 8), (9, 4))
        self.middle, self.inputs = range(2), None
        self.called: list[Any] = []

    def prepare(self, bodies: Any, T: np.ndarray, at_s: float) -> Any:
        self.called.append(("prepare", at_s))
        return SimpleNamespace(middles=None, expected=None, lengths=None)

    def assigned(self, *given: Any) -> np.ndarray:
        self.called.append(("assign", given[0], given[1], given[4]))
        return self.rows

    def settled(self, *given: Any) -> np.ndarray:
        self.called.append(("settle", given[0], given[1], given[3], given[4]))
        return self.rows

    def join(self, stays: int, gone: int) -> None:
        self.called.append(("join", stays, gone))

    def arrange(self, people: Any) -> None:
        self.called.append(("arrange", people))

    def column(self, sensor: str, joints: int = 0) -> int:
        return {("front", 0): 3, ("front", 2): 5}[sensor, joints]

    def update(self, new: SensorBodies, tracks: Any, now_s: float) -> int:
        self.called.append(("update", new, now_s))
        return 0 if new.assigned else self.events


def fused(
    rows: list[int],
    edges: list[int],
    order: list[int],
    corrections: np.ndarray | None = None,
    events: int = UNASSIGNED,
) -> tuple[SensorBodies, Noted]:
    """Bodies 10, 11, … of the sensor "front", whose frame has them in another order; what was fused at last."""
    count, rng = len(rows), np.random.default_rng(0)
    ids = tuple(range(10, 10 + count))
    own = rng.normal(size=(count, JOINTS, 3))
    states = rng.integers(0, 3, (count, JOINTS)).astype(np.uint8)
    noted = Noted(rows, events)
    bodies: Any = SimpleNamespace(sensor="front", ids=ids, positions=own, states=states)
    frame: Any = SimpleNamespace(
        tracking_ids=np.array(ids, np.uint64)[order], clipped_edges=np.array(edges, np.uint8)[order], topology=TOPOLOGY
    )
    people: Any = noted
    tracks: Any = SimpleNamespace(
        update=noted.assigned, settle=noted.settled, column=noted.column, merged=noted.merged, people=noted.people,
        inputs=None,
    )  # fmt: skip
    associate_and_fuse(tracks, people, frame, bodies, T, corrections, at_s=5.0, now_s=6.0)
    new = [call[1] for call in noted.called if call[0] == "update"][-1]
    shown = np.array(rows) >= 0 if new.assigned else np.ones(count, np.bool_)
    np.testing.assert_array_equal(new.positions, own[shown])
    np.testing.assert_array_equal(new.states, states[shown])
    np.testing.assert_array_equal(new.ids, np.array(ids)[shown])
    if corrections is not None:
        np.testing.assert_array_equal(new.corrections, corrections[shown])
    return new, noted


bodies_of_frames = st.integers(0, 5).flatmap(
    lambda count: st.tuples(
        st.permutations(range(count)).flatmap(
            lambda rows: st.lists(st.booleans(), min_size=count, max_size=count).map(
                lambda kept: [row if stays else -1 for row, stays in zip(rows, kept, strict=True)]
            )
        ),
        st.lists(st.integers(0, 15), min_size=count, max_size=count),
        st.permutations(range(count)),
    )
)


@given(bodies_of_frames)
def test_bodies_that_are_nobodys_are_left_out_and_the_others_keep_their_own_values(
    given_bodies: tuple[list[int], list[int], list[int]],
) -> None:
    rows, edges, order = given_bodies
    corrections = np.random.default_rng(1).normal(size=(len(rows), JOINTS, 3))
    new, _ = fused(rows, edges, list(order), corrections)
    assert new.rows.tolist() == [row for row in rows if row >= 0]
    assert new.clipped.tolist() == [edge > 0 for row, edge in zip(rows, edges, strict=True) if row >= 0]
    assert fused(rows, edges, list(order))[0].corrections.shape == (0, JOINTS, 3)


def test_people_are_joined_and_arranged_before_they_are_updated() -> None:
    new, noted = fused([0, 1], [0, 0], [1, 0])
    names = [call[0] for call in noted.called]
    assert names == ["update", "prepare", "assign", "join", "join", "arrange", "update"]
    assert noted.called[1:3] == [("prepare", 6.0), ("assign", "front", (10, 11), 5.0)]
    assert noted.called[3:6] == [("join", 7, 8), ("join", 9, 4), ("arrange", (7, 9))]
    assert noted.called[-1][2] == 6.0
    assert (new.column, new.track_column, new.at_s, new.noise, new.scale_sd) == (3, 5, 5.0, 0.3, 0.2)
    np.testing.assert_array_equal(new.T, T)


def test_tracks_that_may_be_one_are_settled_between_assignment_and_fusion() -> None:
    _, noted = fused([0, 1], [0, 0], [1, 0], events=MAY_BE_ONE)
    assert [call[0] for call in noted.called] == ["update", "settle", "join", "join", "arrange", "update"]
    assert noted.called[1] == ("settle", "front", (10, 11), MAY_BE_ONE, 5.0)


def test_a_usual_frame_is_one_call() -> None:
    new, noted = fused([0, 1], [0, 0], [1, 0], events=0)
    assert [call[0] for call in noted.called] == ["update", "settle"]
    assert not new.assigned


def people_of(k: int, sensor: str, there: list[int]) -> tuple[BodyFrame, Bodies]:
    """The k-th frame of a sensor, with the persons ``there``: bodies that are far apart, but for the last two."""
    rng = np.random.default_rng(3)
    shape = rng.normal(scale=0.3, size=(len(SKELETON), 3))
    places = np.array([[-2.0, 0, 3], [0, 0, 3], [2.0, 0, 3], [2.15, 0, 3]])[there]
    noise = np.random.default_rng([k, sensor == "side"]).normal(scale=0.01, size=(len(there), *shape.shape))
    frame = body_frame(
        sensor, SKELETON, time_ns=round(1e9 * k * DT), positions=shape + places[:, None] + noise,
        tracking_ids=[20 + one for one in there],
    )  # fmt: skip
    return frame, tracked_bodies(frame)


def followed(frames: list[tuple[str, list[int]]]) -> tuple[Tracks, People]:
    """Tracks and people after frames of two sensors, which share one space."""
    tracks, people = Tracks(), People(PeopleSettings(), SKELETON)
    for k, (sensor, there) in enumerate(frames):
        frame, bodies = people_of(k, sensor, there)
        associate_and_fuse(tracks, people, frame, bodies, np.eye(4), at_s=k * DT, now_s=k * DT)
    return tracks, people


@pytest.mark.slow
@given(
    st.lists(
        st.tuples(st.sampled_from(["front", "side"]), st.lists(st.integers(0, 3), unique=True, max_size=4)),
        min_size=1,
        max_size=4,
    ).flatmap(lambda some: st.lists(st.sampled_from(some), min_size=1, max_size=60))
)
@settings(max_examples=30)
def test_one_call_does_what_its_two_parts_do(frames: list[tuple[str, list[int]]]) -> None:
    """People come, go, stand too near, and return; every frame is also taken apart."""
    one_tracks, one_people = followed(frames)
    update = People.update

    def apart(people: People, new: SensorBodies, tracks: Any, now_s: float) -> int:
        return update(people, new, tracks, now_s) if new.assigned else UNASSIGNED

    with mock.patch.object(People, "update", apart):
        other_tracks, other_people = followed(frames)
    assert one_people.numbers == one_tracks.people == other_people.numbers == other_tracks.people
    for sensor in ("front", "side"):
        assert one_tracks.owners(sensor) == other_tracks.owners(sensor)
    for name in one_tracks.memory.__struct_fields__:
        np.testing.assert_array_equal(getattr(one_tracks.memory, name), getattr(other_tracks.memory, name))
    for (name, one), (_, other) in zip(one_people.memory.arrays(), other_people.memory.arrays(), strict=True):
        np.testing.assert_array_equal(one, other, err_msg=name)


@pytest.mark.slow
def test_corrections_are_turned_into_the_space_of_the_people_and_not_moved() -> None:
    tracks, people = Tracks(), People(PeopleSettings(), SKELETON)
    corrections = np.random.default_rng(1).normal(scale=0.01, size=(2, len(SKELETON), 3))
    for k in range(2):  # people who are new, and known ones
        frame, bodies = people_of(k, "front", [0, 1])
        associate_and_fuse(tracks, people, frame, bodies, T, corrections, at_s=k * DT, now_s=k * DT)
        turned = np.einsum("ij,bkj->bki", T[:3, :3], corrections)
        np.testing.assert_allclose(people.memory.view_bias[:, 0], turned, atol=1e-12)
    frame, bodies = people_of(2, "front", [0, 1])
    associate_and_fuse(tracks, people, frame, bodies, T, at_s=2 * DT, now_s=2 * DT)
    assert (people.memory.view_bias == 0).all()
