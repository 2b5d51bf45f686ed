"""The score of a body that was followed in a clip, of one that is made up: files, joints, keypoints, outlines."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mocapella.evaluation import silhouette_video as module
from mocapella.evaluation.silhouette_video import CONFIDENT, GROWN_PX, SCORED, images_of, rig_of, score_video
from mocapella.model.openpose_names import LANDMARKS

FRAMES = 4
NAMES = [LANDMARKS[name] for name in SCORED]
OTHER = ["nose", *NAMES]
"""Landmarks of the body, in another order than the scored joints."""


@pytest.fixture
def clip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A clip of two cameras; all joints are 20 mm off, and the reference lacks one."""
    (tmp_path / "pose-3d").mkdir()
    for name in ("a.trc", "a_filt.trc"):
        (tmp_path / "pose-3d" / name).touch()
    for camera in ("cam02_json", "cam01_json"):
        (tmp_path / "pose-associated" / camera).mkdir(parents=True)
    made = SimpleNamespace(folder=tmp_path, read=[], margins=[], outlines=[])
    landmarks = np.random.default_rng(0).normal(size=(FRAMES, len(OTHER), 3))
    ours = landmarks[:, 1:] + np.array([0.0, 0.0, 0.02])
    reference = np.concatenate([np.full((FRAMES + 2, 1, 3), 9.0), np.zeros((FRAMES + 2, len(SCORED), 3))], axis=1)
    reference[:FRAMES, 1:] = ours[..., [1, 2, 0]]  # its Y is the world's z
    reference[2, 1] = np.nan
    made.reference = reference
    made.followed = [SimpleNamespace(landmarks=of, pose=k) for k, of in enumerate(landmarks)]
    made.body = SimpleNamespace(mesh=SimpleNamespace(landmarks=dict.fromkeys(OTHER)))
    shape = (FRAMES, 2, 1 + len(SCORED))
    made.tracks = SimpleNamespace(
        points=["Other", *SCORED], pixels=np.zeros((*shape, 2)), confidences=np.full(shape, 0.9)
    )
    cameras = {name: name for name in ("cam01", "cam02")}

    def tracks(folders: list[Path]) -> Any:
        made.read += folders
        return made.tracks

    def points(path: Path) -> Any:
        made.read.append(path)
        return SimpleNamespace(keypoints=("Other", *SCORED), positions=made.reference[:, None])

    def see(body: Any, vertices: int, camera: str, *, step_px: int, margin_px: int) -> Any:
        made.margins.append(margin_px)
        if (vertices, camera) == (3, "cam02"):
            return None  # it is outside
        mask = np.zeros((6, 8), bool)
        mask[:, :4] = True
        return SimpleNamespace(silhouette=SimpleNamespace(mask=lambda size: mask if size == (8, 6) else None))

    monkeypatch.setattr(module, "rig_of", lambda _: SimpleNamespace(cameras=cameras))
    monkeypatch.setattr(module, "read_trc", points)
    monkeypatch.setattr(module, "read_image_tracks", tracks)
    monkeypatch.setattr(module, "read_whole", lambda *_, **__: b"")
    monkeypatch.setattr(module, "decode_toml", lambda *_, **__: {"outline": made.outlines})
    monkeypatch.setattr(module, "posed", lambda mesh, pose: pose)
    monkeypatch.setattr(module, "eye", lambda placed: placed)
    monkeypatch.setattr(module, "see", see)
    monkeypatch.setattr(module, "near", lambda outline, pixels: pixels[:, 0] == 0)
    return made


def score(clip: Any) -> Any:
    def draw(polygons: list[Any], holes: list[Any]) -> np.ndarray:
        picture = np.zeros((6, 8), np.uint8)
        picture[:, : len(polygons) + 2] = 255
        picture[: len(holes)] = 0
        return picture

    return score_video(clip.folder, clip.body, clip.followed, Path("drawn.toml"), draw)


def test_joints_are_compared_with_those_of_the_unfiltered_reference(clip: Any) -> None:
    clip.reference[0, 5] += [0.0, 0.0, 0.08]
    found = score(clip)
    folder = clip.folder / "pose-associated"
    assert clip.read == [clip.folder / "pose-3d" / "a.trc", folder / "cam01_json", folder / "cam02_json"]
    assert (found.frames, found.median_mm, found.p95_mm) == (FRAMES, pytest.approx(20.0), pytest.approx(20.0))
    assert found.joints_mm == pytest.approx(dict.fromkeys(SCORED, 20.0))


def test_confident_keypoints_are_inside_or_not_where_the_body_is_seen(clip: Any) -> None:
    """Those of other joints do not count. The outlines' windows reach beyond what counts as inside."""
    clip.tracks.pixels[:2, 0, 1:] = 1.0  # outside
    clip.tracks.pixels[:, :, 0] = 1.0
    clip.tracks.confidences[2:, 0, 1:7] = CONFIDENT
    clip.tracks.confidences[2:, 1, 1:7] = CONFIDENT + 0.01
    joints = len(SCORED)
    sure = 2 * joints + 2 * (joints - 6) + 3 * joints
    assert score(clip).inside == pytest.approx(1 - 2 * joints / sure)
    assert min(clip.margins) > GROWN_PX + 2


def test_drawn_outlines_are_compared_in_their_own_frame_and_camera(clip: Any) -> None:
    for camera, frame, parts, holes in (("cam01", 0, 2, 0), ("cam02", 1, 4, 0), ("cam01", 3, 2, 3), ("cam02", 3, 2, 0)):
        clip.outlines.append({"camera": camera, "frame": frame, "person": [[]] * parts, "without": [[]] * holes})
    found = score(clip).overlaps
    # Of cam02 in frame 3 there is none: the body is outside.
    assert found == pytest.approx({"cam01 0": 1.0, "cam02 1": 4 / 6, "cam01 3": 0.5})


def test_files_are_those_of_the_recording(monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[Path] = []

    def rig(path: Path) -> Any:
        read.append(path)
        return SimpleNamespace(cameras={"cam_01": 1, "cam_02": 2})

    monkeypatch.setattr(module, "load_camera_rig", rig)
    monkeypatch.setattr(module, "CameraRig", lambda cameras: SimpleNamespace(cameras=cameras))
    assert rig_of(Path("clip")).cameras == {"cam01": 1, "cam02": 2}
    monkeypatch.setattr(module, "pictures", lambda path: [(0, path), (1, path)][: 1 + ("02" in path.name)])
    cameras = dict.fromkeys(("cam01", "cam02"))
    (images,) = images_of(Path("clip"), cameras)  # until the shorter one ends
    assert {name: str(path) for name, path in images.items()} == {name: f"clip/videos/{name}.mp4" for name in cameras}
    calibration = Path("clip/calibration/Calib_qualisys.toml")
    assert read == [calibration]
    given: list[Any] = []
    monkeypatch.setattr(module, "VideoSet", lambda videos, *_, **__: given.append(videos) or SimpleNamespace(rig=None))
    module.filmed_rig(Path("clip"))
    assert given == [{name: Path(f"clip/videos/{name}.mp4") for name in cameras}]


def test_the_body_begins_with_the_keypoints_of_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for camera in ("b_json", "a_json"):
        (tmp_path / "pose-associated" / camera).mkdir(parents=True)
    monkeypatch.setattr(module, "read_image_tracks", lambda folders: [path.name for path in folders])
    monkeypatch.setattr(module, "load_camera_rig", lambda path: path)
    monkeypatch.setattr(module, "joints_of_points", lambda *told: told)
    calibration = tmp_path / "calibration" / "Calib_qualisys.toml"
    assert module.first_points(tmp_path) == (["a_json", "b_json"], calibration)
