"""Which hypothesis about two sensors' bodies is the likeliest, or agreed, and when it is believed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest

from mocapella.calibration import pair_memory as at
from mocapella.calibration.cold_start import (
    OTHERS,
    POSTURE_S,
    RIVALS_FACTOR,
    SEVERAL_SD,
    SEVERAL_SD_M,
    WHICH_SIDE,
    WHO_IS_WHO,
    ColdStart,
    Hypothesis,
    Likeliest,
)
from mocapella.calibration.pair_calibration import WALK, PairCalibration, PairEstimate, PairSettings
from mocapella.calibration.time_offset import TimeOffset
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y

S = PairSettings()
UNKNOWN = TimeOffset(0.0, 0.1, False)
SURE = PairEstimate(np.eye(4), np.eye(6), SEVERAL_SD_M, SEVERAL_SD, POSTURE_S, 1.0, RIVALS_FACTOR, UNKNOWN, UNKNOWN, "")


def above(value: float) -> float:
    return float(np.nextafter(value, np.inf))


def hypothesis(residual: float, T: np.ndarray | None = None, *, samples: int = 0, data: bool = True) -> PairCalibration:
    pair = PairCalibration(S, np.eye(4) if T is None else T)
    if data:
        pair.moments[0] = 1.0
        pair.scalars[[at.COST, at.COST_WEIGHT, at.STEPS]] = 4.0 * residual, 4.0, 3.0
        pair.scalars[at.BLOCKS_CLOSED] = samples
    return pair


def judged(walked: bool, rival: float = np.inf, labels: float = np.inf, *, wary: bool = False, **changed: float) -> str:
    pair = hypothesis(0.1, samples=S.samples_wanted * walked)
    return Likeliest(pair, rival, labels).judged(msgspec.structs.replace(SURE, **changed), wary=wary).problem


@pytest.mark.parametrize("walked", [False, True])
def test_a_hypothesis_at_all_its_limits_is_believed(walked: bool) -> None:
    assert judged(walked, 1.0, 1.0) == ""
    assert judged(walked, float(np.nextafter(1.0, 0)), 1.0) == WHO_IS_WHO
    assert judged(walked, 1.0, float(np.nextafter(1.0, 0))) == ("" if walked else WHICH_SIDE)
    assert judged(walked, motion_s=float(np.nextafter(POSTURE_S, 0))) == ("" if walked else WALK)
    assert judged(walked, wary=True) == ("" if walked else WALK)
    for changed in ({"position_sd": above(SEVERAL_SD_M)}, {"rotation_sd": above(SEVERAL_SD)}):
        assert judged(walked, **changed) == ""
        assert judged(walked, wary=True, **changed) == WALK


def test_an_estimate_with_a_problem_keeps_it() -> None:
    wrong = msgspec.structs.replace(SURE, problem="another")
    assert Likeliest(hypothesis(0.1), 0.0, 0.0).judged(wrong) is wrong


def likeliest(**of: PairCalibration) -> tuple[str, float, float]:
    """The likeliest of hypotheses by their name, such as ``h12s``: body 1 in a, 2 in b, swapped."""
    names = {(int(name[1]), int(name[2]), name.endswith("s")): name for name in of}
    found = ColdStart(S, {key: of[name] for key, name in names.items()}).likeliest()
    assert found is not None
    return next(name for name, pair in of.items() if pair is found.pair), found.rival, found.labels


def test_the_least_residual_is_the_likeliest_and_whoever_walked_comes_first() -> None:
    assert likeliest(h12=hypothesis(0.05), h34=hypothesis(0.04))[0] == "h34"
    wanted = S.samples_wanted
    assert likeliest(h12=hypothesis(0.05, samples=wanted), h34=hypothesis(0.04, samples=wanted - 1))[0] == "h12"
    assert likeliest(h12=hypothesis(0.05, samples=wanted), h34=hypothesis(0.04, samples=wanted))[0] == "h34"
    assert likeliest(h12=hypothesis(0.05), h34=hypothesis(0.0, data=False))[0] == "h12"


def test_swapped_labels_have_to_fit_by_a_quarter_better() -> None:
    for swapped, name in ((0.041, "h12"), (0.039, "h12s")):
        assert likeliest(h12=hypothesis(0.05), h12s=hypothesis(swapped))[0] == name


def test_rivals_share_one_of_the_two_bodies() -> None:
    best, others = hypothesis(0.01), {"h12s": hypothesis(0.02), "h34": hypothesis(0.03)}
    assert likeliest(h12=best, **others)[1] == np.inf
    assert likeliest(h12=best, h14=hypothesis(0.05), h52=hypothesis(0.04), **others)[1] == pytest.approx(0.04)
    assert likeliest(h12=best, h14=hypothesis(0.05), h52=hypothesis(0.04, data=False))[1] == pytest.approx(0.05)
    assert likeliest(h12=best, h52s=hypothesis(0.07))[1] == pytest.approx(0.07)


@pytest.mark.parametrize(
    ("turn_deg", "labels"), [(0.0, np.inf), (59.0, np.inf), (61.0, 0.02), (-90.0, 0.02), (180.0, 0.02)]
)
def test_swapped_labels_are_another_motion_if_it_is_turned(turn_deg: float, labels: float) -> None:
    T = rigid(rotation_about_y(np.radians(turn_deg)), [1.0, 0.0, 0.0])
    assert likeliest(h12=hypothesis(0.01), h12s=hypothesis(0.02, T))[2] == pytest.approx(labels)
    assert likeliest(h12s=hypothesis(0.01, T), h12=hypothesis(0.02))[2] == pytest.approx(labels)


def test_without_data_there_is_no_likeliest() -> None:
    assert ColdStart(S).likeliest() is None
    assert ColdStart(S, {(1, 2, False): hypothesis(0.0, data=False)}).likeliest() is None


T_A_B = rigid(rotation_about_y(0.7), [1.0, 0.2, -0.5])
AWAY = rigid(np.eye(3), [3.0, 0.0, 0.0])
PLACES = np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 2.4], [-0.8, 0.1, 3.1], [0.3, 0.0, 4.5]])


def seen(count: int, wrong: int = 0) -> tuple[Any, Any]:
    """Tracks of so many bodies in two sensors, of which some are elsewhere in the second."""
    a, b = PLACES[:count], apply(inverse(T_A_B), PLACES[:count])
    b[:wrong] += 9.0
    return tuple(
        SimpleNamespace(bodies=dict(enumerate(centres)), newest_centres=lambda centres=centres: centres)
        for centres in (a, b)
    )  # type: ignore[return-value]


def agreed(
    of: dict[Hypothesis, PairCalibration], tracks: tuple[Any, Any], believed: PairCalibration | None = None
) -> PairCalibration | None:
    return ColdStart(S, dict(of)).agreed(*tracks, believed)


def test_a_pose_is_agreed_on_if_two_bodies_beside_its_own_coincide() -> None:
    right, key = hypothesis(0.05, T_A_B), (0, 0, False)
    assert agreed({key: right}, seen(4)) is right
    assert agreed({key: right}, seen(OTHERS + 1)) is right
    assert agreed({key: right}, seen(OTHERS)) is None
    assert agreed({key: right}, seen(4, wrong=1)) is right
    assert agreed({key: right}, seen(4, wrong=2)) is None
    assert agreed({key: hypothesis(0.05, T_A_B @ AWAY)}, seen(4)) is None
    assert agreed({}, seen(4)) is None


def test_only_a_pose_that_has_data_and_fits_is_agreed_on() -> None:
    key = (0, 0, False)
    assert agreed({key: hypothesis(S.residual_allowed_m, T_A_B)}, seen(4)) is not None
    assert agreed({key: hypothesis(above(S.residual_allowed_m) + 1e-9, T_A_B)}, seen(4)) is None
    no_frames = hypothesis(0.05, T_A_B)
    no_frames.scalars[at.STEPS] = 0.0
    assert agreed({key: no_frames}, seen(4)) is None


def test_a_rival_that_puts_as_many_together_leaves_it_open_and_hypotheses_of_the_same_people_do_not() -> None:
    """Of those that put as many together, the best fit counts."""
    first, right = hypothesis(0.06, T_A_B), hypothesis(0.05, T_A_B)
    assert agreed({(0, 0, False): first, (1, 1, False): right}, seen(4)) is right
    assert agreed({(0, 0, False): right, (1, 1, False): first}, seen(4)) is right
    for rival in ((0, 1, False), (2, 0, True), (0, 0, True)):
        assert agreed({(0, 0, False): right, rival: first}, seen(4)) is None
        assert agreed({(0, 0, False): right, rival: hypothesis(0.01, T_A_B @ AWAY)}, seen(4)) is right


def test_what_is_believed_stays_unless_another_puts_more_together() -> None:
    right, key = hypothesis(0.05, T_A_B), (0, 0, False)
    for T, replaced in ((T_A_B, False), (T_A_B @ AWAY, True)):
        believed = hypothesis(0.05, T)
        assert agreed({key: right}, seen(4), believed) is (right if replaced else believed)
    assert agreed({}, seen(4), right) is right
    assert agreed({key: hypothesis(0.05, T_A_B @ AWAY)}, seen(4), right) is right
