"""The parts of an analysis joined: other methods beside the logged rows, the same on every engine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mocapella.errors import SettingsError
from mocapella.studies.analysis import merge
from mocapella.studies.whole_analysis import analyze_recordings, check_methods, measured_tables

STUDY = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "kinectmultitrack"
FILE = STUDY / "Study_4_Kinect_2_Time_1_27_36_PM.csv.gz"
needs_data = pytest.mark.skipif(not FILE.exists(), reason="needs shared/data/kinectmultitrack")


def test_an_unknown_method_is_refused_before_anything_is_read() -> None:
    with pytest.raises(SettingsError, match="did you mean default"):
        check_methods(["stand-still", "defualt"])


@needs_data
def test_an_obstacle_is_measured_and_a_recording_that_is_none_is_a_finding(tmp_path: Path) -> None:
    broken = tmp_path / "none.csv"
    broken.write_text("a,b\n1,2\n")
    found = analyze_recordings([FILE, broken])
    assert [one.file for one in found] == [FILE.name, "none.csv"]
    assert found[1].findings
    assert not found[1].whole
    results = merge(found)
    assert {one.key.method for one in results.summaries} == {"stand-still"}
    (table,) = measured_tables(results)
    assert {row[0] for row in table.rows} >= {"lost"}
    assert results.strips
    assert analyze_recordings([FILE], participants=["99"]) == []


@needs_data
@pytest.mark.slow
def test_another_method_is_scored_beside_the_logged_rows() -> None:
    (found,) = analyze_recordings([FILE], methods=("stand-still", "default"))
    by_method = {one.key.method: one for one in found.summaries}
    assert set(by_method) == {"stand-still", "default"}
    logged, other = by_method["stand-still"], by_method["default"]
    assert (logged.key.task, logged.key.first, logged.key.second) == (other.key.task, other.key.first, other.key.second)
    assert other.pairs <= logged.pairs
    assert np.nanmean(other.means[:, 3]) < 2 * np.nanmean(logged.means[:, 3])
