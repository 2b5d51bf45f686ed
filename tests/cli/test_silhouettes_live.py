"""`mocapella track silhouettes` on live cameras: streams over loopback, films as cameras, and mistakes."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.mjpeg_streams import MjpegStreams, jpeg
from support.programs import Program, free_port, run_here, wait_until
from support.silhouette_pictures import Room, pose_at, ring, somebody, write_folders

from mocapella.cli.silhouette_result import SilhouetteResult
from mocapella.errors import InputError
from mocapella.model.camera_rig_file import save_camera_rig
from mocapella.model.rigged_mesh import landmarks_at
from mocapella.recording.bodies_file import read_followed_people
from mocapella.sources.simulate.silhouette_scene import silhouette_scene

COMPILED = 300.0
"""By then everything is compiled, even beside other tests [s]."""
SLOW_HZ = 8.0
"""Poses a second at most, of 20 that the motion has."""
NAMED = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist", "head")


def joints_at(mesh, pose):
    places = zip(mesh.landmarks, landmarks_at(mesh, pose), strict=True)
    return {name: at.tolist() for name, at in places if name.split()[-1] in NAMED}


class Stage:
    """A person who bends the knees before cameras that stream. The test sets the motion; all cameras show it at once.

    Attributes:
        at: the motion's image to show from the streams' next tick on; None shows the empty room.
        off: cameras whose streams end.
    """

    def __init__(self, fps=20.0):
        self.scene = silhouette_scene(
            "knee-bend", seed=4, cameras=3, size_px=(320, 240), fps=fps, sex="male", height_m=1.75
        )
        self.at = self._shown = None
        self.off = set()
        names, noise = list(self.scene.rig.cameras), np.random.default_rng(0).normal(0, 1.5, (480, 640, 3))
        self._noise = noise.astype(np.int8)
        self._empty = dict(zip(names, self.scene.background(0), strict=True))
        self._moving = [dict(zip(names, self.scene.images(k), strict=True)) for k in range(len(self.scene))]

    def move(self, folder):
        """From now on: the next pose when two more frames were followed, so that a busy machine can follow."""

        def run():
            before = seen(folder)
            while self.at < len(self.scene) - 1:
                time.sleep(1 / SLOW_HZ)
                if (now := seen(folder)) >= before + 2:
                    self.at, before = self.at + 1, now

        threading.Thread(target=run, daemon=True).start()

    def streams(self):
        return MjpegStreams(self._pictures, 1 / 15, self._tick)

    def _tick(self):
        self._shown = self.at

    def _pictures(self, name):
        """No two pictures of a camera are the same, not even of somebody who stands still: a repeated one is stale."""
        rng = np.random.default_rng()
        while name not in self.off:
            shown = self._shown
            image = (self._empty if shown is None else self._moving[shown])[name]
            down, right = rng.integers(240), rng.integers(320)
            noise = self._noise[down : down + image.shape[0], right : right + image.shape[1]]
            yield jpeg(cv2.add(image, noise, dtype=cv2.CV_8U))


@pytest.fixture(scope="module")
def stage():
    return Stage()


@pytest.fixture
def folder(stage, tmp_path):
    save_camera_rig(tmp_path / "rig.toml", stage.scene.rig)
    (tmp_path / "joints.json").write_text(json.dumps(joints_at(stage.scene.mesh, stage.scene.pose(0))))
    stage.at, stage.off = None, set()
    return tmp_path


GIVEN = ("--rig", "rig.toml", "--start", "joints.json")


def seen(folder):
    """So many frames are followed by now."""
    return len({path.stem.rpartition("_")[2] for path in (folder / "seen").glob("*.jpg")})


def wait_for_more(folder, count):
    """Until so many more are."""
    wanted = seen(folder) + count
    wait_until("more frames", lambda: seen(folder) >= wanted)


@pytest.mark.slow
def test_somebody_who_comes_before_live_cameras_is_followed_until_ctrl_c(stage, folder):
    scene = stage.scene
    with stage.streams() as streams:
        sources = [f"{name}={streams.address(name)}" for name in reversed(scene.rig.cameras)]
        with Program(
            folder, "run", "track", "silhouettes", *sources, *GIVEN,
            "--set", "empty_room=1", "--json", "out.json", "--overlay", "seen",
            "--view", "--set", "browser=false", "--set", f"view_port={free_port()}",
        ) as program:  # fmt: skip
            wait_until("the room is learnt", program.said("the person may come now"), COMPILED)
            wait_until("it waits", lambda: program.said("until Ctrl-C")() and seen(folder) >= 5, COMPILED)
            assert "the body is there" not in program.output
            stage.at = 0
            wait_until("somebody is there", program.said("the body is there"))
            stage.move(folder)
            wait_until("they have moved", lambda: stage.at == len(scene) - 1, COMPILED)
            wait_for_more(folder, 30)
            assert program.end(signal.SIGINT) == 0
    assert "where the outlines are in the view's pictures: left hip at" in program.output
    assert "something moved" not in program.output
    found = json.loads((folder / "out.json").read_text())
    rows, mesh = found["frames"], scene.mesh
    assert list(found["cameras"]) == list(scene.rig.cameras)
    assert found["cameras"]["camera1"] == {"source": streams.address("camera1"), "size_px": [320, 240]}
    assert set(found["summary"]["dropped"]) == set(scene.rig.cameras)
    assert [row["frame"] for row in rows] == list(range(len(rows)))
    assert rows[0]["time_s"] == 0.0
    assert (np.diff([row["time_s"] for row in rows]) > 0).all()
    lost = [row["lost"] for row in rows]
    # The room is empty, and then the person is there; whom a busy machine loses for a moment is found again.
    assert all(lost[:5])
    assert not any(lost[-5:])
    truth = dict(zip(mesh.landmarks, landmarks_at(mesh, scene.pose(len(scene) - 1)), strict=True))
    off = [np.linalg.norm(np.subtract(at, truth[name])) for name, at in rows[-1]["joints"].items() if name in truth]
    assert np.median(off) < 0.05
    knee = mesh.joint_names.index("left knee flexion")
    deepest = float(scene.poses().angles[:, knee].max())
    followed = [row["angles"]["left knee flexion"] for row in rows if not row["lost"]]
    assert deepest > 1.0
    # Where a busy machine leaves frames far apart, a single fit can bend too far (docs/methods/silhouettes.md).
    assert min(abs(angle - deepest) for angle in followed) < 0.25


@pytest.mark.slow
def test_a_stream_that_ends_is_said_and_counts_again_when_it_is_back(stage, folder):
    stage.at = 0
    with stage.streams() as streams:
        sources = [f"{name}={streams.address(name)}" for name in stage.scene.rig.cameras]
        with Program(
            folder,
            "run",
            "track",
            "silhouettes",
            *sources,
            *GIVEN,
            "--json",
            "out.json",
            "--overlay",
            "seen",
            "--no-view",
        ) as program:
            wait_until("it follows", lambda: program.said("until Ctrl-C")() and seen(folder) >= 3, COMPILED)
            stage.off.add("camera2")
            wait_until("it is missing", program.said("camera2 does not count from frame"))
            gone = f"camera2: {streams.address('camera2')}: gives no picture any more"
            wait_until("why is said", program.said(gone))
            stage.off.clear()
            wait_until("it is back", program.said("camera2 counts again from frame"))
            assert program.end(signal.SIGINT) == 0
    rows = json.loads((folder / "out.json").read_text())["frames"]
    missing = [row for row in rows if row["left_out"].get("camera2") == "it gives no picture"]
    assert len(missing) >= 3
    assert all("camera2" not in row["overlap"] and {"camera1", "camera3"} & set(row["overlap"]) for row in missing)
    assert not any(row["lost"] for row in rows)


@pytest.mark.parametrize("names", [(), ("anna",)], ids=["one", "named"])
def test_a_run_that_is_killed_leaves_its_frames_which_are_read_as_any_result(stage, folder, names):
    stage.at = 0
    (folder / "out.json").write_text("of before")
    start = [word for name in names for word in ("--start", f"{name}=joints.json")] or ["--start", "joints.json"]
    with stage.streams() as streams:
        sources = [f"{name}={streams.address(name)}" for name in stage.scene.rig.cameras]
        given = (
            "track",
            "silhouettes",
            *sources,
            "--rig",
            "rig.toml",
            *start,
            "--json",
            "out.json",
            "--overlay",
            "seen",
            "--no-view",
        )
        with Program(folder, "run", *given) as program:
            wait_until("it follows", lambda: program.said("until Ctrl-C")() and seen(folder) >= 5, COMPILED)
            program.end(signal.SIGKILL)
    assert (folder / "out.json").read_text() == "of before"
    (body,) = read_followed_people(folder / "out.part.json").values()
    assert len(body.frames) >= 5
    assert [row.frame for row in body.frames] == list(range(len(body.frames)))
    with stage.streams() as streams:
        sources = [f"{name}={streams.address(name)}" for name in stage.scene.rig.cameras]
        done = run_here(
            folder, "track", "silhouettes", *sources, "--rig", "rig.toml", "--start", "out.part.json:2",
            "--json", "out.json",
            "--seconds", "1", "--no-view",
        )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "out.part.json is there, of a run that still goes on or was killed" in " ".join(done.stderr.split())
    assert list(read_followed_people(folder / "out.json")) == [*names, *[""][len(names) :]]
    assert len(read_followed_people(folder / "out.part.json").popitem()[1].frames) == len(body.frames)


MESH, RIG, HZ = somebody(), ring(3), 10.0
FILMS = [f"c{k}" for k in (3, 1, 2)]
LIVE = ("--set", "live=true", "--fps", str(HZ), "--no-view")


@pytest.fixture(scope="module")
def films(tmp_path_factory):
    """A rig, a folder of images of each camera, and where somebody is in the first."""
    where, room = tmp_path_factory.mktemp("films"), Room(RIG)
    poses = [pose_at(MESH, 0.005 * k, 0.4 + 0.01 * k) for k in range(10)]
    write_folders(where, [room.images(MESH, pose) for pose in poses])
    write_folders(where / "empty", [room.images() for _ in range(2)])
    write_folders(where / "first_empty", [room.images() for _ in range(10)] + [room.images(MESH, poses[0])] * 10)
    # Again and again, so that it goes on when a busy machine has learnt the room.
    write_folders(where / "walked", 4 * [room.images(MESH, pose_at(MESH, 0.1 * k)) for k in range(12)])
    save_camera_rig(where / "rig.toml", RIG)
    (where / "joints.json").write_text(json.dumps(joints_at(MESH, poses[0])))
    return where


def ran(folder, *arguments):
    done = run_here(
        folder,
        "track",
        "silhouettes",
        *arguments,
        "--no-view",
        "--rig",
        "rig.toml",
        "--start",
        "joints.json",
        "--json",
        "-",
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), " ".join(done.stderr.split())


@pytest.mark.slow
def test_what_asks_for_no_file_leaves_none_and_what_fails_says_where_its_frames_are(films, tmp_path, monkeypatch):
    before = sorted(films.iterdir())
    assert run_here(films, "track", "silhouettes", *FILMS, *LIVE, *GIVEN).returncode == 0
    done = run_here(films, "track", "silhouettes", *FILMS, *LIVE, *GIVEN, "--json", os.devnull)
    assert done.returncode == 0, done.stderr
    assert Path(os.devnull).is_char_device()  # it is no file to be replaced
    assert sorted(films.iterdir()) == before

    def refuse(*_):
        raise InputError("is gone", file="c1")

    monkeypatch.setattr(SilhouetteResult, "finish", refuse)
    out = tmp_path / "out.json"
    done = run_here(films, "track", "silhouettes", *FILMS, *LIVE, *GIVEN, "--json", str(out))
    assert done.returncode == 1
    (body,) = read_followed_people(tmp_path / "out.part.json").values()
    assert f"the {len(body.frames)} frames until then are in" in " ".join(done.stderr.split())
    assert not out.exists()


@pytest.mark.slow
def test_films_as_if_they_were_cameras_end_by_themselves(films):
    found, said = ran(films, *FILMS, "--set", "live=true", "--fps", str(HZ))
    assert "following until Ctrl-C" in said
    assert found["rate_hz"] == HZ
    rows, dropped = found["frames"], found["summary"]["dropped"]
    assert rows
    assert not any(row["lost"] for row in rows)
    for name in RIG.cameras:  # every picture was used, or dropped and counted
        used = sum(name not in row["left_out"] or row["left_out"][name] != "it gives no picture" for row in rows)
        assert used + dropped[name] == 10
    times = [row["time_s"] for row in rows]
    assert (np.diff(times) > 0.9 / HZ / 2).all()
    assert times[-1] <= 9 / HZ + 1e-6


@pytest.mark.slow
def test_somebody_in_the_empty_room_is_said(films):
    found, said = ran(
        films, *(f"walked/{name}" for name in FILMS), "--set", "live=true", "--fps", str(HZ), "--set", "empty_room=0.8"
    )
    assert "something moved in the images of c1, c2, c3 while the empty room was learnt: was a person there?" in said
    assert found["summary"]["notes"][0].startswith("something moved")


@pytest.mark.slow
def test_it_ends_after_so_many_seconds(films):
    found, said = ran(films, *FILMS, "--set", "live=true", "--fps", "1", "--seconds", "2.5")
    assert "following for 2.5 s" in said
    assert 1 <= len(found["frames"]) <= 3
    assert "stopped before the end" not in said


@pytest.mark.slow
def test_who_is_not_there_yet_is_waited_for_where_the_empty_room_is_filmed(films):
    empty = [argument for name in FILMS for argument in ("--background", f"empty/{name}")]
    found, said = ran(films, *(f"first_empty/{name}" for name in FILMS), "--set", "live=true", "--fps", str(HZ), *empty)
    assert "the person may come now" in said
    lost = [row["lost"] for row in found["frames"]]
    assert lost[0]
    assert not lost[-1]
    assert "the body is there" in said
    assert "again" not in said
    there, _ = ran(films, *FILMS, "--set", "live=true", "--fps", str(HZ), *empty)
    # Who is there from the beginning is found as soon as two cameras give a picture.
    assert not any(row["lost"] for row in there["frames"] if len(row["overlap"]) > 1)
    assert not there["frames"][-1]["lost"]


def failed(folder, *arguments):
    done = run_here(
        folder, "track", "silhouettes", *arguments, "--no-view", "--rig", "rig.toml", "--start", "joints.json"
    )
    assert done.returncode == 1, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return " ".join(done.stderr.split())


def test_what_cannot_be_done_live_is_one_line(films):
    gone = f"http://127.0.0.1:{free_port()}/stream"
    for arguments, said in (
        (
            (f"c1={gone}", "c2=camera:91"),
            f"{gone}: cannot be opened; look whether a browser or a player shows the stream",
        ),
        (("c1=camera:91", "c2=c2"), "c1=camera:91 is live, and c2=c2 is not; name cameras for all, or films for all"),
        (("c1=camera:left",), "write camera:0 for the first camera"),
        (("c9=camera:0",), "camera:0: field camera: 'c9': the rig has no such camera; the rig's are c1, c2, c3"),
        (("c1=camera:0", "--frames", "0:10"), "--frames is of videos"),
        (("c1=camera:0", "--set", "empty_room=0"), "empty_room is 0.0; it must be above 0"),
        (("c1=camera:0", "--set", "empty_room=2", "--background", "c1"), "empty_room and --background are both given"),
        (("c1", "--set", "empty_room=2", "--fps", "10"), "empty_room is of live cameras"),
        (("c1", "--seconds", "2", "--fps", "10"), "--seconds is of live cameras"),
        (("c1", "--set", "fourcc=MJPG", "--fps", "10"), "fourcc is of live cameras"),
        (("c1", "--set", "late=c1=20", "--fps", "10"), "late is of live cameras"),
        (
            ("c1", "c2", "--set", "live=true", "--set", "late=c1"),
            "late 'c1' cannot be used; write NAME=MILLISECONDS, such as back=120",
        ),
        (("c1", "c2", "--set", "live=true", "--set", "late=c3=20"), "late c3=20: no source is of c3; there are c1, c2"),
        (("c1", "--set", "live=true", "--set", "late=c8=20"), "the rig has no such camera"),
        (("c1", "--set", "live=true", "--set", "late=C1=20", "--set", "late=c1=30"), "late is given twice of c1"),
        (("c1", "--set", "live=true", "--set", "late=c1=-1"), "late c1 is -1.0; it must be 0 to 500 ms"),
        (("c1=no.avi", "--set", "live=true"), "no.avi: is not there"),
        (("c1", "--set", "live=true", "--fps", "20", "--set", "empty_room=1"), "no camera gives a picture any more"),
        (("c1=c1", "--set", "live=true", "--set", "other_size=half"), "other_size is 'half'"),
    ):
        assert said in failed(films, *arguments), arguments


def test_a_camera_of_another_size_is_refused_as_a_video_is(films, tmp_path):
    write_folders(tmp_path, [{"small": np.full((100, 120, 3), 90, np.uint8)}])
    small = tmp_path / "small"
    said = failed(films, f"c1={small}", "--set", "live=true")
    assert (
        "field size: (120, 100): has images of 120 × 100 px, but the camera c1 is calibrated for 240 × 200 px" in said
    )
    done = run_here(
        films,
        "track",
        "silhouettes",
        f"c1={small}",
        "c2=c2",
        "--set",
        "live=true",
        "--set",
        "other_size=scale",
        "--fps",
        "10",
        "--no-view",
        *GIVEN,
    )
    assert done.returncode == 0, done.stderr
    assert "--set other_size=scale" in " ".join(done.stderr.split())
