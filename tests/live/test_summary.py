"""Laws of the latency histogram."""

from __future__ import annotations

import json

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.messages import arms_scene, small_scene

from mocapella.live.summary import MOST_CONDITIONS, LatencyHistogram, RunSummary
from mocapella.model.scene import Phase, Scene, SensorPlace, TrackerState
from mocapella.model.session import PersonCondition


@given(st.lists(st.floats(2e-6, 50.0), min_size=1, max_size=300), st.sampled_from([50.0, 90.0, 99.0, 100.0]))
def test_a_percentile_is_never_flattered_and_hardly_too_large(latencies: list[float], percent: float) -> None:
    histogram = LatencyHistogram()
    for latency in latencies:
        histogram.add(latency)
    exact = float(np.percentile(latencies, percent, method="inverted_cdf"))
    found = histogram.percentile(percent)
    assert found is not None
    assert exact <= found * (1 + 1e-12)
    assert found <= exact * 1.012


def test_the_largest_is_exact_and_what_is_out_of_range_counts_too() -> None:
    histogram = LatencyHistogram()
    assert histogram.percentile(50) is None
    for latency in (-1e-5, 0.0123, 1e4):
        histogram.add(latency)
    assert histogram.most == 1e4
    assert histogram.percentile(10) == pytest.approx(1e-6)
    assert histogram.percentile(50) == pytest.approx(0.0123, rel=0.012)


def test_a_run_whose_clocks_are_unknown_has_no_latency() -> None:
    assert RunSummary().latency_ms() is None


@given(
    st.sampled_from([Phase.WAITING_FOR_SENSORS, Phase.CALIBRATING, Phase.NEEDS_RECALIBRATION]),
    st.integers(1, 9),
    st.text(min_size=1),
)
def test_a_run_that_never_tracked_names_what_was_missing_and_the_reason(phase: Phase, count: int, reason: str) -> None:
    summary = RunSummary()
    summary.state(0.0, phase.value, "")
    last = TrackerState(phase, sensors_missing=count, frames_remaining=count, frames_wanted=120, reason=reason)
    why = summary.never_tracked(last)
    assert why is not None
    assert f"{count} of " in why
    assert why.endswith(f"; {reason}")
    summary.state(1.0, Phase.TRACKING.value, "")
    assert summary.never_tracked(last) is None


def test_a_run_that_was_not_started_says_so() -> None:
    assert RunSummary().never_tracked(TrackerState(Phase.STOPPED)) == "tracking was not started"


def scene_with(reason: str, places: tuple[SensorPlace, ...] = ()) -> Scene:
    return msgspec.structs.replace(small_scene(0), state=TrackerState(Phase.TRACKING, reason=reason), sensors=places)


def test_every_condition_is_told_of_with_its_times_also_when_another_holds_as_well() -> None:
    summary = RunSummary(began_ns=10**9)
    for second, reason in enumerate(["", "left: moved", "left: moved; asked for", "", "left: moved"]):
        summary.scene(scene_with(reason), None, (second + 1) * 10**9)
    row = summary.as_json(TrackerState(Phase.TRACKING, reason="left: moved"))
    assert row["conditions"] == [
        {"condition": "left: moved", "first_s": 1.0, "last_s": 4.0, "results": 3},
        {"condition": "asked for", "first_s": 2.0, "last_s": 2.0, "results": 1},
    ]
    assert row["conditions_left_out"] == 0
    assert (row["phase"], row["reason"]) == ("tracking", "left: moved")


def test_a_persons_condition_is_told_of_with_the_persons_number() -> None:
    summary = RunSummary(began_ns=0)
    knee = "left knee: sensors and body model disagree by 50°"
    state = TrackerState(Phase.TRACKING, reason="left: moved")
    scene = msgspec.structs.replace(small_scene(2), state=state, sensors=())
    people = tuple(msgspec.structs.replace(one, condition=knee if k else "") for k, one in enumerate(scene.people))
    summary.scene(scene.with_parts(people=people), None, 10**9)
    bent = [PersonCondition(one.id, knee) for one in people[1:]]
    assert summary.people_conditions == tuple(bent)
    summary.scene(scene, None, 2 * 10**9)
    assert summary.people_conditions == ()
    said = {one["condition"]: one["results"] for one in summary.as_json(TrackerState(Phase.TRACKING))["conditions"]}
    assert said == {"left: moved": 2} | {f"person {one.person}: {knee}": 1 for one in bent}


def test_of_many_conditions_the_newest_are_kept_and_the_others_counted() -> None:
    summary = RunSummary()
    for k in range(MOST_CONDITIONS + 7):
        summary.scene(scene_with(f"a hand moved {k} cm"), None, k)
    row = summary.as_json(TrackerState(Phase.CALIBRATING))
    assert [said["condition"] for said in row["conditions"]] == [
        f"a hand moved {k + 7} cm" for k in range(MOST_CONDITIONS)
    ]
    assert row["conditions_left_out"] == 7


def test_where_the_sensors_are_is_told_of_and_null_where_it_is_not_known() -> None:
    places = (
        SensorPlace("front", np.eye(4), 0.012, np.radians(0.4), "12 mm, 0.4°"),
        SensorPlace("left", None, problem="with front: walk"),
        SensorPlace("right", None, problem="with front: walk"),
    )
    summary = RunSummary()
    summary.scene(scene_with("", places), None, 0)
    last = TrackerState(Phase.CALIBRATING, reason="left: with front: walk; right: with front: walk")
    row = summary.as_json(last)
    assert row["sensor_places"][0] == {
        "sensor": "front",
        "T_world_sensor": np.eye(4)[:3].tolist(),
        "position_sd_mm": 12.0,
        "rotation_sd_deg": 0.4,
        "quality": "12 mm, 0.4°",
        "problem": "",
    }
    unknown = row["sensor_places"][1]
    assert [unknown[name] for name in ("T_world_sensor", "position_sd_mm", "rotation_sd_deg")] == [None] * 3
    assert row["never_tracked"] == "calibration never succeeded; left, right: walk"
    json.dumps(row, allow_nan=False)


def scene_of(sensor: str, mirrored: list[bool]) -> Scene:
    """Made by a frame of that sensor, with these of its views of people mirrored; those of the others always are."""
    scene = small_scene(len(mirrored))
    people = tuple(
        msgspec.structs.replace(
            person,
            views=tuple(
                msgspec.structs.replace(view, mirrored=swapped if view.sensor == sensor else True)
                for view in person.views
            ),
        )
        for person, swapped in zip(scene.people, mirrored, strict=True)
    )
    return msgspec.structs.replace(scene.with_parts(people=people), sensor=sensor)


def test_repaired_labels_are_counted_by_sensor_each_view_once_and_each_time_that_it_begins() -> None:
    summary = RunSummary()
    for mirrored in ([False, True], [True, True], [True], [False, False], [True, False]):
        summary.scene(scene_of("front", mirrored), None, 0)
    summary.scene(scene_of("left", [False]), None, 0)
    assert summary.as_json(TrackerState(Phase.TRACKING))["labels_repaired"] == [
        {"sensor": "front", "views": 9, "swapped": 5, "repairs": 3},
        {"sensor": "left", "views": 1, "swapped": 0, "repairs": 0},
    ]
    json.dumps(summary.as_json(TrackerState(Phase.TRACKING)))


def test_arms_are_measured_over_the_time_between_their_captures() -> None:
    summary, arms = RunSummary(), arms_scene()
    for k in range(4):
        scene = msgspec.structs.replace(arms, at_ns=arms.at_ns + k * 50_000_000)
        summary.scene(scene, None, k)  # whenever it was complete
    quality = summary.as_json(TrackerState(Phase.TRACKING))["arm_quality"]
    assert quality["seen_s"] == pytest.approx(len(arms.arms) * 0.15)
