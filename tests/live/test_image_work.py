"""What a node that sends images counts, and what its frames hold."""

from __future__ import annotations

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mocapella.live.image_work import ImageSettings, ImageWork
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import Picture
from mocapella.testing import FakeCamera


def pictures(count: int, seed: int = 0) -> list[Picture]:
    """Pictures of noise of more and more contrast, whose files differ in length."""
    rng = np.random.default_rng(seed)
    images = [rng.integers(0, 8 * (k + 1), (24, 32, 3)).astype(np.uint8) for k in range(count)]
    return [Picture(image, 10**9 + 50_000_000 * k, k, 0.05 * k, 0.0) for k, image in enumerate(images)]


def work(**changes: object) -> ImageWork:
    return ImageWork("left", Acquisition(FakeCamera(name="nothing")), ImageSettings(**changes))  # type: ignore[arg-type]


@settings(max_examples=10)
@given(count=st.integers(0, 5), seed=st.integers(0, 99))
def test_bytes_are_those_of_all_frames_together(count: int, seed: int) -> None:
    made = work()
    sizes = [len(made.frame(picture).data or b"") for picture in pictures(count, seed)]
    report = made.report()
    assert (report["sent"], report["bytes"]) == (count, sum(sizes))
    assert report["median_bytes"] == (round(np.median(sizes)) if sizes else 0)


def test_a_lossless_frame_is_the_picture_itself_from_when_it_was_taken() -> None:
    made = work(format="png", delay_s=0.25)
    (picture,) = pictures(1)
    frame = made.frame(picture)
    assert frame.data is not None
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(frame.data, np.uint8), cv2.IMREAD_COLOR), picture.image)
    assert frame.time_ns == picture.time_ns - 250_000_000
    assert made.newest is not None
    assert made.newest.picture is picture
