"""The line skeleton of whole bodies, on rendered people of known joints: range, floor, lines and their ends."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2")

from mocapella.errors import SettingsError  # noqa: E402 - only where there is OpenCV
from mocapella.geometry.lens import project  # noqa: E402
from mocapella.model.camera import Camera  # noqa: E402
from mocapella.sensing.body_lines import BodyLinesResult, BodyLinesSettings, body_lines, pictures  # noqa: E402
from mocapella.sources.simulate.body import JOINT, body_template  # noqa: E402
from mocapella.sources.simulate.room_depth import FIRST_PERSON, RoomShot, room_depth_scene  # noqa: E402

LIMBS = (("Head",), ("HandTipLeft",), ("HandTipRight",), ("AnkleLeft", "FootLeft"), ("AnkleRight", "FootRight"))
"""Some of a foot goes with the floor that it stands on."""
CASES = [("stand", "exact", 2.0), ("walk", "kinect", 2.0), ("exchange", "kinect", 9.0)]


@cache
def shot(name: str, sensor: str, at_s: float) -> tuple[RoomShot, Camera]:
    scene = room_depth_scene(name, seed=1, sensor=sensor)
    return scene.at(at_s), Camera("depth", scene.sensor.size_px, scene.lens)


def metres(name: str, sensor: str, at_s: float) -> Any:
    made, _ = shot(name, sensor, at_s)
    return made.depth * np.float32(made.unit_m)


@cache
def seen(name: str, sensor: str, at_s: float) -> BodyLinesResult:
    return body_lines(metres(name, sensor, at_s), shot(name, sensor, at_s)[1])


def to_bones(pixels: Any, joints: Any, lens: Any) -> Any:
    """(n,) distances of pixels (n, 2) from the nearest bone in the picture [px]."""
    px, parents = project(joints, lens), body_template().parents
    a, b = px[parents], px
    along = np.clip(((pixels[:, None] - a) * (b - a)).sum(-1) / np.maximum(((b - a) ** 2).sum(-1), 1e-9), 0, 1)
    return np.linalg.norm(pixels[:, None] - a - along[..., None] * (b - a), axis=-1).min(axis=1)


@pytest.mark.parametrize("case", CASES)
def test_lines_are_where_bones_are_and_end_at_head_hands_and_feet(case: tuple[str, str, float]) -> None:
    truth, camera = shot(*case)
    found = seen(*case)
    assert found.reason == ""
    assert len(found.bodies) == len(truth.people)
    for body in found.bodies:
        joints = min(truth.people, key=lambda one: abs(one[0, 0] - np.median(body.ends[:, 0])))
        on_line = np.argwhere(body.thinned > 0)[:, ::-1].astype(float)
        off_m = to_bones(on_line, joints, camera.lens) * body.distance_m / camera.lens[0]
        assert np.median(off_m) < 0.03
        assert np.percentile(off_m, 95) < 0.10  # lines cut the corner of a shoulder
        for limb in LIMBS:
            away = np.linalg.norm(body.ends[:, None] - joints[[JOINT[name] for name in limb]], axis=-1)
            assert away.min() < 0.15, limb
        assert len(body.ends) <= 7
        assert len(body.segments) >= 8
        # The ends in space are those in the picture, and so are the lines'.
        np.testing.assert_allclose(project(body.ends, camera.lens), body.ends_px, atol=1e-6)
        np.testing.assert_allclose(project(body.segments, camera.lens), body.segments_px, atol=1e-6)


@pytest.mark.parametrize("case", CASES)
def test_the_floor_is_found_and_left_out(case: tuple[str, str, float]) -> None:
    truth, camera = shot(*case)
    floor = seen(*case).floor
    assert floor is not None
    np.testing.assert_allclose(floor[:3], [0, -1, 0], atol=0.01)
    assert floor[3] == pytest.approx(1.0, abs=0.03)  # the camera is 1 m above it
    mask = np.bitwise_or.reduce([body.mask for body in seen(*case).bodies]) > 0
    people = truth.parts >= FIRST_PERSON
    kept = people & (truth.depth > 0)
    assert np.count_nonzero(mask & kept) > 0.97 * np.count_nonzero(kept)
    assert np.count_nonzero(mask & ~people) < 0.16 * np.count_nonzero(mask)  # blurs make an outline wider
    with_floor = body_lines(metres(*case), camera, BodyLinesSettings(floor=False))
    assert with_floor.floor is None
    masks = np.bitwise_or.reduce([body.mask for body in with_floor.bodies]) > 0
    assert np.count_nonzero(masks & ~people) > 0.5 * np.count_nonzero(masks)


def test_what_is_out_of_range_is_left_out_and_said() -> None:
    case = CASES[0]
    camera, depth = shot(*case)[1], metres(*case)
    for depth_m, settings, reason in (
        (np.zeros_like(depth), BodyLinesSettings(), "nothing was measured in the whole image"),
        (depth, BodyLinesSettings(far_m=1.0), "nothing lies between 0.8 and 1 m; the nearest is at 2."),
        (np.where(depth > 2.95, depth, 0), BodyLinesSettings(), "nothing but the floor lies in the range"),
        (depth, BodyLinesSettings(least_m2=5.0), "nothing in the range is larger than 5 m²"),
    ):
        found = body_lines(depth_m, camera, settings)
        assert found.bodies == ()
        assert found.reason.startswith(reason), found.reason
    wall = body_lines(depth, camera, BodyLinesSettings(far_m=6.0))
    assert any(np.count_nonzero(body.mask) > 0.3 * body.mask.size for body in wall.bodies)


def test_a_tilted_camera_sees_the_same_lines() -> None:
    """Rolled by a quarter turn there is no floor below: it is then not looked for, and stays."""
    case = CASES[0]
    depth, camera = metres(*case), shot(*case)[1]
    turned = Camera("turned", camera.size_px[::-1], np.array([580.0, 580.0, 239.5, 319.5, 0, 0, 0, 0, 0]))
    assert body_lines(np.ascontiguousarray(depth.T), turned, BodyLinesSettings(tilt_deg=30)).floor is None


def test_each_stage_has_a_picture() -> None:
    case = CASES[0]
    made = pictures(seen(*case))
    assert list(made) == [
        "16 bits above the floor", "8 bits", "median", "Gaussian", "threshold", "outlines", "thinning", "lines",
    ]  # fmt: skip
    assert all(picture.shape[:2] == (480, 640) and picture.dtype == np.uint8 for picture in made.values())
    assert all(picture.any() for picture in made.values())
    assert len(pictures(body_lines(np.zeros((480, 640), np.float32), shot(*case)[1]))) == 5


def test_what_cannot_be_is_refused() -> None:
    camera = shot(*CASES[0])[1]
    with pytest.raises(SettingsError, match="320 × 240; camera depth has 640 × 480"):
        body_lines(np.zeros((240, 320), np.float32), camera)
    wrong: tuple[tuple[str, Any], ...] = (
        ("near_m", 4.0), ("far_m", 21.0), ("floor_clear_m", -0.1), ("tilt_deg", 81.0), ("least_m2", -1.0),
    )  # fmt: skip
    for name, value in wrong:
        with pytest.raises(SettingsError, match="near_m" if name == "far_m" else name):
            replace(BodyLinesSettings(), **{name: value})
