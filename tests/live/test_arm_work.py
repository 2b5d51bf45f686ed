"""What a depth camera's node counts and says: arms, late, empty, too few, none found; and what ends it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.nearest_arm import NearestArm

from mocapella.errors import InputError
from mocapella.live.arm_work import ArmWork, independent_after_s, rough_arm
from mocapella.live.camera_node import WARN_AFTER_S
from mocapella.model.camera import Camera
from mocapella.schema import decode_frame, encode_frame
from mocapella.sources.acquisition import Acquisition, AcquisitionReport
from mocapella.sources.depth_options import complete
from mocapella.sources.picture_source import Picture, SourceState
from mocapella.testing import FakeCamera

LENS = (12.0, 12.0, 7.5, 5.5, 0.0, 0.0, 0.0, 0.0, 0.0)
STATE = SourceState((16, 12), 20.0, problems=("a screw is loose",), unit_m=0.001, lens=LENS)


def work() -> ArmWork:
    acquisition, camera = Acquisition(FakeCamera(STATE, name="nothing")), complete(STATE, "nothing")
    return ArmWork("arm", acquisition, camera, NearestArm(camera))


def picture(number: int, value: int = 700, shape: tuple[int, int] = (12, 16)) -> Picture:
    image = np.full(shape, value, np.uint16)
    return Picture(image, 1 + 50_000_000 * number, number, 0.05 * number, 0.0)


def said(made: ArmWork, begin: int, value: int, count: int = 8) -> list[str]:
    """What it warns of after so many images."""
    for k in range(begin, begin + count):
        made.look(picture(k, value))
    return list(made.warnings(begin + count + WARN_AFTER_S))


def test_arms_and_images_are_frames_that_can_be_sent() -> None:
    made = work()
    assert isinstance(made.detector, NearestArm)
    assert made.detector.times == []  # what it compiled with is forgotten
    frame, image = made.look(picture(3)), made.depth(picture(3))
    assert (frame.sensor, frame.time_ns, frame.size_px, frame.method) == ("arm", 150_000_001, (16, 12), "nearest")
    assert frame.bodies == 1
    assert made.detector.times == [0.150000001]
    assert encode_frame(decode_frame(encode_frame(frame))) == encode_frame(frame)
    back = decode_frame(encode_frame(image))
    np.testing.assert_array_equal(back.depth, picture(3).image)
    assert (back.unit_m, back.lens.tolist()) == (0.001, list(LENS))


@pytest.mark.parametrize(("fps", "after_s"), [(None, None), (1.5, None), (5.0, 3600.0), (30.0, 3600.0)])
def test_only_images_of_a_slow_source_may_be_no_video(fps: float | None, after_s: float | None) -> None:
    assert independent_after_s(fps) == after_s


def test_what_it_compiles_with_is_an_arm_at_the_lower_edge() -> None:
    camera = Camera("depth", (64, 48), np.array([48.0, 48.0, 31.5, 23.5, 0, 0, 0, 0, 0]))
    depth = rough_arm(camera)
    assert (depth.shape, depth.dtype) == ((48, 64), np.float32)
    assert set(np.unique(depth).tolist()) == {0.0, np.float32(0.7).item()}
    assert depth[-1].any()
    assert not any(edge.any() for edge in (depth[0], depth[:, 0], depth[:, -1]))


def test_empty_images_and_missing_arms_are_said_when_they_begin_and_end() -> None:
    made = work()
    assert list(made.warnings(0.0)) == []
    assert said(made, 0, 700) == []
    assert said(made, 10, 0) == ["nothing is measured in 100 % of the images; is it covered?"]
    assert said(made, 20, 0) == []
    assert said(made, 30, 700) == ["images: well again"]
    report = made.report()
    assert (report["looked_at"], report["with_arms"], report["empty"], report["damaged"]) == (32, 16, 16, 0)
    assert report["problems"] == ["a screw is loose"]
    assert report["median_ms"] > 0
    assert "arms in 50.0 %" in made.words()


def test_that_no_arm_is_found_is_said_with_the_detectors_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    made = work()
    list(made.warnings(0.0))
    found = made.detector.update(np.ones((12, 16), np.float32), 0.0)
    nobody = type(found)((), "nobody is near")
    monkeypatch.setattr(made.detector, "update", lambda depth, at_s: nobody)
    assert said(made, 0, 700) == ["no arm is found: nobody is near"]
    assert made.report()["reasons"] == {"nobody is near": 8}
    assert "the median distance is 70 cm" in made.report()["problems"][-1]
    monkeypatch.setattr(made.detector, "update", lambda depth, at_s: found)
    assert said(made, 10, 700) == ["arms: well again"]
    assert made.report()["problems"] == ["a screw is loose"]


def test_late_looks_are_counted_and_what_is_too_late_is_not_sent() -> None:
    made = work()
    assert made.in_time(0.01, 0.02, 0.1)
    assert made.in_time(0.06, 0.08, 0.1)  # longer than the twentieth of a second between two
    assert not made.in_time(0.2, 0.21, 0.1)
    assert (made.late, made.too_late) == (2, 1)


def test_too_few_images_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    made = work()
    list(made.warnings(0.0))
    for live, advice in ((True, "a USB port of its own"), (False, "too busy")):
        slow = AcquisitionReport(100, 0, 0, 10.0, 20.0, live)
        monkeypatch.setattr(made.acquisition, "report", lambda slow=slow: slow)
        assert made.report()["problems"][0].startswith("gives 10.0 images a second, not 20;")
        assert advice in made.report()["problems"][0]
    assert "10.0 a second" in made.words()


def test_a_wrong_unit_ends_it_and_so_does_another_camera() -> None:
    made = work()
    with pytest.raises(InputError, match="median distance would be"):
        made.look(picture(0, 30))
    made = work()
    with pytest.raises(InputError, match=r"gives 8 × 6 px now.*start the node again"):
        made.look(picture(0, shape=(6, 8)))
    made.acquisition.state = replace(STATE, problems=())
    made.look(picture(1))  # the same camera, there again
    made.acquisition.state = replace(STATE, unit_m=0.0001)
    with pytest.raises(InputError, match="another lens or unit"):
        made.look(picture(2))
