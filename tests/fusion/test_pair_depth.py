from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.marker_motion import LENS, pair

from mocapella.errors import SettingsError
from mocapella.fusion.pair_depth import METHODS, PairDepth, PairDepthSettings
from mocapella.geometry.lens import project
from mocapella.geometry.parallel_pair import fit
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y
from mocapella.geometry.triangulation import PointState
from mocapella.model.camera import CameraRig, PlacedCamera

RIG = pair(baseline_m=0.075)
TRUTH = np.random.default_rng(0).uniform([-0.1, -0.1, 0.3], [0.1, 0.1, 0.8], (40, 3))
LEFT_RIGHT = {
    "left": "right",
    "right": "left",
}  # `pair` names them as the cameras would say, not who stands before them


def pixels(rig: CameraRig = RIG, truth: np.ndarray = TRUTH) -> np.ndarray:
    """(points, 2, 2) of the cameras that somebody before them calls left and right."""
    seen = [project(apply(rig.cameras[name].T_camera_world, truth), LENS) for name in ("right", "left")]
    return np.stack(seen, axis=1)


def settings_of(method: str) -> PairDepthSettings:
    """With the law that fits: the very one of the pair."""
    depths = np.array([0.3, 0.5, 1.0])
    law = fit(depths, PairDepth(RIG, **LEFT_RIGHT).pair.disparity(depths))
    return PairDepthSettings(method, k_cm=law.k_cm, z=law.z)


@pytest.mark.parametrize("method", METHODS)
def test_points_come_back_by_every_method_wherever_the_rig_stands(method: str) -> None:
    move = rigid(rotation_about_y(0.7), [1.0, 2.0, 3.0])
    cameras = {
        name: PlacedCamera(c.camera, c.T_camera_world @ inverse(move), c.covariance) for name, c in RIG.cameras.items()
    }
    found = PairDepth(CameraRig(cameras), settings_of(method), **LEFT_RIGHT).points(pixels())
    np.testing.assert_allclose(found.points, apply(move, TRUTH), atol=1e-6)
    assert found.used.all()
    assert np.nanmax(found.residuals_px) < 1e-3


@pytest.mark.parametrize("method", METHODS)
def test_the_covariance_says_how_far_off_points_are(method: str) -> None:
    rng, depth = np.random.default_rng(1), PairDepth(RIG, settings_of(method), **LEFT_RIGHT)
    seen = pixels(truth=np.repeat(TRUTH, 100, axis=0))
    found = depth.points(seen + rng.normal(0, 0.5, seen.shape))
    off = found.points - np.repeat(TRUTH, 100, axis=0)
    good = found.states == PointState.SEEN
    squares = np.einsum("pi,pij,pj->p", off, np.linalg.inv(np.nan_to_num(found.covariances) + 1e-30 * np.eye(3)), off)
    assert good.mean() > 0.99
    assert abs(squares[good].mean() - 3.0) < 0.35


def ahead() -> CameraRig:
    """The rig with both cameras exactly parallel."""
    cameras = {
        name: PlacedCamera(c.camera, rigid(np.eye(3), [-x, 0.0, 0.0]), c.covariance)
        for (name, c), x in zip(RIG.cameras.items(), (-0.0375, 0.0375), strict=True)
    }
    return CameraRig(cameras)


@pytest.mark.parametrize("method", METHODS)
def test_rows_that_differ_leave_half_of_the_difference_to_each_camera(method: str) -> None:
    """Between two parallel cameras no point has other rows than their mean, so all methods leave the same."""
    rig, near_the_axis = ahead(), TRUTH * [0.2, 0.2, 1.0]  # where a lens distorts nothing
    seen = pixels(rig, near_the_axis)
    seen[:, 0, 1] += 0.7
    seen[:, 1, 1] -= 0.7
    found = PairDepth(rig, settings_of(method), **LEFT_RIGHT).points(seen)
    assert found.used.all()
    np.testing.assert_allclose(found.residuals_px, 0.7, rtol=0.03)


def test_settings_are_those_that_are_given_or_else_the_defaults() -> None:
    assert PairDepth(RIG).settings == PairDepthSettings()
    law = settings_of("parallel-fitted")
    twice = replace(law, k_cm=2 * law.k_cm)
    seen, rig = pixels(ahead()), ahead()
    one, other = (PairDepth(rig, given, **LEFT_RIGHT).points(seen).points for given in (law, twice))
    np.testing.assert_allclose(other[:, 2], 2 * one[:, 2], rtol=1e-9)  # the cameras look along z


@pytest.mark.parametrize("method", METHODS[1:])
def test_why_there_is_no_point(method: str) -> None:
    rig = ahead()
    depth, seen = PairDepth(rig, settings_of(method), **LEFT_RIGHT), pixels(rig)[:4]
    seen[0, 0] = np.nan
    seen[1] = seen[1, ::-1]
    seen[2, 0, 1] += 20.0
    found = depth.points(seen)
    states = [PointState.ONE_VIEW, PointState.BEHIND, PointState.INCONSISTENT, PointState.SEEN]
    assert found.states.tolist() == states
    assert np.isnan(found.points[:3]).all()
    assert np.isnan(found.covariances[:3]).all()


def test_cameras_called_by_each_others_name_are_said() -> None:
    assert not PairDepth(RIG, **LEFT_RIGHT).swapped(pixels())
    assert PairDepth(RIG, left="left", right="right").swapped(pixels()[:, ::-1])
    assert PairDepth(RIG).swapped(pixels()[:, ::-1])


def test_a_pair_that_is_none_is_refused() -> None:
    turned = {
        name: PlacedCamera(c.camera, rigid(rotation_about_y(np.pi / 2), [0.0, 0, 0]) @ c.T_camera_world, c.covariance)
        for name, c in pair(0.4).cameras.items()
    }
    placed = RIG.cameras["left"]
    for rig, names, said in (
        (RIG, {"left": "lef"}, "did you mean left"),
        (RIG, {"left": "left", "right": "left"}, "both 'left'"),
        (CameraRig({"a": placed, "b": placed}), {}, "stand in one place"),
        (CameraRig(turned), {}, "along their baseline"),
        (CameraRig({"a": placed}), {}, "'' is not of the rig"),
    ):
        with pytest.raises(SettingsError, match=said):
            PairDepth(rig, **names)


@pytest.mark.parametrize(
    ("name", "value"), [("method", "magic"), ("k_cm", 0.0), ("z", 1.0), ("sd_px", 0.0), ("gate_sd", 0.0)]
)
def test_settings_out_of_range_are_refused(name: str, value: object) -> None:
    with pytest.raises(SettingsError, match=name):
        PairDepthSettings(**({"method": "parallel-fitted", "k_cm": 4543.3, "z": -1.0354} | {name: value}))
