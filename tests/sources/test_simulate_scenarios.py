"""What people do: every scenario begins still, comes round to its beginning, and walks plausibly on the way."""

from __future__ import annotations

import dataclasses
import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.sources.simulate import (
    PersonSettings,
    Room,
    SceneSettings,
    SensorSettings,
    build_room,
    load_scene,
    scene_names,
)
from mocapella.sources.simulate.body import BODY, JOINT, facing
from mocapella.sources.simulate.motion import PERIOD_NS
from mocapella.sources.simulate.postures import POSTURES, STANDING, posture
from mocapella.sources.simulate.route import Route, Spot
from mocapella.sources.simulate.scenarios import FACING_MAIN, STILL_S, plan, scenario_names, written_route

FEET = [JOINT["AnkleLeft"], JOINT["AnkleRight"]]
SECOND = 1_000_000_000
STEP_NS = 10_000_000


@cache
def room(name: str) -> Room:
    return load_scene(name, seed=3)


@cache
def path(name: str) -> np.ndarray:
    """(instants, people, 25, 3) every 10 ms over a whole period."""
    r = room(name)
    return np.stack([r.positions_at(at) for at in range(0, r.duration_ns, STEP_NS)])


@pytest.mark.parametrize("name", scene_names())
@settings(max_examples=15)
@given(st.integers(0, 2**62))
def test_time_wraps_around_to_the_bit(name: str, at: int) -> None:
    r = room(name)
    np.testing.assert_array_equal(r.positions_at(at), r.positions_at(at + r.duration_ns))


@pytest.mark.parametrize("name", scene_names())
def test_nobody_jumps_also_not_where_time_wraps_around(name: str) -> None:
    moving = np.concatenate([path(name), path(name)[:1]])
    speed = np.linalg.norm(np.diff(moving, axis=0), axis=-1) / (STEP_NS / SECOND)
    assert speed.max() < 5.0
    assert speed[-1].max() < 0.1


@pytest.mark.parametrize("name", scene_names())
def test_bones_keep_their_length_and_nobody_sinks_into_the_floor(name: str) -> None:
    p = path(name)
    for parent, child in BODY.bones:
        bone = np.linalg.norm(p[..., child, :] - p[..., parent, :], axis=-1)
        np.testing.assert_allclose(bone, np.broadcast_to(bone[0], bone.shape), atol=1e-9)
    assert p[..., 1].min() > 0
    assert p[..., 1].max() < 2


@pytest.mark.parametrize("name", scene_names())
def test_everybody_stands_still_at_first_and_faces_the_main_sensor(name: str) -> None:
    still = path(name)[: round(6.0 / 0.01)]
    moved = still.max(axis=0) - still.min(axis=0)
    assert np.linalg.norm(moved, axis=-1).max() < 0.03
    assert moved.max() > 0.001, "they breathe"
    np.testing.assert_allclose(facing(still)[..., 2], -1, atol=1e-6)


@pytest.mark.parametrize("name", scene_names())
def test_the_foot_that_stands_does_not_slide(name: str) -> None:
    ankles = path(name)[:, :, FEET]
    speed = np.linalg.norm(np.diff(ankles, axis=0), axis=-1) / (STEP_NS / SECOND)
    assert speed.min(axis=-1).max() < 0.03
    assert np.median(speed.min(axis=-1)) < 0.003


def test_knees_bend_and_arms_swing_with_the_opposite_leg() -> None:
    p, r = path("walk")[:, 0], room("walk")
    going = slice(round((STILL_S + 0.7) / 0.01), round((STILL_S + 3.0) / 0.01))
    assert r.duration_s > STILL_S + 3.0
    ahead = facing(p[going])

    def lead(right: str, left: str) -> np.ndarray:
        return np.einsum("ni,ni->n", p[going, JOINT[right]] - p[going, JOINT[left]], ahead)

    assert np.corrcoef(lead("AnkleRight", "AnkleLeft"), lead("HandRight", "HandLeft"))[0, 1] < -0.9
    bend = knee_deg(p)
    assert bend.min() < 15
    assert 40 < bend.max() < 90


def knee_deg(p: np.ndarray) -> np.ndarray:
    thigh, shank = p[:, JOINT["KneeLeft"]] - p[:, JOINT["HipLeft"]], p[:, JOINT["AnkleLeft"]] - p[:, JOINT["KneeLeft"]]
    cos = np.einsum("ni,ni->n", thigh, shank) / np.linalg.norm(thigh, axis=1) / np.linalg.norm(shank, axis=1)
    return np.degrees(np.arccos(cos))


def test_postures_are_what_they_promise() -> None:
    exercise = slice(round((STILL_S + 1.5) / 0.01), round((STILL_S + 11.0) / 0.01))
    squats, sits, waves, bends = (path(name)[exercise, 0] for name in ("squats", "sit", "wave", "bend"))
    bend = knee_deg(squats)
    assert bend.min() < 15
    assert bend.max() > 95
    assert (np.diff((bend > 60).astype(int)) == 1).sum() >= 3, "again and again"
    thigh = sits[:, JOINT["KneeLeft"]] - sits[:, JOINT["HipLeft"]]
    assert np.abs(thigh[:, 1]).max() < 0.05
    assert np.abs(knee_deg(sits) - 90).max() < 10
    right, left = waves[:, JOINT["HandRight"]], waves[:, JOINT["HandLeft"]]
    assert (right[:, 1] > waves[:, JOINT["Head"], 1] - 0.15).all()
    assert right[:, 0].max() - right[:, 0].min() > 0.2, "to and fro"
    assert (left[:, 1] < waves[:, JOINT["SpineBase"], 1]).all()
    trunk = bends[:, JOINT["SpineShoulder"]] - bends[:, JOINT["SpineBase"]]
    lean = np.degrees(np.arccos(trunk[:, 1] / np.linalg.norm(trunk, axis=1)))
    assert lean.min() < 5
    assert lean.max() > 50


@pytest.mark.parametrize("name", POSTURES)
def test_no_ankle_bends_more_than_a_human_one(name: str) -> None:
    person = PersonSettings((0.0, 2.8), "route", route=("stand 1", f"{name} 4", "stand 1"))
    r = build_room(SceneSettings(name, (SensorSettings("sensor"),), (person,), seed=0))
    p = np.stack([r.positions_at(at)[0] for at in range(0, r.duration_ns, 10 * STEP_NS)])
    for side in ("Left", "Right"):
        shank, foot = (
            p[:, JOINT[end + side]] - p[:, JOINT[of + side]] for end, of in (("Ankle", "Knee"), ("Foot", "Ankle"))
        )
        cos = np.einsum("ni,ni->n", shank, foot) / np.linalg.norm(shank, axis=1) / np.linalg.norm(foot, axis=1)
        assert np.degrees(np.arccos(cos)).max() < 135, "upwards by 45° at most"


def test_a_route_may_have_postures_and_an_unknown_one_is_refused() -> None:
    route = written_route((0.0, 2.8), ["stand 1", "squat 4.8", "wave 2"])
    assert [leg.posture for leg in route.legs] == [STANDING, posture("squat"), posture("wave")]
    with pytest.raises(SettingsError, match="squat SECONDS"):
        written_route((0.0, 2.8), ["jump 2"])
    with pytest.raises(SettingsError, match=r"did you mean squat\?"):
        posture("squad")


def test_the_square_walk_turns_a_whole_turn_and_visits_the_corners() -> None:
    route = plan("walk", (-0.6, 3.4))
    around_square = next(i for i, leg in enumerate(route.legs) if i > 6 and leg.end == Spot(-0.6, 3.4, leg.end.heading))
    headings = [leg.end.heading for leg in route.legs[: around_square + 2]]
    assert headings[-1] - FACING_MAIN == pytest.approx(-math.tau)
    spine = path("walk")[:, 0, JOINT["SpineBase"]][:, [0, 2]]
    for corner in ((-0.6, 2.2), (0.6, 2.2), (0.6, 3.4), (-0.6, 3.4)):
        assert np.linalg.norm(spine - corner, axis=1).min() < 0.05
    turned = np.unwrap(np.arctan2(facing(path("walk")[:, 0])[:, 0], facing(path("walk")[:, 0])[:, 2]))
    assert turned.max() - turned.min() > math.radians(350)


def test_two_exchange_places() -> None:
    spine = path("exchange")[:, :, JOINT["SpineBase"]][..., [0, 2]]
    swapped = np.linalg.norm(spine[:, ::-1] - spine[0], axis=-1).max(axis=1)
    assert swapped.min() < 0.03
    assert np.linalg.norm(spine[:, 0] - spine[:, 1], axis=-1).min() > 0.9


@pytest.mark.parametrize("name", ["front-back", "around", "exchange", "crowd", "obstacle"])
def test_people_do_not_walk_through_each_other(name: str) -> None:
    spine = path(name)[:, :, JOINT["SpineBase"]][..., [0, 2]]
    apart = np.linalg.norm(spine[:, :, None] - spine[:, None], axis=-1) + 9 * np.eye(spine.shape[1])
    assert apart.min() > 0.5


def test_one_goes_to_the_front_of_the_other_and_back_and_then_the_other() -> None:
    spine = path("front-back")[:, :, JOINT["SpineBase"]]
    before = [
        (spine[:, i, 2] < spine[:, 1 - i, 2] - 0.7) & (np.abs(spine[:, 0, 0] - spine[:, 1, 0]) < 0.05) for i in (0, 1)
    ]
    assert before[0].any()
    assert before[1].any()
    assert np.flatnonzero(before[0]).max() < np.flatnonzero(before[1]).min()


@pytest.mark.parametrize(("name", "person", "centre"), [("around", 0, (0.5, 2.9)), ("obstacle", 1, (0.0, 3.0))])
def test_going_around_is_a_whole_turn_about_the_centre(name: str, person: int, centre: tuple[float, float]) -> None:
    out = path(name)[:, person, JOINT["SpineBase"]][:, [0, 2]] - centre
    angle = np.unwrap(np.arctan2(out[:, 0], out[:, 1]))
    assert angle.max() - angle.min() > math.radians(355)


def test_an_unknown_scenario_and_one_without_its_target_are_refused() -> None:
    with pytest.raises(SettingsError, match=r"did you mean walk\?"):
        plan("wallk", (0, 2))
    with pytest.raises(SettingsError, match="exchange needs a target: where the other stands"):
        plan("exchange", (0, 2))


@given(st.sampled_from(scenario_names()), st.floats(-1, 1), st.floats(1.5, 4))
@settings(max_examples=30)
def test_every_route_ends_where_it_began(name: str, x: float, z: float) -> None:
    route = plan(name, (x, z), (x + 1.1, z + 0.3))
    assert math.dist((route.spot.x, route.spot.z), (x, z)) < 1e-9
    assert math.remainder(route.spot.heading - FACING_MAIN, math.tau) == pytest.approx(0, abs=1e-9)
    for before, after in zip(route.legs, route.legs[1:], strict=False):
        assert dataclasses.astuple(before.end) == pytest.approx(dataclasses.astuple(after.start), abs=1e-9)
    for leg in route.legs:
        poses = leg.seconds * SECOND / PERIOD_NS
        assert poses == pytest.approx(round(poses), abs=1e-6)


def test_a_turn_takes_the_shorter_way() -> None:
    route = Route(Spot(0, 0, math.radians(170)))
    route.turn(math.radians(-170))
    assert route.spot.heading == pytest.approx(math.radians(190))


def moves(words: tuple[str, ...], **how: bool) -> np.ndarray:
    """(instants, 25, 3) of a person's route, every 20 ms."""
    person = PersonSettings((0.2, 3.0), "route", route=words, **how)
    r = build_room(SceneSettings("route", (SensorSettings("front"),), (person,), seed=4))
    return np.stack([r.positions_at(at)[0] for at in range(0, r.duration_ns, PERIOD_NS)])


def test_who_is_pushed_on_a_wheelchair_sits_and_is_moved_as_a_whole() -> None:
    p = moves(("seat 1", "roll 0.2 1.5", "seat 1", "roll 0.2 3.0"))
    hip, knee, ankle = (p[:, JOINT[f"{name}Left"]] for name in ("Hip", "Knee", "Ankle"))
    assert np.abs(hip[:, 1] - knee[:, 1]).max() < 0.15
    np.testing.assert_allclose(np.diff(ankle, axis=0)[..., 1], 0, atol=1e-9)
    assert np.ptp(ankle[:, 2]) == pytest.approx(1.5, abs=0.02)
    within = p - p[:, JOINT["SpineBase"], None]
    legs = [JOINT[f"{name}{side}"] for name in ("Knee", "Ankle") for side in ("Left", "Right")]
    assert np.ptp(within[:, legs], axis=0).max() < 0.05
    assert np.linalg.norm(np.diff(p, axis=0), axis=-1).max() < 0.05, "nobody jumps"


def test_a_mannequin_does_not_move_at_all_and_a_person_who_stands_does() -> None:
    assert np.ptp(moves(("stand 3",), lifeless=True), axis=0).max() < 1e-12
    assert np.ptp(moves(("stand 3",)), axis=0).max() > 0.001
