"""``mocapella people`` and the nodes of webcams: from images to a take, and what they refuse."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support.known_people import NAME, RIG, joints_at, known_detector, write_films
from support.programs import result_here, run_here

from mocapella.cli.node_keypoints import camera_name, camera_source
from mocapella.cli.people import _settings_of_method
from mocapella.cli.recordings import open_take
from mocapella.errors import SettingsError
from mocapella.model.camera_rig_file import save_camera_rig
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
def test_films_without_a_rig_that_are_too_short_to_calibrate_are_refused(films: Path) -> None:
    (films / "rig.toml").unlink()
    found = run_here(films, *people(films, "--out", "./walk"))
    assert (found.returncode, "calibrate cameras" in found.stderr) == (1, True)
    assert "for half a minute" in found.stderr
    assert not (films / "walk.mcap").exists()


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
