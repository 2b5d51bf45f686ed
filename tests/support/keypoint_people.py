"""Simulated people before free-running cameras that detect their keypoints, with errors like a detector's."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.geometry.lens import project
from mocapella.geometry.rigid import apply, inverse, rigid
from mocapella.model.camera import Camera, CameraRig, PlacedCamera
from mocapella.model.keypoints import KeypointFrame, keypoint_frame
from mocapella.model.topology import topology
from mocapella.sources.simulate.body import JOINT, bone_lengths, facing
from mocapella.sources.simulate.gait import animate
from mocapella.sources.simulate.motion import Ensemble, together
from mocapella.sources.simulate.route import Route, Spot

Float64 = NDArray[np.float64]

HALPE = topology("halpe_26")
SAME = {
    "Shoulder": "Shoulder", "Elbow": "Elbow", "Wrist": "Wrist", "Hip": "Hip", "Knee": "Knee", "Ankle": "Ankle",
}  # fmt: skip


@dataclass(frozen=True)
class Errors:
    """A detector's errors, in units of a person's size in the image.

    Attributes:
        white: sd of each detection's own error.
        slow: sd of an error that lasts, with ``slow_s`` as its time constant.
        slow_s: time constant [s].
        outliers: share of keypoints that are elsewhere, by 0.15 sizes.
        missing: share of keypoints that are not seen.
        swaps: share of detections whose left and right are exchanged.
    """

    white: float = 0.006
    slow: float = 0.008
    slow_s: float = 0.4
    outliers: float = 0.02
    missing: float = 0.08
    swaps: float = 0.01


NONE = Errors(0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


def walking(seconds: float, starts: list[tuple[float, float]], statures: list[float], seed: int = 0) -> Ensemble:
    """Return people who walk about between random places of the middle of the room."""
    rng = np.random.default_rng(seed)
    motions = []
    for start, stature in zip(starts, statures, strict=True):
        route = Route(Spot(*start, 0.0))
        while sum(leg.seconds for leg in route.legs) < seconds:
            route.go((float(rng.uniform(-1.3, 1.3)), float(rng.uniform(-1.3, 1.3))))
        motions.append(animate(route.legs, bone_lengths(stature), stature, rng))
    return together(motions)


def standing(seconds: float, stature: float = 1.75) -> Ensemble:
    """Return one person who stands still."""
    route = Route(Spot(0.0, 0.0, 0.0))
    route.stand(seconds)
    return together([animate(route.legs, bone_lengths(stature), stature, np.random.default_rng(0), lifeless=True)])


def halpe_joints(joints: Float64) -> Float64:
    """Return Halpe's joints (people, 26, 3) of simulated bodies (people, 25, 3), y up."""
    out = np.full((len(joints), 26, 3), np.nan)
    for k, name in enumerate(HALPE.joints):
        side = {"L": "Left", "R": "Right"}.get(name[0])
        if side and name[1:] in SAME:
            out[:, k] = joints[:, JOINT[name[1:] + side]]
    ahead = facing(joints)
    head = 0.5 * (joints[:, JOINT["Neck"]] + joints[:, JOINT["Head"]])
    left = np.cross([0.0, 1.0, 0.0], ahead)
    out[:, HALPE.index("Hip")] = joints[:, JOINT["SpineBase"]]
    out[:, HALPE.index("Neck")] = joints[:, JOINT["SpineShoulder"]]
    out[:, HALPE.index("Nose")] = head + 0.1 * ahead
    out[:, HALPE.index("Head")] = joints[:, JOINT["Head"]] + [0.0, 0.1, 0.0]
    for sign, side in ((1.0, "L"), (-1.0, "R")):
        out[:, HALPE.index(side + "Ear")] = head + 0.07 * sign * left
        out[:, HALPE.index(side + "Eye")] = head + 0.08 * ahead + 0.03 * sign * left + [0.0, 0.03, 0.0]
        ankle = joints[:, JOINT["Ankle" + ("Left" if side == "L" else "Right")]]
        foot = joints[:, JOINT["Foot" + ("Left" if side == "L" else "Right")]]
        along = foot - ankle
        down = np.array([0.0, 0.045, 0.0])
        out[:, HALPE.index(side + "Heel")] = ankle - 0.4 * along * [1, 0, 1] - down
        out[:, HALPE.index(side + "BigToe")] = ankle + 1.3 * along * [1, 0, 1] - down
        out[:, HALPE.index(side + "SmallToe")] = ankle + 1.1 * along * [1, 0, 1] - down + 0.06 * sign * left
    return out


def ring(count: int = 4, seed: int = 0, size_px: tuple[int, int] = (1280, 720), radius: float = 3.6) -> CameraRig:
    """Return cameras around the room, with unequal heights, lenses and clocks; camera 0's clock is the rig's."""
    rng = np.random.default_rng(seed)
    cameras = {}
    for k in range(count):
        angle = 2 * np.pi * (k + rng.uniform(-0.15, 0.15)) / count
        at = np.array([radius * np.cos(angle), rng.uniform(1.3, 2.3), radius * np.sin(angle)])
        z = np.array([rng.uniform(-0.2, 0.2), 0.95, rng.uniform(-0.2, 0.2)]) - at
        z /= np.linalg.norm(z)
        x = np.cross(z, [0.0, 1.0, 0.0])
        x /= np.linalg.norm(x)
        R = np.stack([x, np.cross(z, x), z])
        focal = size_px[0] / 2 / np.tan(np.radians(rng.uniform(58, 82)) / 2)
        lens = np.array([focal, focal, (size_px[0] - 1) / 2, (size_px[1] - 1) / 2, 0, 0, 0, 0, 0])
        clock = 0.0 if k == 0 else float(rng.uniform(-0.04, 0.04))
        name = f"cam{k + 1}"
        cameras[name] = PlacedCamera(Camera(name, size_px, lens), rigid(R, -R @ at), np.full((6, 6), np.nan), clock)
    return CameraRig(cameras)


@dataclass
class Detector:
    """The keypoints of one camera; each call draws new errors.

    Attributes:
        placed: the camera.
        errors: the detector's errors.
        rng: random numbers.
        hz: frame rate [Hz].
    """

    placed: PlacedCamera
    errors: Errors
    rng: np.random.Generator
    hz: float = 30.0
    _slow: dict[int, Float64] = field(default_factory=dict)

    def see(self, joints: Float64, at_s: float) -> KeypointFrame:
        """Return the frame of people (people, 26, 3) in the world at a time of the room [s]."""
        camera, e = self.placed.camera, self.errors
        pixels = project(apply(self.placed.T_camera_world, joints), camera.lens)
        rows = []
        for person, truth in enumerate(pixels):
            seen = np.isfinite(truth).all(axis=1)
            if seen.sum() < 5:
                continue
            size = float(np.hypot(*np.ptp(truth[seen], axis=0)))
            keep = np.exp(-1.0 / (self.hz * e.slow_s))
            old = self._slow.get(person, self.rng.normal(size=(26, 2)))
            slow = keep * old + np.sqrt(1 - keep**2) * self.rng.normal(size=(26, 2))
            self._slow[person] = slow
            found = truth + size * (e.slow * slow + e.white * self.rng.normal(size=(26, 2)))
            off = self.rng.random(26) < e.outliers
            found[off] += 0.15 * size * self.rng.normal(size=(int(off.sum()), 2))
            if self.rng.random() < e.swaps:
                found = found[np.array(HALPE.mirror)]
            inside = ((found >= 0) & (found < camera.size_px)).all(axis=1)
            found[~inside | (self.rng.random(26) < e.missing)] = np.nan
            if np.isfinite(found).all(axis=1).sum() >= 5:
                rows.append(found)
        order = self.rng.permutation(len(rows))
        return keypoint_frame(
            camera.name, HALPE, time_ns=round((at_s + self.placed.clock_s) * NS_PER_S), size_px=camera.size_px,
            positions_px=np.array([rows[k] for k in order]).reshape(-1, 26, 2), confidences=0.9,
        )  # fmt: skip


def filmed(
    rig: CameraRig, people: Ensemble, seconds: float, errors: Errors | None = None, *, seed: int = 0,
    hz: float = 30.0, begin: float = 10.0,
) -> list[KeypointFrame]:  # fmt: skip
    """Return the frames of all cameras in the order of their capture; each camera has a phase of its own."""
    rng = np.random.default_rng([seed, 7])
    frames = []
    for placed in rig.cameras.values():
        detector, phase = Detector(placed, errors or Errors(), rng, hz), rng.uniform(0, 1 / hz)
        for n in range(int(seconds * hz)):
            at = begin + phase + n / hz
            frames.append((at, detector.see(halpe_joints(people.positions_at(round(at * NS_PER_S))), at)))
    return [frame for _, frame in sorted(frames, key=lambda pair: pair[0])]


def centre_of(placed: PlacedCamera) -> Float64:
    """Return a camera's position (3,) in the world [m]."""
    return inverse(placed.T_camera_world)[:3, 3]
