"""``mocapella people`` and the nodes of webcams: from images to a take, and what they refuse."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support.known_people import NAME, NO_HANDS, RIG, joints_at, known_detector, write_films
from support.programs import result_here, run_here

from mocapella.cli.node_keypoints import camera_name, camera_source
from mocapella.cli.people import _settings_of_method, _why_nobody
from mocapella.cli.recordings import open_take
from mocapella.errors import SettingsError
from mocapella.live.film_people import FilmCounts
from mocapella.model.camera import CameraRig, PlacedCamera
from mocapella.model.camera_rig_file import load_camera_rig, save_camera_rig
from mocapella.testing import FakeServer

pytest.importorskip("cv2")


@pytest.fixture
def films(tmp_path: Path) -> Iterator[Path]:
    write_films(tmp_path, RIG, 12)
    save_camera_rig(tmp_path / "rig.toml", RIG)
    with known_detector():
        yield tmp_path


def people(folder: Path, *more: str) -> list[str]:
    names = [f"{folder / name}" for name in RIG.cameras]
    return ["people", *names, "--detector", NAME, "--fps", "20", *more]


@pytest.mark.slow
def test_films_become_a_take_with_people(films: Path) -> None:
    out = result_here(films, *people(films, "--rig", str(films / "rig.toml"), "--out", "./walk", "--json", "-"))
    counts = out
    assert (counts["instants"], counts["ids"], counts["whole"]) == (12, 1, True)
    cameras = counts["agreement"]["cameras"]
    assert list(cameras) == list(RIG.cameras)
    assert all(one["used"] > 0.5 * one["detections"] > 0 for one in cameras.values())
    assert next(iter(counts["agreement"]["people"].values()))["residual_px"] < 3
    take = open_take(films / "walk.mcap")
    scenes = [scene for _, scene in take.scenes()]
    (person,) = scenes[-1].people
    assert np.median(np.linalg.norm(person.positions - joints_at(11 / 20), axis=-1)) < 0.03
    assert take.info.setup.method == "webcams"
    replayed = run_here(films, "replay", "walk.mcap")
    assert replayed.returncode == 0, replayed.stderr
    again = run_here(films, *people(films, "--out", "./walk"))
    assert again.returncode == 1
    assert "walk.mcap" in again.stderr


@pytest.mark.slow
def test_films_without_a_rig_that_are_too_short_to_calibrate_are_refused_and_their_keypoints_kept(films: Path) -> None:
    (films / "rig.toml").rename(films / "later.toml")
    found = run_here(films, *people(films, "--out", "./walk", "--json", "-"))
    assert (found.returncode, "calibrate cameras" in found.stderr) == (1, True)
    assert "for half a minute" in found.stderr
    assert "the keypoints of 36 images were kept" in found.stderr
    assert json.loads(found.stdout)["take"] == "walk.mcap"
    (line,) = [line for line in found.stderr.splitlines() if line.startswith("next: ")]
    assert "calibrate people walk.mcap --out rig.toml" in line
    words = line.removeprefix("next: mocapella ").partition(",")[0].replace("rig.toml", "later.toml").split()
    assert open_take(films / "walk.mcap").frame_count == 36
    replayed = run_here(films, *words)  # with a rig that came later
    assert replayed.returncode == 0, replayed.stderr
    (tracked,) = films.rglob("walk-tracked.mcap")
    assert [scene.people for _, scene in open_take(tracked).scenes()][-1]
    again = run_here(films, "calibrate", "people", "walk.mcap", "--out", "rig.toml")
    assert again.returncode == 1  # it is read, and too little for this, too
    print(again.stderr)


@pytest.mark.slow
def test_films_in_which_nobody_is_seen_leave_no_take_without_a_rig(films: Path) -> None:
    (films / "rig.toml").unlink()
    for image in films.rglob("*.png"):
        image.write_bytes(black())
    found = run_here(films, *people(films, "--out", "./walk"))
    assert found.returncode == 1
    assert "kept" not in found.stderr
    assert not (films / "walk.mcap").exists()


def black() -> bytes:
    cv2 = __import__("cv2")
    width, height = next(iter(RIG.cameras.values())).camera.size_px
    return bytes(cv2.imencode(".png", np.zeros((height, width, 3), np.uint8))[1])


@pytest.mark.slow
def test_cameras_are_compared_in_a_table_and_one_that_never_agrees_is_named(films: Path) -> None:
    found = run_here(films, *people(films, "--rig", "rig.toml", "--out", "./walk"))
    assert found.returncode == 0, found.stderr
    assert [word for word in ("detections", "residual px") if word in found.stderr] == ["detections", "residual px"]
    assert "disagree" not in found.stderr
    moved = load_camera_rig(films / "rig.toml")
    name, one = list(moved.cameras.items())[-1]
    turned = PlacedCamera(one.camera, rotated_about_y(2.0) @ one.T_camera_world, one.covariance)
    save_camera_rig(films / "moved.toml", CameraRig({**moved.cameras, name: turned}))
    found = run_here(films, *people(films, "--rig", "moved.toml", "--out", "./moved"))
    assert f"camera {name}: none of its 12 detections agrees with the other cameras: it sees another" in found.stderr
    assert "leave it out, or calibrate it again" in found.stderr


def rotated_about_y(angle_rad: float) -> np.ndarray:
    T = np.eye(4)
    T[::2, ::2] = [[np.cos(angle_rad), np.sin(angle_rad)], [-np.sin(angle_rad), np.cos(angle_rad)]]
    return T


def test_hands_alone_that_are_not_found_are_no_people(films: Path) -> None:
    names = [str(films / name) for name in RIG.cameras]
    words = ["people", *names, "--detector", NO_HANDS, "--fps", "20", "--out", "./hands"]
    found = run_here(films, *words, "--rig", "rig.toml")
    assert found.returncode == 1
    assert "hands in 0 of 12 images" in found.stderr
    assert "no hand was tracked: none is seen by" in found.stderr
    for word in ("somebody", "nobody", "person", "0 people"):
        assert word not in found.stderr
    (films / "rig.toml").unlink()
    found = run_here(films, *[*words[:-1], "./other"])
    assert "hands alone do not calibrate cameras, and there is no rig" in found.stderr
    assert not (films / "other.mcap").exists()


def test_what_films_need_is_named(films: Path) -> None:
    (films / "rig.toml").rename(films / "other.toml")
    (films / "cam-0").rename(films / "roof")
    found = run_here(films, "people", "roof", "cam-1", "--rig", "other.toml", "--detector", NAME, "--out", "./walk")
    assert (found.returncode, "roof" in found.stderr) == (1, True)
    found = run_here(films, "people", "cam-1", "cam-2", "--detector", "knwn", "--rig", "other.toml", "--fps", "20",
                     "--out", "./walk")  # fmt: skip
    assert (found.returncode, "did you mean known" in found.stderr) == (1, True)
    found = run_here(films, "people", "cam-1", "typo.mp4", "--rig", "other.toml", "--detector", NAME, "--out", "./walk")
    assert (found.returncode, "typo.mp4: is not there" in found.stderr) == (1, True)
    found = run_here(films, "people", "roof", "cam-1", "--rig", "other.toml", "--detector", NAME, "--out", "./walk")
    assert f"write {next(iter(RIG.cameras))}=roof" in found.stderr
    assert not (films / "walk.mcap").exists()


def test_a_take_that_exists_or_has_no_folder_is_refused_before_the_detection(films: Path) -> None:
    (films / "walk.mcap").write_bytes(b"kept")
    for out, why in (
        ("./walk", "walk.mcap: it exists, and nothing is overwritten"),
        ("none/walk", "none: it does not"),
    ):
        found = run_here(films, *people(films, "--out", out))
        assert (found.returncode, why in found.stderr) == (1, True), found.stderr
        assert "compiling" not in found.stderr
    assert (films / "walk.mcap").read_bytes() == b"kept"


@pytest.mark.parametrize("source", ["0", "camera:0", "rtsp://127.0.0.1/x"])
def test_a_live_camera_is_no_film_and_leads_to_the_node(tmp_path: Path, source: str) -> None:
    found = run_here(tmp_path, "people", f"left={source}", "--out", "./walk")
    assert f"{source}: is a live camera and no film; track it live: mocapella serve --method webcams" in found.stderr
    assert f"mocapella node keypoints {source}" in found.stderr


def test_a_folder_of_films_is_named_as_such(tmp_path: Path) -> None:
    (tmp_path / "session").mkdir()
    (tmp_path / "session" / "left.mp4").write_bytes(b"")
    found = run_here(tmp_path, "people", "session", "--out", "./walk")
    assert "session: is a folder of films; name the films: mocapella people session/*.mp4" in found.stderr


def counts(instants: int, **seen: int) -> FilmCounts:
    return FilmCounts(instants, dict.fromkeys(seen, instants), seen, 0, 0, 0)


def test_nobody_tracked_is_explained() -> None:
    assert _why_nobody(counts(30, left=30, right=0)).startswith("nobody is seen by right; people are found best whole")
    assert _why_nobody(counts(1, left=1, right=1)).startswith("1 instant of the films is too little")
    rooms = _why_nobody(counts(30, left=30, right=30))
    assert "no two cameras of left, right agree about a person" in rooms
    assert "show the same room" in rooms
    assert "Leave out the film of another room" in rooms
    assert _why_nobody(counts(30, left=30, right=0), hands=True).startswith("none is seen by right; hands are found")
    assert "agree about a hand" in _why_nobody(counts(30, left=30, right=30), hands=True)
    assert "for a hand is shown" in _why_nobody(counts(1, left=1, right=1), hands=True)


def test_help_lists_the_settings_of_detector_and_method(tmp_path: Path) -> None:
    found = run_here(tmp_path, "people", "--set", "help")
    assert found.returncode == 0, found.stderr
    for name in ("most_people", "unseen_s", "association.", "height_m", "other_size"):
        assert name in found.stdout


def test_films_take_the_settings_of_the_method_and_of_the_detector() -> None:
    own = {"unseen_s": "1.5", "association": {"least_angle_deg": "5"}, "most_people": "2"}
    of_method = _settings_of_method("webcams", own)
    assert of_method == {"unseen_s": "1.5", "association": {"least_angle_deg": "5"}}
    assert own == {"most_people": "2"}


def test_one_film_needs_no_rig_but_a_detector_with_depth(films: Path) -> None:
    words = ("people", "cam-1", "--detector", NAME, "--fps", "20", "--out", "./alone")
    found = run_here(films, *words, "--set", "height_m=9")
    assert (found.returncode, "from 0.4 to 2.5 m" in found.stderr) == (1, True), found.stderr
    (films / "rig.toml").unlink()
    found = run_here(films, *words, "--set", "height_m=1.8")
    assert (found.returncode, "12 images were not used" in found.stderr) == (1, True), found.stderr
    assert "--detector mediapipe" in found.stderr
    assert "distances are inferred" in found.stderr
    assert open_take(films / "alone.mcap").info.method_settings["height_m"] == 1.8


@pytest.mark.parametrize(
    ("source", "name"),
    [("0", "cam0"), ("camera:2", "cam2"), ("/dev/video1", "cam1"), ("films/left.mp4", "left"), ("walk", "walk")],
)
def test_a_camera_is_named_after_its_source(source: str, name: str) -> None:
    assert camera_name(source) == name


def test_an_address_gives_no_name() -> None:
    with pytest.raises(SettingsError, match="--name"):
        camera_name("http://camera/stream?a=b c")


def test_a_number_is_a_camera_unless_there_is_such_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert [camera_source(text) for text in ("0", "12", "camera:0", "0.mp4")] == [
        "camera:0",
        "camera:12",
        "camera:0",
        "0.mp4",
    ]
    Path("7").mkdir()
    assert camera_source("7") == "7"


@pytest.mark.parametrize("verb", [["node", "keypoints"], ["node", "camera"]])
@pytest.mark.slow
def test_a_node_sends_what_it_detects(films: Path, verb: list[str]) -> None:
    with FakeServer() as server:
        found = run_here(films, *verb, "cam-1", "--detector", NAME, "--connect", server.address, "--fps", "20",
                         "--set", "linger=0.2", "--set", "drop_after_ms=5000", "--json", "-")  # fmt: skip
        assert found.returncode == 0, found.stderr
        summary = json.loads(found.stdout)
        frames = list(server.frames)
    assert summary["sensor"] == "cam-1"
    assert summary["published"] == len(frames) > 0
    assert {type(frame).__name__ for frame in frames} == {"KeypointFrame"}
    assert {frame.bodies for frame in frames} == {1}


def test_a_camera_without_a_detector_sends_images_and_needs_a_name(films: Path) -> None:
    found = run_here(films, "node", "camera", "cam-1")
    assert (found.returncode, "--name NAME" in found.stderr) == (1, True)
    found = run_here(films, "node", "camera", "cam-1", "--name", "a", "--model", "rig.toml")
    assert (found.returncode, "--detector NAME" in found.stderr) == (1, True)


def test_a_simulated_camera_refuses_options_of_real_ones(tmp_path: Path) -> None:
    for words, named in ((["simulated:two-walk/c1", "--detector", "mediapipe"], "--detector"),
                         (["simulated:two-walk"], "simulated:two-walk/c1"),
                         (["simulated:two-walk/c9"], "no camera 'c9'")):  # fmt: skip
        found = run_here(tmp_path, "node", "keypoints", *words)
        assert (found.returncode, named in found.stderr) == (1, True), found.stderr


def test_detectors_are_listed_with_what_they_need(tmp_path: Path) -> None:
    listed = run_here(tmp_path, "node", "keypoints", "0", "--detector", "help").stdout
    assert "mediapipe: " in listed
    assert "onnx: " in listed
