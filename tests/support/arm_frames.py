"""What depth cameras would say of simulated arms, without images: true places, noise, and what each cannot see."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocapella.geometry.rigid import apply, inverse, rigid, rotation_about_x, rotation_about_y
from mocapella.kinematics.hand_chain import hand_chain, palm_landmarks
from mocapella.model.arms import ArmFrame, SeenArm
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.hand import ANGLES, hand_model
from mocapella.model.observations import Arrival
from mocapella.tracker.arm_tracks import TO_SENSOR

Float64 = NDArray[np.float64]
SIZE, LENS = (640, 480), np.array([500.0, 500.0, 319.5, 239.5, 0, 0, 0, 0, 0])
NOISE_M = 0.003
FPS = 30.0


@cache
def shape(left: bool) -> Float64:
    """(23, 3) an open hand, its wrist in the middle of the palm's frame, with a forearm."""
    model = hand_model("full")
    chain = hand_chain(model, model.shape("left" if left else "right"))
    marks = palm_landmarks(chain, np.zeros(len(ANGLES)))
    return np.vstack([marks, [0.5 * (marks[0] + marks[9])], [marks[0] - 2.6 * (marks[9] - marks[0])]]).astype(
        np.float64
    )


def arm_at(at_s: float, left: bool = True, middle: Sequence[float] = (0.0, 0.0, 1.0), reach: float = 0.15) -> Float64:
    """(23, 3) in the world: an arm that is moved and turned about [m]."""
    R = rotation_about_y(0.6 * np.sin(2.1 * at_s)) @ rotation_about_x(0.8 * np.sin(1.3 * at_s + 1.0))
    sway = reach * np.array([np.sin(1.7 * at_s), 0.7 * np.sin(2.3 * at_s + 0.5), 0.6 * np.sin(1.1 * at_s)])
    return apply(rigid(R, np.asarray(middle) + sway), shape(left))


def places() -> dict[str, Float64]:
    """``T_world_camera`` of two cameras that look at (0, 0, 1) from 60° apart; the world is that of the first."""
    R, middle = rotation_about_y(np.radians(60.0)), np.array([0.0, 0.0, 1.0])
    return {"a": TO_SENSOR, "b": rigid(R, middle - R @ middle) @ TO_SENSOR}


def rig(names: Iterable[str] = ("a", "b")) -> CameraRig:
    return CameraRig(
        {name: PlacedCamera(Camera(name, SIZE, LENS), inverse(places()[name]), np.zeros((6, 6))) for name in names}
    )


def seen(
    points: Float64,
    camera: str,
    rng: np.random.Generator,
    *,
    left: bool = True,
    hidden: Sequence[int] = (),
    number: int = 0,
    noise_m: float = NOISE_M,
    **other: Any,
) -> SeenArm:
    """An arm as the camera has it; what is hidden is inferred, 4 cm away."""
    states, sd = np.full(23, 2, np.uint8), np.full(23, max(noise_m, 1e-4), np.float32)
    own = apply(inverse(places()[camera]), points) + noise_m * rng.normal(size=(23, 3))
    own[list(hidden)] += [0.0, 0.0, 0.04]
    states[list(hidden)], sd[list(hidden)] = 1, 0.03
    values: dict[str, Any] = {"left_sure": 0.8, "gesture": "open", "gesture_sure": 0.5, "grabbing": False} | other
    return SeenArm(
        number, left, points=own, states=states, sd=sd, angles=np.zeros(21), T_camera_palm=np.eye(4), **values
    )


def frame(
    camera: str, arms: Iterable[SeenArm], at_s: float, *, delay_s: float = 0.0, node_id: int = 1, reason: str = ""
) -> Arrival:
    at_ns = round(1e9 * (at_s + delay_s)) + 1
    sequence = round(at_s * FPS * 2)
    told = ArmFrame(camera, node_id, sequence, at_ns, 0, SIZE, LENS, "simulated", tuple(arms), reason)
    return Arrival(told, at_ns)


def run(
    seconds: float,
    looks: Mapping[str, Callable[[float], Iterable[SeenArm]]],
    *,
    fps: float = FPS,
    delay_s: dict[str, float] | None = None,
    begin_s: float = 0.0,
) -> list[Arrival]:
    """The frames of all cameras in the order of their capture; each camera is a part of a frame later than the last."""
    arrivals = []
    for k in range(round(seconds * fps)):
        for i, (camera, look) in enumerate(looks.items()):
            t = begin_s + (k + i / len(looks)) / fps
            arrivals.append((t, frame(camera, look(t), t, delay_s=(delay_s or {}).get(camera, 0.0))))
    return [arrival for _, arrival in sorted(arrivals, key=lambda pair: pair[0])]
