"""Study logs as sensors: every row accounted for, each sensor on its own clock, the second where it nominally stood."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.study_examples import FRAME_TICKS, FRONT, NOON_MS, SIDE, Rows, real_logs_of

from mocapella.errors import InputError, SettingsError
from mocapella.geometry import rigid
from mocapella.model.observations import BodyFrame
from mocapella.model.session import PLACEMENTS
from mocapella.model.study_log import YEAR_1_TO_1970_MS, StudyLog
from mocapella.sources.study_replay import MAX_STEP_BACK, StudyReplay
from mocapella.sources.study_sensors import PARALLEL_DISTANCE, STUDY_SENSORS, TURNING_DISTANCE

_PAGE = Path(__file__).parents[2] / "docs" / "study-log.md"


@pytest.fixture(scope="module")
def real_logs(study_logs: Path) -> list[StudyLog]:
    return list(real_logs_of(study_logs).values())


def frames(replay: StudyReplay, sensor: str) -> list[BodyFrame]:
    return [frame for _, frame in replay.frames(sensor)]


def at_front(rows: Rows) -> Any:
    """Indices of the front sensor's rows."""
    return np.flatnonzero(rows["kinect_id"] == FRONT)


# Names, times and bodies


def test_a_study_log_is_two_sensors_and_the_reference_is_the_first() -> None:
    assert StudyReplay(Rows().log()).sensors == ("front", "side")
    swapped = Rows()
    swapped["skeleton_id"] = 1 - swapped["skeleton_id"]
    assert StudyReplay(swapped.log()).sensors == ("side", "front")


@pytest.mark.parametrize(
    ("kinect", "name"),
    [
        ("10.0.0.7", "10.0.0.7"),
        ("0", "kinect-0"),
        ("usb:3/left", "usb-3-left"),
        ("-9999", "kinect-9999"),
        ("#", "kinect-"),
    ],
)
def test_other_kinects_are_named_by_their_ids(kinect: str, name: str) -> None:
    rows = Rows()
    rows["kinect_id"] = np.where(rows["kinect_id"] == SIDE, kinect, FRONT)
    assert StudyReplay(rows.log()).sensors == ("front", name)


def test_names_can_be_given() -> None:
    assert StudyReplay(Rows().log(), sensors={"82": "left", SIDE: "right"}).sensors == ("left", "right")


def test_a_frame_says_what_the_row_says() -> None:
    rows = Rows()
    rows["tilt_deg"] = np.full(8, -10.0)
    frame = frames(StudyReplay(rows.log()), "front")[2]
    assert (frame.sensor, frame.sequence, frame.time_ns) == ("front", 2, (2 * FRAME_TICKS + 700) * 100)
    assert frame.tilt == pytest.approx(np.radians(-10))
    assert frame.height == pytest.approx(1.0)
    assert frame.tracking_ids.tolist() == [0]
    assert frame.tracked.tolist() == [True]
    assert (frame.states == 2).all()
    np.testing.assert_array_equal(frame.positions, rows["positions"][4:5])
    kinds = {name: getattr(frame, name).dtype for name in ("tracking_ids", "tracked", "states", "positions")}
    assert kinds == {"tracking_ids": np.uint64, "tracked": np.bool_, "states": np.uint8, "positions": np.float32}


def test_tilt_and_height_that_are_not_available_are_0() -> None:
    rows = Rows()
    rows["tilt_deg"] = rows["height_cm"] = np.full(8, np.nan)
    frame = frames(StudyReplay(rows.log()), "side")[0]
    assert (frame.tilt, frame.height) == (0.0, 0.0)


def test_missing_joints_are_not_tracked_and_counted() -> None:
    rows = Rows()
    rows["positions"][0, [3, 5]] = np.nan
    rows["positions"][2] = np.nan
    replay = StudyReplay(rows.log())
    first, second = frames(replay, "front")[:2]
    assert np.flatnonzero(first.states[0] == 0).tolist() == [3, 5]
    assert np.isnan(first.positions[0, [3, 5]]).all()
    assert first.tracked.all()
    assert not second.tracked.any()
    assert replay.report.joints_not_tracked == 27


def test_people_of_one_instant_are_one_frame() -> None:
    rows = Rows().take([0, 0, 1, 2, 3, 2])
    rows["person_id"] = [1, 0, 0, 0, 1, 1]
    first, second = frames(StudyReplay(rows.log()), "front")
    assert first.tracking_ids.tolist() == [0, 1]
    assert second.tracking_ids.tolist() == [0, 1]
    assert StudyReplay(rows.log()).report.duplicates_dropped == 0


def test_one_sensor_alone_needs_no_placement() -> None:
    rows = Rows().take([0, 2, 4])
    rows["kinect_config"] = np.full(3, -9999)
    replay = StudyReplay(rows.log())
    assert (replay.sensors, replay.placement) == (("front",), "")
    np.testing.assert_array_equal(replay.T_reference_second, np.eye(4))


def test_repeated_rows_are_dropped_and_counted_the_first_stays() -> None:
    rows = Rows().take([0, 1, 0, 3, 2, 3, 4])
    rows["positions"][2] += 1
    replay = StudyReplay(rows.log())
    assert (replay.report.rows, replay.report.frames, replay.report.duplicates_dropped) == (7, 5, 2)
    np.testing.assert_array_equal(frames(replay, "front")[0].positions, rows["positions"][:1])


def test_rows_that_come_late_are_sorted_and_counted() -> None:
    rows = Rows(frames=6).take([0, 1, 4, 2, 6, 8, 3])
    replay = StudyReplay(rows.log())
    assert replay.report.sorted == 1
    times = [frame.time_ns for frame in frames(replay, "front")]
    assert times == sorted(times)
    assert [frame.sequence for frame in frames(replay, "front")] == [0, 1, 2, 3, 4]


@given(order=st.permutations(range(16)))
@settings(deadline=None)
def test_the_order_of_the_rows_changes_no_frame(order: list[int]) -> None:
    straight, mixed = StudyReplay(Rows(frames=8).log()), StudyReplay(Rows(frames=8).take(order).log())
    for sensor in ("front", "side"):
        for (due, a), (other_due, b) in zip(straight.frames(sensor), mixed.frames(sensor), strict=True):
            assert (due, a.time_ns, a.sequence) == (other_due, b.time_ns, b.sequence)
            np.testing.assert_array_equal(a.positions, b.positions)


def test_times_come_to_one_clock_by_the_least_delay() -> None:
    rows = Rows(frames=4)
    front = at_front(rows)
    rows["tracker_time_ms"] = np.full(8, NOON_MS)
    # Captured every 100 ms, written 40, 15, 130 and 90 ms later: the least delay stands for none.
    rows["skeleton_time_ticks"][front] = [0, 1_000_000, 2_000_000, 3_000_000]
    rows["tracker_time_ms"][front] = NOON_MS + np.array([40, 115, 330, 390])
    arrivals = [arrival for arrival in StudyReplay(rows.log()).arrivals() if arrival.frame.sensor == "front"]
    noon_ns = (NOON_MS - YEAR_1_TO_1970_MS) * 1_000_000
    assert [(arrival.at_ns - noon_ns) // 1_000_000 for arrival in arrivals] == [15, 115, 215, 315]


def test_arrivals_of_the_same_instant_begin_with_the_reference() -> None:
    rows = Rows()
    rows["tracker_time_ms"] -= np.arange(8) % 2
    at = [(arrival.at_ns, arrival.frame.sensor) for arrival in StudyReplay(rows.log()).arrivals()]
    assert [sensor for _, sensor in at] == ["front", "side"] * 4
    assert all(a == b for (a, _), (b, _) in zip(at[::2], at[1::2], strict=True))


def test_frames_are_due_as_they_arrive_from_the_files_first_on() -> None:
    replay = StudyReplay(Rows(frames=5).log())
    due = sorted(due for sensor in replay.sensors for due, _ in replay.frames(sensor))
    arrivals = [arrival.at_ns for arrival in replay.arrivals()]
    assert due[0] == 0.0
    np.testing.assert_allclose(due, [(at - arrivals[0]) / 1e9 for at in arrivals], atol=1e-9)
    assert replay.duration_s == pytest.approx(due[-1])


# Where the second sensor is


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize("turn", [-0.7, 0.7, np.nan])
def test_the_second_sensors_rows_come_back_by_the_inverse(placement: str, turn: float) -> None:
    rows = Rows()
    rows["kinect_config"] = np.full(8, PLACEMENTS[placement])
    rows["init_angle"] = np.where(rows["skeleton_id"] == 1, turn, 0.0)
    replay = StudyReplay(rows.log())
    for i, frame in enumerate(frames(replay, "side")):
        logged = rows["positions"][2 * i + 1]
        np.testing.assert_allclose(rigid.apply(replay.T_reference_second, frame.positions[0]), logged, atol=1e-6)
        assert np.abs(frame.positions[0] - logged).max() > 0.3


@pytest.mark.parametrize(
    ("placement", "degrees"), [("right-45", 45), ("right-90", 90), ("left-45", 45), ("left-90", 90)]
)
@pytest.mark.parametrize("turn", [-0.7, 0.7])
def test_the_second_is_turned_about_where_people_stand(placement: str, degrees: float, turn: float) -> None:
    rows = Rows()
    rows["kinect_config"] = np.full(8, PLACEMENTS[placement])
    rows["init_angle"] = np.where(rows["skeleton_id"] == 1, turn, 0.0)
    T = StudyReplay(rows.log()).T_reference_second
    place = np.array([[0.0, -1.0, 2.4], [0.0, 1.0, 2.4]])
    np.testing.assert_allclose(rigid.apply(T, place), place, atol=1e-12)
    assert np.linalg.norm(T[:3, 3] - [0, 0, 2.4]) == pytest.approx(2.4)
    yaw = np.degrees(np.arctan2(T[0, 2], T[0, 0]))
    assert yaw == pytest.approx(np.copysign(degrees, turn))  # to the side that the logged angles say


@pytest.mark.parametrize(("placement", "side"), [("right-45", 1), ("right-90", 1), ("left-45", -1), ("left-90", -1)])
def test_without_logged_angles_right_is_the_persons_right(placement: str, side: int) -> None:
    rows = Rows()
    rows["kinect_config"] = np.full(8, PLACEMENTS[placement])
    rows["init_angle"] = np.full(8, np.nan)
    T = StudyReplay(rows.log()).T_reference_second
    assert np.sign(T[0, 3]) == side  # who faces a Kinect has its +x at the right hand


def test_parallel_sensors_stand_beside_each_other() -> None:
    rows = Rows()
    rows["kinect_config"] = np.zeros(8, dtype=int)
    T = StudyReplay(rows.log()).T_reference_second
    np.testing.assert_array_equal(T[:3, :3], np.eye(3))
    np.testing.assert_array_equal(T[:3, 3], [0.5, 0, 0])


def test_the_documentation_has_the_nominal_motions_and_the_limit() -> None:
    page = _PAGE.read_text(encoding="utf-8")
    assert f"{PARALLEL_DISTANCE} m aside" in page
    assert f"about the vertical axis {TURNING_DISTANCE} m in front" in page
    assert f"up to {MAX_STEP_BACK} s late" in page
    for end, name in STUDY_SENSORS.items():
        assert f"`{end}` is `{name}`" in page


# The real files


@pytest.mark.slow
def test_all_real_files_replay_and_every_row_is_accounted_for(real_logs: list[StudyLog]) -> None:
    rows = dropped = moved = 0
    for log in real_logs:
        replay = StudyReplay(log)
        keys = set(zip(log.kinect_id.tolist(), log.person_id.tolist(), log.skeleton_time_ticks.tolist(), strict=True))
        assert replay.report.rows - replay.report.duplicates_dropped == len(keys)
        assert replay.report.frames == len({(kinect, ticks) for kinect, _, ticks in keys})
        assert set(replay.sensors) == {"front", "side"}
        assert replay.placement == {0: "parallel", 1: "right-45", 2: "right-90"}[int(log.kinect_config[0])]
        rows += replay.report.rows
        dropped += replay.report.duplicates_dropped
        moved += replay.report.sorted
    assert len(real_logs) == 38
    assert 0.06 < dropped / rows < 0.07  # as the data's README says of them
    assert 0.005 < moved / rows < 0.0065


@pytest.mark.slow
def test_the_side_sensor_stands_on_the_same_side_whichever_is_the_reference(real_logs: list[StudyLog]) -> None:
    seen = set()
    for log in real_logs:
        replay = StudyReplay(log)
        T_front_side = replay.T_reference_second
        if replay.sensors[0] == "side":
            T_front_side = rigid.inverse(T_front_side)
        if replay.placement != "parallel":
            seen.add(replay.sensors[0])
            assert T_front_side[0, 3] > 1
    assert seen == {"front", "side"}


@pytest.mark.slow
def test_a_real_file_s_frames(real_logs: list[StudyLog]) -> None:
    for log in real_logs[::5]:
        replay = StudyReplay(log)
        arrivals = list(replay.arrivals())
        assert len(arrivals) == replay.report.frames
        at = [arrival.at_ns for arrival in arrivals]
        assert at == sorted(at)
        logged = {
            (kinect, person, ticks * 100): positions
            for kinect, person, ticks, positions in zip(
                log.kinect_id.tolist(), log.person_id, log.skeleton_time_ticks, log.positions, strict=True
            )
        }
        for name, kinect in (("front", FRONT), ("side", SIDE)):
            T = np.eye(4) if name == replay.sensors[0] else replay.T_reference_second
            own = [arrival.frame for arrival in arrivals if arrival.frame.sensor == name]
            times = np.array([frame.time_ns for frame in own])
            assert (np.diff(times) > 0).all()
            for frame in own[::50]:
                for body, person in enumerate(frame.tracking_ids.tolist()):
                    wanted = logged[kinect, person, frame.time_ns]
                    np.testing.assert_allclose(rigid.apply(T, frame.positions[body]), wanted, atol=2e-6)


@pytest.mark.slow
def test_no_frame_arrives_after_its_row_was_written(real_logs: list[StudyLog]) -> None:
    log = next(log for log in real_logs if "Study_7_Kinect_2_Time_3_11" in log.source)
    for sensor, kinect in (("front", FRONT), ("side", SIDE)):
        mine = log.kinect_id == kinect
        written = {}
        for ticks, ms in zip(log.skeleton_time_ticks[mine].tolist(), log.tracker_time_ms[mine].tolist(), strict=True):
            written.setdefault(ticks * 100, (ms - YEAR_1_TO_1970_MS) * 1_000_000)
        delays = [
            written[arrival.frame.time_ns] - arrival.at_ns
            for arrival in StudyReplay(log).arrivals()
            if arrival.frame.sensor == sensor
        ]
        assert min(delays) == 0
        assert max(delays) < 1_000_000_000


def test_the_same_file_gives_the_same_arrivals(real_logs: list[StudyLog]) -> None:
    for a, b in zip(StudyReplay(real_logs[-1]).arrivals(), StudyReplay(real_logs[-1]).arrivals(), strict=True):
        assert (a.at_ns, a.frame.key) == (b.at_ns, b.frame.key)
        assert a.frame.positions.tobytes() == b.frame.positions.tobytes()


# What cannot be replayed

CASES: list[tuple[str, Callable[[Rows], Rows], str]] = [
    (
        "back",
        lambda rows: rows.set("skeleton_time_ticks", 4, -5_000_000),
        "row 6: field Skeleton_Time: -5000000: time goes",
    ),
    (
        "ahead",
        lambda rows: rows.set("skeleton_time_ticks", 4, 10**12),
        "row 6: field Skeleton_Time: 1000000000000: is more",
    ),
    ("ticks", lambda rows: rows.set("skeleton_time_ticks", 2, 2**62), "row 4: field Skeleton_Time: 46"),
    ("least", lambda rows: rows.set("skeleton_time_ticks", 2, -(2**63)), "row 4: field Skeleton_Time: -9"),
    ("zero date", lambda rows: rows.set("tracker_time_ms", 3, -(2**63)), "row 5: field Tracker_Time: -9"),
    ("date", lambda rows: rows.set("tracker_time_ms", 3, 12), "row 5: field Tracker_Time: 12: is no date"),
    ("person", lambda rows: rows.set("person_id", 5, -9999), "row 7: field Person_Id: -9999: is no person"),
    ("config", lambda rows: rows.set("kinect_config", 1, 9), "row 3: field Kinect_Config: 9: is no placement"),
    ("third", lambda rows: rows.set("kinect_id", 6, "10.0.0.3"), "row 8: field Kinect_Id: '10.0.0.3': is a third"),
    ("mixed", lambda rows: rows.set("skeleton_id", 3, 0), "row 5: field Skeleton_Id: 0: sensor front is the"),
    ("lost", lambda rows: rows.set("skeleton_id", 2, 1), "row 4: field Skeleton_Id: 1: sensor front is the"),
]


@pytest.mark.parametrize(("change", "message"), [case[1:] for case in CASES], ids=[case[0] for case in CASES])
def test_a_row_that_cannot_be_replayed_is_named(change: Callable[[Rows], Rows], message: str) -> None:
    with pytest.raises(InputError) as caught:
        StudyReplay(change(Rows()).log("walk.csv"))
    assert str(caught.value).startswith("walk.csv: " + message)
    assert "; " in str(caught.value)


def test_steps_back_up_to_the_limit_are_sorted() -> None:
    rows = Rows().set("skeleton_time_ticks", 4, FRAME_TICKS + 700 - 5_000_000)
    assert StudyReplay(rows.log()).report.sorted == 1
    with pytest.raises(InputError, match=r"goes back by more than 0\.5 s"):
        StudyReplay(Rows().set("skeleton_time_ticks", 4, FRAME_TICKS + 700 - 5_000_001).log())


def test_a_file_of_a_day_is_replayed_and_a_longer_one_is_not() -> None:
    rows = Rows()
    first, *_, last = at_front(rows).tolist()
    end = int(rows["skeleton_time_ticks"][first]) + 864_000_000_000
    assert StudyReplay(Rows().set("skeleton_time_ticks", last, end).log()).sensors == ("front", "side")
    with pytest.raises(InputError, match="more than a day after"):
        StudyReplay(Rows().set("skeleton_time_ticks", last, end + 1).log())


@pytest.mark.parametrize(
    ("name", "centre", "by", "says"),
    [
        ("skeleton_time_ticks", 0, 2**62 // 100, "is no time of a sensor"),
        ("tracker_time_ms", YEAR_1_TO_1970_MS, 2**62 // 10**6, "is no date of our time"),
    ],
)
@pytest.mark.parametrize("side", [-1, 1])
def test_times_up_to_a_limit_before_and_after_are_replayed_and_none_beyond(
    name: str, centre: int, by: int, says: str, side: int
) -> None:
    rows = Rows().take([0])
    for beyond in (0, 1):
        rows[name] = [centre + side * (by + beyond)]
        if beyond:
            with pytest.raises(InputError, match=says):
                StudyReplay(rows.log())
        else:
            assert StudyReplay(rows.log()).report.frames == 1


def test_a_file_without_a_reference() -> None:
    rows = Rows()
    rows["skeleton_id"] = np.ones(8, dtype=int)
    with pytest.raises(InputError, match="field Skeleton_Id: no row is the reference sensor's own"):
        StudyReplay(rows.log())


def test_an_unknown_sensor() -> None:
    replay = StudyReplay(Rows().log("walk.csv"))
    with pytest.raises(
        SettingsError, match=r"walk\.csv has no sensor 'fornt'; it has front, side \(did you mean front\?\)"
    ):
        replay.frames("fornt")


def test_names_that_do_not_work() -> None:
    with pytest.raises(SettingsError, match="two Kinects would be the sensor 'front'"):
        StudyReplay(Rows().log(), sensors={"82": "front", "136": "front"})
    with pytest.raises(SettingsError, match="cannot be used"):
        StudyReplay(Rows().log(), sensors={"82": "the front one"})


# Placements


def test_a_placement_that_the_file_has() -> None:
    assert StudyReplay(Rows().log(), placement="right-90").placement == "right-90"


def test_a_placement_that_the_file_does_not_have() -> None:
    with pytest.raises(InputError, match=r"walk.csv: field Kinect_Config: 'parallel': .*; it has right-90"):
        StudyReplay(Rows().log(), placement="parallel")
    with pytest.raises(SettingsError, match="did you mean right-45"):
        StudyReplay(Rows().log(), placement="right45")


def test_a_file_with_several_placements_has_to_be_told_which() -> None:
    rows = Rows()
    rows["kinect_config"] = [2, 2, 2, 2, 0, 0, -9999, -9999]
    with pytest.raises(InputError, match="several placements; choose one with placement: not said, parallel, right-90"):
        StudyReplay(rows.log())
    assert StudyReplay(rows.log(), placement="right-90").report.rows == 4
    assert StudyReplay(rows.log(), placement="parallel").report.frames == 2


def test_a_file_that_does_not_say_its_placement_believes_the_one_given() -> None:
    rows = Rows()
    rows["kinect_config"] = np.full(8, -9999)
    with pytest.raises(InputError, match="does not say how its two sensors stood; give the placement: parallel"):
        StudyReplay(rows.log())
    assert StudyReplay(rows.log(), placement="left-45").placement == "left-45"
