"""What all tests share: the real recordings, how to skip by name where they are not there, and two workers."""

from __future__ import annotations

import os
import sys
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

# Two workers share two cores: threads within a product of small matrices would only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
CACHE = Path(__file__).resolve().parents[1] / ".pytest_cache"
# More than a hundred programs are started. Without the bytecode of what they import, each takes seconds more; who wants
# none beside the sources has it elsewhere.
if sys.dont_write_bytecode:
    sys.pycache_prefix = str(CACHE / "bytecode")
    sys.dont_write_bytecode = False
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from xdist.scheduler import LoadScopeScheduling

from mocapella.tracker import make_ready

# The same examples every time, so that a change is judged by itself; `explore` tries others, and more. A first call may
# compile.
settings.register_profile("same", deadline=None, derandomize=True, max_examples=50)
settings.register_profile("explore", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))

REAL_TIME = (
    *("cli/test_hand_measure.py", "cli/test_record.py", "cli/test_running.py", "sources/test_bridge.py"),
    *(
        "live/test_arm_node.py",
        "live/test_board_calibration.py",
        "live/test_datagrams.py",
        "live/test_marker_node.py",
        "sources/test_acquisition.py",
    ),
    *("live/test_node.py", "live/test_outages.py", "live/test_processes.py", "live/test_recording_desk.py"),
    *("live/test_server.py", "live/test_server_junk.py", "live/test_view_process.py"),
    *("viewer/test_body_view_in_browser.py", "viewer/test_view_in_browser.py", "viewer/test_viewer.py"),
)
"""Tests of programs, servers and a browser that keep real time: never two at once. Those of the README and the examples
start programs, too, but do not mind how long these take."""
COMPILING = ("tracker/test_ready.py",)
"""Tests that compile what others use: first of all."""
BROWSER = ("viewer/test_view_in_browser.py", "viewer/test_viewer.py")
"""Tests that keep real time and need nothing compiled: first of those, for the other worker compiles meanwhile."""
LONG = ("test_readme.py",)
"""Single tests that take a minute: early, so that nobody waits for them alone at the end."""
TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Two workers for all tests or a folder of them; none where files, tests or words are chosen: it begins sooner."""
    chosen = config.option.keyword or any(".py" in argument for argument in config.args)
    return 0 if chosen else 2


class RealTimeApart(LoadScopeScheduling):
    """One worker has all that keeps real time, from the beginning; the other everything else, test by test."""

    def _split_scope(self, nodeid: str) -> str:
        return "real time" if nodeid.removeprefix("tests/").startswith(REAL_TIME) else nodeid


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> RealTimeApart:
    """Group tests without their marks, which only the workers know."""
    return RealTimeApart(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What compiles comes first, what needs nothing compiled, what is long; what keeps real time has a mark."""
    for item in items:
        if _place(item).startswith(REAL_TIME):
            item.add_marker("real_time")
    first = (COMPILING, BROWSER, LONG)
    items.sort(key=lambda item: [not _place(item).startswith(places) for places in first])


def pytest_runtest_setup(item: pytest.Item) -> None:
    """A program that is waited for does not compile meanwhile. Each part is compiled once, by whoever comes first."""
    if _place(item).startswith(COMPILING):
        parts: tuple[str, ...] = ("people", "arms", "hands", "pictures of hands", "rooms")
    elif item.get_closest_marker("real_time") and not _place(item).startswith(BROWSER):
        parts = ("hands", "pictures of hands", "rooms", "people")  # the other worker has begun with the others
        if "arm" in item.nodeid:
            parts = (*parts, "arms")
    else:
        return
    for part in parts:
        if part not in _compiled:
            with _alone(part):
                PARTS[part]()
            _compiled.add(part)


def _make_arms_ready() -> None:
    from mocapella.model.camera import Camera
    from mocapella.sources.simulate.depth_scene import load_depth_scene
    from mocapella.tracker.arm_methods import arm_method

    scene = load_depth_scene("cloth", seed=1)
    finds = arm_method("default", Camera("arm", scene.sensor.size_px, scene.lens))
    for k in range(3):
        shot = scene.at(k / 30)
        finds.update(shot.depth * np.float32(shot.unit_m), k / 30)


def _make_pictures_ready() -> None:
    """Rendered, and markers found in them."""
    from mocapella.sources.simulate.hand_camera import SimulatedHandCamera
    from mocapella.sources.simulate.hand_scene import load_hand_scene

    next(SimulatedHandCamera(load_hand_scene("demo", seed=1), "left").frames())


def _make_rooms_ready() -> None:
    from mocapella.sources.simulate import SimulatedSensor, load_scene

    next(SimulatedSensor(load_scene("obstacle", seed=1), 1).frames())


PARTS = {
    "people": lambda: make_ready("default"),
    "hands": lambda: make_ready("hands"),
    "pictures of hands": _make_pictures_ready,
    "rooms": _make_rooms_ready,
    "arms": _make_arms_ready,
}
_compiled: set[str] = set()
"""By this worker, or loaded after the other one had."""


@contextmanager
def _alone(what: str) -> Iterator[None]:
    """Neither of the two workers does it while the other does."""
    CACHE.mkdir(exist_ok=True)
    with (CACHE / f"{what}.lock").open("w") as lock:
        if fcntl is not None:
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _place(item: pytest.Item) -> str:
    return item.path.relative_to(TESTS).as_posix()


def recordings() -> Path:
    """The folder of real recordings: ``MOCAPELLA_DATA``, or ``../shared/data`` beside the project."""
    return Path(os.environ.get("MOCAPELLA_DATA", ROOT.parent / "shared" / "data"))


@pytest.fixture(scope="session")
def study_logs() -> Path:
    """The real Kinect logs of 2015; the test is skipped, and says so, where they are not there."""
    folder = recordings() / "kinectmultitrack"
    if not folder.is_dir():
        pytest.skip(f"needs the recordings in {folder} (MOCAPELLA_DATA names another place)")
    return folder


@pytest.fixture(scope="session")
def mocap_files() -> Path:
    """BVH, C3D and TRC files of other people's tools."""
    folder = recordings() / "mocap_files"
    if not folder.is_dir():
        pytest.skip(f"needs the recordings in {folder} (MOCAPELLA_DATA names another place)")
    return folder


@pytest.fixture(scope="session")
def one_euro_vectors() -> Any:
    """(1200, 4): the times, the signal, the noisy signal and the result of the 1-euro filter's authors."""
    return np.loadtxt(_recorded("one_euro_filter_vectors") / "groundTruth.csv", delimiter=",", skiprows=1)


@pytest.fixture(scope="session")
def holistic() -> Path:
    """Four webcams, and what MediaPipe Holistic saw in them."""
    return _recorded("mediapipe_holistic_4cam")


@pytest.fixture(scope="session")
def single_person() -> Path:
    """Four cameras, what OpenPose saw in them, and Pose2Sim's result."""
    return _recorded("pose2sim_single_person")


def _recorded(name: str) -> Path:
    folder = recordings() / name
    if not folder.is_dir():
        pytest.skip(f"needs the recordings in {folder} (MOCAPELLA_DATA names another place)")
    return folder


@pytest.fixture(scope="session")
def camera_recordings() -> Path:
    """The folder with the recordings of several cameras: ``charuco_4cam`` and others."""
    if not (recordings() / "charuco_4cam").is_dir():
        pytest.skip(f"needs the recordings in {recordings()} (MOCAPELLA_DATA names another place)")
    return recordings()
