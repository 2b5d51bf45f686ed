"""What all tests share: the real recordings, how to skip by name where they are not there, and three workers."""

from __future__ import annotations

import os
import sys
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

# Three workers share two cores: threads within a product of small matrices would only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
CACHE = Path(__file__).resolve().parents[1] / ".pytest_cache"
# More than a hundred programs are started. Without the bytecode of what they import, each takes seconds more; who wants
# none beside the sources has it elsewhere.
if sys.dont_write_bytecode:
    sys.pycache_prefix = str(CACHE / "bytecode")
    sys.dont_write_bytecode = False
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

from functools import cache
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

PEOPLE, HANDS = ("people", "rooms"), ("hands", "pictures of hands")
REAL_TIME = {
    **dict.fromkeys(("viewer/test_view_in_browser.py", "viewer/test_viewer.py", "cli/test_align.py"), ()),
    **dict.fromkeys(("live/test_recording_desk.py", "live/test_server.py", "live/test_server_junk.py"), ()),
    **dict.fromkeys(("examples/test_plugin.py::test_its_spots_are_in_the_view",), ()),
    **dict.fromkeys(("sources/test_bridge.py", "live/test_node.py", "cli/test_record.py"), PEOPLE),
    **dict.fromkeys(("live/test_outages.py", "live/test_processes.py", "live/test_datagrams.py"), PEOPLE),
    **dict.fromkeys(("viewer/test_run_view_in_browser.py",), ("silhouettes",)),
    **dict.fromkeys(("live/test_marker_node.py", "live/test_board_calibration.py"), (*PEOPLE, *HANDS)),
    **dict.fromkeys(("sources/test_acquisition.py", "cli/test_hand_measure.py"), HANDS),
    **dict.fromkeys(("cli/test_silhouettes_live.py", "live/test_silhouettes_served.py"), ("silhouettes",)),
    **dict.fromkeys(("cli/test_running.py", "live/test_arm_node.py"), (*PEOPLE, *HANDS, "arms")),
    **dict.fromkeys(("live/test_view_process.py",), (*PEOPLE, *HANDS, "arms")),
}
"""Tests of programs, servers and a browser that keep real time, by file or one by one, and which of `PARTS` they want
compiled: never two at once, least of all two browsers that draw in software, and in this order, for other workers
compile meanwhile. The rest of the README's and examples' start programs, too, but do not mind how long these take."""
COMPILING = ("tracker/test_ready.py", "cli/test_silhouettes.py")
"""Tests that compile what others use: first of all, each file on a worker of its own."""
LONG = ("test_readme.py",)
"""Files that take a minute: early, so that nobody waits for them alone at the end."""
TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Three workers for all tests or a folder of them; none where files, tests or words are chosen: it begins sooner.

    Two cores are enough for them: the one that has what keeps real time mostly waits.
    """
    chosen = config.option.keyword or any(".py" in argument for argument in config.args)
    return 0 if chosen else 3


class RealTimeApart(LoadScopeScheduling):
    """One worker has all that keeps real time, from the beginning; the others everything else, file by file."""

    def __init__(self, config: pytest.Config, log: Any) -> None:
        config.option.loadscopereorder = False  # they are in order, see below
        super().__init__(config, log)

    def _split_scope(self, nodeid: str) -> str:
        return "real time" if nodeid.removeprefix("tests/").startswith(tuple(REAL_TIME)) else nodeid.partition("::")[0]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> RealTimeApart:
    """Group tests without their marks, which only the workers know."""
    return RealTimeApart(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What compiles comes first, then what keeps real time, which has a mark, then what is long."""
    order = (*COMPILING, *REAL_TIME, *LONG)
    for item in items:
        if _place(item) in REAL_TIME:
            item.add_marker("real_time")
    items.sort(key=lambda item: order.index(_place(item)) if _place(item) in order else len(order))


def pytest_runtest_setup(item: pytest.Item) -> None:
    """A program that is waited for does not compile meanwhile. Each part is compiled once, by whoever comes first."""
    place = _place(item)
    if place not in REAL_TIME and hasattr(item.config, "workerinput"):
        _give_way()
    if place in COMPILING:
        _compile_what_nobody_does()
    for part in PARTS if place == "tracker/test_ready.py" else REAL_TIME.get(place, ()):
        _compile(part, wait=True)


@cache
def _give_way() -> None:
    """A worker that only computes is in no hurry; programs that keep real time are."""
    if hasattr(os, "nice"):
        os.nice(5)


@cache
def _compile_what_nobody_does() -> None:
    for part in PARTS:
        _compile(part, wait=False)


def _make_arms_ready() -> None:
    from mocapella.detectors import make_detector
    from mocapella.model.camera import Camera
    from mocapella.sources.simulate.depth_scene import load_depth_scene

    scene = load_depth_scene("cloth", seed=1)
    finds = make_detector("kinematic-arm", Camera("arm", scene.sensor.size_px, scene.lens))
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
    "silhouettes": lambda: make_ready("silhouettes"),
    "arms": _make_arms_ready,
    "hands": lambda: make_ready("hands"),
    "pictures of hands": _make_pictures_ready,
    "rooms": _make_rooms_ready,
}
_compiled: set[str] = set()
"""By this worker, or loaded after another one had."""


def _compile(part: str, *, wait: bool) -> None:
    """Once a worker; not while another one does it, for which it may ``wait``."""
    if part in _compiled:
        return
    CACHE.mkdir(exist_ok=True)
    with (CACHE / f"{part}.lock").open("w") as lock:
        if fcntl is not None:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                return
        PARTS[part]()
    _compiled.add(part)


def _place(item: pytest.Item) -> str:
    """The test's own entry of `REAL_TIME`, or its file."""
    name = item.nodeid.removeprefix("tests/")
    return name if name in REAL_TIME else item.path.relative_to(TESTS).as_posix()


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
