"""What the tests of the evaluation share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from mocapella.evaluation.kinectmultitrack import evaluate


@pytest.fixture(scope="session")
def as_logged(study_logs: Path) -> dict[str, Any]:
    """The scoring of all real logs as they are."""
    return evaluate(study_logs, ["stand-still"])
