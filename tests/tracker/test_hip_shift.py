"""The places of MediaPipe's hips, by a recording of MediaPipe's keypoints and proportions of the human body."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.association.keypoint_rays import BONES, SHARES, halpe_keypoints, sources_named
from mocapella.evaluation.keypoint_clips import mediapipe_clip
from mocapella.fusion.one_camera import camera_of_view
from mocapella.fusion.point_tracks import triangulate_tracks
from mocapella.geometry.lens import undistort
from mocapella.model.keypoints import keypoint_frame
from mocapella.model.topology import topology
from mocapella.recording.image_tracks_file import read_image_tracks
from mocapella.tracker.one_webcam import OneWebcamTracker
from mocapella.tracker.silhouette_keypoints import seen_keypoints

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
HALPE, MEDIAPIPE = topology("halpe_26"), topology("mediapipe_pose")
SHIFTS = MEDIAPIPE.shifts["halpe_26"]


def share_of(bone: str) -> float:
    """A bone's length relative to the stature, of Drillis and Contini."""
    one, other = bone.split()
    pair = {HALPE.index(f"L{one}"), HALPE.index(f"L{other}")}
    return float(next(share for ends, share in zip(BONES, SHARES, strict=True) if set(ends) == pair))


@pytest.mark.slow
def test_trunk_and_thigh_have_human_proportions_with_the_shift() -> None:
    if not (DATA / "mediapipe_holistic_4cam").is_dir():
        pytest.skip("mediapipe_holistic_4cam is not there")
    folder = DATA / "mediapipe_holistic_4cam"
    tracks = read_image_tracks([folder / "recording_1" / "HOLISTIC" / "xy_HOLISTIC.csv"])
    space, _ = triangulate_tracks(tracks, mediapipe_clip(DATA).rig)
    trunks, thighs = [], []
    for shoulder, hip, knee in ((11, 23, 25), (12, 24, 26)):  # MediaPipe's numbers, left and right
        at = [space.positions[:, space.points.index(str(number))] for number in (shoulder, hip, knee)]
        moved = at[1] + SHIFTS[HALPE.index("LHip")][1] * (at[0] - at[1])
        trunks += [np.linalg.norm(at[0] - hips, axis=-1) for hips in (at[1], moved)]
        thighs += [np.linalg.norm(at[2] - hips, axis=-1) for hips in (at[1], moved)]
    expected = share_of("Shoulder Hip") / share_of("Hip Knee")
    before, after = (np.nanmedian(trunks[k::2]) / np.nanmedian(thighs[k::2]) for k in (0, 1))
    assert before > 1.02 * expected
    assert after == pytest.approx(expected, rel=0.05)


@given(st.floats(-1000, 1000), st.floats(-1000, 1000), st.booleans())
def test_hips_move_towards_seen_shoulders_and_all_other_joints_stay(x: float, y: float, seen: bool) -> None:
    pixels = np.random.default_rng(0).normal(size=(2, 33, 2))
    sure = np.ones((2, 33))
    hip, shoulder = MEDIAPIPE.index("LEFT_HIP"), MEDIAPIPE.index("LEFT_SHOULDER")
    pixels[0, hip], pixels[0, shoulder] = (x, y), (x + 100.0, y - 200.0)
    sure[0, shoulder] = float(seen)
    before = pixels.copy()
    places, confidences = halpe_keypoints("mediapipe_pose", pixels, sure)
    np.testing.assert_array_equal(pixels, before)
    share = SHIFTS[HALPE.index("LHip")][1] if seen else 0.0
    np.testing.assert_allclose(places[0, HALPE.index("LHip")], [x + 100.0 * share, y - 200.0 * share], atol=1e-9)
    sources = sources_named("mediapipe_pose")
    assert sources is not None
    still = [j for j in range(26) if sources[j] >= 0 and j not in SHIFTS]
    np.testing.assert_array_equal(places[:, still], pixels[:, sources[still]])
    assert (confidences[:, sources < 0] == 0.0).all()
    assert confidences[0, HALPE.index("LShoulder")] == float(seen)


def test_keypoints_of_halpe_stay() -> None:
    pixels = np.random.default_rng(1).normal(size=(3, 26, 2))
    places, _ = halpe_keypoints("halpe_26", pixels, np.ones((3, 26)))
    np.testing.assert_array_equal(places, pixels)


def test_one_webcam_and_silhouettes_shift_hips_as_webcams_does() -> None:
    rng = np.random.default_rng(2)
    pixels, relative = rng.uniform(0.0, 400.0, (1, 33, 2)), rng.normal(size=(1, 33, 3))
    frame = keypoint_frame(
        "cam0", MEDIAPIPE, time_ns=1, size_px=(640, 480), positions_px=pixels, confidences=0.9, relative=relative
    )
    lens = camera_of_view((640, 480), 1.1)
    slopes, body, _ = OneWebcamTracker()._seen(frame, 0, lens)
    beside = seen_keypoints(frame, 1)
    assert beside is not None
    for side, name in (("L", "LEFT"), ("R", "RIGHT")):
        hip, own, shoulder = (
            HALPE.index(f"{side}Hip"),
            MEDIAPIPE.index(f"{name}_HIP"),
            MEDIAPIPE.index(f"{name}_SHOULDER"),
        )
        share = SHIFTS[hip][1]
        place, there = (of[0, own] + share * (of[0, shoulder] - of[0, own]) for of in (pixels, relative))
        np.testing.assert_allclose(beside.pixels[0, hip], place, atol=1e-3)
        np.testing.assert_allclose(slopes[hip], undistort(place[None], lens)[0], atol=1e-5)
        np.testing.assert_allclose(body[hip], there, atol=1e-5)
