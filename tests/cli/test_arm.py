"""mocapella track arm: recordings in, arms out, and what is wrong with what is given said in a line."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from support.nearest_arm import NEAREST, NearestArm, NearestArmSettings
from support.programs import run
from typer.testing import CliRunner

from mocapella.cli import arm as _arm  # noqa: F401 - registers the verb
from mocapella.cli import demo as _demo  # noqa: F401
from mocapella.cli import depth_recordings as inputs
from mocapella.cli import view as _view  # noqa: F401 - and another: an app of one verb has no verbs
from mocapella.cli.app import app
from mocapella.detectors import DETECTORS, make_detector
from mocapella.detectors.arm_settings import KinematicArmSettings
from mocapella.errors import InputError, SettingsError
from mocapella.geometry.lens import project
from mocapella.model.arms import SeenArms
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.camera_rig_file import save_camera_rig
from mocapella.model.depth import depth_frame
from mocapella.model.observations import body_frame
from mocapella.model.session import Setup
from mocapella.model.topology import topology
from mocapella.recording.take import TakeInfo
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_frame
from mocapella.sources.depth_options import DepthOptions

LENS = np.array([12.0, 12.0, 7.5, 5.5, 0, 0, 0, 0, 0])
SAID = ["--intrinsics", "12,7.5,5.5", "--unit", "0.001"]
made: list[NearestArm] = []


def depth(value: int = 700) -> np.ndarray:
    """A wall, and something nearer at (3, 2)."""
    image = np.full((12, 16), 1000, np.uint16)
    image[2, 3] = value
    return image


def png(path: Path, image: np.ndarray) -> None:
    path.write_bytes(cv2.imencode(".png", image)[1].tobytes())


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Three images, and the detector nearest."""
    made.clear()

    def make(camera: Camera, settings: Any) -> NearestArm:
        made.append(NearestArm(camera, settings))
        return made[-1]

    monkeypatch.setitem(DETECTORS, "nearest", replace(NEAREST, make=make))
    (tmp_path / "frames").mkdir()
    for number in (9, 10, 11):
        png(tmp_path / "frames" / f"{number}.png", depth(691 + number))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def arm(*arguments: str) -> Any:
    return CliRunner().invoke(app, ["track", "arm", *arguments, "--detector", "nearest"])


def result(*arguments: str) -> dict[str, Any]:
    done = arm(*arguments, "--json", "out.json")
    assert done.exit_code == 0, (done.output, done.exception)
    found: dict[str, Any] = json.loads(Path("out.json").read_text(encoding="utf-8"))
    return found


def refusal(*arguments: str) -> str:
    done = arm(*arguments)
    assert isinstance(done.exception, InputError | SettingsError), (done.output, done.exception)
    return str(done.exception)


def test_a_folder_gives_joints_in_metres_and_pixels(folder: Path) -> None:
    found = result("frames", *SAID, "--fps", "10", "--set", "a.b=3")
    assert (found["detector"], "method" in found) == ("nearest", False)
    assert made[0].settings == NearestArmSettings({"b": 3})
    (recording,) = found["recordings"]
    assert recording["size_px"] == [16, 12]
    assert recording["unit_m"] == 0.001
    assert recording["lens"] == LENS.tolist()
    assert recording["counts"] == {"images": 3, "with_arms": 3, "arms": 3, "empty": 0, "damaged": 0}
    assert recording["median_ms"] > 0
    frames = recording["frames"]
    assert [Path(frame["file"]).name for frame in frames] == ["9.png", "10.png", "11.png"]
    assert [frame["time_s"] for frame in frames] == [0.0, 0.1, 0.2]
    for frame, z in zip(frames, (0.700, 0.701, 0.702), strict=True):
        (one,) = frame["arms"]
        assert list(one["joints"]) == [
            "elbow", "wrist", "palm", "thumb tip", "index tip", "middle tip", "ring tip", "little tip",
        ]  # fmt: skip
        assert one["joints"]["elbow"] == {"state": "unknown", "m": None, "px": None, "sd_m": None}
        assert one["joints"]["wrist"]["state"] == "inferred"
        palm = one["joints"]["palm"]
        assert palm["state"] == "measured"
        assert palm["m"] == pytest.approx([-4.5 / 12 * z, -3.5 / 12 * z, z], abs=1e-5)
        assert palm["px"] == pytest.approx([3.0, 2.0], abs=0.01)
        np.testing.assert_allclose(project(palm["m"], LENS), palm["px"], atol=0.01)
        assert (one["id"], one["handedness"], one["handedness_sure"]) == (7, "left", 0.9)
        assert (one["gesture"], one["gesture_sure"], one["grabbing"]) == ("open", 0.8, True)


def test_independent_images_are_a_setting_of_detectors_that_continue_images(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result("frames", *SAID, "--independent", "--set", "a.b=3")
    assert made[0].settings == NearestArmSettings({"b": 3})

    def make(camera: Camera, settings: Any) -> NearestArm:
        assert (settings.independent_s, settings.firm) == (0.0, 0.2)
        made.append(NearestArm(camera))
        return made[-1]

    monkeypatch.setitem(DETECTORS, "nearest", replace(NEAREST, make=make, settings=lambda: KinematicArmSettings))
    result("frames", *SAID, "--independent", "--set", "firm=0.2")
    assert len(made) == 2


def test_all_points_and_a_table(folder: Path) -> None:
    png(folder / "frames" / "12.png", np.zeros((12, 16), np.uint16))
    found = result("frames", *SAID, "--all-points", "--csv", "out.csv")
    (recording,) = found["recordings"]
    assert len(recording["frames"][0]["arms"][0]["joints"]) == 23
    assert recording["frames"][3]["arms"] == []
    assert recording["frames"][3]["reason"] == "nothing was measured in the whole image"
    assert recording["counts"]["empty"] == 1
    with (folder / "out.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 3 * 23 + 1
    palm = next(row for row in rows if row["joint"] == "palm")
    shown = recording["frames"][0]["arms"][0]["joints"]["palm"]
    assert [float(palm[name]) for name in ("x_m", "y_m", "z_m", "x_px", "y_px")] == shown["m"] + shown["px"]
    assert (palm["recording"], palm["handedness"], palm["state"]) == ("frames", "left", "measured")
    assert (rows[-1]["arm"], rows[-1]["reason"]) == ("", "nothing was measured in the whole image")


def test_stages_are_written_as_pictures(folder: Path) -> None:
    result("frames", *SAID, "--stages", "looked")
    files = sorted(str(path.relative_to(folder)) for path in (folder / "looked").rglob("*.png"))
    assert files == [f"looked/0000{k}-{9 + k}/{name}" for k in range(3) for name in ("01-8-bit.png", "02-colours.png")]
    assert cv2.imread(files[0], cv2.IMREAD_UNCHANGED).shape == (12, 16)
    assert cv2.imread(files[1], cv2.IMREAD_UNCHANGED).shape == (12, 16, 3)


def test_files_in_a_row_are_one_recording_and_each_folder_is_another(folder: Path) -> None:
    found = result("frames/11.png", "frames/9.png", "frames", "frames/10.png", *SAID)
    assert [[Path(f["file"]).name for f in r["frames"]] for r in found["recordings"]] == [
        ["11.png", "9.png"], ["9.png", "10.png", "11.png"], ["10.png"],
    ]  # fmt: skip
    assert len(made) == 3


def test_a_damaged_image_is_passed_over_and_said(folder: Path) -> None:
    path = folder / "frames" / "10.png"
    path.write_bytes(path.read_bytes()[:-20])
    done = arm("frames", *SAID, "--json", "out.json")
    assert "arms in 2 of 3 images; 1 damaged; arms: 1 left; gestures: open 2" in " ".join(done.stderr.split())
    (recording,) = json.loads(Path("out.json").read_text(encoding="utf-8"))["recordings"]
    assert "cut off" in recording["frames"][1]["reason"]
    assert recording["counts"]["damaged"] == 1
    assert len(made[0].times) == 2


def test_sides_arms_and_gestures_are_said_in_a_line(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one = NearestArm(Camera("a", (16, 12), LENS)).update(depth() * np.float32(0.001), 0.0).arms[0]
    other = msgspec.structs.replace(one, id=8, left=False, gesture="fist")
    again = msgspec.structs.replace(one, left=False, gesture="")  # most of its images show a left one
    seen = iter([(one, other), (one, other), (again,)])
    monkeypatch.setattr(NearestArm, "update", lambda self, depth, at_s: SeenArms(next(seen)))
    line = next(line for line in arm("frames", *SAID).stderr.splitlines() if "arms in" in line)
    assert line == "frames: arms in 3 of 3 images; arms: 1 left, 1 right; gestures: open 2, fist 2"


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["frames"], "give --intrinsics F,CX,CY and --unit METRES"),
        (["frames", "--intrinsics", "12,7.5,5.5"], "give --unit METRES"),
        (
            ["frames", "--intrinsics", "12,7.5,5.5", "--unit", "1"],
            r"median distance would be 1 km; --unit 0.001 \(1 m\)",
        ),
        (["frames", "--intrinsics", "12,7.5,50", "--unit", "0.001"], "outside the image of 16 × 12"),
        (["frames", "--intrinsics", "200,7.5,5.5", "--unit", "0.001"], "4.58° wide"),
        (["frames", "--intrinsics", "12", "--unit", "0.001"], "--intrinsics '12'"),
        (["frames", *SAID, "--rig", "rig.toml"], "both say the lens"),
        (["frames", *SAID, "--fps", "0"], "--fps"),
        (["nowhere", *SAID], "nowhere: is not there"),
        (["openni:0", *SAID], "mocapella node arm openni:0"),
        (["nowhere.mcap", *SAID], "no such file"),
        (["frames", *SAID, "--csv", "no/where.csv"], "--csv no/where.csv"),
        (["frames", *SAID, "--stages", "frames/9.png"], "--stages frames/9.png"),
    ],
)
def test_what_cannot_be_used_is_said(folder: Path, arguments: list[str], named: str) -> None:

    assert re.search(named, refusal(*arguments))


def test_detectors_and_stages_that_there_are_not(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = Camera("depth", (16, 12), LENS)
    with pytest.raises(SettingsError, match=r"unknown arm detector 'line-skelton'; .*did you mean line-skeleton"):
        make_detector("line-skelton", camera)
    bare = SimpleNamespace(name="nearest", update=lambda depth, at_s: None, reset=lambda: None)
    monkeypatch.setitem(DETECTORS, "nearest", replace(NEAREST, make=lambda camera, settings: bare, stages=None))
    said = refusal("frames", *SAID, "--stages", "out")
    assert "the detector nearest has none; detectors that do: angular-segments, line-skeleton, line-skeleton-3d" in said


@pytest.mark.parametrize("verb", [["track", "arm", "frames"], ["node", "arm", "frames"], ["demo", "arm", "--no-view"]])
@pytest.mark.parametrize(("old", "new"), [("default", "kinematic-arm"), ("line-skeleton", "line-skeleton")])
def test_the_former_option_is_refused_with_the_present_one(verb: list[str], old: str, new: str) -> None:
    done = CliRunner().invoke(app, [*verb, "--method", old])
    assert isinstance(done.exception, SettingsError), done.output
    assert str(done.exception) == f"--method {old}: the option is --detector now; write --detector {new}"
    assert "--method" not in CliRunner().invoke(app, ["track", "arm", "--help"]).output


def test_the_former_name_is_refused_with_the_present_one(folder: Path) -> None:
    done = CliRunner().invoke(app, ["track", "arm", "frames", *SAID, "--detector", "default"])
    assert str(done.exception) == "the detector 'default' is called kinematic-arm now"


@pytest.mark.parametrize("verb", [["track", "arm", "frames"], ["node", "arm", "frames"], ["demo", "arm"]])
def test_detectors_are_listed(verb: list[str]) -> None:
    done = CliRunner().invoke(app, [*verb, "--detector", "help"])
    assert done.exit_code == 0
    names = ["angular-segments", "kinematic-arm", "line-skeleton", "line-skeleton-3d"]
    assert [line.split()[0] for line in done.stdout.splitlines()] == names
    assert DETECTORS["kinematic-arm"].summary in done.stdout


def test_a_detector_is_of_the_demonstration_of_an_arm() -> None:
    for what in ("people", "hands", "silhouettes"):
        done = CliRunner().invoke(app, ["demo", what, "--detector", "line-skeleton"])
        assert str(done.exception) == "--detector is of demo arm; leave it out"


def rig(path: Path, *names: str) -> None:
    placed = {name: PlacedCamera(Camera(name, (16, 12), LENS), np.eye(4), np.full((6, 6), np.nan)) for name in names}
    save_camera_rig(path, CameraRig(placed))


def test_the_lens_may_be_a_rigs(folder: Path) -> None:
    rig(folder / "one.toml", "arm")
    rig(folder / "two.toml", "arm", "other")
    for text in ("one.toml", "two.toml:other"):
        assert result("frames", "--unit", "0.001", "--rig", text)["recordings"][0]["lens"] == LENS.tolist()
    for text, named in (("two.toml", "does not say which"), ("one.toml:left", "has no camera 'left'"), ("no.toml", "")):
        assert named in refusal("frames", "--unit", "0.001", "--rig", text)


def take(path: Path, sensors: dict[str, Callable[[int], Any]], count: int = 3) -> Path:
    info = TakeInfo(setup=Setup(), started_unix_ns=1, started_ns=0, method_settings={})
    writer = TakeWriter.create(path, info=info, reserve_bytes=0)
    for number in range(count):
        for name, make in sensors.items():
            data = encode_frame(make(number))
            writer.write_frame(data, sensor=name, node_id=1, sequence=number, log_ns=number)
    return writer.close().path


def seen(name: str, **changed: Any) -> Callable[[int], Any]:
    def make(number: int) -> Any:
        values = {"unit_m": 0.001, "lens": LENS} | (changed if number == 2 else {})
        return depth_frame(
            name, depth(700 + number), time_ns=10**9 + number * 50_000_000, node_id=1, sequence=number, **values
        )

    return make


def nobody(number: int) -> Any:
    return body_frame("front", topology("kinect_v2"), time_ns=number, positions=[], node_id=1, sequence=number)


def test_a_take_says_lens_and_unit_itself(folder: Path) -> None:
    take(folder / "one.mcap", {"front": nobody, "arm": seen("arm")})
    take(folder / "two.mcap", {"arm": seen("arm"), "other": seen("other")})
    for text, sensor in (("one.mcap", "arm"), ("one", "arm"), ("two.mcap:other", "other"), ("two:other", "other")):
        (recording,) = result(text)["recordings"]
        assert [frame["time_s"] for frame in recording["frames"]] == [0.0, 0.05, 0.1]
        assert recording["recording"].endswith(f".mcap:{sensor}")
        assert recording["frames"][2]["file"].endswith(f"{sensor}/2")
        assert recording["frames"][2]["arms"][0]["joints"]["palm"]["m"][2] == 0.702
    assert result("one.mcap", "--unit", "0.002")["recordings"][0]["unit_m"] == 0.002


def test_a_take_that_cannot_be_used_is_said(folder: Path) -> None:
    take(folder / "two.mcap", {"arm": seen("arm"), "other": seen("other"), "front": nobody})
    take(folder / "none.mcap", {"front": nobody})
    take(folder / "changed.mcap", {"arm": seen("arm", unit_m=0.002)})
    for text, named in (
        ("two.mcap", "several depth cameras; write two.mcap:NAME with one of arm, other"),
        ("two.mcap:front", "no depth images of 'front'; it has those of arm, other"),
        ("none.mcap", "has no depth images; record one with mocapella node arm --set publish_depth=true"),
        ("changed.mcap", "has another size, unit or lens than the first"),
    ):
        assert named in refusal(text)
    assert "one.mcap: field unit" in refusal(
        str(take(folder / "one.mcap", {"arm": seen("arm")})), "--unit", "kinect-raw"
    )


def test_where_no_arm_is_found_unit_and_lens_are_doubted(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = result("frames", *SAID)["recordings"][0]
    assert recording["problems"] == []
    assert recording["quality"]["misdetections_per_minute"] is None  # of a tenth of a second
    monkeypatch.setattr(NearestArm, "update", lambda self, depth, at_s: SeenArms((), "no hand is seen"))
    (problem,) = result("frames", *SAID)["recordings"][0]["problems"]
    assert "the median distance is 1 m" in problem
    assert problem in arm("frames", *SAID).stderr


def test_a_cut_off_take_is_read_as_far_as_it_goes(folder: Path) -> None:
    path = take(folder / "one.mcap", {"arm": seen("arm")})
    path.write_bytes(path.read_bytes()[:-200])
    done = arm("one.mcap", "--json", "out.json")
    (recording,) = json.loads(Path("out.json").read_text(encoding="utf-8"))["recordings"]
    assert recording["counts"]["images"] == 3
    assert "ends early" in done.stderr
    assert "ends early" in recording["problems"][0]


def test_the_process_says_it_in_one_line(tmp_path: Path) -> None:
    png(tmp_path / "a.png", np.ones((4, 4), np.uint8))
    done = run(tmp_path, "track", "arm", "a.png", *SAID)
    assert done.returncode == 1
    assert "8-bit greyscale; depth images have 16 bits" in " ".join(done.stderr.split())


def test_a_text_that_is_no_take_is_left_to_others(folder: Path) -> None:
    assert inputs.depth_of_take("frames") is None
    assert inputs.depth_of_take("frames/9.png") is None
    assert inputs.depth_of_take("openni:0") is None
    assert inputs.depth_recordings(["frames"], DepthOptions())[0].name == "frames"
