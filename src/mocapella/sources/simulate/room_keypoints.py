"""Keypoints of a simulated room's people, as a detector reports them in the images of a depth camera with colour.

    seen = RoomKeypoints(room_depth_scene("walk", seed=1), topology("coco_17"))
    frame = seen.at(2.5, "left", time_ns=2_500_000_001)

The errors are a model, not any one detector's: joints in view are seen with a standard deviation in proportion
to the person's size in the image, joints behind something with less confidence and larger errors, and some are missed.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.conventions import NS_PER_S
from mocapella.errors import SettingsError
from mocapella.geometry.lens import project
from mocapella.model.keypoints import KeypointFrame, keypoint_frame
from mocapella.model.topology import Topology, topology
from mocapella.settings import check
from mocapella.sources.simulate.body import JOINT, body_template
from mocapella.sources.simulate.room_depth import RoomDepthScene, RoomShot

Bools = NDArray[np.bool_]
Float64 = NDArray[np.float64]

_HALPE: Final[dict[str, str]] = {
    "Hip": "SpineBase",
    **{f"{s}{own}": f"{joint}{side}" for s, side in (("L", "Left"), ("R", "Right"))
       for own, joint in (("Shoulder", "Shoulder"), ("Elbow", "Elbow"), ("Wrist", "Wrist"), ("Hip", "Hip"),
                          ("Knee", "Knee"), ("Ankle", "Ankle"), ("BigToe", "Foot"))},
}  # fmt: skip
"""Joint of the body at which a keypoint of Halpe is."""
_FACE: Final = {"Nose": (0.0, 0.0, 0.052), "LEye": (0.018, 0.018, 0.048), "REye": (-0.018, 0.018, 0.048),
                "LEar": (0.043, 0.0, 0.0), "REar": (-0.043, 0.0, 0.0)}  # fmt: skip
"""Place of a keypoint of the head, to the person's left, up and forward from its middle, relative to the stature."""
_UNDER_M: Final = 0.06
"""A joint is behind something if a surface is nearer than its limb's by more than this [m]."""


@dataclass(frozen=True)
class KeypointErrors:
    """Errors of a simulated detector of keypoints.

    Attributes:
        sd: standard deviation of a joint in view, relative to the person's height in the image; larger: less exact
            [ratio].
        hidden_sd: that of a joint behind something; larger: less exact [ratio].
        missed: share of keypoints that are missed; larger: fewer keypoints [ratio].

    Raises:
        SettingsError: a value is out of range.
    """

    sd: float = 0.007
    hidden_sd: float = 0.03
    missed: float = 0.01

    def __post_init__(self) -> None:
        check(0 <= self.sd <= 0.2, "sd", self.sd, "from 0 to 0.2")
        check(0 <= self.hidden_sd <= 0.5, "hidden_sd", self.hidden_sd, "from 0 to 0.5")
        check(0 <= self.missed < 1, "missed", self.missed, "from 0 to below 1")


class RoomKeypoints:
    """The keypoints of the people of a room in one camera's images.

    Args:
        scene: the room and the camera.
        own: topology of the keypoints; a joint that the simulated body does not have is never seen.
        errors: errors of the detector; the defaults if None.
        seed: random seed of the errors.

    Attributes:
        scene, topology, errors: as given.

    Raises:
        SettingsError: the topology has no mapping to Halpe's keypoints.
    """

    def __init__(
        self, scene: RoomDepthScene, own: Topology, errors: KeypointErrors | None = None, *, seed: int = 0
    ) -> None:
        self.scene, self.topology, self.errors = scene, own, errors or KeypointErrors()
        halpe = topology("halpe_26")
        single = own.single_joints(halpe.name)
        self._names: list[tuple[int, str]] = [(source, halpe.joints[joint]) for joint, source in single.items()]
        if not self._names:
            raise SettingsError(f"topology {own.name} cannot be simulated: it has no mapping to {halpe.name}")
        self._key = zlib.crc32(f"{scene.room.name}/{scene.T_camera_world.tobytes().hex()}".encode()) + seed

    def truth(self, shot: RoomShot) -> tuple[Float64, Bools]:
        """Return the true joints in an image, and whether each is in view.

        Returns:
            (people, keypoints, 3) positions in the camera frame [m], NaN for joints that the body does not have; and
                (people, keypoints) whether the image has the joint, and nothing but its own limb before it.
        """
        people, n = len(shot.people), len(self.topology)
        joints, flesh = np.full((people, n, 3), np.nan), np.zeros((people, n))
        template = body_template()
        reach = template.radii.copy()
        reach[JOINT["SpineBase"]] = template.radii[JOINT["SpineMid"]]
        for person, body in enumerate(shot.people):
            stature = float(self.scene.room.motion.radii[person, JOINT["Head"]] / template.radii[JOINT["Head"]])
            for index, name in self._names:
                if name in _FACE:
                    joints[person, index] = _in_head(body, _FACE[name], stature)
                    flesh[person, index] = 0.02 * stature
                elif name in _HALPE:
                    joints[person, index] = body[JOINT[_HALPE[name]]]
                    flesh[person, index] = reach[JOINT[_HALPE[name]]] * stature
        pixels = project(joints, shot.lens)
        (height, width), exact = shot.exact_m.shape, shot.exact_m
        inside = np.asarray(((pixels >= 0) & (pixels <= (width - 1, height - 1))).all(axis=-1))
        at = np.where(inside[..., None], pixels, 0).round().astype(int)
        surface = exact[at[..., 1], at[..., 0]]
        return joints, inside & (surface > joints[..., 2] - 1.6 * flesh - _UNDER_M)

    def at(self, at_s: float, sensor: str, *, time_ns: int) -> KeypointFrame:
        """Return the keypoints of the image at a time since the room's start [s].

        Args:
            at_s: the time.
            sensor: name of the camera in the frame.
            time_ns: capture time in the frame.
        """
        return self.of(self.scene.at(at_s), sensor, time_ns=time_ns)

    def near(self, time_ns: int) -> KeypointFrame:
        """Return the keypoints of the image at a time since the room's start [ns], for a camera without a name."""
        return self.of(self.scene.near(time_ns), "", time_ns=time_ns)

    def of(self, shot: RoomShot, sensor: str, *, time_ns: int) -> KeypointFrame:
        """Return the keypoints of an image of the scene; see `at`."""
        joints, visible = self.truth(shot)
        e = self.errors
        rng = np.random.default_rng([self._key, round(shot.at_s * NS_PER_S)])
        draws, sure, gone = rng.normal(size=(*visible.shape, 2)), rng.random(visible.shape), rng.random(visible.shape)
        pixels = project(joints, shot.lens)
        tall = np.full((len(joints), 1, 1), 1.0)
        for person, found in enumerate(pixels):
            rows = found[np.isfinite(found).all(axis=-1)]
            tall[person] = math.dist(rows.min(axis=0), rows.max(axis=0)) if len(rows) else 1.0
        pixels = pixels + draws * tall * np.where(visible, e.sd, e.hidden_sd)[..., None]
        width, height = self.scene.sensor.size_px
        inside = np.asarray(((pixels >= 0) & (pixels <= (width - 1, height - 1))).all(axis=-1))
        confidences = np.where(visible, 0.6 + 0.35 * sure, 0.1 + 0.5 * sure)
        confidences[~inside | (gone < e.missed)] = 0.0
        kept = (confidences > 0.3).sum(axis=1) >= 5
        return keypoint_frame(
            sensor, self.topology, time_ns=time_ns, size_px=(width, height), positions_px=pixels[kept],
            confidences=confidences[kept], ids=np.flatnonzero(kept),
        )  # fmt: skip


def _in_head(body: Float64, place: tuple[float, float, float], stature: float) -> Float64:
    """Return the position (3,) of a place of the head, in the frame of the joints (25, 3)."""
    up = body[JOINT["Head"]] - body[JOINT["Neck"]]
    up = up / np.linalg.norm(up)
    left = body[JOINT["ShoulderLeft"]] - body[JOINT["ShoulderRight"]]
    left = left - (left @ up) * up
    left = left / np.linalg.norm(left)
    middle = 0.5 * (body[JOINT["Head"]] + body[JOINT["Neck"]])
    return np.asarray(middle + stature * (place[0] * left + place[1] * up + place[2] * np.cross(left, up)))
