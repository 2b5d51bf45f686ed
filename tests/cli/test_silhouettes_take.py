"""A take of videos: it refers to them, is replayed to the bit, and says what has become of them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.programs import run_here
from support.silhouette_pictures import Room, pose_at, ring, somebody, write_folders

from mocapella.model.camera_rig_file import save_camera_rig
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.recording.take_reader import read_take

FRAMES = 8


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders of images of somebody who goes aside, of the empty room, and a take of them."""
    folder = tmp_path_factory.mktemp("videos")
    mesh, rig = somebody(), ring(2, size_px=(160, 130))
    room = Room(rig)
    write_folders(folder / "films", (room.images(mesh, pose_at(mesh, 0.01 * k)) for k in range(FRAMES)))
    write_folders(folder / "empty", (room.images() for _ in range(3)))
    save_camera_rig(folder / "rig.toml", rig)
    places = dict(zip(mesh.landmarks, landmarks_at(mesh, pose_at(mesh)).tolist(), strict=True))
    (folder / "start.json").write_text(json.dumps(places))
    done = run_here(folder, *command("--record", "./walk"))
    assert done.returncode == 0, done.stderr
    assert "recorded 22 images in walk.mcap" in done.stderr
    return folder


def command(*more: str) -> tuple[str, ...]:
    films = ("films/c1", "films/c2", "--background", "empty/c1", "--background", "empty/c2", "--fps", "20")
    return ("track", "silhouettes", *films, "--start", "start.json", "--set", "height=1.75", *more)


@pytest.mark.slow
def test_the_take_is_replayed_to_the_bit_from_the_videos(made: Path) -> None:
    done = run_here(made, "replay", "walk", "--json", "replayed.json")
    assert done.returncode == 0, done.stderr
    (row,) = json.loads((made / "replayed.json").read_text())
    assert (row["recorded_scenes"], row["differing_scenes"], row["most_bodies"]) == (2 * FRAMES + 6, 0, 1)
    assert row["clean"]


@pytest.mark.slow
def test_an_image_of_a_video_takes_a_few_hundred_bytes(made: Path) -> None:
    take = read_take(made / "walk.mcap")
    stored = [one for one in take.frames("c1") if one.frame.format == "file"]
    assert len(stored) == FRAMES
    assert all(len(one.raw) < 400 for one in stored)
    assert [one.frame.format for one in take.frames("c2") if one.frame.empty_room] == ["png"] * 3


def test_the_results_are_those_without_a_take(made: Path) -> None:
    for name, more in (("with", ("--record", "./again")), ("without", ())):
        assert run_here(made, *command("--json", f"{name}.json", *more)).returncode == 0
    one, other = (json.loads((made / f"{name}.json").read_text())["frames"] for name in ("with", "without"))
    for row, same in zip(one, other, strict=True):
        assert row["joints"].keys() == same["joints"].keys()
        for joint, place in row["joints"].items():
            assert place == pytest.approx(same["joints"][joint], abs=1e-6)


@pytest.mark.slow
def test_a_video_that_changed_or_is_gone_is_named(made: Path) -> None:
    image = made / "films" / "c2" / "0003.png"
    content = image.read_bytes()
    try:
        image.write_bytes(content[:-1])
        done = run_here(made, "replay", "walk")
        assert done.returncode == 1
        assert "c2: field sha256" in done.stderr.replace("\n", "")
        assert "is not the video that the take was made of" in done.stderr
    finally:
        image.write_bytes(content)
    (made / "films").rename(made / "elsewhere")
    try:
        done = run_here(made, "replay", "walk")
        assert done.returncode == 1
        assert "is not there any more" in done.stderr
    finally:
        (made / "elsewhere").rename(made / "films")


def test_live_cameras_are_recorded_by_a_server(made: Path) -> None:
    done = run_here(made, *command("--record", "./live"), "--set", "live=true")
    assert done.returncode == 1
    assert "mocapella serve --method silhouettes --record TAKE" in done.stderr


def test_nothing_is_overwritten(made: Path) -> None:
    done = run_here(made, *command("--record", "./walk"))
    assert done.returncode == 1
    assert "walk.mcap" in done.stderr


@pytest.mark.slow
def test_it_is_tracked_again_from_the_videos_or_says_that_one_is_gone(made: Path) -> None:
    done = run_here(made, "replay", "walk", "--record", "./walk-2")
    assert done.returncode == 0, done.stderr
    assert f"{2 * FRAMES + 6} results of {2 * FRAMES + 6} frames in walk-2.mcap" in done.stderr
    replayed = run_here(made, "replay", "walk-2")
    assert f"all {2 * FRAMES + 6} results identical to the live run" in replayed.stderr
    (made / "films").rename(made / "elsewhere")
    try:
        done = run_here(made, "replay", "walk", "--record", "./walk-3")
        assert done.returncode == 1
        assert "is not there any more" in done.stderr.replace("\n", "")
        assert not (made / "walk-3.mcap").exists()
    finally:
        (made / "elsewhere").rename(made / "films")
