"""What all tests share: the real recordings, how to skip by name where they are not there, and two workers."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

# The same examples every time, so that a change is judged by itself; `explore` tries others. A first call may compile.
settings.register_profile("same", deadline=None, derandomize=True)
settings.register_profile("explore", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))

COMPILING = ("test_ready.py",)
"""Files whose tests compile what many others use, and are run first."""
ROOT = Path(__file__).resolve().parent.parent


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Two workers for all tests or a folder of them; none where files, tests or words are chosen: it begins sooner."""
    chosen = config.option.keyword or any(".py" in argument for argument in config.args)
    return 0 if chosen else 2


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What keeps real time stays together, on one worker; what compiles for both comes first on the other."""
    for item in items:
        if item.get_closest_marker("real_time"):
            item.add_marker(pytest.mark.xdist_group("real-time"))
    items.sort(key=lambda item: item.path.name not in COMPILING)


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
