"""When a calibration is done, what it finds, and everything that makes it begin again, by name."""

from __future__ import annotations

import numpy as np
import pytest
from support.standing_people import HEAD, LEFT_SHOULDER, RIGHT_HAND, bodies, moved, somebody, without

from mocapella.calibration.stand_still import Calibration, StandStill, StandStillSettings, movement, standing
from mocapella.errors import SettingsError
from mocapella.geometry.rigid import apply
from mocapella.model.bodies import Bodies
from mocapella.model.observations import JointState
from mocapella.model.scene import Phase

ME, YOU = somebody(0), somebody(1)
BOTH = ("front", "side")


def calibration(frames: int = 3, sensors_expected: int = 1, **settings: object) -> StandStill:
    return StandStill(StandStillSettings(frames=frames, **settings), sensors_expected)  # type: ignore[arg-type]


def feed(method: StandStill, *frames: Bodies, speaking: tuple[str, ...] = ("front",)) -> Calibration:
    return [method.update(frame, speaking) for frame in frames][-1]


def phase(result: Calibration) -> tuple[Phase, int, str]:
    return result.state.phase, result.state.frames_remaining, result.state.reason


def test_it_counts_down_and_then_tracks() -> None:
    method, front = calibration(), bodies("front", [ME])
    assert phase(feed(method, front)) == (Phase.CALIBRATING, 2, "")
    assert phase(feed(method, front)) == (Phase.CALIBRATING, 1, "")
    done = feed(method, front)
    assert phase(done) == (Phase.TRACKING, 0, "")
    assert done.number == 1
    np.testing.assert_allclose(apply(done.T_world_sensor["front", 1], front.positions[0]), ME, atol=1e-6)


def test_it_waits_until_enough_sensors_speak() -> None:
    method, front = calibration(sensors_expected=3), bodies("front", [ME])
    assert feed(method, *[front] * 9, speaking=BOTH).state.sensors_missing == 1
    assert feed(method, front, speaking=BOTH).state.phase is Phase.WAITING_FOR_SENSORS
    assert phase(feed(method, front, speaking=(*BOTH, "third"))) == (Phase.CALIBRATING, 2, "")


def test_the_slowest_sensor_that_sees_somebody_counts() -> None:
    method, front, side = calibration(), bodies("front", [ME]), bodies("side", [ME])
    assert feed(method, side, *[front] * 9, speaking=BOTH).state.frames_remaining == 2
    assert feed(method, side, side, speaking=BOTH).state.phase is Phase.TRACKING

    method = calibration()
    nobody = bodies("side", [])
    assert feed(method, nobody, front, front, speaking=BOTH).state.frames_remaining == 1
    assert set(feed(method, front, speaking=BOTH).T_world_sensor) == {("front", 1)}


def test_only_the_latest_frames_count() -> None:
    far, near = bodies("front", [ME + np.array([0.09, 0, 0])]), bodies("front", [ME])
    side = bodies("side", [ME])
    done = feed(calibration(frames=2), side, far, near, near, side, speaking=BOTH)
    assert done.state.phase is Phase.TRACKING
    np.testing.assert_allclose(apply(done.T_world_sensor["front", 1], near.positions[0]), ME, atol=1e-6)


@pytest.mark.parametrize(
    ("now", "reason"),
    [
        (bodies("front", [moved(ME, RIGHT_HAND, 0.14), YOU]), "front: right hand of body 1 moved 14 cm"),
        (bodies("front", [ME, moved(YOU, HEAD, -0.3)]), "front: head of body 2 moved 30 cm"),
        (bodies("front", [ME, YOU], states=without(RIGHT_HAND, 2)), "front: right hand of body 2 went missing"),
        (bodies("front", [ME, YOU, YOU]), "front: a new person arrived"),
        (bodies("front", [ME, YOU], ids=[1, 3]), "front: a new person arrived"),
        (bodies("front", [ME]), "front: body 2 is gone"),
    ],
)
def test_it_begins_again_and_says_why(now: Bodies, reason: str) -> None:
    method, front = calibration(), bodies("front", [ME, YOU])
    side = bodies("side", [ME])
    assert feed(method, front, front, side, speaking=BOTH).state.frames_remaining == 2
    again = feed(method, now, speaking=BOTH)
    # The frame that was different is the first of the new ones, and the other sensor begins again too.
    assert phase(again) == (Phase.CALIBRATING, 3, reason)
    assert phase(feed(method, side, side, speaking=BOTH)) == (Phase.CALIBRATING, 2, reason)
    assert phase(feed(method, now, now, speaking=BOTH)) == (Phase.CALIBRATING, 1, reason)
    assert phase(feed(method, side, speaking=BOTH)) == (Phase.TRACKING, 0, "")
    assert method.restarts == 1


def test_ten_centimetres_is_still_and_a_joint_that_is_not_head_or_hand_may_move() -> None:
    method = calibration(frames=9)
    knee = bodies("front", [ME]).topology.index("KneeLeft")
    frames = [bodies("front", [moved(ME, RIGHT_HAND, by)]) for by in (0.0, 0.0999, 0.0)]
    assert feed(method, *frames, bodies("front", [moved(ME, knee, 1.0)])).state.frames_remaining == 5
    assert method.restarts == 0


def test_slow_motion_passes_the_thesis_algorithm_and_not_its_program() -> None:
    slowly = [bodies("front", [moved(ME, RIGHT_HAND, 0.04 * i)]) for i in range(4)]
    assert feed(calibration(4, compare_with="previous"), *slowly).state.phase is Phase.TRACKING
    reason = "front: right hand of body 1 moved 12 cm"
    assert phase(feed(calibration(4, compare_with="first"), *slowly)) == (Phase.CALIBRATING, 3, reason)


def test_a_hand_that_the_sensor_never_sees_does_not_stop_it_and_may_come_back() -> None:
    hidden, seen = bodies("front", [ME], states=without(RIGHT_HAND)), bodies("front", [ME])
    assert feed(calibration(), hidden, hidden, hidden).state.phase is Phase.TRACKING
    assert feed(calibration(), hidden, seen, seen).state.phase is Phase.TRACKING


def test_when_everybody_is_gone_it_needs_them_back() -> None:
    method, front, nobody = calibration(), bodies("front", [ME]), bodies("front", [])
    assert phase(feed(method, nobody)) == (Phase.CALIBRATING, 3, "no person is in view yet")
    feed(method, front, front)
    assert phase(feed(method, nobody)) == (Phase.NEEDS_RECALIBRATION, 3, "all people have left")
    assert phase(feed(method, nobody)) == (Phase.NEEDS_RECALIBRATION, 3, "all people have left")
    assert phase(feed(method, front)) == (Phase.CALIBRATING, 2, "front: a new person arrived")
    assert phase(feed(method, front, front)) == (Phase.TRACKING, 0, "")
    assert phase(feed(method, nobody)) == (Phase.NEEDS_RECALIBRATION, 3, "all people have left")


def test_while_tracking_only_somebody_new_or_nobody_at_all_makes_it_begin_again() -> None:
    front, side = bodies("front", [ME, YOU]), bodies("side", [ME])
    method = calibration(frames=2)
    done = feed(method, side, front, side, front, speaking=BOTH)
    calibrated = done.number
    for harmless in (
        bodies("front", [moved(ME, RIGHT_HAND, 1.0), YOU]),
        bodies("front", [ME], states=without(HEAD)),
        bodies("front", []),
        bodies("side", [ME]),
    ):
        assert feed(method, harmless, speaking=BOTH).number == calibrated
        assert method.update(harmless, BOTH).state.phase is Phase.TRACKING
    feed(method, bodies("front", []), speaking=BOTH)
    assert feed(method, bodies("side", []), speaking=BOTH).state.phase is Phase.NEEDS_RECALIBRATION


def test_somebody_new_while_tracking_is_named_with_the_sensor() -> None:
    method = calibration()
    feed(method, *[bodies("front", [ME])] * 3)
    again = feed(method, bodies("front", [ME, YOU]))
    assert phase(again) == (Phase.CALIBRATING, 2, "front: a new person arrived")
    assert again.T_world_sensor == {}


def test_a_sensor_that_joins_is_taken_in_as_soon_as_it_sees_somebody() -> None:
    method = calibration()
    feed(method, *[bodies("front", [ME])] * 3)
    assert feed(method, bodies("side", []), speaking=BOTH).state.phase is Phase.TRACKING
    joined = feed(method, bodies("side", [ME]), speaking=BOTH)
    assert phase(joined) == (Phase.CALIBRATING, 3, "side: a new sensor sees a person")


def test_a_silent_sensor_is_left_out_and_the_state_says_so() -> None:
    method, front, side = calibration(), bodies("front", [ME]), bodies("side", [ME])
    feed(method, front, side, speaking=BOTH)
    assert feed(method, front, speaking=BOTH).state.frames_remaining == 2
    assert feed(method, front).state.phase is Phase.TRACKING  # the side's one frame does not hold it back

    method = calibration()
    feed(method, front, side, front, side, front, side, speaking=BOTH)
    assert phase(feed(method, front)) == (Phase.TRACKING, 0, "side: silent")
    back = feed(method, side, speaking=BOTH)
    assert phase(back) == (Phase.TRACKING, 0, "")
    assert back.number == 1


def test_a_guessed_hand_may_jump() -> None:
    guessed = without(RIGHT_HAND)
    guessed[0, RIGHT_HAND] = JointState.INFERRED
    here, there = (bodies("front", [moved(ME, RIGHT_HAND, by)], states=guessed) for by in (0.0, 0.5))
    assert feed(calibration(), here, there, bodies("front", [ME])).state.phase is Phase.TRACKING


def test_a_body_whose_shoulders_are_never_seen_is_left_out_and_the_state_says_so() -> None:
    method, seen = calibration(), bodies("side", [ME])
    hidden = bodies("front", [ME, YOU], states=without(LEFT_SHOULDER, 2))
    done = feed(method, hidden, seen, hidden, seen, hidden, seen, speaking=BOTH)
    assert phase(done) == (Phase.TRACKING, 0, "front: the shoulders of body 2 were never seen")
    assert set(done.T_world_sensor) == {("front", 1), ("side", 1)}
    assert feed(method, bodies("front", [ME, YOU]), speaking=BOTH).number == 1
    assert method.restarts == 0
    quiet = feed(method, seen, speaking=("side",))
    assert quiet.state.reason == "front: the shoulders of body 2 were never seen; front: silent"


def test_where_nobodys_shoulders_are_ever_seen_it_begins_again() -> None:
    hidden = bodies("front", [ME], states=without(LEFT_SHOULDER))
    result = feed(calibration(), hidden, hidden, hidden)
    assert phase(result) == (Phase.CALIBRATING, 3, "front: the shoulders of body 1 were never seen")


def test_a_new_tracking_id_of_a_known_body_can_be_said() -> None:
    method = calibration()
    done = feed(method, *[bodies("front", [ME, YOU])] * 3)
    renamed = bodies("front", [ME, YOU], ids=[1, 7])
    assert method.unknown(renamed)
    method.rename("front", {2: 7, 5: 8})
    assert not method.unknown(renamed)
    again = feed(method, renamed)
    assert again.number == 1
    np.testing.assert_array_equal(again.T_world_sensor["front", 7], done.T_world_sensor["front", 2])
    assert set(again.T_world_sensor) == {("front", 1), ("front", 7)}
    assert method.unknown(bodies("front", [ME, YOU]))


def test_asked_to_it_begins_again_with_the_reason_given() -> None:
    method, front = calibration(), bodies("front", [ME])
    feed(method, front, front, front)
    method.restart("somebody pressed the button")
    assert phase(feed(method, front)) == (Phase.CALIBRATING, 2, "somebody pressed the button")
    method.reset()
    assert phase(feed(method, front)) == (Phase.CALIBRATING, 2, "")
    assert (method.restarts, method.completed) == (0, 0)


def test_the_angle_is_the_circular_mean_or_that_of_the_latest_frame_with_shoulders() -> None:
    facing = [bodies("front", [ME @ _turn(angle).T]) for angle in (0.1, 0.3, 0.5)]
    mean = standing(facing, "mean")[1][0]
    assert mean == pytest.approx(-0.3, abs=1e-6)
    assert standing(facing, "latest")[1][0] == pytest.approx(-0.5, abs=1e-6)
    hidden = bodies("front", [ME], states=without(LEFT_SHOULDER))
    assert standing([*facing, hidden], "latest")[1][0] == pytest.approx(-0.5, abs=1e-6)
    assert standing([*facing, hidden], "mean")[1][0] == pytest.approx(mean, abs=1e-9)
    backs = [bodies("front", [ME @ _turn(np.pi + angle).T]) for angle in (0.1, -0.1)]
    assert abs(standing(backs, "mean")[1][0]) == pytest.approx(np.pi, abs=1e-6)


@pytest.mark.parametrize(
    "wrong",
    [{"frames": 0}, {"still_within_m": -0.1}, {"compare_with": "next"}, {"angle_from": "median"}, {"centre_of": "all"}],
)
def test_settings_out_of_range_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(SettingsError, match=next(iter(wrong))):
        StandStillSettings(**wrong)  # type: ignore[arg-type]


def _turn(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])


def test_a_part_may_move_by_just_as_much_as_still_is() -> None:
    before = bodies("front", [ME])
    now = bodies("front", [ME])
    hand = now.topology.parts["hand_left"]
    for array, x in ((before, 0.0), (now, 0.125)):
        array.positions[0, hand] = [x, 1.0, 2.0]
    assert movement(before, now, 0.125) == ""
    assert movement(before, now, 0.1249) == "front: left hand of body 1 moved 12 cm"


def test_no_distance_at_all_is_refused_as_still() -> None:
    with pytest.raises(SettingsError, match="still_within_m"):
        StandStillSettings(still_within_m=0.0)
