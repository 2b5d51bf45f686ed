"""Laws of the planner: coverage, cost and proposals change with a room as they must."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.sources.simulate.occlusion import Box, Cylinder
from mocapella.studies.planner import placement_search
from mocapella.studies.planner.placement_search import (
    best_placement,
    costs_with,
    exhaustive_placement,
    groups_of,
    score_poses,
)
from mocapella.studies.planner.placement_table import arrangement, best_arrangement, compare_placements
from mocapella.studies.planner.planned_room import PlannedPeople, PlannedRoom, PlannedSensors, SensorSites
from mocapella.studies.planner.room_views import PlannedPose, RoomViews, cells_of, poses_of, site_places, wrapped
from mocapella.studies.planner.symmetric import six_of, trace_of_inverse

SITES = SensorSites(along=((0.2, 3.8), (0.2, 0.2), (4.8, 0.2)), every_m=1.2, heights_m=(1.0,), tilts_deg=(0.0,))
ROOM = PlannedRoom(
    width=5.0,
    depth=4.0,
    height=2.5,
    sites=(SITES,),
    area=((1.0, 1.5), (4.0, 1.5), (4.0, 3.5), (1.0, 3.5)),
    cylinders=(Cylinder((3.3, 2.3), 0.2, 2.5),),
    boxes=(Box((1.2, 1.0), (0.8, 1.2, 0.3), 20.0),),
    people=PlannedPeople(facings=4),
    cell_m=0.5,
)
"""A small room that no mirror maps to itself."""

NARROW = PlannedRoom(width=2.0, depth=8.0, height=2.5, sites=(SensorSites((1.0,), points=((1.0, 0.2),)),), cell_m=0.5)


@cache
def views_of(room: PlannedRoom) -> RoomViews:
    return RoomViews(room)


def moved(room: PlannedRoom, by: tuple[float, float], flip: bool = False) -> PlannedRoom:
    """The room moved by (x, z) [m], after it was mirrored, if ``flip``, at x = 0."""
    sign = -1.0 if flip else 1.0

    def at(points: Any) -> Any:
        return tuple((sign * x + by[0], z + by[1]) for x, z in points)

    x0, z0 = room.corner
    return dataclasses.replace(
        room,
        corner=(sign * x0 - (room.width if flip else 0.0) + by[0], z0 + by[1]),
        area=at(room.area),
        sites=tuple(dataclasses.replace(s, along=at(s.along)) for s in room.sites),
        boxes=tuple(Box(at([b.centre])[0], b.size, sign * b.yaw_deg) for b in room.boxes),
        cylinders=tuple(Cylinder(at([c.centre])[0], c.radius, c.height) for c in room.cylinders),
    )


def moved_pose(pose: PlannedPose, by: tuple[float, float], flip: bool = False) -> tuple[float, ...]:
    sign = -1.0 if flip else 1.0
    yaw = wrapped(sign * pose.yaw_deg)
    return round(sign * pose.x + by[0], 6), pose.height, round(pose.z + by[1], 6), yaw, pose.tilt_deg


POSES = st.lists(st.integers(0, len(views_of(ROOM).poses) - 1), min_size=1, max_size=3)


@settings(max_examples=20)
@given(POSES, st.integers(0, len(views_of(ROOM).poses) - 1))
def test_one_more_sensor_never_lowers_coverage_nor_raises_the_error(chosen: list[int], more: int) -> None:
    views = views_of(ROOM)
    before = score_poses(views, [views.poses[k] for k in chosen])
    after = score_poses(views, [views.poses[k] for k in (*chosen, more)])
    assert (after.seen_by >= before.seen_by).all()
    assert (after.error_cm <= before.error_cm + 1e-4).all()
    assert after.covered_percent >= before.covered_percent
    assert after.twice_percent >= before.twice_percent


@settings(max_examples=20)
@given(POSES, st.sampled_from(["boxes", "cylinders"]))
def test_an_obstacle_removed_never_lowers_coverage(chosen: list[int], which: str) -> None:
    views, free = views_of(ROOM), views_of(dataclasses.replace(ROOM, **{which: ()}))
    poses = [views.poses[k] for k in chosen]
    before, after = score_poses(views, poses), score_poses(free, poses)
    kept = {tuple(cell): k for k, cell in enumerate(free.cells.round(6).tolist())}
    same = [kept[tuple(cell)] for cell in views.cells.round(6).tolist()]
    assert (after.seen_by[same] >= before.seen_by).all()
    assert (after.error_cm[same] <= before.error_cm + 1e-4).all()


@pytest.mark.slow
@pytest.mark.parametrize(("by", "flip"), [((0.0, 0.0), True), ((-7.5, 3.25), False), ((2.0, -11.0), True)])
def test_a_moved_or_mirrored_room_has_the_moved_or_mirrored_proposal(by: tuple[float, float], flip: bool) -> None:
    here = best_placement(views_of(ROOM), 2)
    there = best_placement(views_of(moved(ROOM, by, flip)), 2)
    assert there.cost_cm == pytest.approx(here.cost_cm, abs=1e-3)
    assert (there.covered_percent, there.twice_percent) == (here.covered_percent, here.twice_percent)
    expected = np.array(sorted(moved_pose(pose, by, flip) for pose in here.poses))
    assert np.array(sorted(moved_pose(pose, (0, 0)) for pose in there.poses)) == pytest.approx(expected)


def test_the_same_seed_gives_the_same_proposal() -> None:
    one, other = (best_placement(RoomViews(ROOM), 2, seed=5) for _ in range(2))
    assert one.poses == other.poses
    assert (one.error_cm == other.error_cm).all()


@pytest.mark.slow
@pytest.mark.parametrize("sensors", [1, 2])
@pytest.mark.parametrize("change", [{}, {"boxes": ()}, {"cylinders": ()}, {"cell_m": 0.4}])
def test_the_search_finds_what_trying_all_finds(sensors: int, change: dict[str, Any]) -> None:
    views = views_of(dataclasses.replace(ROOM, **change))
    least, _ = exhaustive_placement(views, sensors)
    assert best_placement(views, sensors).cost_cm == pytest.approx(least, abs=1e-3)


@pytest.mark.slow
def test_a_greedy_start_alone_can_miss_the_best_and_exchanges_find_it() -> None:
    views = views_of(dataclasses.replace(ROOM, cylinders=()))
    least, _ = exhaustive_placement(views, 2)
    greedy = placement_search._greedy(views, 2, int(costs_with(views, []).argmin()), lambda _: None)
    assert score_poses(views, [views.poses[k] for k in greedy]).cost_cm >= least - 1e-3
    assert best_placement(views, 2).cost_cm == pytest.approx(least, abs=1e-3)


@settings(max_examples=20)
@given(st.lists(st.integers(0, len(views_of(ROOM).poses) - 1), max_size=2), st.integers(0, 10**6))
def test_the_search_s_cost_is_the_score_s(chosen: list[int], more: int) -> None:
    views = views_of(ROOM)
    index = more % len(views.poses)
    found = score_poses(views, [views.poses[k] for k in (*chosen, index)])
    assert costs_with(views, chosen)[index] == pytest.approx(found.cost_cm, rel=1e-4)


def test_the_cost_is_what_the_document_states() -> None:
    views = views_of(ROOM)
    found = score_poses(views, [views.poses[0], views.poses[-1]])
    weights = ROOM.weights
    parts = (
        found.mean_cm,
        weights.uncovered_cm * (1 - found.covered_percent / 100),
        weights.single_cm * (1 - found.twice_percent / 100),
        weights.apart_cm * (found.groups - 1),
    )
    assert found.cost_cm == pytest.approx(sum(parts))


def test_a_joint_that_nobody_sees_has_the_stated_error() -> None:
    views = views_of(ROOM)
    away = score_poses(views, [PlannedPose(0.2, 1.0, 0.2, -135.0, 0.0)])  # looks at the wall
    assert away.error_cm == pytest.approx(ROOM.weights.unseen_cm)
    assert (away.covered_percent, away.mean_cm) == (0.0, pytest.approx(ROOM.weights.unseen_cm))


@given(st.lists(st.lists(st.booleans(), min_size=5, max_size=5), min_size=5, max_size=5))
def test_groups_are_the_components_of_the_graph(rows: list[list[bool]]) -> None:
    linked = np.array(rows)
    linked |= linked.T
    left, groups = set(range(5)), 0
    while left:
        groups, waiting = groups + 1, [left.pop()]
        while waiting:
            here = waiting.pop()
            near = {k for k in left if linked[here, k]}
            left -= near
            waiting += near
    assert groups_of(linked) == groups


def test_sensors_that_share_no_floor_are_two_groups_and_the_proposal_has_one() -> None:
    apart = PlannedRoom(width=20.0, depth=4.0, height=2.5, sites=(SensorSites(points=((0.5, 2.0), (19.5, 2.0)),
                        yaws_deg=(90.0, -90.0), heights_m=(1.0,), tilts_deg=(0.0,)),), cell_m=0.5,
                        people=PlannedPeople(facings=4))  # fmt: skip
    views = views_of(apart)
    both = score_poses(views, [PlannedPose(0.5, 1.0, 2.0, 90.0, 0.0), PlannedPose(19.5, 1.0, 2.0, -90.0, 0.0)])
    assert (both.groups, both.overlap_m2[0, 1]) == (2, 0.0)
    assert best_placement(views, 2).groups == 1
    assert any("is covered by no sensor at any site" in note for note in views.notes)


@given(st.lists(st.floats(-2, 2), min_size=9, max_size=9))
def test_the_trace_of_an_inverse_is_that_of_the_inverse(values: list[float]) -> None:
    A = np.reshape(values, (3, 3))
    matrix = A @ A.T + np.eye(3)
    assert trace_of_inverse(six_of(matrix)) == pytest.approx(np.trace(np.linalg.inv(matrix)))


@pytest.mark.slow
def test_a_huge_room_gets_larger_cells_and_says_so() -> None:
    hall = PlannedRoom(width=60.0, depth=40.0, height=5.0, sites=(SensorSites(along=((0, 0), (60, 0), (60, 40)),
                       every_m=5.0, heights_m=(1.0,), tilts_deg=(0.0,)),), people=PlannedPeople(facings=4))  # fmt: skip
    views = RoomViews(hall)
    assert views.room.cell_m > hall.cell_m
    assert any(note.startswith("cells of ") for note in views.notes)
    assert sum(map(len, views.joints)) < 10_000_000


def test_what_cannot_be_planned_is_named_with_the_remedy() -> None:
    within = SensorSites(points=((3.3, 2.3),), heights_m=(1.0,))
    with pytest.raises(SettingsError, match=r"sites\[0\]: no sensor fits, all its places are inside obstacles"):
        RoomViews(dataclasses.replace(ROOM, sites=(within,)))
    assert poses_of(dataclasses.replace(ROOM, cylinders=(Cylinder((3.3, 2.3), 0.2, 0.5),), sites=(within,)),
                    cells_of(ROOM))  # fmt: skip
    with pytest.raises(SettingsError, match="no sensor at any of the sites sees a person in the area"):
        RoomViews(dataclasses.replace(ROOM, sensor=PlannedSensors(range_m=(0.1, 0.3))))
    full = Box((2.5, 2.5), (4.0, 1.0, 3.0))
    with pytest.raises(SettingsError, match="the area has no cell outside obstacles"):
        RoomViews(dataclasses.replace(ROOM, boxes=(full,)))
    with pytest.raises(SettingsError, match=r"0 sensors cannot be placed; give --sensors 1 or more"):
        best_placement(views_of(ROOM), 0)
    with pytest.raises(SettingsError, match="no sensor to score"):
        score_poses(views_of(ROOM), [])


def test_places_are_even_along_lines_and_within_polygons() -> None:
    line = site_places(SensorSites((1.0,), along=((0, 0), (3, 0), (3, 1)), every_m=1.0))
    assert {tuple(place) for place in line.tolist()} == {(0, 0), (1, 0), (2, 0), (3, 0), (3, 1)}
    tripod = site_places(SensorSites((1.0,), within=((0, 0), (2, 0), (2, 2), (0, 2)), every_m=1.0))
    assert {tuple(place) for place in tripod.tolist()} == {(0.5, 0.5), (0.5, 1.5), (1.5, 0.5), (1.5, 1.5)}
    assert len(site_places(SensorSites((1.0,), within=((0, 0), (0.3, 0), (0, 0.3)), every_m=5.0))) == 1


def test_two_parallel_sensors_are_side_by_side_and_an_arrangement_looks_at_the_middle() -> None:
    views = views_of(dataclasses.replace(ROOM, cylinders=(), boxes=()))
    one, other = arrangement(views, (0.0, 0.0), 180.0)
    assert (one.yaw_deg, other.yaw_deg) == (0.0, 0.0)
    assert one.z == pytest.approx(other.z)
    assert abs(one.x - other.x) == pytest.approx(0.5)
    middle = views.cells.mean(axis=0)
    for pose in arrangement(views, (0.0, 90.0), 135.0):
        away = middle - (pose.x, pose.z)
        assert np.degrees(np.arctan2(*away)) == pytest.approx(pose.yaw_deg)


@pytest.mark.slow
def test_the_table_compares_placements_and_says_what_does_not_fit() -> None:
    views = views_of(ROOM)
    rows = {row.name: row.score for row in compare_placements(views, best_placement(views, 2))}
    assert best_arrangement(views_of(NARROW), (0.0, 90.0)) is None
    assert {"proposal", "parallel", "45°", "90°", "best 1 sensor", "best 3 sensors", "tilt 0°"} <= set(rows)
    proposal = rows["proposal"]
    assert proposal is not None
    for name in ("parallel", "90°"):
        score = rows[name]
        assert score is None or score.cost_cm > proposal.cost_cm
