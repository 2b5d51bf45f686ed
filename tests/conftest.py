"""What all tests share: the real recordings, how to skip by name where they are not there, and four workers."""

from __future__ import annotations

import atexit
import gc
import os
import shutil
import sys
import tempfile
from pathlib import Path

# Four workers share two cores: threads within a product of small matrices would only wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ["MOCAPELLA_VIEW_TOKEN"] = "tokenofalltests0"  # of all views: support/browser.py has their addresses
CACHE = Path(__file__).resolve().parents[1] / ".pytest_cache"
os.environ["MOCAPELLA_LOGS"] = str(CACHE / "logs")  # not the user's
# More than a hundred programs are started. Without the bytecode of what they import, each takes seconds more; who wants
# none beside the sources has it elsewhere.
if sys.dont_write_bytecode:
    sys.pycache_prefix = str(CACHE / "bytecode")
    sys.dont_write_bytecode = False
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# The keys of this run's sessions, which workers and programs share, and never the user's own.
if "PYTEST_XDIST_WORKER" not in os.environ:
    os.environ["MOCAPELLA_SESSIONS"] = tempfile.mkdtemp(prefix="mocapella-sessions-")
    atexit.register(shutil.rmtree, os.environ["MOCAPELLA_SESSIONS"], ignore_errors=True)
    os.environ.pop("MOCAPELLA_SESSION", None)

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest
import typer.testing
from hypothesis import settings
from hypothesis.internal.conjecture import providers
from xdist.scheduler import LoadScopeScheduling

from mocapella.registry import load
from mocapella.tracker import METHODS, warm_up

# Typer's runner would build all commands for each command line, which takes longer than most of what the tests run.
typer.testing._get_command = cache(typer.testing._get_command)

# The same examples every time, so that a change is judged by itself; `explore` tries others, and more. A first call may
# compile.
settings.register_profile("same", deadline=None, derandomize=True, max_examples=50)
settings.register_profile("explore", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))
if settings.get_current_profile_name() == "same":
    # Else examples would have constants of all modules that a worker has loaded, which depend on its other tests.
    # The name is hypothesis' own: it fails here if another version has it no more.
    pytest.MonkeyPatch().setattr(providers, "is_local_module_file", lambda path: False)

BROWSERS = (
    "viewer/test_view_in_browser.py",
    "viewer/test_run_view_in_browser.py",
    "viewer/test_study_pages.py",
    "viewer/test_viewer.py",
    "live/test_cameras_in_view.py",
    "live/test_camera_sliders_in_view.py",
    "live/test_board_calibration.py",
    "live/test_study_session.py",
    "live/test_view_process.py",
    "examples/test_plugin.py::test_its_spots_are_in_the_view",
)
"""Tests with a browser that draws in software, by file or one by one: never two at once."""
PROGRAMS = (
    "live/test_stream_processes.py",
    "live/test_outages.py",
    "live/test_processes.py",
    "live/test_datagrams.py",
    "live/test_labels.py",
    "live/test_expected_people.py",
    "live/test_server.py",
    "live/test_server_errors.py",
    "live/test_server_junk.py",
    "live/test_thread_deaths.py",
    "live/test_node.py",
    "live/test_arm_node.py",
    "live/test_rgbd_node.py",
    "live/test_azure_kinect_node.py",
    "live/test_body_files.py",
    "live/test_marker_node.py",
    "live/test_camera_settings.py",
    "live/test_recording_service.py",
    "live/test_silhouettes_served.py",
    "sources/test_acquisition.py",
    "sources/test_bridge.py",
    "sources/test_live_set.py",
    "studies/test_study_engines.py",
    "live/test_relaying.py",
    "clients/test_kinect_v2.py",
    "clients/test_kinect_v2_session.py",
    "cli/test_align.py",
    "cli/test_hand_measure.py",
    "cli/test_record.py",
    "cli/test_running.py",
    "cli/test_silhouettes_live.py",
)
"""Tests of programs and servers that keep real time: never two at once, either. The rest of the README's and examples'
start programs, too, but do not mind how long these take."""
MANUALS = ("test_readme.py", "examples/")
"""These start programs too, as a reader would."""
RUNS = 3
"""Number of attempts of such a test: no limit of time is long enough for a machine that stands still."""
STUDY = (
    "evaluation/test_facing_figures.py",
    "evaluation/test_fused_metrics.py",
    "evaluation/test_interactions.py",
    "evaluation/test_study_tables.py",
)
"""Tests that compute the same of all real logs: one worker does so once."""
RULES = (
    "test_decoding_rule.py",
    "test_fuzz.py",
    "test_import_rule.py",
    "test_no_kinds.py",
    "test_security_doc.py",
    "test_unique_names.py",
)
"""Rules of all sources: one worker parses these once."""
LONG = (*STUDY, "cli/test_silhouettes.py", "test_readme.py")
"""Files that take a minute: early, so that nobody waits for them alone at the end."""
TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Four workers for all tests or a folder of them; none where files, tests or words are chosen: it begins sooner.

    Two cores are enough for them: the two that have what keeps real time mostly wait.
    """
    return 0 if _chosen(config) else 4


def _chosen(config: pytest.Config) -> bool:
    """Whether files, tests or words are named."""
    return bool(config.option.keyword) or any(".py" in argument for argument in config.args)


class RealTimeApart(LoadScopeScheduling):
    """One worker has the browsers and one the programs, from the beginning; the others all else, mostly by file."""

    def __init__(self, config: pytest.Config, log: Any) -> None:
        config.option.loadscopereorder = False  # they are in order, see below
        super().__init__(config, log)

    def _split_scope(self, nodeid: str) -> str:
        name = _name(nodeid)
        shared = "study" if name.startswith(STUDY) else "rules" if name.startswith(RULES) else ""
        return _lane(nodeid) or shared or nodeid.partition("::")[0]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> RealTimeApart:
    """Group tests without their marks, which only the workers know."""
    return RealTimeApart(config, log)


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Iterator[None]:
    """Workers compile all kernels first, each part once: what keeps real time must not wait for it.

    The first worker collects meanwhile. The others load the bytecode that it has written.
    """
    first = session.config.workerinput["workerid"] == "gw0" if hasattr(session.config, "workerinput") else None
    gc.disable()
    if first is False:
        _compile_what_nobody_does(session.config)
    yield
    if first:
        _compile_what_nobody_does(session.config)
    # What is there now stays: nobody need look through a million objects again and again. Nor need a test that makes
    # as many, as a syntax tree has, look through them after every few hundred.
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000)
    gc.enable()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """What keeps real time comes first and has a mark, then what is long. Slow tests are run if they are chosen."""
    if not (config.option.markexpr or _chosen(config)):
        slow = {item for item in items if item.get_closest_marker("slow")}
        config.hook.pytest_deselected(items=[item for item in items if item in slow])
        items[:] = [item for item in items if item not in slow]
    lanes = ("browsers", "programs", "")
    for item in items:
        if _lane(item.nodeid):
            item.add_marker("real_time")
        if _lane(item.nodeid) or _name(item.nodeid).startswith(MANUALS):
            item.add_marker(pytest.mark.flaky(reruns=RUNS - 1))
    items.sort(key=lambda item: (lanes.index(_lane(item.nodeid)), not _name(item.nodeid).startswith(LONG)))


def pytest_runtest_setup(item: pytest.Item) -> None:
    """A worker that only computes is in no hurry; programs that keep real time are."""
    if not _lane(item.nodeid) and hasattr(item.config, "workerinput"):
        _give_way()


@cache
def _give_way() -> None:
    if hasattr(os, "nice"):
        os.nice(5)


def _lane(nodeid: str) -> str:
    """Which worker's tests it is of: "browsers", "programs", or "" for those that keep no real time."""
    name = _name(nodeid)
    return "browsers" if name.startswith(BROWSERS) else "programs" if name.startswith(PROGRAMS) else ""


def _name(nodeid: str) -> str:
    return nodeid.removeprefix("tests/")


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


def _make_filmed_bodies_ready() -> None:
    from mocapella.sources.simulate.silhouette_scene import silhouette_scene

    scene = silhouette_scene("t-pose", cameras=1, size_px=(64, 48))
    scene.images(0)
    scene.masks(0)


def _make_hands_ready() -> None:
    """What hands and triangulation share is compiled once if one process compiles both."""
    warm_up("hands")
    from mocapella.geometry.triangulation import triangulate, views

    lens = [900.0, 900.0, 320.0, 240.0, 0.1, 0.0, 0.0, 0.0, 0.0]
    beside = np.eye(4)
    beside[0, 3] = 0.5
    triangulate(np.full((1, 2, 2), 300.0), views([lens, lens], [np.eye(4), beside]))


def _make_contours_ready() -> None:
    """A third of what the silhouettes compile; a second worker does it meanwhile."""
    from mocapella.model.silhouettes import Silhouette
    from mocapella.sensing.region_contour import region_contour

    phi = np.where(np.hypot(*np.mgrid[-8:8, -8:8]) < 5, np.float32(4), np.float32(-4))
    region_contour(np.full((64, 64, 3), 128, np.uint8), Silhouette((16, 16), 2, phi))


def _make_people_ready() -> None:
    """The parts, which a server compiles in processes of their own, and then the whole method."""
    for part in METHODS["default"].warm_up_parts:
        load(part)()
    warm_up("default")


PARTS = {
    "silhouettes": lambda: warm_up("silhouettes"),
    "contours": _make_contours_ready,
    "people": _make_people_ready,
    "arms": _make_arms_ready,
    "hands": _make_hands_ready,
    "pictures of hands": _make_pictures_ready,
    "filmed bodies": _make_filmed_bodies_ready,
    "rooms": _make_rooms_ready,
}
"""What tests want compiled. What takes longest begins first."""


def _compile_what_nobody_does(config: Any) -> None:
    claims = CACHE / "compiling" / config.workerinput["testrunuid"]
    claims.mkdir(parents=True, exist_ok=True)
    for part, compile_part in PARTS.items():
        try:
            (claims / part).touch(exist_ok=False)
        except FileExistsError:
            continue
        compile_part()


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
def azure_and_vicon() -> Path:
    """Squats before an Azure Kinect."""
    return _recorded("azure_and_vicon")


@pytest.fixture(scope="session")
def kinect_v2_gestures() -> Path:
    """People who stand and gesture before a Kinect v2."""
    return _recorded("kinect_v2_gestures")


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
