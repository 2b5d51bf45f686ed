"""The parts of a calibration of cameras: what is refused, what counts, and what the report says."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from support.filmed_boards import BOARD, SIZE, film

from mocapella.calibration import cameras
from mocapella.calibration.board_bundle import LensPrior
from mocapella.calibration.board_guidance import GRID
from mocapella.calibration.board_views import OneCamera, one_camera, usable
from mocapella.calibration.cameras import (
    LEAST_FOR_HALVES,
    SURE_FOCAL,
    _check,
    _check_focal,
    _halves,
    _shared_instants,
    _with_own_views,
    calibrate_cameras,
)
from mocapella.errors import CalibrationError
from mocapella.model.board import Board, BoardView
from mocapella.model.camera import Camera

LENS = np.array([600.0, 600.0, 320.0, 240.0, 0, 0, 0, 0, 0])


def view(camera: str, frame: int = 0, size_px: tuple[int, int] = SIZE) -> BoardView:
    return BoardView(camera, frame, size_px, np.arange(20), np.zeros((20, 2)))


def one(covariance: np.ndarray, lens: np.ndarray = LENS) -> OneCamera:
    return OneCamera(lens, [], 0.2, covariance)


def test_a_lens_is_of_one_size_of_picture_that_of_the_given_lens_if_there_is_one() -> None:
    known = {"a": Camera("a", SIZE, LENS)}
    _check([view("a"), view("a", 1)], ["a"], BOARD, {})
    _check([view("a")], ["a"], BOARD, known)
    with pytest.raises(CalibrationError, match="pictures of several sizes: 640×480, 1280×720 px"):
        _check([view("a"), view("a", 1, (640, 480))], ["a"], BOARD, {"b": Camera("b", (8, 8), LENS)})
    with pytest.raises(CalibrationError, match="several sizes and its lens is of: 640×480, 1280×720 px"):
        _check([view("a", 0, (640, 480))], ["a"], BOARD, known)


def test_a_board_that_looks_the_same_when_turned_is_for_one_camera_only() -> None:
    board = Board("chessboard", 6, 6, 0.05)
    _check([view("a")], ["a"], board, {})
    with pytest.raises(CalibrationError, match="looks the same when turned by 180°"):
        _check([view("a"), view("b")], ["a", "b"], board, {})
    _check([view("a"), view("b")], ["a", "b"], BOARD, {})


def test_a_focal_length_as_uncertain_as_the_limit_is_refused_and_told_in_percent() -> None:
    def known_to(part: float) -> OneCamera:
        return one(np.diag([(part * 512.0) ** 2] + [0.0] * 8), LENS * [512 / 600, 1, 1, 1, 1, 1, 1, 1, 1])

    _check_focal("a", known_to(0.999 * SURE_FOCAL))
    _check_focal("a", known_to(0.0))
    for part in (SURE_FOCAL, 0.37, np.nan):
        with pytest.raises(CalibrationError, match=f"uncertain by {100 * part:.0f} %"):
            _check_focal("a", known_to(part))


def test_lenses_that_are_given_need_no_certain_focal_length(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    monkeypatch.setattr(cameras, "_check_focal", lambda name, _: asked.append(name))
    filmed = film(cameras=2, instants=4)
    found = calibrate_cameras(filmed.views, BOARD, known={"c0": Camera("c0", SIZE, filmed.lenses[0])}, measure=False)
    assert asked == ["c1"]
    assert found.cameras["c0"].focal_sd_percent == 0.0 < found.cameras["c1"].focal_sd_percent


@pytest.mark.parametrize("weight", [0.0, 0.25, 3.0])
def test_what_own_views_say_of_a_lens_is_added_as_so_many_of_them_would_be(weight: float) -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(2, 9, 20))
    prior = LensPrior(np.stack([LENS, LENS]), np.stack([x @ x.T, x @ x.T]))
    own, given = one(y @ y.T, LENS + rng.normal(size=9)), one(np.zeros((9, 9)))
    found = _with_own_views(prior, [own, given], weight)
    np.testing.assert_array_equal(found.precision[1], prior.precision[1])
    np.testing.assert_array_equal(found.mean[1], LENS)

    def cost(of: LensPrior, lens: np.ndarray) -> float:
        return float((lens - of.mean[0]) @ of.precision[0] @ (lens - of.mean[0]))

    def added(lens: np.ndarray) -> float:
        by_views = weight * (lens - own.lens) @ np.linalg.solve(own.covariance, lens - own.lens)
        return cost(found, lens) - cost(prior, lens) - float(by_views)

    lenses = LENS + rng.normal(size=(5, 9))
    np.testing.assert_allclose([added(lens) for lens in lenses], added(LENS), rtol=1e-6, atol=1e-6)


def test_a_rig_with_views_that_disagree_adds_own_views_by_what_the_dispersion_takes_away(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of one camera nothing is taken away."""
    told: list[Any] = []
    adjust, own_views = cameras.adjust, cameras._with_own_views

    def adjusted(*given: Any) -> Any:
        found = adjust(*given)
        told.append(found.dispersion)
        return found

    def added(prior: LensPrior, single: Any, weight: float) -> LensPrior:
        told.append(("added", weight))
        return own_views(prior, single, weight)

    monkeypatch.setattr(cameras, "adjust", adjusted)
    monkeypatch.setattr(cameras, "_with_own_views", added)
    filmed, rng = film(instants=4, noise_px=0.1, seed=6), np.random.default_rng(2)
    late = [
        msgspec.structs.replace(v, corners_px=v.corners_px + (v.camera == "c1") * rng.normal(0, 2.0, 2))
        for v in filmed.views
    ]
    calibrate_cameras(late, BOARD, measure=False)
    dispersion, (_, weight), _ = told
    assert dispersion > 2
    assert weight == pytest.approx(dispersion - 1)
    told.clear()
    calibrate_cameras([v for v in late if v.camera == "c1"], BOARD, measure=False)
    assert len(told) == 1


def test_instants_are_shared_by_two_cameras_or_more() -> None:
    instants = {("a", 0): 7, ("a", 1): 3, ("a", 2): 5, ("b", 0): 3, ("b", 1): 5, ("c", 0): 5, ("b", 2): 9}
    assert _shared_instants([view(name, frame) for name, frame in instants], instants) == [3, 5]
    assert _shared_instants([view("a"), view("a", 1)], {("a", 0): 4, ("a", 1): 4}) == []


def test_each_half_of_the_shared_views_is_judged_by_what_all_others_give(monkeypatch: pytest.MonkeyPatch) -> None:
    shared = list(range(LEAST_FOR_HALVES))
    views = [view(name, frame) for frame in shared for name in "ab"] + [view("a", 99)]
    instants = {(v.camera, v.frame): v.frame for v in views}
    used: list[list[int]] = []
    tested: list[list[int]] = []
    names = ["a", "b"]

    def solve(kept: list[BoardView], *_: Any) -> Any:
        used.append([v.frame for v in kept])
        return SimpleNamespace(adjusted=SimpleNamespace(sigma_px=0.1, covariance=np.zeros(1)))

    monkeypatch.setattr(cameras, "_solve", solve)
    monkeypatch.setattr(cameras, "_placed", lambda *_: dict.fromkeys(names))
    monkeypatch.setattr(cameras, "corner_quality", lambda of, *_: tested.append([v.frame for v in of]) or "quality")
    assert _halves(views, BOARD, instants, {}, shared) == ["quality", "quality"]
    for k in (0, 1):
        assert tested[k] == [frame for frame in shared[k::2] for _ in "ab"]
        assert used[k] == [frame for frame in shared[1 - k :: 2] for _ in "ab"] + [99]
    assert _halves(views, BOARD, instants, {}, shared[1:]) is None
    names.append("c")
    assert _halves(views, BOARD, instants, {}, shared) is not None
    del names[1:]
    assert _halves(views, BOARD, instants, {}, shared) is None


def test_a_report_counts_views_and_fields_and_has_its_errors_in_percent_and_millimetres() -> None:
    filmed = film(cameras=2, instants=7, noise_px=0.2)
    few = [
        msgspec.structs.replace(v, frame=50 + k, ids=v.ids[:4], corners_px=v.corners_px[:4])
        for k, v in enumerate(filmed.views[:3])
    ]
    good = [v for v in filmed.views if usable(v, BOARD)]
    found = calibrate_cameras(filmed.views + few, BOARD, measure=False)
    for name, of in found.cameras.items():
        mine = [v for v in good if v.camera == name]
        assert of.views == len(mine)
        assert of.rejected == sum(v.camera == name for v in filmed.views + few) - len(mine)
        pixels = np.concatenate([v.corners_px for v in mine])
        cells = {tuple(cell) for cell in ((pixels + 0.5) / SIZE * GRID).astype(int).tolist()}
        assert of.fields == pytest.approx(len(cells) / (GRID[0] * GRID[1]))
        covariance = found.rig.cameras[name].covariance
        assert of.position_sd_mm == pytest.approx(1e3 * np.sqrt(np.trace(covariance[:3, :3])))
        assert of.rotation_sd_deg == pytest.approx(np.degrees(np.sqrt(np.trace(covariance[3:, 3:]))))
        alone = one_camera(mine, BOARD)
        assert of.focal_sd_percent == pytest.approx(100 * np.sqrt(alone.covariance[0, 0]) / alone.lens[0], rel=0.7)
        assert 0.1 < of.reprojection_px < 0.5
    assert found.shared_instants == len(
        {v.frame for v in good if v.camera == "c0"} & {v.frame for v in good if v.camera == "c1"}
    )
