"""Films of clips: the lag of keypoints behind images is measured without a reference, and used to align one."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.webcam_clips import DATA

from mocapella.detectors.keypoint_detector import SeenPeople
from mocapella.errors import SettingsError
from mocapella.evaluation.keypoint_clips import KeypointClip, pose2sim_clip
from mocapella.evaluation.keypoint_films import FILMS, LAGS, evaluate_films, films_of, lag_behind_images, peak, shifted
from mocapella.evaluation.webcams import score_clip
from mocapella.model.camera import CameraRig
from mocapella.model.keypoints import KeypointFrame, keypoint_frame
from mocapella.model.topology import topology
from mocapella.sensing.point_motion import grey, point_motion
from mocapella.sources.frame_set import FrameSet

HALPE = topology("halpe_26")
SIZE = (320, 240)
TEXTURE = np.random.default_rng(3).integers(0, 256, (60, 80, 3)).astype(np.uint8).repeat(8, axis=0).repeat(8, axis=1)


def places(count: int) -> np.ndarray:
    """Where a textured wall is in each image: (count, 2) whole pixels, with changing speed."""
    t = np.arange(count)
    return np.stack([60 + 40 * np.sin(0.45 * t), 60 + 25 * np.cos(0.31 * t)], axis=-1).round().astype(int)


def film(count: int) -> list[FrameSet]:
    images = [TEXTURE[y : y + SIZE[1], x : x + SIZE[0]] for x, y in places(count)]
    return [FrameSet.at_rate(k, 30.0, {"left": image}) for k, image in enumerate(images)]


def keypoints(count: int, lag: int) -> list[list[KeypointFrame]]:
    """Keypoints on the wall as of the image ``lag`` frames earlier."""
    at = -places(count).astype(float)
    spread = np.random.default_rng(1).uniform([150, 120], [280, 200], (26, 2))
    rows = []
    for k in range(count):
        px = (spread + at[min(max(k - lag, 0), count - 1)])[None]
        rows.append([keypoint_frame("left", HALPE, time_ns=k + 1, size_px=SIZE, positions_px=px, confidences=0.9)])
    return rows


@pytest.mark.parametrize("lag", [-2, -1, 0, 1, 2])
def test_a_known_lag_is_measured(lag: int) -> None:
    assert lag_behind_images(film(40), keypoints(40, lag), LAGS) == pytest.approx(lag, abs=0.3)


def test_still_images_and_empty_frames_tell_no_lag() -> None:
    still = [FrameSet.at_rate(k, 30.0, {"left": TEXTURE[:240, :320]}) for k in range(20)]
    assert np.isnan(lag_behind_images(still, keypoints(20, 0), LAGS))
    nobody = [[keypoint_frame("left", HALPE, time_ns=k + 1, size_px=SIZE, positions_px=[])] for k in range(20)]
    assert np.isnan(lag_behind_images(film(20), nobody, LAGS))
    assert np.isnan(lag_behind_images(film(5), keypoints(5, 0), LAGS))


@given(st.floats(-3.0, 3.0), st.floats(0.1, 10.0))
def test_the_peak_of_a_parabola_is_exact(place: float, bend: float) -> None:
    at = np.arange(-4, 5)
    assert peak(at, 1.0 - bend * (at - place) ** 2) == pytest.approx(place, abs=1e-6)
    assert np.isnan(peak(at, np.full(9, np.nan)))


def test_a_peak_at_the_end_is_the_end() -> None:
    assert peak(np.arange(3), np.array([3.0, 2.0, 1.0])) == 0.0


@settings(max_examples=20)
@given(st.integers(-3, 3))
def test_a_reference_is_shifted_and_ends_where_it_has_nothing(lag: int) -> None:
    reference = np.arange(10.0)[None, :, None, None] * np.ones((1, 1, 26, 3))
    clip = shifted(KeypointClip("c", CameraRig({}), ((),) * 10, reference, 60.0), lag)
    expected = np.arange(10.0) + lag
    expected[(expected < 0) | (expected > 9)] = np.nan
    np.testing.assert_array_equal(clip.reference[0, :, 0, 0], expected)


def test_points_move_as_the_image_does() -> None:
    before, after = (grey(TEXTURE[y : y + 240, x : x + 320]) for x, y in ((60, 60), (57, 64)))
    moved = point_motion(before, after, np.array([[100.0, 100.0], [np.nan, 1.0], [200.0, 150.0]]))
    np.testing.assert_allclose(moved[[0, 2]], [[3.0, -4.0]] * 2, atol=0.2)
    assert np.isnan(moved[1]).all()


@pytest.mark.slow
def test_the_films_of_the_clip_are_one_image_later_than_its_keypoint_files() -> None:
    """OpenPose's files of the recording: measured with the images alone, as is the evaluation's ``aligned``."""
    if not (DATA / FILMS[0]).is_dir():
        pytest.skip(f"{FILMS[0]} is not there")
    clip = pose2sim_clip(DATA, FILMS[0])
    assert lag_behind_images(films_of(DATA, clip), clip.frames, LAGS) == pytest.approx(-1.0, abs=0.5)


class Told:
    """A detector that gives the keypoints of a clip's files for the images of one camera, one after the other."""

    topology = HALPE

    def __init__(self, clip: KeypointClip, camera: int) -> None:
        self._frames = iter([row[camera] for row in clip.frames])

    def update(self, image: np.ndarray, at_s: float, regions_px: np.ndarray | None = None) -> SeenPeople:
        frame = next(self._frames, None)
        if frame is None:  # the film is longer than the files
            return SeenPeople(np.empty(0, np.int64), np.empty((0, 26, 2), np.float32), np.empty((0, 26), np.float32))
        return SeenPeople(frame.ids, frame.positions_px, frame.confidences)


@pytest.mark.slow
def test_films_with_the_clips_own_keypoints_score_as_the_clip_and_have_one_lag() -> None:
    if not (DATA / FILMS[0]).is_dir():
        pytest.skip(f"{FILMS[0]} is not there")
    clip = pose2sim_clip(DATA, FILMS[0])
    cameras = itertools.count()
    found, targets = evaluate_films(DATA, lambda: Told(clip, next(cameras)))
    films = found[FILMS[0]]
    (own,) = score_clip(clip).people
    (as_is,) = films["as_is"]["people"]
    assert as_is["median_mm"] == pytest.approx(own.median_mm, abs=0.5)
    assert films["detector_lag_frames"] == pytest.approx(films["reference_lag_frames"], abs=1e-6)
    assert films["aligned"]["people"][0]["median_mm"] > as_is["median_mm"]  # these keypoints are the reference's own
    assert targets[f"films of {FILMS[0]}: median_mm"]["met"]
    with pytest.raises(SettingsError, match="nothing"):
        evaluate_films(DATA, lambda: Told(clip, 0), {"nothing": 1})
