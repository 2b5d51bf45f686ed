from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.marker_motion import LENS, hand, pair, shot

from mocapella.errors import SettingsError
from mocapella.fusion.marker_rays import MarkerPoints, MarkerRays, MarkerRaysSettings, RayState, captured, views_of
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.geometry.triangulation import TriangulationSettings, triangulate
from mocapella.model.camera import CameraRig

SD_PX = 0.3
EVERY_PAIR = TriangulationSettings(gate_sd=np.inf)


def frames(rig: CameraRig, count: int, hz: float = 30.0, seed: int = 0) -> Iterator[tuple[str, np.ndarray, float]]:
    """Camera, pixels and time of frames in turn, half a frame apart."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        for k, name in enumerate(rig.cameras):
            at_s = (i + 0.5 * k) / hz
            pixels = shot(rig, name, at_s, hand)
            yield name, pixels + rng.normal(0, SD_PX, pixels.shape), at_s + rig.cameras[name].clock_s


def errors(results: list[MarkerPoints]) -> np.ndarray:
    return np.array([np.linalg.norm(r.points - hand(r.at_s), axis=-1) for r in results])


def test_unsynchronised_rolling_shutters_cost_a_tenth_of_what_they_do_when_time_is_ignored() -> None:
    rig = pair()
    rays, latest, late, ignored = MarkerRays(rig, 5), {}, [], []
    for name, pixels, at_s in frames(rig, 60):
        late.append(rays.update(name, pixels, SD_PX, at_s))
        latest[name] = pixels
        if len(latest) == 2:
            both = triangulate(np.stack([latest[n] for n in rig.cameras], axis=1), views_of(rig), SD_PX, EVERY_PAIR)
            ignored.append(np.linalg.norm(both.points - hand(late[-1].at_s), axis=-1))
    ours = errors(late[10:])
    assert np.median(ours) < 0.2 * np.nanmedian(ignored[9:])
    assert np.percentile(ours, 95) < 0.012
    assert rays.report.received == rays.report.used + 5  # the first frame alone makes no point
    assert rays.report.begun == 5


def test_a_camera_whose_clock_is_known_to_be_late_is_as_good_as_one_whose_is_not() -> None:
    results = []
    for clock_s in (0.0, 7.0):
        rig = pair(clock_s=clock_s)
        rays = MarkerRays(rig, 5)
        results.append(np.stack([rays.update(*frame[:2], SD_PX, frame[2]).points for frame in frames(rig, 20)]))
    np.testing.assert_allclose(results[0], results[1], atol=1e-9)


def test_frames_that_come_in_another_order_lead_to_the_same_place() -> None:
    rig = pair()
    settings = MarkerRaysSettings(keep_s=0.1)
    orderly, mixed = MarkerRays(rig, 5, settings), MarkerRays(rig, 5, settings)
    shots = list(frames(rig, 12))
    for frame in shots:
        orderly.update(*frame[:2], SD_PX, frame[2])
    for k in range(0, len(shots), 2):
        for frame in (shots[k + 1], shots[k]) if k else shots[:2]:
            mixed.update(*frame[:2], SD_PX, frame[2])
    np.testing.assert_allclose(mixed.at(0.4).points, orderly.at(0.4).points, atol=1e-9)
    assert mixed.report.late == 0
    old = shots[0]
    mixed.update(old[0], old[1], SD_PX, old[2])
    assert mixed.report.late == 5
    assert mixed.report.frames_late == 1


def test_the_covariance_says_how_far_off_points_are_that_move_as_the_filter_says() -> None:
    """Many markers, each with white acceleration of the density that is set."""
    rig, rng, density, count, step = pair(readout_s=0.0), np.random.default_rng(2), 0.3, 200, 1 / 60
    settings = MarkerRaysSettings(acceleration_density=density, gate_sd=20)
    rays = MarkerRays(rig, count, settings)
    x = rng.uniform(-0.1, 0.1, (count, 3)) + np.array([0, 0, 0.5])
    v = np.zeros((count, 3))
    noise = np.linalg.cholesky(density * np.array([[step**3 / 3, step**2 / 2], [step**2 / 2, step]]))
    for i in range(24):
        name = ("left", "right")[i % 2]
        a, b = np.einsum("ij,jpk->ipk", noise, rng.normal(size=(2, count, 3)))
        x, v = x + step * v + a, v + b
        pixels = project(apply(rig.cameras[name].T_camera_world, x), LENS)
        result = rays.update(name, pixels + rng.normal(0, SD_PX, pixels.shape), SD_PX, i * step)
    off = result.points - x
    squares = np.einsum("pi,pij,pj->p", off, np.linalg.inv(result.covariances), off)
    assert (result.states == RayState.TRACKED).all()
    assert abs(squares.mean() - 3.0) < 0.6  # the mean of χ² of three; its sd here is 0.17


def test_a_marker_that_one_camera_loses_is_inferred_and_ever_less_sure_and_then_lost() -> None:
    rig = pair()
    rays = MarkerRays(rig, 5)
    results = []
    for name, pixels, at_s in frames(rig, 60):
        if at_s > 0.5 and name == "right":
            pixels[0] = np.nan
        results.append(rays.update(name, pixels, SD_PX, at_s))
    states = np.array([r.states for r in results])
    assert (states[20:, 1:] == RayState.TRACKED).all()
    alone = states[:, 0]
    first = int(np.argmax(alone[20:] == RayState.INFERRED)) + 20
    assert results[first].at_s == pytest.approx(0.5 + 0.08, abs=0.04)
    sds = [np.sqrt(r.covariances[0].trace()) for r in results[first : first + 4]]
    assert (np.diff(sds) > 0).any()
    assert alone[-1] == RayState.LOST
    assert np.isnan(results[-1].points[0]).all()
    assert rays.report.forgotten >= 1


def test_a_marker_that_nobody_sees_goes_on_for_a_while() -> None:
    rig = pair()
    rays = MarkerRays(rig, 5)
    for name, pixels, at_s in frames(rig, 20):
        rays.update(name, pixels, SD_PX, at_s)
    soon, later = rays.at(0.72), rays.at(1.5)
    assert np.linalg.norm(soon.points - hand(0.72), axis=-1).max() < 0.06
    assert (later.states == RayState.LOST).all()


def test_frames_in_which_nothing_is_seen_tell_the_time() -> None:
    rig = pair()
    rays = MarkerRays(rig, 5)
    nothing = np.full((5, 2), np.nan)
    before = rays.update("left", nothing, SD_PX, 3.0)
    assert before.at_s == pytest.approx(3.0 - rig.cameras["left"].clock_s)
    assert (before.states == RayState.LOST).all()
    for name, pixels, at_s in frames(rig, 20):
        rays.update(name, pixels, SD_PX, 4.0 + at_s)
    for name in rig.cameras:
        last = rays.update(name, nothing, SD_PX, 6.0)
    assert (last.states == RayState.LOST).all()
    assert np.isnan(last.points).all()


def test_a_wrong_pixel_is_refused() -> None:
    rig = pair()
    rays = MarkerRays(rig, 5)
    for k, (name, pixels, at_s) in enumerate(frames(rig, 20)):
        if k == 30:
            pixels[2] += 100.0
        result = rays.update(name, pixels, SD_PX, at_s)
        assert k < 10 or np.linalg.norm(result.points - hand(result.at_s), axis=-1).max() < 0.03
    assert rays.report.refused == 1


def test_a_marker_that_jumps_is_found_again() -> None:
    rig = pair()
    rays = MarkerRays(rig, 5, MarkerRaysSettings(acceleration_density=0.01))
    for k in range(60):
        name, jump = ("left", "right")[k % 2], np.where(np.arange(5) == 3, 0.15 * (k >= 30), 0.0)
        pixels = shot(rig, name, k / 60, lambda _t, jump=jump: hand(0.0) + jump[:, None] * [0.0, 1.0, 0.0])
        result = rays.update(name, pixels, SD_PX, k / 60)
    truth = hand(0.0)
    truth[3, 1] += 0.15
    np.testing.assert_allclose(result.points, truth, atol=0.002)
    assert (rays.report.forgotten, rays.report.begun, rays.report.refused) == (1, 6, 6)


def test_after_a_reset_it_is_as_new() -> None:
    rig = pair()
    rays = MarkerRays(rig, 5)
    first = [rays.update(*f[:2], SD_PX, f[2]).points for f in frames(rig, 4)]
    rays.reset()
    assert rays.report.received == 0
    np.testing.assert_array_equal(first, [rays.update(*f[:2], SD_PX, f[2]).points for f in frames(rig, 4)])


def test_a_row_is_captured_later_and_a_clock_that_is_ahead_says_more() -> None:
    camera = pair(readout_s=0.02, clock_s=3.0).cameras["right"]
    np.testing.assert_allclose(captured(camera, [0.0, 479.0], 10.0), [7.0, 7.02])


@given(st.lists(st.tuples(st.sampled_from(["left", "right"]), st.integers(0, 6)), max_size=12))
def test_a_frame_is_late_if_its_camera_had_one_of_that_time_or_later(shots: list[tuple[str, int]]) -> None:
    rig = pair(clock_s=2.0)
    rays, nothing, late = MarkerRays(rig, 1), np.full((1, 2), np.nan), 0
    newest: dict[str, int] = {}
    for name, at_s in shots:
        result = rays.update(name, nothing, SD_PX, at_s)
        late += at_s <= newest.get(name, -1)
        newest[name] = max(at_s, newest.get(name, -1))
        assert result.at_s == max(t - rig.cameras[other].clock_s for other, t in newest.items())
    assert rays.report.frames_late == late


def test_the_time_is_that_of_the_latest_row_of_a_seen_marker() -> None:
    rig = pair(readout_s=0.02)
    rays = MarkerRays(rig, 3)
    seen = np.array([[300.0, 100.0], [300.0, 479.0], [np.nan, np.nan]])
    assert rays.update("left", seen, SD_PX, 1.0).at_s == pytest.approx(1.02)
    assert rays.update("left", seen[[0, 0, 2]], SD_PX, 2.0).at_s == pytest.approx(2.0 + 0.02 * 100 / 479)


def test_what_is_not_of_the_rig_is_refused() -> None:
    rays = MarkerRays(pair(), 5)
    with pytest.raises(SettingsError, match=r"'rihgt' is not of the rig.*did you mean right"):
        rays.update("rihgt", np.zeros((5, 2)), 1.0, 0.0)
    with pytest.raises(SettingsError, match="5 points"):
        rays.update("right", np.zeros((4, 2)), 1.0, 0.0)


@pytest.mark.parametrize(
    "name",
    [
        "acceleration_density", "speed_sd", "gate_sd", "keep_s", "together_s", "image_speed_px", "least_angle_rad",
        "alone_s", "forget_after_s", "largest_sd_m",
    ],
)  # fmt: skip
def test_settings_out_of_range_are_refused(name: str) -> None:
    with pytest.raises(SettingsError, match=name):
        MarkerRaysSettings(**{name: -1.0})
