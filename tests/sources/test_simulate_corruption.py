"""Pictures made worse: as much as said, the same again by the seed, and nothing where nothing is said."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mocapella.errors import SettingsError
from mocapella.sources.simulate.corruption import WRONG, Corruption

IMAGE = np.random.default_rng(0).integers(60, 180, (120, 160, 3), dtype=np.uint8)


def changed(corruption: Corruption, frame: int = 3, camera: int = 0) -> np.ndarray[Any, Any]:
    return (corruption.of(IMAGE, frame, camera) != IMAGE).any(axis=-1)


def test_nothing_said_is_nothing_done() -> None:
    np.testing.assert_array_equal(Corruption().of(IMAGE, 5), IMAGE)


@given(st.floats(0, 1), st.integers(0, 1000))
def test_as_many_pixels_are_noise_as_said(share: float, seed: int) -> None:
    hit = changed(Corruption(noise=share, seed=seed)).mean()
    assert hit == pytest.approx(share, abs=5 * np.sqrt(0.25 / IMAGE[..., 0].size) + 1e-6)


def test_noise_is_all_values_alike() -> None:
    noisy = Corruption(noise=1.0).of(IMAGE, 0)
    counts = np.bincount(noisy.ravel(), minlength=256)
    assert counts.min() > 0.6 * counts.mean()


@given(st.integers(0, 1000), st.integers(0, 1000), st.integers(0, 7))
def test_the_same_seed_frame_and_camera_give_the_same_and_others_do_not(seed: int, frame: int, camera: int) -> None:
    worse = Corruption(noise=0.15, rectangles=3, seed=seed)
    image = worse.of(IMAGE, frame, camera)
    np.testing.assert_array_equal(image, Corruption(noise=0.15, rectangles=3, seed=seed).of(IMAGE, frame, camera))
    for other in ((frame + 1, camera), (frame, camera + 1)):
        assert (image != worse.of(IMAGE, *other)).any()
    assert (image != Corruption(noise=0.15, rectangles=3, seed=seed + 1).of(IMAGE, frame, camera)).any()


def test_the_picture_itself_stays_as_it_is() -> None:
    before = IMAGE.copy()
    Corruption(noise=0.5, rectangles=9, wrong=0.5).of(IMAGE, 1)
    np.testing.assert_array_equal(IMAGE, before)


@given(st.integers(0, 200), st.floats(0.05, 0.6))
def test_a_rectangle_is_no_larger_than_said(seed: int, share: float) -> None:
    hit = changed(Corruption(rectangles=1, rectangle_share=share, seed=seed))
    rows, columns = np.flatnonzero(hit.any(axis=1)), np.flatnonzero(hit.any(axis=0))
    assert hit.any()
    assert max(np.ptp(rows), np.ptp(columns)) < max(share * max(IMAGE.shape), 2)


def test_wrong_frames_are_those_that_are_named_and_as_many_more_as_said() -> None:
    named = Corruption(wrong_frames=(4, 9))
    assert [k for k in range(20) if named.is_wrong(k)] == [4, 9]
    some = Corruption(wrong=0.1, seed=3)
    assert np.mean([some.is_wrong(k) for k in range(4000)]) == pytest.approx(0.1, abs=0.02)


def test_cameras_frames_are_wrong_by_themselves_as_often_as_said() -> None:
    worse = Corruption(wrong_each=0.2, wrong_from=5, seed=1)
    wrong = np.array([[worse.is_wrong(k, camera) for camera in range(3)] for k in range(2000)])
    assert not wrong[:5].any()
    assert wrong.mean(axis=0) == pytest.approx([0.2] * 3, abs=0.03)
    assert np.abs(np.corrcoef(wrong.T) - np.eye(3)).max() < 0.08
    assert not any(worse.is_wrong(k) for k in range(100)), "in all cameras at once none is"
    assert [changed(worse, k, 1).mean() > 0.9 for k in range(40)] == wrong[:40, 1].tolist()


@pytest.mark.parametrize("kind", WRONG)
def test_a_wrong_frame_has_little_of_the_picture(kind: str) -> None:
    worse = Corruption(wrong_frames=(2,), wrong_kind=kind)
    assert changed(worse, 2).mean() > 0.9
    assert not changed(worse, 3).any()


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"noise": 1.1}, "noise is 1.1"),
        ({"rectangles": -1}, "rectangles is -1"),
        ({"rectangle_share": 0.0}, "rectangle_share is 0.0"),
        ({"wrong": -0.1}, "wrong is -0.1"),
        ({"wrong_frames": (-3,)}, "wrong_frames"),
        ({"wrong_kind": "blak"}, "black"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_what_cannot_be_is_said(wrong: dict[str, Any], says: str) -> None:
    with pytest.raises(SettingsError, match=says):
        Corruption(**wrong)


def test_blocks_are_coarser_the_larger_their_steps_are_and_keep_their_mean() -> None:
    smooth = np.repeat(np.add.outer(np.arange(61), np.arange(75))[:, :, None], 3, axis=2).astype(np.uint8)
    far = []
    for levels in (5.0, 20.0, 80.0):
        coarse = Corruption(blocks=levels).of(smooth, 0)
        assert coarse.shape == smooth.shape
        assert np.abs(coarse.mean() - smooth.mean()) < levels / 16
        far.append(np.abs(coarse.astype(int) - smooth).mean())
    assert far == sorted(far)
    assert far[0] < 2 < far[2]


def test_blocks_do_not_know_of_each_other() -> None:
    image = IMAGE.copy()
    image[8:16, 16:24] = 255
    differ = (Corruption(blocks=30.0).of(image, 0) != Corruption(blocks=30.0).of(IMAGE, 0)).any(axis=-1)
    rows, columns = np.nonzero(differ)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (8, 15, 16, 23)


def test_blocks_out_of_range_are_refused() -> None:
    with pytest.raises(SettingsError, match="blocks"):
        Corruption(blocks=-1.0)
