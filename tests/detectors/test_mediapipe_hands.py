"""The keypoint detector mediapipe-hands, and the method webcams on its hands of a real clip of two webcams."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mocapella.detectors.keypoint_detector import KEYPOINT_DETECTORS, frame_of, make_keypoint_detector
from mocapella.detectors.mediapipe_hands import HandDetectorSettings, seen_hands
from mocapella.errors import SettingsError
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, rigid
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.hand import PARENTS
from mocapella.model.observations import Arrival, JointState
from mocapella.tracker.webcams import WebcamsTracker

CLIP = Path(__file__).parents[3] / "shared" / "data" / "stereo_hand_webcams"
SIZE = (720, 720)
M_PER_UNIT = 0.043
"""The clip does not tell its unit: with this one, the palm is 9 cm long."""


def marks_of(places: NDArray[np.float64]) -> Any:
    return SimpleNamespace(landmark=[SimpleNamespace(x=x, y=y) for x, y in places])


def side_of(score: float) -> Any:
    return SimpleNamespace(classification=[SimpleNamespace(score=score)])


def test_landmarks_are_pixels_with_the_confidence_of_their_hand() -> None:
    seen = seen_hands([marks_of(np.full((21, 2), 0.5))], [side_of(0.8)], (640, 480))
    assert seen.positions_px[0, 3].tolist() == [319.5, 239.5]
    assert seen.confidences == pytest.approx(np.full((1, 21), 0.8))


def test_an_image_without_hands_has_no_detections() -> None:
    seen = seen_hands(None, None, (640, 480))
    assert seen.positions_px.shape == (0, 21, 2)
    assert seen.confidences.shape == (0, 21)
    assert len(seen.ids) == 0


@pytest.mark.parametrize(("name", "value"), [("most_hands", 0), ("least_confidence", 1.5)])
def test_invalid_settings_are_refused(name: str, value: Any) -> None:
    with pytest.raises(SettingsError, match=name):
        HandDetectorSettings(**{name: value})


def numbers(path: Path) -> list[list[float]]:
    lines = path.read_text(encoding="utf-8").splitlines()
    return [[float(x) for x in line.split()] for line in lines if line.strip()[:1] in tuple("-0123456789")]


def rig_of_the_clip() -> CameraRig:
    cameras = {}
    for i in (0, 1):
        inner = numbers(CLIP / "camera_parameters" / f"c{i}.dat")
        outer = numbers(CLIP / "camera_parameters" / f"rot_trans_c{i}.dat")
        lens = np.array([inner[0][0], inner[1][1], inner[0][2], inner[1][2], *inner[3]])
        T = rigid(np.array(outer[:3]), M_PER_UNIT * np.array(outer[3:6])[:, 0])
        cameras[f"cam{i}"] = PlacedCamera(Camera(f"cam{i}", SIZE, lens), T, np.full((6, 6), np.nan))
    return CameraRig(cameras)


@pytest.mark.slow
def test_a_real_hand_before_two_webcams_is_one_right_hand_with_constant_bones() -> None:
    cv2 = pytest.importorskip("cv2")
    if KEYPOINT_DETECTORS.find("mediapipe-hands").missing() or not CLIP.is_dir():
        pytest.skip("needs MediaPipe and the clip stereo_hand_webcams")
    rig = rig_of_the_clip()
    tracker, shown, away = WebcamsTracker(rig), [], []
    films = [cv2.VideoCapture(str(CLIP / f"cam{i}_test.mp4")) for i in (0, 1)]
    detectors = [make_keypoint_detector("mediapipe-hands", {"most_hands": 1}) for _ in films]
    for k in range(150):
        at_ns = 1_000_000_000 + k * 1_000_000_000 // 30
        for i, (film, detector) in enumerate(zip(films, detectors, strict=True)):
            seen = detector.update(film.read()[1], k / 30)
            frame = frame_of(seen, detector.topology, f"cam{i}", at_ns, SIZE)
            scene = tracker.update(Arrival(frame, at_ns))
        shown += [scene.hands]
        for hand in scene.hands:
            for i, placed in enumerate(rig.cameras.values()):
                if i == int(frame.sensor[-1]) and len(frame.ids):
                    px = project(apply(placed.T_camera_world, hand.landmarks), placed.camera.lens)
                    away.append(np.linalg.norm(px - frame.positions_px[0], axis=1))
    assert max(map(len, shown)) == 1
    hands = [one[0] for one in shown if one]
    assert len(hands) > 0.9 * len(shown)
    assert len({hand.id for hand in hands}) == 1
    assert not hands[-1].left
    assert np.mean([hand.states == JointState.TRACKED for hand in hands]) > 0.8
    x = np.array([hand.landmarks for hand in hands[-60:]])
    bones = np.linalg.norm(x[:, 1:] - x[:, list(PARENTS[1:])], axis=2)
    # Bones change only when a new size is taken, which happens once in these instants.
    assert np.median(bones.std(axis=0) / bones.mean(axis=0)) < 0.08
    assert np.median(away) < 10.0
