"""Looks at a board, one after the other: what is of one instant, what is kept, and what comes out."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.filmed_boards import BOARD, SIZE, film, to_first

from mocapella.calibration.board_run import LATELY, BoardLook, BoardRun, BoardRunSettings, _moved, _speed
from mocapella.calibration.rig_report import HEADINGS, sentences, table, tape_measure
from mocapella.errors import CalibrationError, SettingsError
from mocapella.model.board import BoardView

CORNERS = np.array([[300.0 + 40 * (k % 5), 200.0 + 40 * (k // 5)] for k in range(20)])


def view(camera: str, shift_px: float = 0.0) -> BoardView:
    return BoardView(camera, 0, SIZE, np.arange(20), CORNERS + np.array([shift_px, 0.0]))


def looks(at_s: float, shift_px: float = 0.0, **later_s: float) -> dict[str, BoardLook]:
    """All cameras see the board, each a little later."""
    return {name: BoardLook(at_s + later, view(name, shift_px)) for name, later in later_s.items()}


@settings(deadline=None)
@given(
    speed=st.floats(0.0, 2000.0),
    later=st.lists(st.floats(-0.2, 0.2), min_size=2, max_size=4),
    tolerance=st.floats(0.0, 0.2),
    most=st.floats(0.1, 20.0),
)
def test_views_are_of_one_instant_where_little_time_and_little_motion_is_between_them(
    speed: float, later: list[float], tolerance: float, most: float
) -> None:
    """Law: within an instant no two pictures are farther apart than is allowed; each view has one, of its look."""
    names = {f"c{k}": wait for k, wait in enumerate(later)}
    run = BoardRun(BOARD, list(names), settings=BoardRunSettings(tolerance, most, 0.0))
    run.add(looks(1.0, **names))
    run.add(looks(1.5, 0.5 * speed, **names))
    of = run.instants
    assert len(run.views) == len(of)
    last = max(frame for _, frame in of)
    groups: dict[int, list[float]] = {}
    for (name, frame), instant in of.items():
        assert instant // len(names) == frame
        if frame == last:
            groups.setdefault(instant, []).append(1.5 + names[name])
    widest = max(np.ptp(times) for times in groups.values())
    assert widest <= tolerance + 1e-9
    assert widest * speed <= most * (1 + 1e-6) or last == 0
    starts = sorted(min(times) for times in groups.values())
    allowed = min(tolerance, most / speed if speed else np.inf)
    assert all(b - a > allowed - 1e-9 for a, b in pairwise(starts)) or last == 0


def test_a_board_that_holds_still_is_of_one_instant_however_the_cameras_are_triggered_and_counts_once() -> None:
    run = BoardRun(BOARD, ["a", "b"])
    for k in range(5):
        run.add(looks(float(k), 0.0, a=0.0, b=0.09))
    assert len(run.views) == 2
    assert len(set(run.instants.values())) == 1
    report = run.report
    assert (report.looks, report.kept, report.still, report.split) == (5, 1, 4, 0)
    assert "90.0 ms apart (median)" in report.words()
    assert "the board moved 0.0 px meanwhile" in report.words()


@pytest.mark.parametrize(("least_px", "moved_px", "kept"), [(0, 0, 2), (10, 10, 2), (10, 9.999, 1), (10, -9.999, 1)])
def test_a_round_counts_if_the_board_has_moved_as_much_as_is_asked(least_px: int, moved_px: float, kept: int) -> None:
    run = BoardRun(BOARD, ["a", "b"], settings=BoardRunSettings(least_moved=least_px / SIZE[0]))
    for k in range(2):
        run.add(looks(float(k), moved_px * k, a=0.0, b=0.0))
    assert run.report.kept == kept


def test_a_board_that_never_holds_still_serves_the_lenses_only_and_that_is_said() -> None:
    run = BoardRun(BOARD, ["a", "b"])
    for k in range(LATELY + 1):
        run.add(looks(0.5 * k, 60.0 * (k % 2), a=0.0, b=0.03))
    assert len(run.views) == 2 * (LATELY + 1)
    assert len(set(run.instants.values())) == 2 * (LATELY + 1)
    assert run.hints()[0].text.startswith("hold the board still")
    assert run.report.words() == ""
    run.add(looks(9.0, 60.0, a=0.0, b=0.0))
    assert run.hints()[0].cause != "moving"
    assert "rounds that were not simultaneous: 5" in run.report.words()


@settings(deadline=None, max_examples=20)
@given(st.permutations(["c0", "c1"]), st.floats(-1e4, 1e4))
def test_neither_the_order_of_cameras_nor_the_clocks_origin_matters(names: list[str], origin_s: float) -> None:
    def collected(order: list[str], begin_s: float) -> dict[Any, Any]:
        run = BoardRun(BOARD, order)
        for k in range(6):
            seen = looks(begin_s + 0.5 * k, 0.3 * k * k, c0=0.0, c1=0.01)
            run.add({name: seen[name] for name in order})
        return run.instants

    assert collected(names, origin_s) == collected(["c0", "c1"], 0.0)


@pytest.mark.slow
def test_a_filmed_board_becomes_a_rig_within_its_standard_deviation() -> None:
    filmed = film(cameras=3, instants=16, noise_px=0.2, seed=4)
    run = BoardRun(BOARD, ["c0", "c1", "c2"])
    for k in range(16):
        run.add({v.camera: BoardLook(0.5 * k, v) for v in filmed.views if v.frame == k})
    found = run.calibrate()
    T = to_first([found.rig.cameras[name].T_camera_world for name in ("c0", "c1", "c2")])
    for k, name in enumerate(("c0", "c1", "c2")):
        off_mm = 1e3 * np.linalg.norm(np.linalg.inv(T[k])[:3, 3] - np.linalg.inv(filmed.T_camera_first[k])[:3, 3])
        assert off_mm < 4 * found.cameras[name].position_sd_mm + 1e-6
    rows = table(found)
    assert [row[0] for row in rows] == ["c0", "c1", "c2"]
    assert all(len(row) == len(HEADINGS) for row in rows)
    assert "triangulated one by one" in sentences(found)[0]
    true_m = np.linalg.norm(np.linalg.inv(filmed.T_camera_first[1])[:3, 3])
    assert float(tape_measure(found).split("c0 – c1 ")[1].split(" m")[0]) == pytest.approx(true_m, abs=0.01)


def test_cameras_that_give_nothing_are_counted_and_named() -> None:
    run = BoardRun(BOARD, ["a", "b"])
    with pytest.raises(CalibrationError, match="no camera has seen the board: check its kind"):
        run.calibrate()
    run.add({"a": BoardLook(0.0, None, "camera a: there is one of 9 × 6 squares")})
    assert run.report.unanswered == {"a": 0, "b": 1}
    with pytest.raises(CalibrationError, match="there is one of 9 × 6 squares"):
        run.calibrate()
    run.add({"a": BoardLook(1.0, view("a")), "b": BoardLook(problem="camera b does not answer")})
    with pytest.raises(CalibrationError, match="camera b has not seen the board: camera b does not answer"):
        run.calibrate()
    assert (run.report.unseen, run.report.kept) == (1, 1)
    with pytest.raises(CalibrationError, match="camera q is not calibrated here: a, b"):
        run.add({"q": BoardLook()})
    run.add({"b": BoardLook(2.0, view("b"))})
    with pytest.raises(CalibrationError, match="sees the board in 1 pictures"):
        run.calibrate()


def test_a_single_camera_has_no_distance_to_measure() -> None:
    filmed = film(cameras=1, instants=8, noise_px=0.1)
    run = BoardRun(BOARD, ["c0"])
    for v in filmed.views:
        run.add({"c0": BoardLook(float(v.frame), v)})
    assert tape_measure(run.calibrate()) == ""


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"tolerance_s": -1.0}, "tolerance_s"),
        ({"most_moved_px": 0.0}, "most_moved_px"),
        ({"least_moved": 1.0}, "least"),
    ],
)
def test_settings_that_cannot_be_are_refused(wrong: dict[str, float], field: str) -> None:
    with pytest.raises(SettingsError, match=field):
        BoardRunSettings(**wrong)


def test_a_run_of_no_camera_is_refused() -> None:
    with pytest.raises(SettingsError, match="one or more"):
        BoardRun(BOARD, [])


def test_what_one_camera_sees_alone_is_neither_simultaneous_nor_too_fast() -> None:
    run = BoardRun(BOARD, ["a", "b"])
    for k in range(3 * LATELY):
        run.add(looks(float(k), 100.0 * k, a=0.0))
    assert (run.report.kept, run.report.split, run.report.apart_s, run.shared) == (3 * LATELY, 0, [], 0)
    assert "moving" not in {hint.cause for hint in run.hints()}


def test_rounds_with_views_of_one_instant_are_shared_and_tell_the_time_between_them() -> None:
    run = BoardRun(BOARD, ["a", "b"], settings=BoardRunSettings(tolerance_s=0.0625, most_moved_px=1000.0))
    for k, later in enumerate((0.0, 0.0625, 0.03125, 0.0626)):
        run.add(looks(float(k), 100.0 * k, a=0.0, b=later))
    assert (run.shared, run.report.split) == (3, 1)
    assert run.report.apart_s == pytest.approx([0.0, 0.0625, 0.03125])


def test_of_two_simultaneous_rounds_of_a_board_that_holds_still_the_first_is_kept() -> None:
    """How fast it is, and so what is simultaneous, is known from the second round on."""
    run = BoardRun(BOARD, ["a", "b"])
    for k, shift_px in enumerate((0.0, 1.0, 2.0)):
        run.add(looks(float(k), shift_px, a=0.0, b=0.01))
    assert {v.corners_px[0, 0] for v in run.views} == {CORNERS[0, 0] + 1.0}


def test_a_motion_is_of_common_corners_in_pictures_of_one_size_and_a_speed_of_time_that_passed() -> None:
    old, new = view("a"), view("a", 3.0)
    assert _moved(old, new) == pytest.approx(3.0)
    assert _moved(msgspec.structs.replace(old, ids=old.ids[:9], corners_px=CORNERS[:9]), new) == pytest.approx(3.0)
    assert _moved(msgspec.structs.replace(old, ids=old.ids + 50), new) == np.inf
    assert _moved(msgspec.structs.replace(old, size_px=(640, 480)), new) == np.inf
    for later_s, speed in ((0.5, 6.0), (0.0, np.inf), (-1.0, np.inf)):
        assert _speed(BoardLook(1.0, old), BoardLook(1.0 + later_s, new)) == pytest.approx(speed)
    assert _speed(BoardLook(1.0, old), BoardLook(1.0, old)) == 0.0
    assert _speed(BoardLook(1.0), BoardLook(2.0, new)) == np.inf


def test_a_board_that_moves_too_fast_is_told_of_though_one_camera_alone_sees_it_at_times() -> None:
    run = BoardRun(BOARD, ["a", "b"])
    for k in range(2 * LATELY + 2):
        run.add(looks(float(k), 500.0 * (k % 2), **({"a": 0.0, "b": 0.09} if k % 2 else {"a": 0.0})))
        told = "moving" in {hint.cause for hint in run.hints()}
        assert told == ((k + 1) // 2 >= LATELY)
