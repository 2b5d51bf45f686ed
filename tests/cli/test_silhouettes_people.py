"""`mocapella track silhouettes` with several people, as a user runs it, and what users get wrong about them."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from support.programs import result, result_here, run_here

from mocapella.detectors.keypoint_detector import SeenPeople
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply
from mocapella.model.openpose_names import LANDMARKS
from mocapella.model.topology import topology
from mocapella.recording.bodies_file import read_followed_people
from mocapella.sources.simulate.silhouette_files import write_sequence
from mocapella.sources.simulate.silhouette_scene import silhouette_scene

NAMES = ("anna", "ben")
SCENE = silhouette_scene("runner", seed=4, cameras=3, size_px=(320, 240), seconds=0.4, fps=30.0, people=2)
FILMS = tuple(f"{name}.avi" for name in SCENE.rig.cameras)
MODELS = tuple(
    word for name, mesh in zip(NAMES, SCENE.meshes, strict=True) for word in ("--set", f"model={name}={mesh.name}")
)


def joints_of(person, k=0):
    return dict(zip(SCENE.meshes[person].landmarks, SCENE.landmarks(k, person).tolist(), strict=True))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Films of two people, the rig, and joints to start from: of both in one file, and of each in one."""
    where = write_sequence(tmp_path_factory.mktemp("people"), SCENE)
    for k, name in enumerate(NAMES):
        (where / f"{name}.json").write_text(json.dumps(joints_of(k)))
    (where / "both.json").write_text(json.dumps({name: joints_of(k) for k, name in enumerate(NAMES)}))
    return where


def write_keypoints(where):
    """OpenPose's files of both people, in changing order, of all frames and cameras: BODY_25 with noise of 1 px."""
    names = topology("body_25").joints
    rng = np.random.default_rng(3)
    for camera, placed in SCENE.rig.cameras.items():
        (where / f"{camera}_json").mkdir(parents=True)
        for k in range(len(SCENE)):
            people = []
            for person in (0, 1) if k % 2 else (1, 0):
                at = {name: np.array(place) for name, place in joints_of(person, k).items()}
                at |= {name: 0.5 * (at[f"left {joint}"] + at[f"right {joint}"])
                       for name, joint in (("Neck", "shoulder"), ("MidHip", "hip"))}  # fmt: skip
                points = np.array([at.get(LANDMARKS.get(name, name), np.full(3, np.nan)) for name in names])
                pixels = project(apply(placed.T_camera_world, points), placed.camera.lens)
                pixels += rng.normal(size=pixels.shape)
                rows = [[x, y, 0.9] if np.isfinite(x) else [0.0, 0.0, 0.0] for x, y in pixels.tolist()]
                people.append({"pose_keypoints_2d": [value for row in rows for value in row]})
            text = json.dumps({"version": 1.3, "people": people})
            (where / f"{camera}_json" / f"{camera}_{k:012d}_keypoints.json").write_text(text)
    return where


@pytest.fixture(scope="module")
def found(folder):
    (folder / "out.json").write_text(
        json.dumps(
            result(folder, "track", "silhouettes", *FILMS, "--start", "both.json", *MODELS, "--overlay", "overlay")
        )
    )
    return json.loads((folder / "out.json").read_text())


def failed(folder, *arguments):
    """The one line that it ends with."""
    done = run_here(folder, "track", "silhouettes", *FILMS, *arguments)
    assert done.returncode == 1, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return " ".join(done.stderr.split())


def off_m(found, person, k):
    """Median distance of the joints of a frame from the truth."""
    truth = joints_of(person, k)
    at = found["people"][NAMES[person]]["frames"][k]["joints"]
    return np.median([np.linalg.norm(np.subtract(place, truth[name])) for name, place in at.items()])


@pytest.mark.slow
def test_two_people_are_followed_and_written_by_name(found):
    assert (found["format"], found["version"]) == ("mocapella followed people", 1)
    assert list(found["people"]) == list(NAMES)
    assert found["summary"]["frames"] == len(SCENE) == 12
    for person, name in enumerate(NAMES):
        one = found["people"][name]
        assert (one["format"], one["model"]) == ("mocapella followed body", SCENE.meshes[person].name)
        assert [row["frame"] for row in one["frames"]] == list(range(12))
        assert one["summary"]["lost"] == 0
        assert one["summary"]["median_overlap"] > 0.8
        assert off_m(found, person, 11) < 0.04


@pytest.mark.slow
def test_both_models_are_drawn_into_the_pictures_in_their_colours(folder, found):
    picture = cv2.imread(str(folder / "overlay" / "camera1_000011.jpg")).astype(int)
    blue, green, red = np.moveaxis(picture, -1, 0)
    assert np.count_nonzero((green > 180) & (red < 130) & (blue < 150)) > 30  # anna's green
    assert np.count_nonzero((green > 160) & (red > 200) & (blue < 130)) > 30  # ben's yellow


@pytest.mark.slow
def test_they_start_from_what_was_written_all_or_one(folder, found):
    assert list(read_followed_people(folder / "out.json")) == list(NAMES)
    again = result(
        folder, "track", "silhouettes", *FILMS, "--start", "out.json:5", "--frames", "5:7", "--set", "plot=plot.png"
    )
    assert list(again["people"]) == list(NAMES)
    assert [row["frame"] for row in again["people"]["ben"]["frames"]] == [5, 6]
    assert again["people"]["ben"]["proportions"] == found["people"]["ben"]["proportions"]
    assert (folder / "plot.png").stat().st_size > 1000
    done = run_here(
        folder, "track", "silhouettes", *FILMS, "--start", "ben=out.json:5", "--frames", "5:7",
        "--json", "ben-again.json",
        "--set", "beside=out.json", "--set", "plot=ben.png",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "ben" in done.stdout
    assert "not drawn, for it is of anna" in " ".join(done.stderr.split())
    assert list(json.loads((folder / "ben-again.json").read_text())["people"]) == ["ben"]


def test_a_start_can_be_a_file_for_each_and_heights_are_of_one_or_of_all(folder):
    done = run_here(
        folder, "track", "silhouettes", *FILMS, "--start", "anna=anna.json", "--start", "ben=ben.json",
        "--set", "height=1.6",
        "--set", "height=ben=1.8", "--frames", "0:1", "--json", "tall.json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    people = json.loads((folder / "tall.json").read_text())["people"]
    assert {name: one["height_m"] for name, one in people.items()} == {"anna": 1.6, "ben": 1.8}
    assert "anna" in done.stdout


@pytest.fixture(scope="module")
def keypoints(folder):
    """Files of keypoints in the folder, one for each person."""
    for k, name in enumerate(NAMES):
        rows = ["frame,camera,point,x_px,y_px"]
        for camera, placed in SCENE.rig.cameras.items():
            seen = project(apply(placed.T_camera_world, np.array([*joints_of(k).values()])), placed.camera.lens)
            rows += [f"0,{camera},{joint},{x},{y}" for joint, (x, y) in zip(joints_of(k), seen, strict=True)]
        (folder / f"{name}.csv").write_text("\n".join(rows))


@pytest.mark.usefixtures("keypoints")
def test_keypoints_are_named_by_person(folder):
    points = [word for name in NAMES for word in ("--set", f"points={name}={name}.csv")]
    done = run_here(folder, "track", "silhouettes", *FILMS, *points, "--frames", "0:1", "--json", "points.json")
    assert done.returncode == 0, done.stderr
    people = json.loads((folder / "points.json").read_text())
    assert [off_m(people, k, 0) < 0.05 for k in (0, 1)] == [True, True]


@pytest.mark.slow
def test_all_people_of_keypoint_files_are_followed_without_a_start(folder):
    write_keypoints(folder / "pose")
    found = result(folder, "track", "silhouettes", *FILMS, "--set", "keypoints=pose")
    assert list(found["people"]) == ["person_0", "person_1"]
    for k in (0, len(SCENE) - 1):
        truth = [joints_of(person, k) for person in (0, 1)]
        away = np.array([
            [np.median([np.linalg.norm(np.subtract(at, one[name])) for name, at in person["frames"][k]["joints"].items()
                        if name in one]) for one in truth]
            for person in found["people"].values()
        ])  # fmt: skip
        assert sorted(away.argmin(axis=1).tolist()) == [0, 1]
        assert away.min(axis=1).max() < 0.08
    assert all(type(one["summary"]["keypoints_left_out"]) is int for one in found["people"].values())
    done = run_here(folder, "track", "silhouettes", *FILMS, "--set", "keypoints=pose", "--record", "./seen")
    assert done.returncode == 0, done.stderr
    assert f"recorded {3 * len(SCENE)} images in seen.mcap" in " ".join(done.stderr.split())
    done = run_here(folder, "replay", "seen", "--json", "replayed.json")
    assert done.returncode == 0, done.stderr
    (row,) = json.loads((folder / "replayed.json").read_text())
    assert (row["recorded_scenes"], row["differing_scenes"], row["clean"]) == (6 * len(SCENE), 0, True)
    said = failed(folder, "--set", "keypoints=pose", "--start", "both.json")
    assert "choose one of them" in said
    said = failed(folder, "--set", "keypoints=pose", "--set", "detector=mediapipe")
    assert "choose one of them" in said


@pytest.mark.slow
def test_all_people_are_detected_in_the_films_without_a_start(folder, monkeypatch):
    """The detector is a stand-in that knows the scene; one is made for each camera, in the rig's order."""
    made = []

    class Detector:
        topology = topology("body_25")

        def __init__(self, placed):
            self.placed = placed

        def update(self, image, at_s, regions_px=None):
            assert image.shape == (240, 320, 3)
            points = np.array([
                [joints_of(person, round(at_s * 30.0)).get(LANDMARKS.get(name, ""), [np.nan] * 3)
                 for name in self.topology.joints] for person in (0, 1)
            ])  # fmt: skip
            pixels = project(apply(self.placed.T_camera_world, points), self.placed.camera.lens)
            sure = np.isfinite(pixels).all(axis=-1) * 0.9
            return SeenPeople(np.array([-1, -1]), pixels.astype(np.float32), sure.astype(np.float32))

    def opened(verb, name, model, settings):
        assert (verb, name) == ("track silhouettes", "stand-in")
        made.append(Detector(list(SCENE.rig.cameras.values())[len(made)]))
        return made[-1]

    monkeypatch.setattr("mocapella.cli.keypoint_options.opened_detector", opened)
    found = result_here(folder, "track", "silhouettes", *FILMS, "--set", "detector=stand-in")
    assert len(made) == 3
    assert sorted(found["people"]) == ["person_0", "person_1"]
    assert found["summary"]["frames"] == len(SCENE)


@pytest.mark.slow
@pytest.mark.usefixtures("keypoints")
def test_people_who_cannot_be_are_one_line(folder, found):
    def start(name, value):
        (folder / name).write_text(json.dumps(value))
        return "--start", name

    anna, ben = joints_of(0), joints_of(1)
    far = {name: np.add(at, [50.0, 0.0, 0.0]).tolist() for name, at in ben.items()}
    for arguments, said in (
        (start("same.json", {"anna": anna, "ben": anna}), "anna and ben start in the same place, 0 cm apart"),
        (start("far.json", {"anna": anna, "ben": far}), "ben would start at (5"),
        (start("few.json", {"anna": anna, "ben": {"nose": ben["nose"]}}), "ben: few.json: field left hip: is missing"),
        (
            start("feet.json", {"anna": anna, "ben": {k: np.divide(at, 0.3048).tolist() for k, at in ben.items()}}),
            "ben: ",
        ),
        (start("odd.json", {"anna": {**anna, "nose": [1]}, "ben": ben}), "odd.json: field anna.nose: [1]: is no place"),
        (start("mixed.json", {"anna": anna, "nose": [1, 2, 3]}), "mixed.json: field anna"),
        (start("nobody.json", {"anna": {}}), "nobody.json: field anna: {}: has no named joints"),
        (start("name.json", {"a=b": anna}), "'a=b' cannot be a person's name"),
        (("--start", "anna.json", "--start", "ben=ben.json"), "is given both with and without a name: write --start"),
        (("--start", "anna.json", "--start", "ben.json"), "have no person's name; write --start anna=FILE"),
        (("--start", "both.json", "--start", "ben=ben.json"), "both.json and ben.json are both of ben"),
        (("--start", "bne=both.json"), "both.json has no person called 'bne'; anna, ben (did you mean ben?)"),
        (("--start", "=anna.json"), "'' cannot be a person's name"),
        (("--start", "both.json", "--set", "model=bne=male"), "model bne=male: no person is called 'bne'; anna, ben"),
        (("--start", "anna.json", "--set", "model=anna=male"), "the start names nobody: write --start NAME=FILE"),
        (
            ("--start", "both.json", "--set", "model=male", "--set", "model=female"),
            "model is given twice: male and female",
        ),
        (("--start", "both.json", "--set", "height=ben=tall"), "height is 'tall'; it must be metres"),
        (("--start", "both.json", "--set", "height=ben=0.1"), "height is 0.1; it must be 0.5 to 2.5 m"),
        (("--start", "both.json", "--set", "model=ben=mail"), "did you mean male"),
        (("--start", "anna=out.json:77"), "out.json: field frame: 77: has no such frame; it has frames from 0 to 11"),
        (("--set", "points=anna=anna.csv", "--set", "points=anna.csv"), "write --set points anna=FILE for each"),
    ):
        assert said in failed(folder, *arguments), arguments
    broken = {**found, "people": {"anna": {**found["people"]["anna"], "frames": []}}}
    assert "field people.anna.frames: has no frame" in failed(folder, *start("empty.json", broken))
    assert "field people: has no body" in failed(folder, *start("none.json", {**found, "people": {}}))
    assert "field version: 9" in failed(folder, *start("new.json", {**found, "version": 9}))
