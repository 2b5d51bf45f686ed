"""Check the properties of trackers on which replays and resumed recordings rely."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from mocapella.errors import WireError
from mocapella.model.observations import Arrival
from mocapella.model.scene import Scene
from mocapella.schema import decode_scene, encode_scene
from mocapella.tracker.protocol import Tracker


def check_tracker(make: Callable[[], Tracker], arrivals: Sequence[Arrival]) -> list[Scene]:
    """Check that a tracker keeps the promises of `mocapella.tracker.protocol.Tracker`, and return its scenes.

    - The same arrivals give the same scenes to the bit, also after `reset`; a decoded scene encodes to the same bytes.
    - Scenes are numbered 0, 1, 2, …, and have the time of their arrival, and its frame's sensor, node and number.
    - A new tracker that restores a snapshot makes the same further scenes, to the bit, after 0, 1/3, 2/3 of them.
    - `restore` raises `WireError` for bytes that are no snapshot, and the tracker is then reset.
    - The report counts each frame once, as kept or rejected.

    Args:
        make: function that creates a new tracker, always with the same settings; it is called several times.
        arrivals: frames in the order of their arrival; enough to track something.

    Returns:
        The scenes of the first tracker, one for each arrival.

    Raises:
        AssertionError: a promise is broken; says which, and at which step.
    """
    tracker = make()
    scenes = [tracker.update(arrival) for arrival in arrivals]
    written = [encode_scene(scene) for scene in scenes]
    for step, (scene, arrival, data) in enumerate(zip(scenes, arrivals, written, strict=True)):
        if scene.step != step:
            raise AssertionError(f"scene {step} has step {scene.step}")
        if (scene.at_ns, (scene.sensor, scene.node_id, scene.sequence)) != (arrival.at_ns, arrival.frame.key):
            raise AssertionError(f"scene {step} names another time or frame than its arrival's; make it with scene_at")
        if encode_scene(decode_scene(data)) != data:
            raise AssertionError(f"scene {step} encodes to other bytes after decoding")
    _check_report(tracker, len(arrivals))
    _compare(make(), arrivals, written, 0, "a second tracker")
    for begun in sorted({0, len(arrivals) // 3, 2 * len(arrivals) // 3}):
        first, second = make(), make()
        for arrival in arrivals[:begun]:
            first.update(arrival)
        second.restore(first.snapshot())
        _compare(
            second, arrivals[begun:], written[begun:], begun, f"a tracker restored from the snapshot at step {begun}"
        )
        _check_report(second, len(arrivals))
    _check_refusal(tracker)
    tracker.reset()
    _compare(tracker, arrivals, written, 0, "the tracker after reset()")
    return scenes


def _compare(tracker: Tracker, arrivals: Iterable[Arrival], written: Iterable[bytes], begun: int, what: str) -> None:
    for step, (arrival, data) in enumerate(zip(arrivals, written, strict=True), begun):
        if encode_scene(tracker.update(arrival)) != data:
            raise AssertionError(f"{what} makes another scene at step {step}")


def _check_report(tracker: Tracker, count: int) -> None:
    report = tracker.report
    rejected = sum(report.rejected.values())
    if report.frames != count or report.kept + rejected != count:
        raise AssertionError(
            f"the report has {report.frames} frames, {report.kept} kept and {rejected} rejected of {count} arrivals"
        )


def _check_refusal(tracker: Tracker) -> None:
    before = tracker.snapshot()
    for junk in (b"", b"\xc1", b"no snapshot"):
        tracker.restore(before)
        try:
            tracker.restore(junk)
        except WireError:
            left = tracker.snapshot()
            tracker.reset()
            if tracker.snapshot() != left:
                raise AssertionError(f"restore({junk!r}) does not reset the tracker that refuses it") from None
        except Exception as error:
            raise AssertionError(f"restore({junk!r}) raises {type(error).__name__}; WireError is wanted") from error
        else:
            raise AssertionError(f"restore({junk!r}) raises nothing; WireError is wanted")
