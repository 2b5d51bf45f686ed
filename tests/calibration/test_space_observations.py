"""What is collected to align another tracker's space, and what is asked of who collects it."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from support.moved_wand import DELAY_S, HZ, ON_BODY, T_WORLD_VR, moved, wand

from mocapella.calibration.space_observations import SpaceObservations
from mocapella.errors import InputError, SettingsError
from mocapella.model.observations import JointState
from mocapella.model.scene import TrackedObject, TrackedPoints

SECONDS = 2


def observed(*, parts: dict[str, Any] | None = None, **what: str) -> SpaceObservations:
    """The observations of a moved wand, in whose scenes some parts are replaced."""
    found = SpaceObservations("LHR-1", **what)
    for scene, frame in moved(SECONDS):
        changed = scene if parts is None else msgspec.structs.replace(scene, parts={**scene.parts, **parts})
        found.update([changed] if frame is None else [changed, frame])
    return found


@pytest.mark.parametrize("given", [{}, {"thing": "wand", "marker": "cyan"}])
def test_neither_or_both_of_object_and_marker_are_refused(given: dict[str, str]) -> None:
    with pytest.raises(SettingsError, match="either --marker or --object"):
        SpaceObservations("LHR-1", **given)


def test_an_object_is_its_origin_and_a_point_on_each_axis_once_for_each_frame_of_a_camera() -> None:
    """The scenes of the other tracker's frames repeat the object, and give no points."""
    at_s, points = observed(thing="wand").points()
    assert at_s == pytest.approx(1 + np.arange(SECONDS * HZ) / HZ)
    assert points.shape == (SECONDS * HZ, 4, 3)
    for t, four in zip(at_s - 1, points, strict=True):
        T = wand(t) @ ON_BODY
        np.testing.assert_allclose(four[0], T[:3, 3], atol=1e-12)
        axes = (four[1:] - four[0]) @ T[:3, :3]
        np.testing.assert_allclose(axes, np.linalg.norm(axes, axis=1)[0] * np.eye(3), atol=1e-12)


def test_a_marker_is_one_point_and_the_pose_of_the_body_is_that_of_its_own_time() -> None:
    found = observed(marker="cyan")
    at_s, points = found.points()
    assert points.shape == (len(at_s), 1, 3) == (SECONDS * HZ, 1, 3)
    np.testing.assert_allclose(points[:, 0], [(wand(t - 1) @ ON_BODY)[:3, 3] for t in at_s], atol=1e-12)
    at_s, T_space_body = found.poses()
    assert at_s == pytest.approx(1.011 + np.arange(SECONDS * HZ) / HZ)
    for t, T in zip(at_s, T_space_body, strict=True):
        np.testing.assert_allclose(T_WORLD_VR @ T, wand(t - 1 - DELAY_S), atol=1e-6)


@pytest.mark.parametrize(("cameras", "counts"), [(1, False), (2, True), (3, True)])
def test_a_marker_counts_from_two_cameras_on(cameras: int, counts: bool) -> None:
    one = np.array([0.001], np.float32)
    points = TrackedPoints(("cyan",), np.zeros((1, 3)), one, np.array([cameras], np.uint8))
    found = observed(marker="cyan", parts={"points": (points,)})
    assert len(found.points()[0]) == (SECONDS * HZ if counts else 0)


@pytest.mark.parametrize("state", list(JointState))
def test_an_object_counts_while_it_is_tracked(state: JointState) -> None:
    objects = (TrackedObject("wand", np.eye(4), np.zeros((2, 3)), state),)
    found = observed(thing="wand", parts={"objects": objects})
    assert len(found.points()[0]) == (SECONDS * HZ if state == JointState.TRACKED else 0)


@pytest.mark.parametrize(("space", "begin_s"), [("one", 0), ("other", 1)])
def test_poses_are_of_the_named_space_and_have_a_time(space: str, begin_s: int) -> None:
    found = SpaceObservations("LHR-1", space=space, thing="wand")
    for name, begin in (("one", 0), ("other", HZ)):
        for scene, frame in moved(1, spaces=(name,), begin=begin):
            found.update([scene] if frame is None else [scene, frame])
    _, late = list(moved(1, spaces=(space,), begin=2 * HZ))[-1]
    assert late is not None
    found.update([late])  # its scene has not come
    at_s, _ = found.poses()
    assert at_s == pytest.approx(1.011 + begin_s + np.arange(HZ) / HZ)


def test_what_is_unknown_is_named_with_what_there_is() -> None:
    """Of a session, the nodes are to be started; of a take, they were to be recorded."""
    empty, take = SpaceObservations("LHR-1", thing="wand"), SpaceObservations("LHR-1", thing="wand", source="a.mcap")
    with pytest.raises(InputError, match="no poses of another tracker came; start mocapella node"):
        empty.poses()
    with pytest.raises(InputError, match=r"a\.mcap: has no poses of another tracker; record with node"):
        take.poses()
    with pytest.raises(SettingsError, match="--object 'wand': there are none"):
        empty.points()
    with pytest.raises(SettingsError, match="--object 'wand': the take has none"):
        take.points()
    found = SpaceObservations("LHR-9", space="stage", thing="wnd")
    for count, (scene, frame) in enumerate(moved(1)):
        found.update([scene] if frame is None else [scene, frame])
        assert found.scenes == count + 1
    with pytest.raises(InputError, match=r"stage.*--space is one of vr"):
        found.poses()
    with pytest.raises(SettingsError, match="--object 'wnd': there are wand"):
        found.points()
    other = SpaceObservations("LHR-9", thing="wand")
    other.update(frame for _, frame in moved(1) if frame is not None)
    with pytest.raises(InputError, match=r"LHR-9.*--body is one of LHR-1"):
        other.poses()
