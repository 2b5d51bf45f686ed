"""Order of tracking for all frames of a take's run, also frames that were not tracked live.

Frames that a live tracker skipped, because it was slow, stopped, or of another method, are in a take, but no scene
states their capture times on the server's clock.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from itertools import accumulate
from typing import Final, NamedTuple

import numpy as np

from mocapella.recording.take import Command
from mocapella.recording.take_index import TakeIndex
from mocapella.recording.take_refs import FrameRef, SceneRef

LARGEST_NS: Final = 2**62
"""Largest time that a frame without a scene gets, before and after 0; it fits into a message [ns]."""


class TimedFrame(NamedTuple):
    """A frame of a take, with its capture time on the server's clock ``at_ns``."""

    frame: FrameRef
    at_ns: int


def raw_order(index: TakeIndex, run: int, commands: Sequence[Command]) -> Iterator[Command | TimedFrame]:
    """Yield all frames of a run and its commands, in the order of tracking.

    Frames with a scene keep their order and time. A frame without one is inserted by its capture time: its own clock's
    plus the offset of the frames with scenes of its node, linear in time between them and constant outside. For a node
    without scenes in this run, the offset is the smallest difference of arrival and capture time. A frame without
    scene belongs to the run that was recorded when it was stored.

    Args:
        index: index of the take.
        run: number of the run.
        commands: the run's commands, in their order.
    """
    scenes = [(scene, frame) for scene in index.scenes if scene.run == run and (frame := index.frame_of(scene))]
    tracked = {(scene.sensor, scene.node_id, scene.sequence) for scene in index.scenes}
    others = [
        frame
        for frame in index.frames
        if frame.run == run and (frame.sensor, frame.node_id, frame.sequence) not in tracked
    ]
    times = list(accumulate((scene.at_ns for scene, _ in scenes), max))
    steps = list(accumulate((scene.step for scene, _ in scenes), max))
    # An event's place is its time, and within a time the number of tracked frames before it.
    events: list[tuple[tuple[int, int, int], Command | TimedFrame]] = [
        ((time, k, 1), TimedFrame(frame, scene.at_ns))
        for k, (time, (scene, frame)) in enumerate(zip(times, scenes, strict=True))
    ]
    untracked = map(TimedFrame, others, _times(others, scenes))
    events += [((timed.at_ns, len(scenes), 1), timed) for timed in untracked]
    latest = times[-1] if times else 0
    for command in commands:
        k = bisect_left(steps, command.before_step)
        latest = max(latest, command.log_ns)
        events.append(((times[k] if k < len(scenes) else latest, k, 0), command))
    events.sort(key=lambda event: event[0])  # stable
    for _, event in events:
        yield event


def _times(frames: Sequence[FrameRef], scenes: Sequence[tuple[SceneRef, FrameRef]]) -> list[int]:
    """Return the capture times of frames without scenes on the server's clock [ns]."""
    known: dict[tuple[str, int], list[tuple[int, int]]] = {}
    for scene, frame in scenes:
        known.setdefault((frame.sensor, frame.node_id), []).append((frame.time_ns, scene.at_ns - frame.time_ns))
    for frame in frames:
        if (frame.sensor, frame.node_id) not in known:
            known[frame.sensor, frame.node_id] = [(0, _least_latency(frames, frame))]
    clocks = {node: _Clock(sorted(pairs)) for node, pairs in known.items()}
    times = (frame.time_ns + clocks[frame.sensor, frame.node_id].offset_ns(frame.time_ns) for frame in frames)
    return [min(max(at_ns, -LARGEST_NS), LARGEST_NS) for at_ns in times]


def _least_latency(frames: Sequence[FrameRef], of: FrameRef) -> int:
    node = of.sensor, of.node_id
    return min(one.ref.log_ns - one.time_ns for one in frames if (one.sensor, one.node_id) == node)


class _Clock:
    """Offset of the server's clock from a node's, by pairs (node's time, offset) in ascending order [ns]."""

    def __init__(self, pairs: Sequence[tuple[int, int]]) -> None:
        (self._time, self._offset) = pairs[0]
        self._times = np.array([time - self._time for time, _ in pairs], dtype=np.float64)
        self._offsets = np.array([offset - self._offset for _, offset in pairs], dtype=np.float64)

    def offset_ns(self, time_ns: int) -> int:
        return self._offset + round(float(np.interp(float(time_ns - self._time), self._times, self._offsets)))
