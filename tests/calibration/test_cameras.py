"""Cameras from views of a board: what is true comes back, as sure as is said, and what is missing is named."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from support.filmed_boards import BOARD, LENSES, SIZE, film, to_first

from mocapella.calibration.cameras import BOARD_LYING, Origin, calibrate_cameras
from mocapella.calibration.corner_quality import corner_quality
from mocapella.errors import CalibrationError
from mocapella.geometry.rigid import apply, inverse
from mocapella.geometry.twists import log_motion
from mocapella.model.board import Board
from mocapella.model.camera import Camera, PlacedCamera


def places(found: object) -> list[np.ndarray]:
    return [placed.T_camera_world for placed in found.rig.cameras.values()]  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def exact():
    filmed = film(cameras=3)
    return filmed, calibrate_cameras(filmed.views, BOARD, measure=False)


def test_without_noise_lenses_and_places_come_back(exact) -> None:
    filmed, found = exact
    np.testing.assert_allclose(to_first(places(found)), filmed.T_camera_first, atol=1e-5)
    lenses = np.array([placed.camera.lens for placed in found.rig.cameras.values()])
    np.testing.assert_allclose(lenses[:, :4], filmed.lenses[:, :4], rtol=1e-4)
    np.testing.assert_allclose(lenses[:, [4, 6, 7]], filmed.lenses[:, [4, 6, 7]], atol=1e-4)
    assert found.fit.distance_rms_mm < 1e-3
    assert found.sigma_px < 1e-3


def test_the_first_camera_is_the_world_with_y_up(exact) -> None:
    _, found = exact
    np.testing.assert_allclose(places(found)[0], np.diag([1.0, -1, -1, 1]), atol=1e-12)
    assert not found.rig.cameras["c0"].covariance.any()


def test_the_order_of_views_and_the_names_of_cameras_make_no_difference(exact) -> None:
    filmed, found = exact
    names = {"c0": "z", "c1": "b", "c2": "a"}
    renamed = [msgspec.structs.replace(view, camera=names[view.camera]) for view in reversed(filmed.views)]
    other = calibrate_cameras(renamed, BOARD, measure=False)
    assert list(other.rig.cameras) == ["a", "b", "z"]
    same = [other.rig.cameras[names[name]].T_camera_world for name in ("c0", "c1", "c2")]
    np.testing.assert_allclose(to_first(same), to_first(places(found)), atol=1e-5)


@pytest.mark.parametrize("upright", [False, True])
def test_the_world_can_be_the_board_at_an_instant(exact, upright: bool) -> None:
    filmed, found = exact
    turned = calibrate_cameras(filmed.views, BOARD, origin=Origin(7, upright), measure=False)
    np.testing.assert_allclose(to_first(places(turned)), to_first(places(found)), atol=1e-5)
    camera = turned.rig.cameras["c0"]
    assert camera.covariance.any()
    view = next(view for view in filmed.views if view.camera == "c0" and view.frame == 7)
    R = np.diag([1.0, -1, -1]) if upright else BOARD_LYING
    in_world = apply(camera.T_camera_world, BOARD.corners_m[view.ids] @ R.T)
    from mocapella.geometry.lens import project

    np.testing.assert_allclose(project(in_world, camera.camera.lens), view.corners_px, atol=1e-2)
    toward_viewer = R @ [0, 0, -1.0]
    np.testing.assert_allclose(toward_viewer, [0, 0, 1] if upright else [0, 1, 0], atol=1e-12)


def test_lenses_that_are_given_stay(exact) -> None:
    filmed, _ = exact
    known = {f"c{c}": Camera(f"c{c}", SIZE, LENSES[c]) for c in range(3)}
    found = calibrate_cameras(filmed.views[:12], BOARD, known=known, measure=False)
    for name, camera in known.items():
        assert found.rig.cameras[name].camera is camera
        assert found.cameras[name].focal_sd_percent == 0
    np.testing.assert_allclose(to_first(places(found)), filmed.T_camera_first, atol=1e-6)


@pytest.mark.slow
def test_errors_are_as_large_as_the_covariance_says() -> None:
    """Normalised squared errors of six components over eight films: χ² of 48 degrees of freedom, 19 to 93 at 1e-4."""
    total, largest, focal = 0.0, 0.0, 0.0
    for seed in range(8):
        filmed = film(noise_px=0.3, seed=seed, instants=16)
        found = calibrate_cameras(filmed.views, BOARD, measure=False)
        off = log_motion(to_first(places(found))[1] @ inverse(filmed.T_camera_first[1]))
        total += float(off @ np.linalg.solve(found.rig.cameras["c1"].covariance, off))
        largest = max(largest, found.sigma_px)
        for c in range(2):
            sd = found.cameras[f"c{c}"].focal_sd_percent / 100
            focal += (found.rig.cameras[f"c{c}"].camera.lens[0] / filmed.lenses[c, 0] - 1) ** 2 / sd**2
    assert 19 < total < 93
    assert 3.0 < focal < 45  # of 16 focal lengths
    assert largest == pytest.approx(0.3, rel=0.15)


@pytest.mark.slow
def test_the_quality_that_is_expected_is_the_one_that_is_measured() -> None:
    filmed = film(noise_px=0.3, instants=24, seed=3)
    found = calibrate_cameras(filmed.views, BOARD)
    assert found.left_out is not None
    for half in found.left_out:
        assert half.distance_rms_mm == pytest.approx(half.predicted_rms_mm, rel=0.35)
    other = film(noise_px=0.3, instants=12, seed=4)
    instants = {(view.camera, view.frame): view.frame for view in other.views}
    fresh = corner_quality(other.views, instants, found.rig.cameras, BOARD)
    assert fresh.distance_rms_mm == pytest.approx(found.left_out[0].predicted_rms_mm, rel=0.35)
    assert abs(fresh.scale_percent) < 0.1


@pytest.mark.slow
def test_corners_that_are_elsewhere_do_not_count() -> None:
    filmed = film(noise_px=0.1, seed=5)
    rng = np.random.default_rng(1)
    bent = []
    for view in filmed.views:
        corners = view.corners_px.copy()
        corners[rng.random(len(corners)) < 0.05] += 80.0
        bent.append(msgspec.structs.replace(view, corners_px=corners))
    found = calibrate_cameras(bent, BOARD, measure=False)
    off = log_motion(to_first(places(found))[1] @ inverse(filmed.T_camera_first[1]))
    assert np.linalg.norm(off[:3]) < 0.01
    assert np.linalg.norm(off[3:]) < 0.01


def test_what_no_view_determines_is_said_and_stays_small() -> None:
    """A board in the middle of the picture only says nothing of k3."""
    filmed = film(cameras=1, noise_px=0.3, instants=12, nearer=0.5)
    found = calibrate_cameras(filmed.views, BOARD, measure=False)
    assert "k3" not in found.cameras["c0"].observed
    assert abs(found.rig.cameras["c0"].camera.lens[8]) < 0.3
    near = film(cameras=1, noise_px=0.02, instants=30, nearer=1.6)
    assert "k1" in calibrate_cameras(near.views, BOARD, measure=False).cameras["c0"].observed


def test_a_slower_clock_makes_the_covariance_larger() -> None:
    """One camera's pictures are late, the board has moved by then: views as wholes are off, and that is known."""
    filmed = film(noise_px=0.1, seed=6, instants=10)
    rng = np.random.default_rng(2)
    late = [
        msgspec.structs.replace(view, corners_px=view.corners_px + (view.camera == "c1") * rng.normal(0, 2.0, 2))
        for view in filmed.views
    ]
    found = calibrate_cameras(late, BOARD, measure=False)
    assert found.dispersion > 3
    assert calibrate_cameras(filmed.views, BOARD, measure=False).dispersion < 2


def refused(views: list, **more: object) -> str:
    with pytest.raises(CalibrationError) as error:
        calibrate_cameras(views, more.pop("board", BOARD), measure=False, **more)  # type: ignore[arg-type]
    return str(error.value)


@pytest.mark.slow
def test_each_cause_of_failure_is_named() -> None:
    filmed = film(instants=8)
    views = filmed.views
    assert "no picture shows the board" in refused([])
    few = [view for view in views if view.camera == "c0" or view.frame < 2]
    assert "camera c1 sees the board in 2 pictures" in refused(few)
    apart = [view for view in views if (view.camera == "c0") == (view.frame < 4)]
    assert "camera c1 never sees the board at the same instant as camera c0" in refused(apart)
    line = [
        msgspec.structs.replace(view, ids=view.ids[:4], corners_px=view.corners_px[:4]) if view.camera == "c1" else view
        for view in views
    ]
    assert "camera c1 sees enough of the board in no picture" in refused(line)
    sizes = [msgspec.structs.replace(view, size_px=(640, 480)) if view.frame == 3 else view for view in views]
    assert "camera c0 has pictures of several sizes: 640×480, 1280×720 px" in refused(sizes)
    other = {"c0": Camera("c0", (640, 480), LENSES[0])}
    assert "its lens is of: 640×480, 1280×720 px" in refused(views, known=other)
    assert "looks the same when turned by 180°" in refused(views, board=Board("chessboard", 6, 6, 0.05))
    assert "at the instant 99 of the origin: choose one of 0 to 7" in refused(views, origin=Origin(99))
    flat = film(cameras=1, flat=True, noise_px=0.2).views
    assert "tilt the board more" in refused(flat)


def test_triangulation_needs_two_cameras() -> None:
    filmed = film(cameras=1, instants=4)
    placed = PlacedCamera(Camera("c0", SIZE, LENSES[0]), np.eye(4), np.full((6, 6), np.nan))
    instants = {(view.camera, view.frame): view.frame for view in filmed.views}
    assert corner_quality(filmed.views, instants, {"c0": placed}, BOARD).points == 0
