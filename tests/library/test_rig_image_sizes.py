"""Keypoints of images of another size than the rig's are refused; those of another room are not mistaken for them."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
from support.keypoint_folders import RATE_HZ, frames_of, walkers, write_openpose

from mocapella.errors import InputError
from mocapella.library.people_calibration import detected_frames
from mocapella.library.people_triangulation import triangulate_people
from mocapella.library.rig_image_sizes import check_image_sizes
from mocapella.model.camera import CameraRig, PlacedCamera
from mocapella.model.camera_rig_file import load_camera_rig
from mocapella.model.keypoints import KeypointFrame, keypoint_frame
from mocapella.model.topology import topology
from mocapella.recording.detection_files import read_detections

FRAMES = 24
Frames = dict[str, list[KeypointFrame]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sizes")
    write_openpose(path, walkers(FRAMES))
    return path


@pytest.fixture(scope="module")
def rig(folder: Path) -> CameraRig:
    return load_camera_rig(folder / "rig.toml")


@pytest.fixture(scope="module")
def frames(folder: Path, rig: CameraRig) -> Frames:
    return frames_of(folder, rig)


def scaled(placed: PlacedCamera, scale: float) -> PlacedCamera:
    lens = placed.camera.lens.copy()
    lens[:4] *= scale
    size = tuple(round(scale * side) for side in placed.camera.size_px)
    return PlacedCamera(
        msgspec.structs.replace(placed.camera, size_px=size, lens=lens), placed.T_camera_world, placed.covariance
    )


def of_rig(frames: Frames, rig: CameraRig) -> Frames:
    sizes = {name: rig.cameras[name].camera.size_px for name in frames}
    return {name: [msgspec.structs.replace(f, size_px=sizes[name]) for f in some] for name, some in frames.items()}


def test_keypoints_of_the_rigs_images_are_taken(frames: Frames, rig: CameraRig) -> None:
    check_image_sizes(frames, rig, file="pose")
    check_image_sizes({name: some[:0] for name, some in frames.items()}, rig, file="pose")


@pytest.mark.parametrize("scale", [1.5, 2.0, 3.0])
def test_a_rig_for_larger_images_is_refused_with_the_likely_size(frames: Frames, rig: CameraRig, scale: float) -> None:
    larger = CameraRig({name: scaled(placed, scale) for name, placed in rig.cameras.items()})
    width, height = next(iter(rig.cameras.values())).camera.size_px
    with pytest.raises(InputError, match=rf"pose: .*agree about people if the images have {width} × {height} px; give"):
        check_image_sizes(of_rig(frames, larger), larger, file="pose")


def test_a_rig_for_smaller_images_is_refused(frames: Frames, rig: CameraRig) -> None:
    smaller = CameraRig({name: scaled(placed, 1 / 3) for name, placed in rig.cameras.items()})
    with pytest.raises(InputError, match=r"pose: field camera .* of its keypoints are outside the .* px that the rig"):
        check_image_sizes(of_rig(frames, smaller), smaller, file="pose")


@pytest.mark.parametrize("seed", range(3))
def test_keypoints_of_other_rooms_are_no_matter_of_size(rig: CameraRig, seed: int) -> None:
    """Each camera sees people of its own, whom no scale makes one: that is reported elsewhere."""
    rng, of = np.random.default_rng(seed), topology("halpe_26")
    frames: Frames = {}
    for name, placed in rig.cameras.items():
        width, height = placed.camera.size_px
        frames[name] = []
        for k in range(FRAMES):
            shape = rng.normal(0.0, 0.08 * height, (1, len(of), 2)) + rng.uniform(0.3, 0.7, 2) * [width, height]
            one = keypoint_frame(
                name, of, time_ns=10**9 + k, size_px=(width, height), positions_px=shape, confidences=0.9, sequence=k
            )
            frames[name].append(one)
    check_image_sizes(frames, rig, file="pose")


def test_triangulation_refuses_a_rig_for_another_size(folder: Path, rig: CameraRig) -> None:
    larger = CameraRig({name: scaled(placed, 2.0) for name, placed in rig.cameras.items()})
    with pytest.raises(InputError, match="give a rig for the size of the images"):
        triangulate_people([one for one in sorted(folder.iterdir()) if one.is_dir()], larger, fps=RATE_HZ)


def test_a_calibration_refuses_a_stated_size_that_the_keypoints_exceed(folder: Path) -> None:
    found = read_detections([one for one in sorted(folder.iterdir()) if one.is_dir()])
    assert detected_frames(found, None, (640, 480), RATE_HZ)
    with pytest.raises(InputError, match=r"outside the 160 × 120 px that --size has; give the size .* with --size"):
        detected_frames(found, None, (160, 120), RATE_HZ)


def test_normalised_keypoints_are_refused_with_the_factors(frames: Frames, rig: CameraRig) -> None:
    width, height = next(iter(rig.cameras.values())).camera.size_px
    size = np.array([width, height], np.float32)
    parts = {
        name: [msgspec.structs.replace(one, positions_px=one.positions_px / size) for one in some]
        for name, some in frames.items()
    }
    with pytest.raises(InputError, match=rf"parts of the image's size; .*x by the width, here {width}, and y by the"):
        check_image_sizes(parts, rig, file="pose")
