"""The example of a plug-in, installed beside the program, works in every way: no line of ours is changed for it."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.browser import FLAGS
from support.distributions import distribution
from support.programs import Program, free_port, result, run, wait_until

from mocapella.model.session import SessionStatus
from mocapella.wire.reader import Newest
from mocapella.wire.session import open_reader

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "plugin_thermal"
ARTIFACTS = ROOT / "artifacts"
CHROMIUM = shutil.which("chromium")
STAGE_PX = 190, 450
"""Below the message about the browser, and left of the panel."""
METHOD = ["--method", "heat", "--sensors", "2", "--set", "places.north=[-0.5,0]", "--set", "places.south=[0.5,0]"]
NODES = {"north": "-0.5", "south": "0.5"}


def project() -> dict[str, object]:
    return tomllib.loads((EXAMPLE / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example as an installer leaves it, without one: nothing has to be fetched for it."""
    described = project()
    folder = tmp_path_factory.mktemp("packages")
    shutil.copytree(EXAMPLE / "src", folder, dirs_exist_ok=True)
    return distribution(folder, described["name"], described["entry-points"], version=described["version"])


@pytest.fixture
def installed(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The programs that a test starts have the example; the test itself has not."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(package), *filter(None, [os.environ.get("PYTHONPATH")])]))


@pytest.mark.slow
def test_the_detector_and_the_smoother_of_the_page_pass_their_own_tests(tmp_path: Path) -> None:
    """The second example, as `docs/extending.md` shows it, installed beside the program."""
    example = ROOT / "examples" / "plugin_people"
    described = tomllib.loads((example / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    shutil.copytree(example / "src", tmp_path, dirs_exist_ok=True)
    distribution(tmp_path, described["name"], described["entry-points"], version=described["version"])
    path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", str(example / "tests")],
        capture_output=True, text=True, check=False, timeout=300, env={**os.environ, "PYTHONPATH": path}, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:]


class Session:
    """A server with two heat cameras."""

    def __init__(self, folder: Path, *words: str) -> None:
        port = free_port()
        self.address = f"tcp/127.0.0.1:{port}"
        self.serve = Program(folder, "serve", "serve", "--port", str(port), *METHOD, *words)
        self.nodes = [
            Program(folder, name, "node", "heat", "--name", name, "--x", x, "--connect", self.address)
            for name, x in NODES.items()
        ]

    def wait_for_spots(self) -> SessionStatus:
        """Until two spots are tracked, as a program sees it that has not installed the example."""
        bus = open_reader(self.address)
        newest, found = Newest(bus), []

        def tracked() -> bool:
            status, scene = newest.status(), newest.scene()
            # One can be seen before the other has joined, and both before the other's first frame.
            both = status is not None and [bool(sensor.frames) for sensor in status.sensors] == [True, True]
            if both and scene is not None and status.counts == {"spots": 2}:
                found.append((status, scene))
            return bool(found)

        wait_until("two spots are tracked", tracked)
        bus.close()
        status, scene = found[0]
        assert [part.kind for part in scene.of("spots")] == ["spots"] * 2
        return status

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        for program in (*self.nodes, self.serve):
            program.__exit__(None, None, None)


@pytest.fixture(scope="module")
def recorded(package: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the take `heat-1.mcap` of a live session, and its summary."""
    folder = tmp_path_factory.mktemp("heat")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(package))
        with Session(folder, "--no-view", "--record", "./heat-1", "--json", "summary.json") as session:
            wait_until("a server", session.serve.said("waiting for sensors"))
            status = session.wait_for_spots()
            assert [(sensor.name, sensor.sends) for sensor in status.sensors] == [("north", "heat"), ("south", "heat")]
            assert session.serve.end() == 0
            assert all(node.end() == 0 for node in session.nodes)
            assert "is skipped" not in session.serve.output
    return folder


def test_it_is_counted_and_recorded(recorded: Path) -> None:
    summary = json.loads((recorded / "summary.json").read_text(encoding="utf-8"))
    assert summary["spots"] == 2
    assert summary["most_spots"] >= 2  # more while one camera's frames are late: the example compares newest frames
    assert summary["rejected"] == 0
    assert summary["recording"]["problem"] == ""
    assert summary["recording"]["scenes"] > 0


@pytest.mark.usefixtures("installed")
def test_its_take_replays_to_the_bit(recorded: Path) -> None:
    (row,) = result(recorded, "replay", "heat-1")
    assert row["recorded_scenes"] > 0
    assert row["differing_scenes"] == 0
    assert row["most_spots"] == json.loads((recorded / "summary.json").read_text(encoding="utf-8"))["most_spots"]


@pytest.mark.slow
@pytest.mark.usefixtures("installed")
def test_its_export_and_the_general_one_have_every_spot(recorded: Path) -> None:
    assert run(recorded, "export", "spots", "heat-1").returncode == 0
    with (recorded / "heat-1.spots.csv").open(encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    made = result(recorded, "export", "json", "heat-1")
    assert made["parts"] == {"spots": len(table)}
    assert made["unread"] == {}
    last = json.loads((recorded / "heat-1.jsonl").read_text(encoding="utf-8").splitlines()[-1])
    found = last["parts"]["spots"]  # new spots, if a camera stood still for long
    assert [str(spot["id"]) for spot in found] == [row["id"] for row in table if row["step"] == table[-1]["step"]]
    assert len(found) == 2
    assert found[0]["cameras"] == ["north", "south"]
    assert f"left out by export arms: spots ({len(table)})" in run(recorded, "export", "arms", "heat-1").stderr


@pytest.mark.slow
@pytest.mark.usefixtures("installed")
def test_help_and_the_doctor_name_it(tmp_path: Path) -> None:
    assert "A simulated heat camera." in run(tmp_path, "node", "--help").stdout
    assert "Hot spots: a row for each spot" in run(tmp_path, "export", "--help").stdout
    findings = [one for one in result(tmp_path, "doctor") if one["what"] == "plug-in mocapella-thermal 1.0"]
    assert {one["verdict"] for one in findings} == {"ok"}
    assert len(findings) == sum(len(names) for names in project()["entry-points"].values())


def test_without_it_the_take_opens_and_names_the_package(recorded: Path) -> None:
    done = run(recorded, "replay", "heat-1")
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    for what in ("tracking method heat", "frame type heat", "part type spots"):
        assert f"it was made with the {what} of mocapella-thermal 1.0, which is not installed" in line
    made = result(recorded, "export", "json", "heat-1", "--out", "without.jsonl")
    assert made["unread"] == made["parts"]
    assert made["parts"]["spots"] > 0
    assert "unknown export 'spots'" in re.sub(r"\s*│\s*", " ", run(recorded, "export", "spots", "heat-1").stderr)


def amber(screenshot: bytes) -> int:
    """How many pixels of the stage have the colour of the spots."""
    image = cv2.imdecode(np.frombuffer(screenshot, np.uint8), cv2.IMREAD_COLOR)
    hue, saturation, value = cv2.split(cv2.cvtColor(image[:, : STAGE_PX[1]][STAGE_PX[0] :], cv2.COLOR_BGR2HSV))
    return int(((hue > 15) & (hue < 25) & (saturation > 100) & (value > 60)).sum())


@pytest.mark.slow
@pytest.mark.usefixtures("installed")
@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium on the PATH")
def test_its_spots_are_in_the_view(tmp_path: Path) -> None:
    sync_api = pytest.importorskip("playwright.sync_api")
    with Session(tmp_path, "--set", f"view_port={free_port()}") as session:
        wait_until("the view", session.serve.said("live view: "))
        session.wait_for_spots()
        url = re.findall(r"live view: (http\S+)", session.serve.output)[0]
        with sync_api.sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
            page = browser.new_page(viewport={"width": 800, "height": 480})
            page.set_default_timeout(60_000)
            page.goto(url)
            page.locator(".mocapella-status", has_text="2 spots").wait_for()
            wait_until("balls are drawn", lambda: amber(page.screenshot()) > 100)
            ARTIFACTS.mkdir(exist_ok=True)
            page.screenshot(path=ARTIFACTS / "plugin-view.png")
            browser.close()
        assert session.serve.end() == 0


def test_an_installer_makes_the_same_of_it(package: Path, tmp_path: Path) -> None:
    command = ["uv", "pip", "install", "--offline", "--no-deps", "--python", sys.executable, "--target", "there"]
    done = subprocess.run([*command, str(EXAMPLE)], cwd=tmp_path, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip("the package cannot be built without the network here")
    (made,) = (tmp_path / "there").glob("*.dist-info/entry_points.txt")
    (laid,) = package.glob("*.dist-info/entry_points.txt")
    assert sorted(made.read_text().split()) == sorted(laid.read_text().split())
    files = {path.name for path in (tmp_path / "there" / "mocapella_thermal").glob("*.py")}
    assert files == {path.name for path in (EXAMPLE / "src" / "mocapella_thermal").glob("*.py")}


@pytest.mark.slow
@pytest.mark.usefixtures("installed")
def test_its_own_tests_pass(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", os.devnull]
    done = subprocess.run([*command, str(EXAMPLE / "tests")], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
