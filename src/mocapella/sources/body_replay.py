"""Replay a file of one sensor's bodies (`mocapella.recording.body_csv`) as that sensor."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import InputError
from mocapella.model.body_rows import BodyRows
from mocapella.model.observations import Arrival, BodyFrame, check_sensor_name
from mocapella.sources.recorded_track import MAX_LENGTH, MAX_STEP_BACK, ONE_RUN, RecordedTrack, ReplayReport, order_rows


class BodyReplay:
    """A file of bodies as one sensor. The constructor sorts the rows into frames.

    Args:
        rows: the file.
        sensor: name of the sensor, which is not in the file; None for the name of its topology.

    Attributes:
        sensor: name of the sensor.
        report: counts of rows and frames.

    Raises:
        SettingsError: the name cannot be used.
        InputError: times go back by more than `MAX_STEP_BACK` or span more than `MAX_LENGTH`, or a row repeats a body
            and instant with other joints.
    """

    def __init__(self, rows: BodyRows, sensor: str | None = None) -> None:
        self.sensor = check_sensor_name(sensor or rows.topology.name)
        self._track = _track(rows, self.sensor)
        self.report = ReplayReport(
            rows=len(rows.ids),
            frames=len(self._track.time_ns),
            duplicates_dropped=self._track.duplicates_dropped,
            sorted=self._track.sorted,
            joints_not_tracked=int((self._track.bodies["states"] == 0).sum()),
        )

    @property
    def duration_s(self) -> float:
        """Time from the first frame to the last [s]."""
        return float(self._due_s()[-1])

    def frames(self, sensor: str) -> Iterator[tuple[float, BodyFrame]]:
        """Yield the frames in the order of capture, with ``sensor`` as the sensor's name, each with its due time.

        ``node_id`` and ``sent_ns`` are 0: the publisher sets them.

        Yields:
            (due_s, frame): time since the first frame [s].

        Raises:
            SettingsError: the name cannot be used.
        """
        track = msgspec.structs.replace(self._track, sensor=check_sensor_name(sensor))
        return ((due_s, track.frame(number)) for number, due_s in enumerate(self._due_s().tolist()))

    def arrivals(self) -> Iterator[Arrival]:
        """Yield the frames in the order of capture, for tracking without a network; ``at_ns`` is the file's time."""
        for number, at_ns in enumerate(self._track.at_ns.tolist()):
            yield Arrival(self._track.frame(number), at_ns)

    def _due_s(self) -> NDArray[np.float64]:
        return np.asarray((self._track.at_ns - self._track.at_ns[0]) / NS_PER_S)


def _track(rows: BodyRows, sensor: str) -> RecordedTrack:
    _check_times(rows)
    order = order_rows(rows.time_ns, rows.ids)
    same = np.isclose(rows.positions[order.repeated], rows.positions[order.first], rtol=0, equal_nan=True)
    differs = order.repeated[~same.all(axis=(1, 2))]
    _refuse(
        rows, differs, "repeats the body and the time of another row, with other joints",
        "give a file for each person, or number the bodies",
    )  # fmt: skip
    time_ns = rows.time_ns[order.kept][order.starts[:-1]]
    states = rows.states[order.kept]
    bodies = {
        "tracking_ids": rows.ids[order.kept].astype(np.uint64),
        "tracked": np.asarray((states > 0).any(axis=1)),
        "clipped_edges": np.zeros(len(order.kept), dtype=np.uint8),
        "states": states,
        "positions": rows.positions[order.kept],
    }
    none = [0.0] * len(time_ns)
    dropped = len(order.repeated)
    return RecordedTrack(
        sensor, rows.topology, bodies, order.starts, none, none, time_ns, time_ns, dropped, order.sorted
    )  # fmt: skip


def _check_times(rows: BodyRows) -> None:
    ahead = rows.time_ns - rows.time_ns[0] > MAX_LENGTH * NS_PER_S
    _refuse(rows, np.flatnonzero(ahead), "the time is more than a day after the first row's", ONE_RUN)
    back = np.maximum.accumulate(rows.time_ns) - rows.time_ns > MAX_STEP_BACK * NS_PER_S
    _refuse(rows, np.flatnonzero(back), f"the time goes back by more than {MAX_STEP_BACK} s", ONE_RUN)


def _refuse(rows: BodyRows, wrong: NDArray[np.intp], problem: str, fix: str) -> None:
    if len(wrong):
        row = rows.first_row + int(wrong.min())
        value = f"{rows.time_ns[wrong.min()] / NS_PER_S:.6f} s"
        raise InputError(problem, file=rows.source, row=row, value=value, fix=fix)
