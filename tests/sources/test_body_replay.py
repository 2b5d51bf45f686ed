"""A file of one sensor's bodies as that sensor: frames in the order of capture, several bodies in one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.body_tables import AZURE, azure_rows, azure_text, kinect_rows, kinect_text

from mocapella.errors import InputError, SettingsError
from mocapella.model.body_rows import BodyRows
from mocapella.recording.body_csv import read_body_csv
from mocapella.sources.body_replay import BodyReplay


def rows_of(folder: Path, text: str) -> BodyRows:
    path = folder / "bodies.csv"
    path.write_text(text)
    return read_body_csv(path)


def test_bodies_of_one_instant_are_one_frame(tmp_path: Path) -> None:
    rows = azure_rows()
    rows[2:4] = rows[3:1:-1]
    rows[4], rows[1] = rows[1], rows[4]
    replay = BodyReplay(rows_of(tmp_path, azure_text(rows)))
    arrivals = list(replay.arrivals())
    assert [a.frame.time_ns for a in arrivals] == [a.at_ns for a in arrivals] == [33_000_000, 66_000_000, 99_000_000]
    assert replay.duration_s == pytest.approx(0.066)
    assert replay.report.rows == 6
    assert (replay.report.frames, replay.report.duplicates_dropped, replay.report.sorted) == (3, 0, 3)
    for k, (due_s, frame) in enumerate(replay.frames("left")):
        assert (frame.sensor, frame.topology, frame.sequence, frame.node_id) == ("left", AZURE, k, 0)
        assert due_s == pytest.approx(0.033 * k)
        assert frame.tracking_ids.tolist() == [1, 2]
        assert frame.tracked.all()
        for body in (1, 2):
            (row,) = [one for one in rows if (one.time, one.body) == (33_000 * (k + 1), body)]
            assert frame.states[body - 1].tolist() == np.minimum(row.states, 2).tolist()


def test_the_file_names_no_sensor_so_any_name_will_do(tmp_path: Path) -> None:
    rows = rows_of(tmp_path, kinect_text(kinect_rows()))
    assert BodyReplay(rows).sensor == "kinect_v2"
    assert BodyReplay(rows, "front").sensor == "front"
    with pytest.raises(SettingsError, match="sensor name 'a/b' cannot be used"):
        BodyReplay(rows).frames("a/b")


def test_a_repeated_row_is_dropped_and_one_with_other_joints_refused(tmp_path: Path) -> None:
    rows = kinect_rows()
    replay = BodyReplay(rows_of(tmp_path, kinect_text([*rows, rows[-1]])))
    assert (replay.report.frames, replay.report.duplicates_dropped) == (3, 1)
    other = rows[-1]._replace(at=rows[-1].at + 1, states=rows[-1].states * 0 + 2)
    message = r"row 4: '0\.099000 s': repeats the body and the time of another row.*a file for each person"
    with pytest.raises(InputError, match=message):
        BodyReplay(rows_of(tmp_path, kinect_text([*rows, other])))


@pytest.mark.parametrize(
    ("ticks", "message"),
    [
        (5_990_001, "row 3: .*the time goes back by more than 0.5 s; .*split it where the time restarts"),
        (24 * 3600 * 10_000_000 + 330_001, "row 2: .*more than a day after"),
    ],
)
def test_a_file_of_two_runs_is_refused(tmp_path: Path, ticks: int, message: str) -> None:
    rows = kinect_rows()
    rows[1] = rows[1]._replace(time=ticks)
    with pytest.raises(InputError, match=message):
        BodyReplay(rows_of(tmp_path, kinect_text(rows)))


def test_a_row_that_is_late_by_just_the_limit_is_sorted(tmp_path: Path) -> None:
    rows = kinect_rows()
    rows[1] = rows[1]._replace(time=rows[2].time + 5_000_000)
    assert BodyReplay(rows_of(tmp_path, kinect_text(rows))).report.sorted == 1
