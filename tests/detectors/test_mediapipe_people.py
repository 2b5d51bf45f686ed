"""Keypoints by MediaPipe: landmarks become pixels and confidences; on real films where the package is installed."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mocapella.detectors.keypoint_detector import KEYPOINT_DETECTORS, make_keypoint_detector
from mocapella.detectors.mediapipe_people import SHIPPED, check_shipped, nobody, one_seen
from mocapella.detectors.mediapipe_pose import missing
from mocapella.errors import InputError, SettingsError
from mocapella.model.topology import topology

POSE = topology("mediapipe_pose")


def marks(x: float, y: float, visibility: float = 1.0, presence: float = 1.0) -> list[SimpleNamespace]:
    return [SimpleNamespace(x=x, y=y, z=0.5, visibility=visibility, presence=presence) for _ in POSE.joints]


def test_the_middle_of_an_image_is_between_its_middle_pixels() -> None:
    seen = one_seen(marks(0.5, 0.5), marks(0.1, 0.2), (640, 480))
    np.testing.assert_allclose(seen.positions_px, np.tile([319.5, 239.5], (33, 1)), atol=1e-4)
    np.testing.assert_allclose(seen.relative, np.tile([0.1, 0.2, 0.5], (33, 1)), rtol=1e-6)


def test_a_confidence_is_visibility_times_presence() -> None:
    assert one_seen(marks(0.5, 0.5, 0.5, 0.5), marks(0, 0), (64, 48)).confidences.tolist() == [0.25] * 33


@pytest.mark.parametrize(("x", "seen"), [(1.04, True), (1.06, False), (-0.04, True), (-0.06, False)])
def test_guesses_far_outside_of_the_image_are_not_seen(x: float, seen: bool) -> None:
    found = one_seen(marks(x, 0.5), marks(0, 0), (640, 480))
    assert bool(np.isfinite(found.positions_px).all()) == seen
    assert bool(found.confidences.any()) == seen


@pytest.mark.parametrize(("nose_z", "seen"), [(-0.1, True), (0.1, False)])
def test_a_face_that_looks_away_is_not_seen(nose_z: float, seen: bool) -> None:
    world = marks(0.0, 0.0)
    for one in world:
        one.z = 0.0
    world[POSE.index("NOSE")].z = nose_z
    found = one_seen(marks(0.5, 0.5), world, (640, 480))
    hidden = {name for name, sure in zip(POSE.joints, found.confidences, strict=True) if sure == 0}
    face = {name for name in POSE.joints if name == "NOSE" or "EYE" in name or "MOUTH" in name}
    assert hidden == (set() if seen else face)
    assert np.isfinite(found.positions_px).all(axis=1).sum() == 33 - len(hidden)


def test_what_is_missing_is_named_with_its_remedy() -> None:
    assert "--extra mediapipe" in missing({"cv2": True, "mediapipe": False})
    assert "--extra cameras" in missing({"cv2": False, "mediapipe": True})
    assert missing({"cv2": True, "mediapipe": True}) == ""


def test_a_version_without_models_says_what_would_work(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--model.*0\.10\.21"):
        check_shipped(tmp_path)
    for name in (SHIPPED, "python/solutions/pose.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    check_shipped(tmp_path)


def test_a_detector_that_cannot_be_used_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="mediapipe, mediapipe-hands, onnx"):
        make_keypoint_detector("mediapip")
    with pytest.raises(SettingsError, match="most_peple"):
        make_keypoint_detector("mediapipe", {"most_peple": 1})
    if not KEYPOINT_DETECTORS["mediapipe"].missing():
        with pytest.raises(InputError, match="is not there"):
            make_keypoint_detector("mediapipe", model=tmp_path / "none.task")
        (tmp_path / "bad.task").write_bytes(b"no model")
        with pytest.raises(InputError, match=r"bad\.task.*is no model"):
            make_keypoint_detector("mediapipe", model=tmp_path / "bad.task")


def test_nobody_has_the_shapes_of_somebody() -> None:
    seen = nobody(33)
    assert seen.relative is not None
    assert (seen.positions_px.shape, seen.confidences.shape, seen.relative.shape) == ((0, 33, 2), (0, 33), (0, 33, 3))


@pytest.mark.slow
def test_two_people_are_followed_in_a_real_film(camera_recordings: Path) -> None:
    pytest.importorskip("mediapipe")
    cv2 = pytest.importorskip("cv2")
    finds = make_keypoint_detector("mediapipe", {"search_every_s": 0.1})
    film, ids = cv2.VideoCapture(str(camera_recordings / "pose2sim_two_people" / "videos" / "cam02.mp4")), []
    for k in range(12):
        _, image = film.read()
        seen = finds.update(np.asarray(image, np.uint8), k / 60)
        ids.append(seen.ids.tolist())
    assert ids[-1] == [0, 1]
    left, right = POSE.index("LEFT_SHOULDER"), POSE.index("RIGHT_HIP")
    assert (seen.confidences[:, [left, right]] > 0.9).all()
    assert seen.relative is not None
    assert (seen.relative[:, left, 1] < seen.relative[:, right, 1] - 0.3).all()  # y is down
    finds.reset()
    assert finds.update(np.zeros((64, 64, 3), np.uint8), 1.0).ids.tolist() == []
