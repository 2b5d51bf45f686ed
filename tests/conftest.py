"""What all tests share: the real recordings, and how to skip by name where they are not there."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

# The same examples every time, so that a change is judged by itself; `explore` tries others. A first call may compile.
settings.register_profile("same", deadline=None, derandomize=True)
settings.register_profile("explore", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "same"))

ROOT = Path(__file__).resolve().parent.parent


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
