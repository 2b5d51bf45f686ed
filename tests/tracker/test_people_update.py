"""What of a frame's bodies reaches the fusion: of those that are assigned to people, each with its own values."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mocapella.geometry.rigid import rigid, rotation_about_y
from mocapella.tracker.people_memory import FrameViews
from mocapella.tracker.people_update import associate_and_fuse

JOINTS = 4
T = rigid(rotation_about_y(0.7), np.array([1.0, 2.0, 3.0]))
TOPOLOGY: Any = SimpleNamespace(noise=0.3, scale_sd=0.2)


class Noted:
    """Tracks and people of a tracker, which note what they are given."""

    def __init__(self, positions: np.ndarray, rows: list[int]) -> None:
        self.rows, self.positions = np.array(rows, np.int64), positions
        self.people, self.merged = (7, 9), ((7, 8), (9, 4))
        self.called: list[Any] = []

    def prepare(self, bodies: Any, T: np.ndarray, at_s: float) -> Any:
        self.called.append(("prepare", at_s))
        return SimpleNamespace(positions=self.positions, middles=None, expected=None, lengths=None)

    def assigned(self, *given: Any) -> np.ndarray:
        self.called.append(("assign", given[0], given[1], given[4]))
        return self.rows

    def join(self, stays: int, gone: int) -> None:
        self.called.append(("join", stays, gone))

    def arrange(self, people: Any) -> None:
        self.called.append(("arrange", people))

    def column(self, sensor: str) -> int:
        return {"front": 3}[sensor]

    def update(self, new: FrameViews, now_s: float) -> None:
        self.called.append(("update", new, now_s))


def fused(
    rows: list[int], edges: list[int], order: list[int], corrections: np.ndarray | None = None
) -> tuple[FrameViews, Noted]:
    """Bodies 10, 11, … of the sensor "front", whose frame has them in another order."""
    count, rng = len(rows), np.random.default_rng(0)
    ids = tuple(range(10, 10 + count))
    positions, own = rng.normal(size=(2, count, JOINTS, 3))
    states = rng.integers(0, 3, (count, JOINTS)).astype(np.uint8)
    noted = Noted(positions, rows)
    bodies: Any = SimpleNamespace(sensor="front", ids=ids, positions=own, states=states)
    frame: Any = SimpleNamespace(
        tracking_ids=np.array(ids, np.uint64)[order], clipped_edges=np.array(edges, np.uint8)[order], topology=TOPOLOGY
    )
    people: Any = noted
    tracks: Any = SimpleNamespace(update=noted.assigned, merged=noted.merged, people=noted.people)
    associate_and_fuse(tracks, people, frame, bodies, T, corrections, at_s=5.0, now_s=6.0)
    (new,) = (call[1] for call in noted.called if call[0] == "update")
    shown = np.array(rows) >= 0
    np.testing.assert_array_equal(new.positions, positions[shown])
    np.testing.assert_array_equal(new.own_positions, own[shown])
    np.testing.assert_array_equal(new.states, states[shown])
    np.testing.assert_array_equal(new.ids, np.array(ids)[shown])
    return new, noted


bodies = st.integers(0, 5).flatmap(
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


@given(bodies)
def test_bodies_that_are_nobodys_are_left_out_and_the_others_keep_their_own_edges(
    given_bodies: tuple[list[int], list[int], list[int]],
) -> None:
    rows, edges, order = given_bodies
    new, _ = fused(rows, edges, list(order))
    assert new.rows.tolist() == [row for row in rows if row >= 0]
    assert new.clipped.tolist() == [edge > 0 for row, edge in zip(rows, edges, strict=True) if row >= 0]


def test_corrections_are_turned_into_the_space_of_the_people_and_not_moved() -> None:
    corrections = np.random.default_rng(1).normal(size=(3, JOINTS, 3))
    new, _ = fused([1, -1, 0], [0, 0, 0], [0, 1, 2], corrections)
    turned = np.einsum("ij,bkj->bki", T[:3, :3], corrections)
    np.testing.assert_allclose(new.bias, turned[[0, 2]], atol=1e-12)
    new, _ = fused([1, -1, 0], [0, 0, 0], [0, 1, 2])
    assert (new.bias == 0).all()


def test_people_are_joined_and_arranged_before_they_are_updated() -> None:
    new, noted = fused([0, 1], [0, 0], [1, 0])
    assert [call[0] for call in noted.called] == ["prepare", "assign", "join", "join", "arrange", "update"]
    assert noted.called[0] == ("prepare", 6.0)
    assert noted.called[1] == ("assign", "front", (10, 11), 5.0)
    assert noted.called[2:5] == [("join", 7, 8), ("join", 9, 4), ("arrange", (7, 9))]
    assert noted.called[-1][2] == 6.0
    assert (new.column, new.at_s, new.noise, new.scale_sd) == (3, 5.0, 0.3, 0.2)
    np.testing.assert_array_equal(new.sensor_position, T[:3, 3])
