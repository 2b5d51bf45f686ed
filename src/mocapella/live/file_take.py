"""Record a run without a bus, such as tracking of videos: a take of the frames and scenes in their order."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from mocapella.live.recording_service import packages_of
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene
from mocapella.model.sensor_frame import SensorFrame
from mocapella.model.session import Setup
from mocapella.recording.take import TakeInfo, TakeReport
from mocapella.recording.take_writer import TakeWriter
from mocapella.schema import encode_frame, encode_scene

FLUSH_EVERY: Final = 64
"""Frames between two flushes."""


class FileTake:
    """Writes a take on the caller's thread. A context manager; leaving it closes the take.

    Args:
        path: path of the take, which must not exist.
        setup: setup of the tracker.
        method_settings: settings of the tracker's method, by name; a replay uses them and the setup.
        reserve_bytes: free disk space to leave [bytes].

    Raises:
        TakeExistsError, DiskFullError, RecordingError: before anything is created.
    """

    def __init__(
        self, path: Path, setup: Setup, method_settings: Mapping[str, Any], *, reserve_bytes: int = 1 << 30
    ) -> None:
        info = TakeInfo(setup, time.time_ns(), 0, dict(method_settings), packages=packages_of(setup.method))
        self._writer = TakeWriter.create(path, info=info, reserve_bytes=reserve_bytes)
        self._since = 0

    def write(self, frame: SensorFrame, arrival: Arrival, scene: Scene) -> None:
        """Write a frame, with the arrival's time as log time, and the scene that the tracker made of the arrival.

        Raises:
            DiskFullError, RecordingError: earlier flushed frames are safe.
        """
        self.write_frame(frame, arrival)
        self._writer.write_scene(encode_scene(scene), arrival.at_ns)

    def write_frame(self, frame: SensorFrame, arrival: Arrival) -> None:
        """Write a frame that is not tracked, with the arrival's time as log time.

        Raises:
            DiskFullError, RecordingError: earlier flushed frames are safe.
        """
        self._writer.write_frame(
            encode_frame(frame), sensor=frame.sensor, node_id=frame.node_id, sequence=frame.sequence,
            log_ns=arrival.at_ns,
        )  # fmt: skip
        self._since += 1
        if self._since >= FLUSH_EVERY:
            self._since = 0
            self._writer.flush()

    def close(self) -> TakeReport:
        """Finish the take and return its report; a second call returns the same report."""
        return self._writer.close()

    def __enter__(self) -> FileTake:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
