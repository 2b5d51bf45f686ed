"""Body frames of a depth camera with colour, in this process."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from mocapella.detectors.keypoint_detector import SeenPeople
from mocapella.errors import InputError, SettingsError
from mocapella.live.rgbd_work import RgbdWork, RoomDetector, lift_of
from mocapella.model.observations import JointState
from mocapella.model.skeleton import skeleton_mapping
from mocapella.model.topology import Topology, topology
from mocapella.sources.acquisition import Acquisition
from mocapella.sources.depth_options import DepthOptions
from mocapella.sources.open_depth import open_depth
from mocapella.sources.picture_source import ColourCamera, Picture, SourceState
from mocapella.sources.simulate.rendered_depth import RenderedDepth
from mocapella.sources.simulate.room_keypoints import KeypointErrors, RoomKeypoints
from mocapella.testing import FakeCamera

LENS = (580.0, 580.0, 319.5, 239.5, 0.0, 0.0, 0.0, 0.0, 0.0)
STATE = SourceState((640, 480), 30.0, unit_m=0.001, lens=LENS, colour=ColourCamera((640, 480), LENS))


class Nobody:
    """A detector that finds nobody."""

    def __init__(self, name: str = "coco_17") -> None:
        self.topology: Topology = topology(name)

    def update(self, image: object, at_s: float, regions_px: object = None) -> SeenPeople:
        return SeenPeople(np.zeros(0, np.int64), np.zeros((0, 17, 2), np.float32), np.zeros((0, 17), np.float32))

    def reset(self) -> None:
        pass


def room(scene: str) -> tuple[RenderedDepth, RoomDetector]:
    images = open_depth(f"rendered:room-{scene}/3/exact", DepthOptions(colour=True))
    assert isinstance(images, RenderedDepth)
    return images, RoomDetector(RoomKeypoints(images.scene, topology("coco_17"), KeypointErrors(0, 0, 0)))


def picture(images: RenderedDepth, at_s: float) -> Picture:
    return Picture(images.render(at_s), round(1e9 * at_s) + 1, 0, 0.0, 0.0, images.colour)


def test_a_rendered_person_becomes_a_body_with_the_joints_of_people() -> None:
    images, finds = room("stand")
    with Acquisition(images) as acquisition:
        work = RgbdWork("front", acquisition, finds)
        frames = [work.frame(picture(images, at_s)) for at_s in (8.0, 8.1)]
    first, second = frames
    assert (first.sensor, first.bodies, first.topology.name) == ("front", 1, "coco_17")
    assert first.tracking_ids.tolist() == second.tracking_ids.tolist() == [1]
    mapping = skeleton_mapping("coco_17")
    assert mapping is not None
    mapped = mapping.positions(first.positions.astype(float))[0]
    true = images.scene.at(8.0).people[0] * (-1, -1, 1)  # a body sensor's x is to its left, its y up
    tracked = mapping.states(first.states)[0] == JointState.TRACKED
    assert tracked.sum() >= 12
    assert np.median(np.linalg.norm(mapped - true, axis=-1)[tracked]) < 0.05
    report = work.report()
    assert (report["bodies"], report["not_in_space"], report["images"]) == (2, 0, 2)


def test_two_people_keep_their_ids_when_they_change_places() -> None:
    images, finds = room("exchange")
    with Acquisition(images) as acquisition:
        work = RgbdWork("front", acquisition, finds)
        ids = [work.frame(picture(images, float(at_s))).tracking_ids.tolist() for at_s in np.arange(7.0, 9.0, 0.1)]
    assert all(sorted(both) == [1, 2] for both in ids)


def test_a_covered_depth_camera_is_reported() -> None:
    images, finds = room("stand")
    shot = picture(images, 8.0)
    with Acquisition(images) as acquisition:
        work = RgbdWork("front", acquisition, finds)
        for _ in range(40):
            frame = work.frame(replace(shot, image=np.zeros_like(shot.image)))
            assert frame.bodies == 0
        assert any("no body in the depth images" in text for text in work.report()["problems"])
        assert work.report()["empty"] == 40


@pytest.mark.parametrize(
    ("state", "said"),
    [
        (replace(STATE, colour=None), "gives no colour images"),
        (replace(STATE, lens=None), "--intrinsics"),
        (replace(STATE, unit_m=None, lens=None), "--unit"),
    ],
)
def test_a_camera_that_does_not_tell_enough_is_refused(state: SourceState, said: str) -> None:
    with pytest.raises(InputError, match=said):
        lift_of(state, "camera")


def test_a_detector_whose_joints_are_not_peoples_is_refused() -> None:
    with Acquisition(FakeCamera(STATE)) as acquisition, pytest.raises(SettingsError, match="no mapping"):
        RgbdWork("front", acquisition, Nobody("hand"))


def test_images_without_colour_or_of_another_camera_end_the_node() -> None:
    with Acquisition(FakeCamera(STATE)) as acquisition:
        work = RgbdWork("front", acquisition, Nobody())
        depth = np.full((480, 640), 1500, np.uint16)
        colour = np.zeros((480, 640, 3), np.uint8)
        assert work.frame(Picture(depth, 1, 0, 0.0, 0.0, colour)).bodies == 0
        with pytest.raises(InputError, match="start the node again"):
            work.frame(Picture(depth, 2, 1, 0.0, 0.0))
        acquisition.state = replace(STATE, unit_m=0.0005)
        with pytest.raises(InputError, match="start the node again"):
            work.frame(Picture(depth, 3, 2, 0.0, 0.0, colour))


def test_a_wrong_unit_is_refused_at_the_first_image() -> None:
    with Acquisition(FakeCamera(replace(STATE, unit_m=1.0))) as acquisition:
        work = RgbdWork("front", acquisition, Nobody())
        colour = np.zeros((480, 640, 3), np.uint8)
        with pytest.raises(InputError, match="--unit"):
            work.frame(Picture(np.full((480, 640), 1500, np.uint16), 1, 0, 0.0, 0.0, colour))


def test_a_recorded_pair_is_a_source_of_bodies(tmp_path: Path) -> None:
    """Images of a room that are written into folders give the same bodies as the room itself."""
    images, finds = room("stand")
    for part in ("depth", "colour"):
        (tmp_path / part).mkdir()
    shot = picture(images, 8.0)
    assert shot.colour is not None
    cv2.imwrite(str(tmp_path / "depth" / "0.png"), np.asarray(shot.image))
    cv2.imwrite(str(tmp_path / "colour" / "0.png"), shot.colour)
    lens = ", ".join(map(str, images.scene.lens[:4]))
    text = f"unit_m = {images.scene.sensor.unit_m}\nlens = [{lens}]\n"
    (tmp_path / "depth" / "depth.toml").write_text(text, encoding="utf-8")
    recorded = open_depth(str(tmp_path), DepthOptions(colour=True))
    with Acquisition(images) as one, Acquisition(recorded) as other:
        direct = RgbdWork("front", one, finds).frame(shot)
        recorded.begin(0.0)
        read = recorded.read(threading.Event())
        assert read is not None
        again = RgbdWork("front", other, finds).frame(replace(read, time_ns=shot.time_ns))
    assert np.array_equal(direct.positions, again.positions, equal_nan=True)
