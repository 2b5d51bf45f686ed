"""Results as study logs: in the reference view's camera space, with θ and C of each view, every n-th, or nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support import study_examples as examples

from mocapella.calibration.centre_and_angle import world_from_sensor
from mocapella.errors import RecordingError, SettingsError, TakeExistsError
from mocapella.geometry import rigid
from mocapella.model.scene import Person, Phase, PotentialSkeleton, Scene, SensorPlace, TrackedArm, TrackerState
from mocapella.model.session import Setup
from mocapella.model.study_log import YEAR_1_TO_1970_MS
from mocapella.model.topology import Topology, topology
from mocapella.recording.study_export import ExportReport, export_study_log, rows_of, stand_still_of
from mocapella.recording.study_log import read_study_log
from mocapella.sources.study_replay import StudyReplay
from mocapella.tracker import make_tracker

KINECT_V2 = topology("kinect_v2")
SETUP = Setup(participant=7, placement="right-90", scenario="walk")

angles = st.floats(-3.1, 3.1)
metres = st.floats(-5.0, 5.0)
motions = st.builds(lambda angle, *C: world_from_sensor(C, angle), angles, metres, metres, metres)


def view(sensor: str, camera: Any, T_world_sensor: Any, **fields: Any) -> PotentialSkeleton:
    """What that sensor saw, ``camera`` being the joints in its own camera space."""
    states = np.where(np.isfinite(camera[:, 0]), 2, 0).astype(np.uint8)
    values = {"tracking_id": 1, "time_ns": 12_345_678_900, "tilt": 0.0, "height": 1.0} | fields
    positions = rigid.apply(T_world_sensor, camera)
    return PotentialSkeleton(sensor=sensor, T_world_sensor=T_world_sensor, positions=positions, states=states, **values)


def scene(*people: tuple[PotentialSkeleton, ...], phase: Phase = Phase.TRACKING, of: Topology = KINECT_V2) -> Scene:
    persons = tuple(Person(i, views[0].positions, views[0].states, views) for i, views in enumerate(people))
    return Scene(0, 0, "a", 1, 0, of, TrackerState(phase), {"people": persons})


def joints(seed: int = 0, count: int = 25) -> Any:
    return np.random.default_rng(seed).normal(size=(count, 3)) * 0.4 + [0, 0, 2.5]


def two_views(T_world_a: Any = None, T_world_b: Any = None) -> Scene:
    T_world_a = world_from_sensor([0.1, -0.2, 2.4], 0.3) if T_world_a is None else T_world_a
    T_world_b = world_from_sensor([0.0, -0.1, 2.6], -1.2) if T_world_b is None else T_world_b
    return scene((view("a", joints(1), T_world_a), view("b", joints(2), T_world_b)))


def rows(of: Scene, reference: str | None = None, **options: Any) -> Any:
    return rows_of(of, setup=SETUP, reference=reference, tracker_time_ms=5, **options)


# What stands in a row


@given(T_world_a=motions, T_world_b=motions)
@settings(deadline=None)
def test_the_reference_view_is_in_its_own_camera_space_and_the_others_come_to_it(
    T_world_a: Any, T_world_b: Any
) -> None:
    own, other = rows(two_views(T_world_a, T_world_b), "b")
    np.testing.assert_allclose(own.positions, joints(2), atol=1e-5)
    expected = rigid.apply(rigid.inverse(T_world_b) @ T_world_a, joints(1))
    np.testing.assert_allclose(other.positions, expected, atol=1e-5)
    assert [own.kinect_id, other.kinect_id] == ["b", "a"]
    assert [own.skeleton_id, other.skeleton_id] == [0, 1]


def test_all_rows_are_in_the_reference_sensors_space_also_of_people_whom_it_does_not_see() -> None:
    T_world_c = world_from_sensor([0.4, 0.0, 2.0], 0.7)
    seen = msgspec.structs.replace(two_views(), sensors=(SensorPlace("a", None), SensorPlace("c", T_world_c)))
    of_a, of_b = rows(seen, "c", fixed=True)
    expected = rigid.apply(rigid.inverse(T_world_c), seen.people[0].views[0].positions)
    np.testing.assert_allclose(of_a.positions, expected, atol=1e-5)
    assert [of_a.skeleton_id, of_b.skeleton_id] == [1, 2]
    for reference in ("a", "unknown"):  # the person is seen by it, or its pose is unknown
        assert [row.skeleton_id for row in rows(seen, reference, fixed=True)] == [0, 1]


@given(angle=angles, centre=st.tuples(metres, metres, metres))
def test_angle_and_distance_are_those_that_made_the_motion(angle: float, centre: Any) -> None:
    found, distance = stand_still_of(world_from_sensor(centre, angle))
    assert found == pytest.approx(angle, abs=1e-9)
    assert distance == pytest.approx(centre[2], abs=1e-9)


def test_the_equations_by_hand() -> None:
    # θ = 90°, C = (1, 0, 2): x' = z − 2, z' = −(x − 1); the camera's (0, 0, 3) is the world's (1, 0, 1), and back.
    T = np.array([[0, 0, 1, -2], [0, 1, 0, 0], [-1, 0, 0, 1], [0, 0, 0, 1]], dtype=float)
    assert stand_still_of(T) == pytest.approx((np.pi / 2, 2.0))
    seen = scene((view("a", np.tile([0.0, 0.0, 3.0], (25, 1)), T),))
    np.testing.assert_allclose(seen.people[0].positions[0], [1, 0, 1])
    np.testing.assert_allclose(rows(seen)[0].positions[0], [0, 0, 3])


def test_the_fields_of_a_row() -> None:
    seen = view("a", joints(), np.eye(4), tilt=np.radians(-5.0), height=0.57, time_ns=603_051_043_408_99)
    (row,) = rows(scene((seen,)), kinect_ids={"a": "138.251.213.82"})
    assert (row.study_id, row.kinect_config, row.scenario_id) == (7, 2, 3)
    assert (row.tracker_time_ms, row.person_id, row.skeleton_time_ticks) == (5, 0, 603_051_043_408)
    assert (row.kinect_id, row.tilt_deg, row.height_cm) == ("138.251.213.82", -5.0, 57.0)


def test_what_is_not_known_is_not_available() -> None:
    seen = scene((view("a", joints(), np.eye(4), height=0.0),))
    (row,) = rows_of(seen, setup=Setup(), reference=None, tracker_time_ms=0)
    assert (row.study_id, row.kinect_config, row.scenario_id) == (-9999, -9999, -9999)
    assert np.isnan(row.height_cm)


def test_who_the_reference_sensor_does_not_see_has_the_first_view_as_the_reference() -> None:
    both, one = two_views().people[0].views, (view("b", joints(3), world_from_sensor([0, 0, 2], 1.0)),)
    found = rows(scene(both, one), "a")
    assert [(row.person_id, row.skeleton_id, row.kinect_id) for row in found] == [(0, 0, "a"), (0, 1, "b"), (1, 0, "b")]
    np.testing.assert_allclose(found[2].positions, joints(3), atol=1e-6)


def test_missing_joints_stay_missing_and_only_they() -> None:
    camera = joints()
    camera[[3, 7]] = np.nan
    (row,) = rows(scene((view("a", camera, world_from_sensor([0, 0, 2], 0.5)),)))
    assert np.flatnonzero(np.isnan(row.positions).all(axis=-1)).tolist() == [3, 7]
    assert np.isnan(row.positions).sum() == 6


def test_another_sensors_joints_go_by_their_names() -> None:
    v1 = topology("kinect_v1")
    (row,) = rows(scene((view("a", joints(count=20), np.eye(4)),), of=v1))
    np.testing.assert_allclose(row.positions[KINECT_V2.index("FootRight")], joints(count=20)[v1.index("FootRight")])
    missing = [joint for joint, point in zip(KINECT_V2.joints, row.positions, strict=True) if np.isnan(point).all()]
    assert missing == [joint for joint in KINECT_V2.joints if joint not in v1.joints]
    assert "Neck" in missing


# A file of them


def export(path: Path, scenes: list[Scene], **options: Any) -> ExportReport:
    timed = ((SETUP, one, 1000 + i) for i, one in enumerate(scenes))
    return export_study_log(timed, path, **options)


@pytest.mark.parametrize("name", ["log.csv", "log.csv.gz"])
def test_what_is_exported_is_read_with_the_same_points(tmp_path: Path, name: str) -> None:
    report = export(tmp_path / name, [two_views()] * 3, reference="b")
    assert report == ExportReport(results=3, written=3, rows=6, without_reference=0, mirrored=0)
    log = read_study_log(tmp_path / name)
    for i, row in enumerate(rows(two_views(), "b") * 3):
        np.testing.assert_array_equal(log.positions[i], row.positions)
        assert (log.init_angle[i], log.init_dist[i]) == (row.init_angle, row.init_dist)
    assert log.tracker_time_ms.tolist() == [1000, 1000, 1001, 1001, 1002, 1002]


def test_only_every_nth_result_is_written_and_what_is_no_result_does_not_count(tmp_path: Path) -> None:
    calibrating = scene(two_views().people[0].views, phase=Phase.CALIBRATING)
    nobody = scene()
    scenes = [calibrating, *[two_views(), nobody] * 5]
    report = export(tmp_path / "log.csv", scenes, every=2)
    assert report == ExportReport(results=5, written=3, rows=6, without_reference=0, mirrored=0, not_tracking=1)
    assert read_study_log(tmp_path / "log.csv").tracker_time_ms[::2].tolist() == [1001, 1005, 1009]


def test_people_without_the_reference_are_counted(tmp_path: Path) -> None:
    alone = scene((view("b", joints(), np.eye(4)),))
    assert export(tmp_path / "log.csv", [two_views(), alone], reference="a").without_reference == 1


def test_rows_keep_the_sensors_labels_and_those_that_were_swapped_are_counted(tmp_path: Path) -> None:
    one, other = two_views().people[0].views
    swapped = scene((one, msgspec.structs.replace(other, mirrored=True)))
    assert export(tmp_path / "log.csv", [two_views(), swapped, swapped]).mirrored == 2
    as_they_are = read_study_log(tmp_path / "log.csv").positions
    np.testing.assert_array_equal(as_they_are[:2], as_they_are[2:4])


def test_what_cannot_be_exported_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no scene is a result"):
        export(tmp_path / "log.csv", [scene(two_views().people[0].views, phase=Phase.CALIBRATING), scene()])
    nowhere = np.zeros((23, 3)), np.zeros(23, np.uint8), np.zeros(23, np.float32), np.zeros(21)
    arm = TrackedArm(1, True, *nowhere, None, "open", 0.5, False, -1, ("a",))
    with pytest.raises(RecordingError, match="no scene is a result; mocapella export arms writes the arms"):
        export(tmp_path / "log.csv", [scene(), scene().with_parts(arms=(arm,))])
    with pytest.raises(SettingsError, match=r"'front'; there are a, b"):
        export(tmp_path / "log.csv", [two_views()], reference="front")
    with pytest.raises(SettingsError, match="every is 0"):
        export(tmp_path / "log.csv", [two_views()], every=0)
    assert list(tmp_path.iterdir()) == []


def test_an_export_never_overwrites(tmp_path: Path) -> None:
    export(tmp_path / "log.csv", [two_views()])
    before = (tmp_path / "log.csv").read_bytes()
    with pytest.raises(TakeExistsError):
        export(tmp_path / "log.csv", [two_views()] * 2)
    assert (tmp_path / "log.csv").read_bytes() == before


# A real file, tracked and exported


def test_a_real_log_tracked_and_exported_has_the_reference_sensors_own_points(tmp_path: Path, study_logs: Path) -> None:
    log = read_study_log(study_logs / "Study_7_Kinect_2_Time_3_11_06_PM.csv.gz")
    replay = StudyReplay(log)
    tracker = make_tracker("stand-still", sensors_expected=2)
    scenes, own = [], {}
    setup = Setup(participant=7, placement=replay.placement, scenario="stationary")
    for arrival, _ in zip(replay.arrivals(), range(500), strict=False):
        scenes.append((setup, tracker.update(arrival), arrival.at_ns // 1_000_000 + YEAR_1_TO_1970_MS))
        if arrival.frame.sensor == "front":
            own[arrival.frame.time_ns // 100] = arrival.frame.positions[0]
    ids = {"front": examples.FRONT, "side": examples.SIDE}
    report = export_study_log(scenes, tmp_path / "log.csv", reference="front", every=2, kinect_ids=ids)
    back = read_study_log(tmp_path / "log.csv")
    assert report.written == -(-report.results // 2) > 100
    reference = back.skeleton_id == 0
    assert set(back.kinect_id[reference]) == {examples.FRONT}
    for ticks, positions in zip(back.skeleton_time_ticks[reference], back.positions[reference], strict=True):
        np.testing.assert_allclose(positions, own[int(ticks)], atol=2e-6)
    again = StudyReplay(back)  # our own export is a study log like any other
    assert again.sensors == ("front", "side")
    np.testing.assert_allclose(again.T_reference_second, replay.T_reference_second)
