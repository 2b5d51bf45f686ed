"""The recording of a hand without a reference: reading, scale, and figures of consistency on a simulated one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.webcam_clips import DATA

from mocapella.errors import InputError
from mocapella.evaluation.hand_clips import CLIP, HandClip, read_hand_clip, scaled, score_hand_clip, triangulated
from mocapella.model.camera import PlacedCamera
from mocapella.model.hand import hand_model
from mocapella.model.keypoints import KeypointFrame
from mocapella.sources.simulate.hand_keypoints import hand_frames, hand_keypoint_scene

PALM_M = float(np.linalg.norm(hand_model("full").shape("right").bases[2]))


def simulated(seconds: float) -> HandClip:
    scene = hand_keypoint_scene("fist")
    instants: dict[int, list[KeypointFrame]] = {}
    for item in hand_frames(scene, 2, seconds=seconds):
        instants.setdefault(item.frame.sequence, []).append(item.frame)
    return HandClip(scene.rig, tuple(tuple(sorted(row, key=lambda frame: frame.sensor)) for row in instants.values()))


def test_a_rig_of_an_unknown_unit_is_scaled_to_an_average_palm() -> None:
    clip = simulated(0.5)
    large = {}
    for name, one in clip.rig.cameras.items():
        T = one.T_camera_world.copy()
        T[:3, 3] *= 40.0
        large[name] = PlacedCamera(one.camera, T, one.covariance)
    points = triangulated(scaled(large, clip.frames), clip.frames)
    palm = np.nanmedian(np.linalg.norm(points[:, 9] - points[:, 0], axis=1))
    assert palm == pytest.approx(PALM_M, rel=1e-6)


def test_a_recording_too_short_to_withhold_frames_has_no_figures_of_them() -> None:
    found = score_hand_clip(simulated(0.07))
    assert found.instants == 2
    assert np.isnan([found.withheld_px, found.withheld_percent, found.jitter_mm]).all()


@pytest.mark.slow
def test_withheld_detections_are_near_and_the_fit_is_steadier_than_its_detections() -> None:
    found = score_hand_clip(simulated(3.0))
    assert found.followed_percent == 100.0
    assert found.ids == 1
    assert found.seen_percent < found.withheld_percent < 8.0
    assert found.jitter_mm < found.detections_jitter_mm
    assert 5.0 < found.bones_percent < 20.0


def test_a_recording_without_its_files_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="c0"):
        read_hand_clip(tmp_path, lambda: pytest.fail("no detector is made"))
    (tmp_path / CLIP / "camera_parameters").mkdir(parents=True)
    for name in ("c0", "rot_trans_c0"):
        (tmp_path / CLIP / "camera_parameters" / f"{name}.dat").write_text("R:\n1 2 3\n", encoding="ascii")
    with pytest.raises(InputError, match="other numbers"):
        read_hand_clip(tmp_path, lambda: pytest.fail("no detector is made"))


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / CLIP).is_dir(), reason="no recordings")
def test_the_recorded_hand_is_followed() -> None:
    pytest.importorskip("mediapipe")
    from mocapella.detectors.mediapipe_hands import HandDetectorSettings, MediaPipeHands

    found = score_hand_clip(read_hand_clip(DATA, lambda: MediaPipeHands(HandDetectorSettings())))
    assert found.instants == 378
    assert found.followed_percent > 95.0
    assert found.ids == 1
    assert found.withheld_percent < 6.0
