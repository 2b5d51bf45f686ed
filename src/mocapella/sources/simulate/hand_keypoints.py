"""Simulated hands as the keypoints of several cameras, with errors of a detector, for the method ``webcams``.

The errors are assumed: they scatter triangulated bones about as much as MediaPipe's landmarks of one recording do,
which has no reference (`mocapella.evaluation.hand_clips`). Equal seeds give equal bits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError, one_of
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, rigid
from mocapella.model.camera import CameraRig
from mocapella.model.hand import DIGIT_ANGLES, DIGITS, LANDMARKS, TIPS, Handedness, HandPose, HandShape, hand_model
from mocapella.model.keypoints import KeypointFrame, keypoint_frame
from mocapella.model.topology import topology
from mocapella.settings import check
from mocapella.sources.simulate.crowd import CameraRing, ring_rig
from mocapella.sources.simulate.hand_motion import landmarks_of

Float64 = NDArray[np.float64]
Sides = dict[Handedness, Float64]
"""Landmarks (21, 3) of the hands, world [m], by side."""
Shapes = dict[Handedness, HandShape]
"""Sizes of a person's hands, by side."""

HZ: Final = 30
LASTS_S: Final = 4.0
"""Duration of a scene [s]."""
SIDES: Final[tuple[Handedness, Handedness]] = ("left", "right")
BODY: Final = "halpe_136"
"""Topology of a body with both hands, whose keypoints of the hands begin at `HANDS_AT`."""
HANDS_AT: Final[dict[Handedness, int]] = {"left": 94, "right": 115}
_LANDMARKS: Final = len(LANDMARKS)
_PERIOD_S: Final = 2.0
"""Time from rest to a posture and back, and of the movement of arms and passing hands [s]."""
_BODY_PX: Final = 2.0
"""Standard deviation of the keypoints of the body [px]."""
_SURE: Final = 0.9
"""Confidence of all detected keypoints [0 to 1]."""
_CLOSED: Final = (80.0, 95.0, 60.0)
_POSTURES: Final[Mapping[str, Mapping[str, tuple[float, ...]]]] = {
    "open": dict.fromkeys(DIGITS, (0.0, 5.0, 3.0)),
    "fist": {"thumb": (25.0, 35.0, 40.0), **dict.fromkeys(DIGITS[1:], _CLOSED)},
    "spread": {"thumb": (0.0, 0.0, 0.0), **dict.fromkeys(DIGITS[1:], (0.0, 5.0, 3.0))},
    "pinch": {
        "thumb": (25.0, 25.0, 20.0), "index": (50.0, 45.0, 25.0), "middle": (20.0, 25.0, 15.0),
        "ring": (20.0, 25.0, 15.0), "little": (20.0, 25.0, 15.0),
    },
    "pointing": {"thumb": (25.0, 35.0, 40.0), "index": (5.0, 5.0, 3.0), **dict.fromkeys(DIGITS[2:], _CLOSED)},
}  # fmt: skip
"""Flexions of each digit's joints in a posture [°]."""
_SCATTER: Final = 0.05
"""Standard deviation of each bone of a person, relative to the average."""
_SPREAD_DEG: Final = (-20.0, 14.0, 3.0, -9.0, -18.0)
"""Abductions of the digits of the posture ``spread`` [°]."""
_MODEL: Final = hand_model("full")


@dataclass(frozen=True)
class HandDetectorErrors:
    """Assumed errors of a detector of hands.

    Attributes:
        white: standard deviation of an error that is new in each image, relative to the hand's longer side in the
            image; larger: more jitter [ratio].
        slow: standard deviation of an error that lasts; larger: less exact, and no steadier when averaged [ratio].
        slow_s: time constant of that error; larger: it lasts longer [s].
        missing_tips: share of the fingertips that are missing; larger: fewer measured tips [ratio].
        outliers: share of the landmarks that are far off, by half the hand's side; larger: more wrong rays [ratio].
        confused: share of the images where the hands of a body are exchanged; larger: more wrong sides [ratio].
        exchanged: number of cameras that exchange the hands of a body in all images; larger: more wrong sides [count].
        one_camera_after_s: time after which only the first camera sees the left hand; larger: it is measured longer
            [s].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    white: float = 0.012
    slow: float = 0.02
    slow_s: float = 0.15
    missing_tips: float = 0.0
    outliers: float = 0.0
    confused: float = 0.0
    exchanged: int = 0
    one_camera_after_s: float = 1000.0

    def __post_init__(self) -> None:
        for name in ("white", "slow", "missing_tips", "outliers", "confused"):
            check(0 <= getattr(self, name) <= 1, name, getattr(self, name), "from 0 to 1")
        check(0 < self.slow_s <= 100, "slow_s", self.slow_s, "above 0 and at most 100 s")
        check(0 <= self.exchanged <= 32, "exchanged", self.exchanged, "from 0 to 32")
        check(self.one_camera_after_s > 0, "one_camera_after_s", self.one_camera_after_s, "above 0 s")


@dataclass(frozen=True, eq=False)
class HandKeypointScene:
    """Moving hands before cameras.

    Attributes:
        name: name of the scene.
        summary: what happens.
        ring: the cameras.
        of: topology of the frames: ``hand``, or `BODY`.
        at: joints of the body (26, 3), None for hands alone, and landmarks of the hands at a time [s], world [m], of
            hands of given sizes.
        errors: errors of the detector.
    """

    name: str
    summary: str
    ring: CameraRing
    of: str
    at: Callable[[float, Shapes], tuple[Float64 | None, Sides]]
    errors: HandDetectorErrors = field(default_factory=HandDetectorErrors)

    @property
    def rig(self) -> CameraRig:
        """The cameras' lenses and poses."""
        return ring_rig(self.ring)


class SimulatedHands(msgspec.Struct, frozen=True, eq=False):
    """A camera's frame with its ground truth.

    Attributes:
        frame: the frame.
        at_ns: its capture time [ns].
        hands: landmarks of the hands then, by side.
        cameras: for each side, number of cameras that see the hand in their images.
    """

    frame: KeypointFrame
    at_ns: int
    hands: Sides
    cameras: dict[Handedness, int]


def hand_keypoint_scenes() -> dict[str, str]:
    """Return names and summaries of the scenes."""
    return {scene.name: scene.summary for scene in _SCENES}


def hand_keypoint_scene(name: str) -> HandKeypointScene:
    """Return a scene by its name.

    Raises:
        SettingsError: no such scene; lists those there are.
    """
    for scene in _SCENES:
        if scene.name == name:
            return scene
    raise SettingsError(f"unknown scene {name!r}; known: {one_of(name, hand_keypoint_scenes())}")


def hand_frames(scene: HandKeypointScene, seed: int = 0, *, seconds: float = LASTS_S) -> Iterator[SimulatedHands]:
    """Yield the frames of all cameras in the order of their capture; cameras are a part of a period apart.

    Args:
        scene: the scene.
        seed: random seed of the errors.
        seconds: duration [s].
    """
    seen = _Detector(scene, seed)
    count = len(seen.rig.cameras)
    delays = np.concatenate([[0.0], seen.rng.uniform(0.0, 0.3 / HZ, count - 1)])
    for k in range(round(seconds * HZ)):
        for c in np.argsort(delays).tolist():
            yield seen.frame(c, k, k / HZ + float(delays[c]))


class _Detector:
    """The cameras of a scene and a detector of hands, with errors that last."""

    def __init__(self, scene: HandKeypointScene, seed: int) -> None:
        self.scene, self.rig, self.rng = scene, scene.rig, np.random.default_rng([seed, 21])
        self._names = list(self.rig.cameras)
        self._shapes = hand_shapes(seed)
        self._slow: dict[tuple[int, Handedness], Float64] = {}

    def frame(self, camera: int, sequence: int, at_s: float) -> SimulatedHands:
        """Return the frame of a camera at a time [s]."""
        errors, name = self.scene.errors, self._names[camera]
        joints, hands = self.scene.at(at_s, self._shapes)
        seen = {side: self._detected(camera, side, points) for side, points in hands.items()}
        alone = at_s >= errors.one_camera_after_s
        if alone and camera > 0 and "left" in seen:
            seen["left"][:] = np.nan
        always = camera >= len(self._names) - errors.exchanged
        if len(seen) == 2 and (self.rng.uniform() < errors.confused or always):
            seen = {"left": seen["right"], "right": seen["left"]}
        if joints is None:
            rows = [px for px in seen.values() if np.isfinite(px[:, 0]).sum() >= _LANDMARKS // 2]
            px = np.array(rows[:: -1 if self.rng.uniform() < 0.5 else 1]).reshape(-1, _LANDMARKS, 2)
        else:
            px = np.full((1, len(topology(self.scene.of)), 2), np.nan)
            px[0, : len(joints)] = _pixels(self.rig, name, joints) + self.rng.normal(size=(len(joints), 2)) * _BODY_PX
            for side, own in seen.items():
                px[0, HANDS_AT[side] : HANDS_AT[side] + _LANDMARKS] = own
        frame = keypoint_frame(
            name, topology(self.scene.of), time_ns=round((1.0 + at_s) * NS_PER_S), positions_px=px, sequence=sequence,
            size_px=self.rig.cameras[name].camera.size_px,
            confidences=np.where(np.isfinite(px[..., 0]), _SURE, 0.0) if len(px) else 1.0,
        )  # fmt: skip
        cameras = {side: 1 if alone and side == "left" else self._seeing(points) for side, points in hands.items()}
        return SimulatedHands(frame, frame.time_ns, hands, cameras)

    def _detected(self, camera: int, side: Handedness, points: Float64) -> Float64:
        """Return the pixels (21, 2) that the detector gives for a hand; NaN where it gives none."""
        rng, errors, px = self.rng, self.scene.errors, _pixels(self.rig, self._names[camera], points)
        new, keep = rng.normal(size=px.shape), math.exp(-1.0 / (HZ * errors.slow_s))
        before = self._slow.get((camera, side))
        slow = new if before is None else keep * before + math.sqrt(1.0 - keep**2) * new
        self._slow[camera, side] = slow
        white, far, lost = rng.normal(size=px.shape), rng.normal(size=px.shape), rng.uniform(size=(2, _LANDMARKS))
        if not np.isfinite(px).any():
            return px
        length = float((np.nanmax(px, axis=0) - np.nanmin(px, axis=0)).max())
        px = px + length * (errors.white * white + errors.slow * slow)
        px = np.where((lost[0] < errors.outliers)[:, None], px + 0.5 * length * far, px)
        tips = np.zeros(_LANDMARKS, dtype=np.bool_)
        tips[list(TIPS)] = True
        px[tips & (lost[1] < errors.missing_tips)] = np.nan
        return px

    def _seeing(self, points: Float64) -> int:
        return sum(bool(np.isfinite(_pixels(self.rig, name, points)).all()) for name in self._names)


def _pixels(rig: CameraRig, name: str, points: Float64) -> Float64:
    """Return the pixels (n, 2) of points; NaN outside the image."""
    placed = rig.cameras[name]
    px = project(apply(placed.T_camera_world, points), placed.camera.lens)
    px[~((px >= 0) & (px <= np.array(placed.camera.size_px) - 1)).all(axis=1)] = np.nan
    return px


def hand_shapes(seed: int) -> Shapes:
    """Return the sizes of a person's hands, which differ from the average in length and in each bone."""
    rng = np.random.default_rng([seed, 22])
    length_m = 0.185 * float(rng.uniform(0.9, 1.1))
    bones, palm = rng.normal(1.0, _SCATTER, (5, 3)), rng.normal(1.0, _SCATTER, (5, 3))
    average = {side: _MODEL.shape(side, hand_length_m=length_m) for side in SIDES}
    return {side: HandShape(side, one.lengths * bones, one.bases * palm) for side, one in average.items()}


def posture_landmarks(shape: HandShape, posture: str, share: float, T_world_palm: Float64) -> Float64:
    """Return the landmarks (21, 3) of a hand between rest and a posture, world [m].

    Args:
        shape: the hand.
        posture: ``open``, ``fist``, ``spread``, ``pinch`` or ``pointing``.
        share: 0 for the hand at rest, 1 for the posture.
        T_world_palm: (4, 4) pose of the palm.
    """
    angles = _MODEL.natural.copy()
    for digit, row in enumerate(DIGIT_ANGLES):
        flexions = _POSTURES[posture][DIGITS[digit]]
        for column, value in zip((0, 2, 3), flexions, strict=True):
            angles[row[column]] += share * (math.radians(value) - angles[row[column]])
        if posture == "spread":
            angles[row[1]] += share * (math.radians(_SPREAD_DEG[digit]) - angles[row[1]])
    pose = HandPose(_MODEL.limited(angles), T_world_palm)
    return landmarks_of(_MODEL, shape, pose)


def palm_at(wrist: Float64, forwards: Float64, back: Float64) -> Float64:
    """Return T_world_palm (4, 4) at a wrist, with the fingers forwards; the back of the hand faces about ``back``."""
    z = forwards / np.linalg.norm(forwards)
    x = np.cross(back, z)
    x /= np.linalg.norm(x)
    return rigid(np.stack([x, np.cross(z, x), z], axis=1), wrist)


def _wave(at_s: float) -> float:
    """Return a share that goes from 0 to 1 and back."""
    return 0.5 - 0.5 * math.cos(2.0 * math.pi * at_s / _PERIOD_S)


def _desk(posture: str) -> Callable[[float, Shapes], tuple[None, Sides]]:
    """A right hand over a desk that goes to a posture and back while it moves and turns."""

    def at(at_s: float, shapes: Shapes) -> tuple[None, Sides]:
        turn = 0.5 * math.sin(1.5 * at_s)
        wrist = np.array([0.06 * math.sin(2.0 * at_s), 0.03 * math.sin(1.3 * at_s), 0.08 * math.cos(1.7 * at_s)])
        T = palm_at(wrist, np.array([math.sin(turn), 0.3, math.cos(turn)]), np.array([0.3, 1.0, 0.0]))
        return None, {"right": posture_landmarks(shapes["right"], posture, _wave(at_s), T)}

    return at


def _passing(at_s: float, shapes: Shapes) -> tuple[None, Sides]:
    """Two hands over a desk that pass above each other, 6 cm apart."""
    hands: Sides = {}
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        x = 0.12 * sign * math.cos(2.0 * math.pi * at_s / _PERIOD_S)
        T = palm_at(np.array([x, 0.03 * sign, -0.05]), np.array([0.2 * sign, 0.1, 1.0]), np.array([0.0, 1.0, 0.0]))
        hands[side] = posture_landmarks(shapes[side], "open", _wave(1.3 * at_s), T)
    return None, hands


def _person(posture: str, *, crossing: bool = False) -> Callable[[float, Shapes], tuple[Float64, Sides]]:
    """A person who stands and moves the forearms; with ``crossing``, the wrists pass each other before the chest."""
    halpe = topology("halpe_26")

    def at(at_s: float, shapes: Shapes) -> tuple[Float64, Sides]:
        joints, hands = _STANDING.copy(), Sides()
        for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
            letter = side[0].upper()
            swing = math.sin(2.0 * math.pi * at_s / _PERIOD_S + (0.7 if sign > 0 else 0.0))
            inwards = -0.9 - 0.6 * swing if crossing else 0.2 * swing
            forwards = np.array([sign * inwards, 0.15 * sign if crossing else 0.3 * swing, 0.9])
            forwards /= np.linalg.norm(forwards)
            elbow = joints[halpe.index(f"{letter}Elbow")]
            wrist = elbow + 0.26 * forwards
            joints[halpe.index(f"{letter}Wrist")] = wrist
            T = palm_at(wrist, forwards, np.array([0.6 * sign, 1.0, 0.0]))
            hands[side] = posture_landmarks(shapes[side], posture, _wave(at_s), T)
        return joints, hands

    return at


def _standing() -> Float64:
    """Return the joints of ``halpe_26`` (26, 3) of a standing person who faces z; y is up [m]."""
    places = {
        "Nose": (0.0, 1.58, 0.1), "Eye": (0.03, 1.61, 0.08), "Ear": (0.07, 1.6, 0.0), "Shoulder": (0.18, 1.4, 0.0),
        "Elbow": (0.22, 1.12, 0.05), "Wrist": (0.22, 1.12, 0.31), "Hip": (0.1, 0.92, 0.0), "Knee": (0.11, 0.5, 0.02),
        "Ankle": (0.11, 0.08, 0.0), "Head": (0.0, 1.74, 0.0), "Neck": (0.0, 1.42, 0.0), "BigToe": (0.13, 0.02, 0.18),
        "SmallToe": (0.17, 0.02, 0.15), "Heel": (0.1, 0.02, -0.05),
    }  # fmt: skip
    joints = []
    for name in topology("halpe_26").joints:
        x, y, z = places.get(name) or places[name[1:]]
        joints.append((0.0 if name == "Hip" else -x if name[0] == "R" and name not in places else x, y, z))
    return np.array(joints)


_STANDING: Final = _standing()
_OVER_DESK: Final = CameraRing(count=2, radius=0.75, height=0.45, centre=(0.0, 0.0, 0.0), first_deg=-37, arc_deg=74)
_THREE: Final = CameraRing(count=3, radius=0.75, height=0.45, centre=(0.0, 0.0, 0.0), first_deg=-60, arc_deg=120)
_ROOM: Final = CameraRing(count=4, radius=2.5, height=1.6, centre=(0.0, 1.0, 0.0))
_TWO: Final = CameraRing(count=2, radius=2.5, height=1.6, centre=(0.0, 1.0, 0.0), first_deg=-40, arc_deg=80)


def _desk_scene(name: str, summary: str, errors: HandDetectorErrors | None = None) -> HandKeypointScene:
    own = errors or HandDetectorErrors()
    return HandKeypointScene(name, summary, _OVER_DESK, "hand", _desk(name if name in _POSTURES else "open"), own)


def _room_scene(
    name: str, summary: str, errors: HandDetectorErrors | None = None, *, ring: CameraRing = _ROOM
) -> HandKeypointScene:
    at = _person("fist", crossing=name == "crossed-arms")
    return HandKeypointScene(name, summary, ring, BODY, at, errors or HandDetectorErrors())


_SCENES: Final[Sequence[HandKeypointScene]] = (
    _desk_scene("open", "a hand alone opens, two cameras"),
    _desk_scene("fist", "a hand alone closes to a fist, two cameras"),
    _desk_scene("spread", "a hand alone spreads its fingers, two cameras"),
    _desk_scene("pinch", "thumb and index finger of a hand alone meet, two cameras"),
    _desk_scene("pointing", "a hand alone points, two cameras"),
    _desk_scene("tips-missing", "a hand alone, a third of the tips is missing", HandDetectorErrors(missing_tips=0.33)),
    _desk_scene("outliers", "a hand alone, a twentieth of the landmarks is far off", HandDetectorErrors(outliers=0.05)),
    HandKeypointScene("passing", "two hands alone pass each other, three cameras", _THREE, "hand", _passing),
    _room_scene("person", "a person closes both hands, four cameras"),
    _room_scene("two-cameras", "a person closes both hands, two cameras", ring=_TWO),
    _room_scene("crossed-arms", "the wrists of a person pass each other, four cameras"),
    _room_scene(
        "sides-confused", "a third of the images exchanges the person's hands", HandDetectorErrors(confused=0.33)
    ),
    _room_scene("camera-exchanged", "one of four cameras always exchanges the hands", HandDetectorErrors(exchanged=1)),
    _room_scene(
        "one-camera", "only one camera sees the left hand from 2 s on", HandDetectorErrors(one_camera_after_s=2.0)
    ),
)
