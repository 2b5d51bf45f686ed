"""What a node that detects keypoints counts and says: people, skipped images, black images, and no colours."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.known_people import KnownPeople, brightness, joints_at, placed

from mocapella.errors import NotNowError, WireError
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.live.camera_node import WARN_AFTER_S
from mocapella.live.keypoint_work import KeypointWork, dead
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.picture_source import Picture
from mocapella.testing import FakeCamera
from mocapella.wire.expected import write_expected


def keypoint_work() -> KeypointWork:
    return KeypointWork("left", Acquisition(FakeCamera(name="nothing")), KnownPeople())


def grey(level: int, number: int = 0) -> Picture:
    image = np.full((480, 640, 3), level, np.uint8)
    image[::16] = np.minimum(image[::16] + (9 if level else 0), 255)  # a picture is never of one colour
    return Picture(image, 1 + 10**8 * number, number, 0.1 * number, 0.0)


def test_a_frame_has_the_people_of_its_image() -> None:
    made = keypoint_work()
    frame = made.look(grey(brightness(1), 3))
    one = placed(1)
    np.testing.assert_allclose(
        frame.positions_px[0], project(apply(one.T_camera_world, joints_at(0.3)), one.camera.lens), atol=0.01
    )
    assert (frame.sensor, frame.time_ns, frame.size_px, frame.bodies) == ("left", 1 + 3 * 10**8, (640, 480), 1)
    assert made.look(grey(0, 4)).bodies == 0
    report = made.report()
    assert (report["images"], report["with_people"], report["people"]) == (2, 1, 0)
    assert made.newest is not None
    assert made.newest.frame.names == ()


@given(st.floats(0, 0.3), st.floats(0, 0.3))
def test_what_is_too_old_is_not_sent_and_counted(took_s: float, age_s: float) -> None:
    made = keypoint_work()
    assert made.in_time(took_s, age_s, 0.2) == (age_s <= 0.2)
    assert (made.late, made.too_late) == (int(took_s > 1 / 30), int(age_s > 0.2))
    assert made.report()["p99_ms"] == pytest.approx(1e3 * age_s)


def test_the_detector_searches_where_people_were_expected_a_short_time_ago() -> None:
    finds = KnownPeople()
    made = KeypointWork("left", Acquisition(FakeCamera(name="nothing")), finds)
    made.look(grey(brightness(1), 3))
    made.expect(write_expected(1 + 3 * 10**8, np.array([[1, 2, 30, 40]], np.float32)))
    for number in (4, 8, 9, 2):  # 0.1, 0.5, 0.6 and −0.1 s later
        made.look(grey(brightness(1), number))
    assert [None if one is None else one.tolist() for one in finds.regions] == [
        None, [[1, 2, 30, 40]], [[1, 2, 30, 40]], None, None,
    ]  # fmt: skip
    made.expect(write_expected(1 + 9 * 10**8, np.empty((0, 4), np.float32)))
    made.look(grey(brightness(1), 10))
    assert finds.regions[-1].shape == (0, 4)
    assert made.report()["with_expected"] == 2
    with pytest.raises(WireError, match="expected people"):
        made.expect(b"people")


def test_skipped_images_are_reported_as_a_share_with_advice() -> None:
    camera = FakeCamera()
    with Acquisition(camera) as acquisition:
        made = KeypointWork("left", acquisition, KnownPeople())
        for number in range(20):
            acquisition._put(grey(60, number))
            if number % 2:
                picture = acquisition.take(0.0)
                assert picture is not None
                made.look(picture)
        assert made.report()["skipped_share"] == 0.5
        list(made.warnings(0.0))
        (text,) = [one for one in made.warnings(WARN_AFTER_S + 1) if "skipped" in one]
        assert "50 % of the images are skipped" in text
        assert "drop_after_ms" not in text
        assert "50.0 % skipped" in made.words()


def test_a_detector_that_is_too_slow_for_every_image_is_told_of_the_limit() -> None:
    """Nothing at all is sent then, and a faster camera does not help."""
    with Acquisition(FakeCamera()) as acquisition:
        made = KeypointWork("left", acquisition, KnownPeople())
        for number in range(4):
            acquisition._put(grey(60, number))
            picture = acquisition.take(0.0)
            assert picture is not None
            made.look(picture)
            assert not made.in_time(0.7, 0.75, 0.2)
        list(made.warnings(0.0))
        (text,) = [one for one in made.warnings(WARN_AFTER_S + 1) if "skipped" in one]
    assert "keypoints older than 200 ms are not sent, and a detection takes 700 ms" in text
    assert "--set drop_after_ms=1000" in text


@pytest.mark.parametrize(
    ("level", "spread", "found"), [(0, 0, "black"), (10, 4, "black"), (100, 0, "of one colour"), (100, 40, "")]
)
def test_images_that_show_nothing_are_named(level: int, spread: int, found: str) -> None:
    image = np.full((64, 64, 3), level, np.uint8)
    image[:32] += np.uint8(spread)
    assert dead(image) == found


def test_a_covered_lens_is_warned_of_once_and_its_end_told() -> None:
    made = keypoint_work()
    list(made.warnings(0.0))
    made.look(grey(0))
    assert [text for text in made.warnings(10.0) if "black" in text] != []
    made.look(grey(60, 1))
    assert list(made.warnings(200.0)) == ["image: well again"]


def test_colours_are_refused() -> None:
    made = keypoint_work()
    assert (made.names, made.detector) == ((), None)
    with pytest.raises(NotNowError, match="node markers"):
        made.use(None)  # type: ignore[arg-type]
