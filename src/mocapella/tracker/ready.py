"""A method made ready before the first frame counts: what is compiled once a machine is compiled now."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np

from mocapella.compiled import told_of_compiling
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_y
from mocapella.kinematics.body_model import body_model
from mocapella.kinematics.hand_chain import hand_chain, palm_landmarks
from mocapella.kinematics.hand_tracker import base_layout
from mocapella.model.arms import ArmFrame, SeenArm
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.hand import TIPS, hand_model
from mocapella.model.markers import marker_frame
from mocapella.model.observations import Arrival, body_frame
from mocapella.model.topology import topology
from mocapella.tracker.arms import ArmsTracker
from mocapella.tracker.default import DefaultTracker
from mocapella.tracker.hands import HandsSettings, HandsTracker
from mocapella.tracker.protocol import Tracker

_PRACTICE_S: Final = 6.0
_RATE_HZ: Final = 30


_READY: Final[set[str]] = set()


def make_ready(method: str, on_compiling: Callable[[], None] = lambda: None) -> None:
    """Compile what a method needs, the first time on a machine; load what is compiled, the first time in a process.

    A tracker that is given its first frames would compile in the middle of them, while others come in.

    Args:
        method: key of `METHODS`.
        on_compiling: called once when there is something to compile, before that is done.
    """
    if method not in _PRACTICES or method in _READY:
        return
    make, practice = _PRACTICES[method]
    with told_of_compiling(on_compiling):
        tracker = make()
        for arrival in practice():
            tracker.update(arrival)
        tracker.restore(tracker.snapshot())
    _READY.add(method)


_SIZE: Final = (640, 480)
_LENS: Final = np.array([530.0, 530.0, 319.5, 239.5, -0.05, 0.0, 0.0, 0.0, 0.0])
_AT: Final = {"practice-0": -0.2, "practice-1": 0.0, "practice-2": 0.2}
"""Of cameras that look along z; where along x [m]."""
_RIG: Final = CameraRig(
    {
        name: PlacedCamera(Camera(name, _SIZE, _LENS), rigid(np.eye(3), (-x, 0.0, 0.5)), np.zeros((6, 6)))
        for name, x in _AT.items()
    }
)


def _practice_of_an_arm() -> Iterator[Arrival]:
    """An arm that is held still before a camera: what is loaded when it is first needed is loaded."""
    points, states, sd = np.full((23, 3), 0.5), np.full(23, 2, np.uint8), np.full(23, 0.005, np.float32)
    arm = SeenArm(0, False, 0.9, points, states, sd, np.zeros(21))
    for k in range(3):
        at_ns = round(1e9 * k / _RATE_HZ) + 1
        yield Arrival(ArmFrame("practice", 0, k, at_ns, 0, _SIZE, _LENS, "practice", (arm,)), at_ns)


def _practice_of_a_hand() -> Iterator[Arrival]:
    """A hand that opens and closes before three cameras; one camera, and then all, lose it for a while."""
    settings = HandsSettings()
    model = hand_model(settings.constraints)
    shape = model.shape("right")
    chain, base = hand_chain(model, shape), base_layout(shape, len(settings.base))
    for k in range(round(2.0 * _RATE_HZ)):
        t = k / _RATE_HZ
        angles = model.limited(model.natural * (1.0 + 0.8 * np.sin(4.0 * t)))
        markers = np.concatenate([palm_landmarks(chain, angles)[list(TIPS)], base]) - [0.0, 0.0, 0.1]
        for i, (name, camera) in enumerate(_RIG.cameras.items()):
            px = project(apply(camera.T_camera_world, markers), _LENS)
            px[(i == 0) & (0.5 < t < 0.7) | (1.2 < t < 1.4)] = np.nan
            at_ns = round(1e9 * (t + 0.003 * i)) + 1
            frame = marker_frame(name, settings.markers, time_ns=at_ns, size_px=_SIZE, positions_px=px, sequence=k)
            yield Arrival(frame, at_ns)


def _practice() -> Iterator[Arrival]:
    """Two people who walk in circles before three sensors; one of them is lost for a while and comes back."""
    tree = topology("kinect_v2")
    offsets = body_model(tree.name).bones
    rest = np.zeros((len(tree), 3))
    for parent, child in tree.bones:
        rest[child] = rest[parent] + 1.7 * np.array(offsets[child].offset)
    places = [rigid(rotation_about_y(np.radians(a)), (2.5 * np.sin(np.radians(-a)), 1.0, 0.0)) for a in (0, 40, -40)]
    for k in range(round(_PRACTICE_S * _RATE_HZ)):
        for i, T_world_sensor in enumerate(places):
            t = (k + i / len(places)) / _RATE_HZ
            angles = [t] if 2.0 < t < 4.0 else [t, t + np.pi]
            world = [
                apply(rigid(rotation_about_y(a), (0.7 * np.sin(a), 1.0, 3.0 + 0.7 * np.cos(a))), rest) for a in angles
            ]
            frame = body_frame(
                f"practice-{i}",
                tree,
                time_ns=round(1e9 * t),
                positions=apply(inverse(T_world_sensor), np.array(world)),
                tracking_ids=range(len(angles)),
                sequence=k,
            )
            yield Arrival(frame, round(1e9 * t))


def _tracker_of_silhouettes() -> Tracker:
    # Images are decoded by a library that other methods do without.
    from mocapella.tracker.silhouettes_practice import practice_tracker

    return practice_tracker()


def _practice_of_silhouettes() -> Iterator[Arrival]:
    from mocapella.tracker.silhouettes_practice import practice_arrivals

    yield from practice_arrivals()


_PRACTICES: Final[dict[str, tuple[Callable[[], Tracker], Callable[[], Iterator[Arrival]]]]] = {
    "default": (lambda: DefaultTracker(sensors_expected=3), _practice),
    "hands": (lambda: HandsTracker(_RIG), _practice_of_a_hand),
    "arms": (ArmsTracker, _practice_of_an_arm),
    "silhouettes": (_tracker_of_silhouettes, _practice_of_silhouettes),
}
"""By method, how to make it, and what it does then."""
