"""``mocapella calibrate cameras``: from pictures to a rig file, in words and in JSON."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.filmed_boards import BOARD, SIZE, film

from mocapella.cli import main
from mocapella.errors import SettingsError
from mocapella.library.calibration import named_inputs
from mocapella.model.board import Board, BoardView
from mocapella.model.camera_rig_file import load_camera_rig
from mocapella.sensing import boards

TOML = 'kind = "charuco"\ncolumns = 6\nrows = 5\nsquare_m = 0.06\n'


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """The exit status of a command line."""
    monkeypatch.setattr(sys, "argv", ["mocapella", *map(str, arguments)])
    try:
        main()
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two cameras' folders of pictures, whose pixels say which view they are, and a detector that reads that."""
    (tmp_path / "board.toml").write_text(TOML)
    views: dict[tuple[str, int], BoardView] = {(v.camera, v.frame): v for v in film(instants=14, noise_px=0.2).views}
    for camera in ("c0", "c1"):
        (tmp_path / camera).mkdir()
        for k in range(14):
            cv2.imwrite(str(tmp_path / camera / f"{k:02}.png"), np.full((4, 4, 3), 10 * k, dtype=np.uint8))

    class Reader(boards.BoardDetector):
        def update(self, image: Any, camera: str, frame: int) -> BoardView | None:
            self.report.pictures += 1
            view = views.get((camera, frame))
            if view is not None:
                assert int(image[0, 0, 0]) == 10 * frame
                self.report.found += 1
                self.report.corners += len(view.ids)
            return view

    monkeypatch.setattr(boards, "BoardDetector", Reader)
    return tmp_path


def test_pictures_become_a_rig_and_a_report(
    scene: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = scene / "rig.toml"
    status = run(
        monkeypatch,
        "calibrate",
        "cameras",
        scene / "c0",
        scene / "c1",
        "--board",
        scene / "board.toml",
        "--out",
        out,
        "--json",
        "-",
    )
    said = capsys.readouterr()
    assert status == 0, said.err
    rig = load_camera_rig(out)
    assert list(rig.cameras) == ["c0", "c1"]
    result = json.loads(said.out)
    assert result["cameras"]["c1"]["lens"] == rig.cameras["c1"].camera.lens.tolist()
    assert result["cameras"]["c1"]["distance_to_first_m"] == pytest.approx(0.56, abs=0.1)
    assert result["instants"] == 14
    assert result["sigma_px"] == pytest.approx(0.2, rel=0.2)
    assert result["left_out"][0]["distance_rms_mm"] < 1
    assert "c0: the board in 14 of 14 pictures" in said.err
    assert [hint["text"] for hint in result["hints"]] == [line for line in said.err.splitlines() if "camera c" in line]


@pytest.mark.slow
def test_lenses_of_another_rig_times_and_a_table(
    scene: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    common = ["--board", scene / "board.toml", "--frames", "0:12"]
    cameras = [scene / "c0", scene / "c1"]
    assert run(monkeypatch, "calibrate", "cameras", *cameras, *common, "--out", scene / "a.toml") == 0
    table = capsys.readouterr().out
    assert "triangulated one by one" in table
    assert "each half by the other" in table
    times = scene / "times.csv"
    rows = [f"{c},{k},{0.1 * k + 0.004 * (c == 'c1')}" for c in ("c0", "c1") for k in range(14)]
    times.write_text("\n".join(["camera,frame,time_s", *rows]))
    more = ["--rig", scene / "a.toml", "--timestamps", times, "--origin", "3"]
    assert run(monkeypatch, "calibrate", "cameras", *cameras, *common, *more, "--out", scene / "b.toml") == 0
    first, second = load_camera_rig(scene / "a.toml"), load_camera_rig(scene / "b.toml")
    for name in ("c0", "c1"):
        np.testing.assert_array_equal(first.cameras[name].camera.lens, second.cameras[name].camera.lens)
    assert not np.allclose(first.cameras["c0"].T_camera_world, second.cameras["c0"].T_camera_world)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["c0", "c0"], "two cameras are called 'c0'; write NAME=VIDEO"),
        (["c0", "camera:0"], "live cameras, nodes and videos cannot be calibrated together"),
        (["node:a", "camera:0"], "live cameras, nodes and videos cannot be calibrated together"),
        (["b=node:a"], "a node's camera keeps its name; write node:a"),
        (["node:a", "--connect", "tcp/127.0.0.1:9"], "no server answers at tls/127.0.0.1:9"),
        (["camera:x"], "write camera:0"),
        (["c0", "--frames", "some"], "write odd, even or FROM:TO:STEP"),
        (["c0", "c1", "--tolerance-ms", "3"], "has no meaning without timestamps"),
        (["c0", "c1", "--alone", "c9=c0"], "no such camera; there are c0, c1"),
        (["c0", "c1", "--origin", "77"], "no camera has that frame"),
        (["empty"], "is a folder without images"),
    ],
)
def test_a_command_line_that_cannot_be_says_what_can(
    scene: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str], says: str
) -> None:
    (scene / "empty").mkdir()
    monkeypatch.chdir(scene)
    assert run(monkeypatch, "calibrate", "cameras", *arguments, "--board", "board.toml", "--out", "rig.toml") == 1
    assert says in capsys.readouterr().err
    assert not (scene / "rig.toml").exists()


def test_a_camera_that_never_sees_the_board_is_told_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "board.toml").write_text(TOML + 'dictionary = "DICT_6X6_50"\n')
    shown = Board("charuco", 6, 5, 0.06, dictionary="DICT_4X4_50")
    cv2.imwrite(str(tmp_path / "left.png"), cv2.copyMakeBorder(boards.draw_board(shown, 60), *[40] * 4, 0, value=255))
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, "calibrate", "cameras", "left.png", "--board", "board.toml", "--out", "rig.toml") == 1
    said = capsys.readouterr().err
    assert "camera left: found no corner of DICT_6X6_50 board of 6 × 5 squares; of DICT_4X4_50 there are 15" in said


def test_a_board_is_drawn_in_its_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "board.toml").write_text(TOML)
    monkeypatch.chdir(tmp_path)
    assert (
        run(monkeypatch, "calibrate", "board", "board.toml", "--out", "board.png", "--dpi", "100", "--json", "-") == 0
    )
    assert json.loads(capsys.readouterr().out) == {"path": "board.png", "width_mm": 420, "height_mm": 360}
    data = (tmp_path / "board.png").read_bytes()
    at = data.index(b"pHYs")
    assert int.from_bytes(data[at + 4 : at + 8]) == round(100 / 0.0254)
    image = cv2.imread("board.png", cv2.IMREAD_GRAYSCALE)
    assert image.shape == (6 * 236, 7 * 236)
    view = boards.BoardDetector(Board("charuco", 6, 5, 0.06)).update(image, "a", 0)
    assert view is not None
    assert len(view.ids) == 20


def test_without_opencv_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import importlib.util

    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert (
        run(monkeypatch, "calibrate", "cameras", "a.mp4", "--board", "b.toml", "--out", str(tmp_path / "r.toml")) == 1
    )
    assert "calibrate cameras needs OpenCV: uv sync --extra cameras" in capsys.readouterr().err


def test_names_come_from_files_or_are_given() -> None:
    assert named_inputs(["a/left.mp4", "r=b/x.mp4", "camera:2"]) == {
        "left": "a/left.mp4",
        "r": "b/x.mp4",
        "camera_2": "camera:2",
    }
    with pytest.raises(SettingsError, match="sensor name"):
        named_inputs(["a b.mp4"])


def test_live_cameras_are_filmed_and_guided(
    scene: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two fake cameras, whose every picture is looked at; hints are said when they change."""
    from mocapella.sources import video

    class Fake:
        lost: dict[str, int] = {"camera_0": 0, "camera_1": 3}  # noqa: RUF012
        frame = -1

        def __init__(self, numbers: dict[str, int]) -> None:
            assert numbers == {"camera_0": 0, "camera_1": 1}

        def read(self) -> dict[str, tuple[float, np.ndarray]]:
            Fake.frame += 1
            there = {name: (0.0, np.full((4, 4, 3), Fake.frame, dtype=np.uint8)) for name in Fake.lost}
            return dict(list(there.items())[: 1 if Fake.frame == 0 else 2])

        def close(self) -> None:
            pass

    views = {(v.camera.replace("c", "camera_"), v.frame): v for v in film(instants=14, noise_px=0.2).views}

    class Reader:
        def __init__(self, board: Board) -> None:
            assert board == BOARD

        def update(self, image: Any, camera: str, _frame: int) -> BoardView | None:
            view = views.get((camera, int(image[0, 0, 0]) % 14))
            return None if view is None else BoardView(camera, 0, SIZE, view.ids, view.corners_px)

    import time

    ticks = iter(range(1000))
    monkeypatch.setattr(video, "LiveCameras", Fake)
    monkeypatch.setattr(boards, "BoardDetector", Reader)
    monkeypatch.setattr(time, "monotonic", lambda: float(next(ticks)))
    monkeypatch.chdir(scene)
    arguments = ["camera:0", "camera:1", "--board", "board.toml", "--out", "rig.toml", "--seconds", "70"]
    assert run(monkeypatch, "calibrate", "cameras", *arguments) == 0
    said = capsys.readouterr().err.replace("\n", " ")
    assert "of 10: go on filming" in said
    assert "camera camera_1 gave no picture 3 times" in said  # while it was gone
    assert "camera camera_1 gave no picture 1 times" in said  # in all
    assert list(load_camera_rig(scene / "rig.toml").cameras) == ["camera_0", "camera_1"]
