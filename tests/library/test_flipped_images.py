"""Mirrored and upside-down images are named, with the remedy; those that are neither are not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.keypoint_folders import frames_of, walkers, write_openpose

from mocapella.library.flipped_images import FEWEST, flipped_images
from mocapella.library.people_report import PeopleReport, alarms
from mocapella.library.people_triangulation import triangulate_people
from mocapella.model.camera import CameraRig
from mocapella.model.keypoints import KeypointFrame
from mocapella.model.topology import topology

Frames = dict[str, list[KeypointFrame]]
MIRROR = np.array(topology("halpe_26").mirror)
ASIDE = np.array([0.6, 0.0, 0.4])
"""People in the middle look alike in mirrored images [m]."""


def flipped(folder: Path, cameras: tuple[str, ...], how: str, width: int, height: int) -> None:
    """Rewrite the keypoints of some cameras as a detector sees them in mirrored or upside-down images."""
    for path in (one for name in cameras for one in (folder / "pose" / f"{name}_json").glob("*.json")):
        content: dict[str, Any] = json.loads(path.read_text())
        for person in content["people"]:
            values = np.reshape(person["pose_keypoints_2d"], (-1, 3))
            seen = values[:, 2] > 0.0
            values[seen, 0] = width - 1 - values[seen, 0]
            if how == "upside down":
                values[seen, 1] = height - 1 - values[seen, 1]
            person["pose_keypoints_2d"] = (values[MIRROR] if how == "mirrored" else values).ravel().tolist()
        path.write_text(json.dumps(content))


def recorded(folder: Path, cameras: int, which: tuple[str, ...], how: str) -> tuple[Frames, CameraRig]:
    rig = write_openpose(folder, walkers(2 * FEWEST) + ASIDE, cameras=cameras)
    width, height = next(iter(rig.cameras.values())).camera.size_px
    flipped(folder, which, how, width, height)
    return frames_of(folder / "pose", rig), rig


@pytest.mark.parametrize("how", ["mirrored", "upside down"])
@pytest.mark.parametrize(
    ("cameras", "which"),
    [(4, ("cam-1",)), (3, ("cam-0", "cam-1", "cam-2")), (6, ("cam-2", "cam-5")), (3, ("cam-0",))],
)
def test_flipped_images_are_named(tmp_path: Path, cameras: int, which: tuple[str, ...], how: str) -> None:
    text = flipped_images(*recorded(tmp_path, cameras, which, how))
    for name in (f"cam-{k}" for k in range(cameras)):
        assert (name in text) == (name in which), text
    assert f"are {how}: " in text


@pytest.mark.parametrize("cameras", [2, 3, 4, 6])
def test_images_that_are_not_flipped_are_not_named(tmp_path: Path, cameras: int) -> None:
    frames, rig = recorded(tmp_path, cameras, (), "mirrored")
    assert flipped_images(frames, rig) == ""
    assert flipped_images({}, rig) == ""


def test_too_few_instants_tell_nothing(tmp_path: Path) -> None:
    frames, rig = recorded(tmp_path, 4, ("cam-1",), "mirrored")
    few = {name: some[: FEWEST - 1] for name, some in frames.items()}
    assert flipped_images(few, rig) == ""


def test_keypoints_that_no_flip_explains_are_not_called_flipped(tmp_path: Path) -> None:
    frames, rig = recorded(tmp_path, 4, (), "mirrored")
    names = list(frames)
    exchanged = {names[k]: frames[names[k - 1]] for k in range(4)}
    assert flipped_images(exchanged, rig) == ""


@pytest.mark.slow
def test_whoever_triangulates_mirrored_keypoints_is_told_so_and_not_that_the_rig_is_wrong(tmp_path: Path) -> None:
    rig = write_openpose(tmp_path, walkers(24) + ASIDE, cameras=3)
    width, height = next(iter(rig.cameras.values())).camera.size_px
    flipped(tmp_path, tuple(rig.cameras), "mirrored", width, height)
    found = triangulate_people(tmp_path / "pose", rig, fps=30.0)
    assert [note for note in found.notes if "mirrored" in note] == [found.report.flipped]
    assert not any("compare the rig" in note or "--up" in note for note in found.notes)


def test_flipped_images_explain_all_else() -> None:
    report = PeopleReport(10, {}, {}, float("nan"), flipped="the images of left are mirrored: …")
    assert alarms(report) == [report.flipped]
    assert alarms(PeopleReport(10, {}, {}, float("nan"))) != [""]
