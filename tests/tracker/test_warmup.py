"""A method that was made ready compiles nothing more while people are tracked, and who waits for it is told."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest
from support.hand_frames import tracker as tracker_of_a_hand
from support.hand_frames import watched
from support.silhouette_pictures import Room, pose_at, ring, somebody
from support.walking_people import Walker
from tracker.test_default import frames, told

from mocapella.calibration import body_track_kernels, floor_kernels, graph_kernels, pair_kernels
from mocapella.compiled import on_first_compilation
from mocapella.kinematics import articulated_kernels, hand_follow_kernels
from mocapella.model.observations import Arrival
from mocapella.registry import load
from mocapella.schema import decode_frame, encode_frame
from mocapella.tracker import METHODS, people_warmup, warm_up
from mocapella.tracker.image_arrivals import arrivals_of
from mocapella.tracker.initial_body import InitialBody
from mocapella.tracker.silhouettes import SilhouettesTracker

BODY = somebody()


def as_it_comes(arrival: Arrival) -> Arrival:
    """A frame's arrays are those of a message, which cannot be written."""
    frame = decode_frame(encode_frame(arrival.frame))
    assert not frame.states.flags.writeable
    return Arrival(frame, arrival.at_ns)


def test_once_it_is_ready_nothing_is_compiled_while_people_are_tracked() -> None:
    warm_up("default")
    compiled: list[str] = []
    walker = Walker()
    with on_first_compilation(lambda: compiled.append("something")):
        tracker = told()
        for arrival in frames({1: walker}, 3.0, noise=0.01):
            tracker.update(as_it_comes(arrival))
        tracker.recalibrate("asked for")
        tracker.restore(tracker.snapshot())
        for arrival in frames({1: walker, 2: Walker()}, 3.0, begin=3.0, noise=0.01):
            tracker.update(as_it_comes(arrival))
    assert compiled == []


def test_the_run_calls_every_kernel_that_a_calibration_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    """A kernel's first call in a process loads it from disk, which takes as long as several frames."""
    called = set[str]()
    kernels = [
        *((pair_kernels, name) for name in ("take_newest_of_each",)),
        *((body_track_kernels, name) for name in ("add_bodies", "newest_centres", "mutually_nearest")),
        *((graph_kernels, name) for name in ("refine", "inverses_of_positive", "inverse_of_positive")),
        (floor_kernels, "stand"),
    ]
    for module, name in kernels:
        kernel = getattr(module, name)

        def noted(*arguments: Any, name: str = name, kernel: Any = kernel) -> Any:
            called.add(name)
            return kernel(*arguments)

        monkeypatch.setattr(module, name, noted)
    tracker, arrivals = people_warmup.warm_up_run()
    for arrival in arrivals:
        tracker.update(arrival)
    assert called == {name for _, name in kernels}


def test_parts_call_kernels_as_the_method_does() -> None:
    """A kernel on disk has one entry for each specialisation; the run calls this one within another kernel."""
    warm_up("default")
    for part in METHODS["default"].warm_up_parts:
        load(part)()
    kernel = articulated_kernels.correct
    assert len(kernel.signatures) == 1
    assert len(kernel._cache._cache._cache_file._load_index()) == 1


def test_once_it_is_ready_nothing_is_compiled_while_a_hand_is_tracked() -> None:
    warm_up("hands")
    seen = list(watched(0, 30))
    compiled: list[str] = []
    with on_first_compilation(lambda: compiled.append("something")):
        one = tracker_of_a_hand()
        for arrival in seen:
            one.update(Arrival(decode_frame(encode_frame(arrival.frame)), arrival.at_ns))
        one.restore(one.snapshot())
    assert compiled == []


def test_the_run_of_hands_solves_the_fingers_of_a_palm_with_three_markers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else a session with three markers on the base would compile this kernel before its first hand."""
    solved: list[bool] = []
    kernel = hand_follow_kernels.direct_start

    def noted(*arguments: Any) -> bool:
        solved.append(bool(kernel(*arguments)))
        return solved[-1]

    monkeypatch.setattr(hand_follow_kernels, "direct_start", noted)
    run = METHODS["hands"].warm_up_run
    assert run is not None
    tracker, arrivals = run()
    for arrival in arrivals:
        tracker.update(arrival)
    assert any(solved)


def test_once_it_is_ready_nothing_is_compiled_while_bodies_are_fitted() -> None:
    warm_up("silhouettes")
    compiled: list[str] = []
    room = Room(ring(3))
    with on_first_compilation(lambda: compiled.append("something")):
        one = SilhouettesTracker({"": InitialBody(BODY, pose_at(BODY))}, room.rig)
        for k in range(24):
            away = 8 <= k < 20
            images = room.images() if away else room.images(BODY, pose_at(BODY, 0.01 * k))
            if k == 5:
                noisy = np.random.default_rng(0).random(images["c1"].shape[:2]) < 0.1
                images["c1"][noisy] = 255
            for arrival in arrivals_of(images, (k + 1) * 33_000_000, number=k):
                one.update(arrival)
        one.restore(one.snapshot())
    assert compiled == []


def test_who_waits_is_told_once_and_only_where_something_is_compiled() -> None:
    @numba.njit
    def new(x):  # type: ignore[no-untyped-def]
        return x + 1

    said: list[int] = []
    with on_first_compilation(lambda: said.append(1)):
        assert said == []
        new(1)
        new(1.0)
    assert said == [1]
    with on_first_compilation(lambda: said.append(2)):
        new(2)
    assert said == [1]
