"""A person's arm as a skinned triangle mesh, drawn by `depth_scene`.

    mesh = arm_mesh(arm_shapes()["average"], "right")
    vertices = mesh.at(pose)            # (n, 3) in the camera frame
    points = mesh.points(pose)          # (24, 3) exact joints: ARM_POINTS and the shoulder

In the rest pose, the surface is that of a smooth union of tapered limbs: fingers, a palm of four metacarpals with the
balls of the thumb and of the little finger, the skin between the digits, an oval wrist, a forearm of two bones, the
upper arm. Its surface is triangulated once (surface net) and skinned with dual quaternions, so that knuckles stay
round. The mesh shares with the detectors of arms only the description of a hand, `mocapella.model.hand`, and the shape
of its surface, `mocapella.model.hand_flesh`.

**Rest pose.** The arm is straight along z; all angles are 0 except the fingers' abductions, `REST_ANGLES`.

**Fingertips.** The surface ends 0.6 `ArmMesh.tip_radii_m` beyond a tip's landmark; see `mocapella.model.hand_flesh`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.decoding import own_toml
from mocapella.errors import SettingsError, one_of
from mocapella.geometry.limb_surface import group_distances, polygonise
from mocapella.geometry.rigid import rigid
from mocapella.model.hand import DIGIT_ANGLES, DIGITS, Handedness, HandModel, HandShape, hand_model
from mocapella.model.hand_flesh import (
    BETWEEN_M,
    CORE,
    REST_ANGLES,
    WITHIN_M,
    finger_radii,
    hand_limbs,
    hand_weights,
)
from mocapella.model.rigged_mesh import smooth
from mocapella.settings import check, parse

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]

BONES: Final = (
    *("upper arm", "forearm at the elbow", "forearm at the wrist", "palm"),
    *(f"{digit} {bone}" for digit in DIGITS for bone in ("first", "second", "last")),
)
UPPER_ARM, ELBOW_END, WRIST_END, PALM_BONE, FIRST_DIGIT = range(5)
PARTS: Final = (*BONES, *(f"{digit} tip" for digit in DIGITS))
"""Names of the parts that label triangles: the bone with the largest weight, or a fingertip from 8 mm before its
landmark on."""
FIRST_TIP: Final = len(BONES)
TIP_PATCH_M: Final = 0.008
SHOULDER: Final = 23
"""Index of the shoulder in `ArmMesh.points`, after `mocapella.model.arms.ARM_POINTS`."""
WRIST_FLEXION_RAD: Final = (np.radians(-70), np.radians(75))
WRIST_DEVIATION_RAD: Final = (np.radians(-35), np.radians(22))
ELBOW_FLEXION_RAD: Final = (0.0, np.radians(145))
PRONATION_RAD: Final = (np.radians(-90), np.radians(90))
"""Joint limits of the forearm's pronation [rad]. This and the arm's other limits are from: American Academy of
Orthopaedic Surgeons, *Joint motion: method of measuring and recording* (1965)."""


@dataclass(frozen=True)
class ArmShape:
    """Size and proportions of an arm.

    Attributes:
        hand_length_m: length of the hand from the wrist to the tip of the middle finger [m].
        hand_breadth_m: breadth of the hand across the knuckles [m].
        finger_thickness: thickness of the fingers, relative to the reference hand of the same length.
        finger_length: length of the fingers without the thumb, relative to the reference hand of the same length.
        forearm_m, upper_arm_m: lengths of forearm and upper arm from joint to joint [m].
        forearm_thickness: thickness of the forearm, relative to the reference.
        sleeve_from_m: distance of the sleeve's end from the wrist; 0 for a bare arm [m].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    hand_length_m: float = 0.189
    hand_breadth_m: float = 0.085
    finger_thickness: float = 1.0
    finger_length: float = 1.0
    forearm_m: float = 0.255
    upper_arm_m: float = 0.29
    forearm_thickness: float = 1.0
    sleeve_from_m: float = 0.0

    def __post_init__(self) -> None:
        check(0.10 <= self.hand_length_m <= 0.25, "hand_length_m", self.hand_length_m, "0.10 to 0.25 m")
        check(0.04 <= self.hand_breadth_m <= 0.12, "hand_breadth_m", self.hand_breadth_m, "0.04 to 0.12 m")
        check(0.7 <= self.finger_thickness <= 1.3, "finger_thickness", self.finger_thickness, "0.7 to 1.3")
        check(0.85 <= self.finger_length <= 1.15, "finger_length", self.finger_length, "0.85 to 1.15")
        check(0.12 <= self.forearm_m <= 0.35, "forearm_m", self.forearm_m, "0.12 to 0.35 m")
        check(0.15 <= self.upper_arm_m <= 0.4, "upper_arm_m", self.upper_arm_m, "0.15 to 0.4 m")
        check(0.7 <= self.forearm_thickness <= 1.3, "forearm_thickness", self.forearm_thickness, "0.7 to 1.3")
        least, most = 0.02, self.forearm_m
        ok = self.sleeve_from_m == 0 or least <= self.sleeve_from_m <= most
        check(ok, "sleeve_from_m", self.sleeve_from_m, f"0 for none, or {least} to {most} m")

    @property
    def finger_radii(self) -> Float64:
        """Radii (5, 4) of the digits at their joints and tips [m]."""
        return finger_radii(self.hand_length_m, self.finger_thickness)

    def hand(self, handedness: Handedness) -> HandShape:
        """Return the hand's bones, as `mocapella.model.hand` describes them; longer fingers shorten the palm.

        Raises:
            SettingsError: the hand's size is not human.
        """
        model = hand_model("full")
        shape = model.shape(handedness, hand_length_m=self.hand_length_m, hand_breadth_m=self.hand_breadth_m)
        lengths = shape.lengths.copy()
        lengths[1:] *= self.finger_length
        bases = shape.bases.copy()
        short = (self.hand_length_m - float(lengths[2].sum())) / float(bases[2, 2])  # the palm keeps the hand's length
        bases[:, 2] *= short
        return HandShape(handedness, lengths, bases)


class ArmMeshPose(msgspec.Struct, frozen=True, eq=False):
    """Pose of an arm.

    Attributes:
        angles: (21,) angles in the order of `mocapella.model.hand.ANGLES` [rad].
        joints: (4,) flexion of the elbow; pronation of the forearm, 0 with the thumb on the upper arm's side of a bent
            elbow, π/2 with the palm facing away from the upper arm; flexion of the wrist towards the palm; deviation of
            the wrist towards the thumb [rad].
        T_camera_shoulder: (4, 4) from the shoulder's frame, with z along the upper arm towards the elbow, to the camera
            frame. A left arm's frame is chosen so that the arm, mirrored in x, is a right arm.
    """

    angles: Float64
    joints: Float64
    T_camera_shoulder: Float64


class ArmMesh:
    """An arm's surface with skinning weights; made by `arm_mesh`, which caches it: do not change its arrays.

    A left arm is a right arm whose posed vertices are mirrored in x.

    Args:
        shape: size and proportions.
        handedness: left or right.

    Attributes:
        shape, handedness: as given.
        hand: the hand's bones.
        model: model of the hand's joints, with all 21 angles.
        vertices: (n, 3) of a right arm in the rest pose, in the shoulder's frame [m].
        triangles: (m, 3) indices of vertices, anticlockwise as seen from outside; for a left arm, after mirroring.
        parts: (m,) index in `PARTS` of each triangle's part.
        bones_of, weights: (n, 4) indices in `BONES` of the bones that move a vertex, and their weights, which sum to 1.
        limbs: (k, 9) tapered limbs of a right arm in the rest pose, relative to the wrist: two ends (3 + 3) and the
            radii there [m], and the index of a group, within which limbs blend smoothly.
        tip_radii_m: (5,) radii of the fingertips, thumb to little finger [m].
    """

    def __init__(self, shape: ArmShape, handedness: Handedness) -> None:
        self.shape, self.handedness, self.model = shape, handedness, hand_model("full")
        self.hand = shape.hand(handedness)
        right = _right_arm(shape)
        self.vertices, self.parts, self.bones_of, self.weights = (
            right.vertices,
            right.parts,
            right.bones_of,
            right.weights,
        )
        self.triangles = right.triangles if handedness == "right" else np.ascontiguousarray(right.triangles[:, ::-1])
        self.limbs, self.tip_radii_m, self._rest = right.limbs, right.tip_radii_m, right.bones

    def frames(self, pose: ArmMeshPose) -> tuple[Float64, Float64]:
        """Return ``T_shoulder_bone`` (19, 3, 4) of `BONES` and joints (24, 3) of a right arm, shoulder's frame [m].

        The joints are `mocapella.model.arms.ARM_POINTS` and the shoulder. A left arm's are not mirrored here.
        """
        return arm_frames(self.model, self.shape, self.hand, pose)

    def points(self, pose: ArmMeshPose) -> Float64:
        """Return `mocapella.model.arms.ARM_POINTS` and the shoulder (24, 3) in the camera frame [m]."""
        T = pose.T_camera_shoulder
        return np.asarray((self.hand.mirror * self.frames(pose)[1]) @ T[:3, :3].T + T[:3, 3])

    def T_camera_palm(self, pose: ArmMeshPose) -> Float64:  # noqa: N802 - the field's notation
        """Return the palm's pose (4, 4) in the camera frame."""
        T = self.frames(pose)[0][PALM_BONE]
        M = self.hand.mirror
        return np.asarray(pose.T_camera_shoulder @ rigid(M[:, None] * T[:, :3] * M, M * T[:, 3]))

    def at(self, pose: ArmMeshPose) -> Float64:
        """Return the vertices (n, 3) of the posed arm in the camera frame [m]."""
        bones = self.frames(pose)[0]
        motions, out = np.empty((len(bones), 8)), np.empty_like(self.vertices)
        k = _kernels()
        k.dual_quaternions(bones, self._rest, motions)
        T = pose.T_camera_shoulder[:3].copy()
        T[:, :3] *= self.hand.mirror
        k.skin(self.vertices, self.bones_of, self.weights, motions, T, out)
        return out

    @cached_property
    def palm_parts(self) -> NDArray[np.bool_]:
        """Whether each triangle (m,) belongs to the palm or to a digit; False for forearm and upper arm."""
        return self.parts >= PALM_BONE

    @cached_property
    def digit_of(self) -> Int64:
        """Index of each triangle's digit (m,), 0 for the thumb to 4; -1 for none."""
        bones = np.where(self.parts >= FIRST_TIP, -1, (self.parts.astype(np.int64) - FIRST_DIGIT) // 3)
        return np.where(self.parts >= FIRST_TIP, self.parts.astype(np.int64) - FIRST_TIP, np.maximum(bones, -1))


def arm_frames(model: HandModel, shape: ArmShape, hand: HandShape, pose: ArmMeshPose) -> tuple[Float64, Float64]:
    """Compute the forward kinematics of a right arm, in the shoulder's frame; ``pose.T_camera_shoulder`` is not used.

    Args:
        model: model of the hand's joints.
        shape: lengths of the upper arm and the forearm.
        hand: the hand's bones.
        pose: the arm's pose.

    Returns:
        ``T_shoulder_bone`` (19, 3, 4) of `BONES` [m]; and the joints (24, 3), `mocapella.model.arms.ARM_POINTS` and the
        shoulder [m].
    """
    bones, points = np.empty((len(BONES), 3, 4)), np.empty((SHOULDER + 1, 3))
    _kernels().arm_frames(
        model.frames, DIGIT_ANGLES, hand.bases, hand.lengths, shape.upper_arm_m, shape.forearm_m,
        np.asarray(pose.joints, dtype=np.float64), np.asarray(pose.angles, dtype=np.float64), bones, points,
    )  # fmt: skip
    return bones, points


@cache
def arm_mesh(shape: ArmShape, handedness: Handedness) -> ArmMesh:
    """Make the mesh of an arm, or return the same object from the cache; do not change its arrays.

    Raises:
        SettingsError: ``handedness`` is neither left nor right.
    """
    check(handedness in ("left", "right"), "handedness", handedness, "left or right")
    return ArmMesh(shape, handedness)


@cache
def arm_shapes() -> dict[str, ArmShape]:
    """The arm shapes of the simulated people, by name."""
    shapes = own_toml("mocapella.sources.simulate", "data", "arm_shapes.toml")
    return {name: parse(ArmShape, row, where=f"arm shape {name}") for name, row in shapes.items()}


def arm_shape(name: str) -> ArmShape:
    """Look up an arm shape by name.

    Raises:
        SettingsError: unknown name; lists the known ones.
    """
    if name not in arm_shapes():
        raise SettingsError(f"unknown arm shape {name!r}; known: {one_of(name, arm_shapes())}")
    return arm_shapes()[name]


@dataclass(frozen=True, eq=False)
class _RightArm:
    vertices: Float64
    triangles: Int64
    parts: UInt8
    bones_of: Int64
    weights: Float64
    limbs: Float64
    tip_radii_m: Float64
    bones: Float64


@cache
def _right_arm(shape: ArmShape) -> _RightArm:
    hand, model = shape.hand("right"), hand_model("full")
    pose = ArmMeshPose(REST_ANGLES, np.zeros(4), np.eye(4))
    bones, points = arm_frames(model, shape, hand, pose)
    wrist = points[0]
    limbs, radii = _limbs(shape, points - wrist)
    within = np.array(WITHIN_M)
    fine = 0.0031 * shape.hand_length_m / 0.189
    nodes = _grid(limbs, fine)
    vertices, triangles = polygonise(limbs, within, BETWEEN_M, nodes)
    bones_of, weights = _weights(vertices, limbs, within, bones=bones, wrist=wrist, shape=shape)
    parts = _parts(vertices, triangles, bones_of, bones=bones, wrist=wrist, hand=hand)
    return _RightArm(vertices + wrist, triangles, parts, bones_of, weights, limbs, radii, bones)


def _limbs(shape: ArmShape, at_rest: Float64) -> tuple[Float64, Float64]:
    """Tapered limbs (n, 9) around the joints (24, 3) relative to the wrist; and radii of the fingertips (5,) [m]."""
    big = shape.hand_length_m / 0.189
    wide = shape.hand_breadth_m / 0.085
    mm = 1e-3 * big
    radii = shape.finger_radii
    rows = hand_limbs(at_rest, radii, hand_length_m=shape.hand_length_m, hand_breadth_m=shape.hand_breadth_m)

    def add(group: int, a: Any, b: Any, ra: float, rb: float) -> None:
        rows.append([*map(float, a), *map(float, b), ra, rb, group])

    # Wrist and forearm: two bones side by side, thicker towards the elbow. The radius is on the thumb's side.
    arm, L = 1e-3 * (0.5 + 0.5 * big) * shape.forearm_thickness, shape.forearm_m
    wrist = 1e-3 * (0.35 + 0.65 * wide) * (0.5 + 0.5 * shape.forearm_thickness)
    profile = [
        (10 * mm, 9.5, 16.0, wrist), (-0.06, 10.0, 16.6, wrist), (-0.30, 9.5, 20.5, arm), (-0.55, 8.0, 28.0, arm),
        (-0.78, 8.0, 34.0, arm), (-0.97, 6.0, 33.5, arm),
    ]  # fmt: skip
    sections = [(z if z > 0 else z * L, x * unit, r * unit) for z, x, r, unit in profile]
    for (z0, x0, r0), (z1, x1, r1) in pairwise(sections):
        for side in (-1.0, 1.0):
            add(CORE, [side * x0, -0.06 * r0, z0], [side * x1, -0.06 * r1, z1], r0, r1)
    U = shape.upper_arm_m
    add(CORE, [0, 0, -L], [0, 0, -L - 0.4 * U], 36 * arm, 43 * arm)
    add(CORE, [0, 0, -L - 0.4 * U], [0, 0, -L - 0.96 * U], 43 * arm, 52 * arm)
    if shape.sleeve_from_m:
        start = -shape.sleeve_from_m - 0.02
        z = np.array([-s[0] for s in sections])
        for z0, z1 in pairwise(np.linspace(start, -L, 5)):
            x0, x1 = np.interp([-z0, -z1], z, [s[1] for s in sections])
            r0, r1 = np.interp([-z0, -z1], z, [s[2] for s in sections]) + 0.008
            for side in (-1.0, 1.0):
                add(CORE, [side * x0, 0, z0], [side * x1, 0, z1], r0, r1)
        add(CORE, [0, 0, -L], [0, 0, -L - 0.96 * U], 36 * arm + 0.01, 52 * arm + 0.01)
    return np.array(sorted(rows, key=lambda row: row[8])), radii[:, 3].copy()


def _grid(limbs: Float64, fine: float) -> Float64:
    """Grid nodes (a, b, c, 3), ``fine`` apart [m] at the hand, and up to 3.4 times as far apart along the arm."""
    low = (np.minimum(limbs[:, :3], limbs[:, 3:6]) - limbs[:, 6:8].max(axis=1)[:, None]).min(axis=0)
    high = (np.maximum(limbs[:, :3], limbs[:, 3:6]) + limbs[:, 6:8].max(axis=1)[:, None]).max(axis=0)

    def coarse(z: float) -> float:
        return 1.0 + 2.4 * float(np.clip((-0.02 - z) / 0.09, 0.0, 1.0))

    zs = [high[2] + 2 * fine]
    while zs[-1] > low[2] - 4 * fine:
        zs.append(zs[-1] - fine * coarse(zs[-1]))
    zs += [zs[-1] - fine * coarse(zs[-1])]
    z = np.array(zs[::-1])
    x = np.arange(low[0] - 3 * fine, high[0] + 3 * fine, fine)
    y = np.arange(low[1] - 3 * fine, high[1] + 3 * fine, fine)
    # The nodes also spread across the arm: x and y grow with the spacing along it.
    spread = np.array([coarse(value) for value in z])
    nodes = np.empty((len(x), len(y), len(z), 3))
    nodes[..., 0] = x[:, None, None] * spread
    nodes[..., 1] = y[None, :, None] * spread
    nodes[..., 2] = z
    return nodes


def _weights(
    vertices: Float64, limbs: Float64, within: Float64, *, bones: Float64, wrist: Float64, shape: ArmShape
) -> tuple[Int64, Float64]:
    """Skinning: bones (n, 4) and weights (n, 4)."""
    big = shape.hand_length_m / 0.189
    distance = group_distances(limbs, within, vertices)
    weights = np.zeros((len(vertices), len(BONES)))
    digits = bones[FIRST_DIGIT:].copy()
    digits[:, :, 3] -= wrist
    weights[:, PALM_BONE:] = hand_weights(vertices, distance, digits, hand_length_m=shape.hand_length_m)
    z, L = vertices[:, 2], shape.forearm_m
    at_hand = smooth(z, -0.016 * big, 0.012 * big)
    at_wrist = np.clip((z + 0.88 * L) / (0.78 * L), 0.0, 1.0)
    at_forearm = smooth(z, -L - 0.03, -L + 0.03)
    weights *= at_hand[:, None]
    weights[:, WRIST_END] = (1 - at_hand) * at_wrist * at_forearm
    weights[:, ELBOW_END] = (1 - at_hand) * (1 - at_wrist) * at_forearm
    weights[:, UPPER_ARM] = (1 - at_hand) * (1 - at_forearm)
    order = np.argsort(-weights, axis=1, kind="stable")[:, :4]
    most = np.take_along_axis(weights, order, axis=1)
    return np.ascontiguousarray(order), most / most.sum(axis=1)[:, None]


def _parts(
    vertices: Float64, triangles: Int64, bones_of: Int64, *, bones: Float64, wrist: Float64, hand: HandShape
) -> UInt8:
    middles = vertices[triangles].mean(axis=1)
    parts = bones_of[triangles, 0]
    main: UInt8 = np.where(parts[:, 1] == parts[:, 2], parts[:, 1], parts[:, 0]).astype(np.uint8)
    for digit in range(5):
        last = FIRST_DIGIT + 3 * digit + 2
        T = bones[last]
        along = (middles - (T[:, 3] - wrist)) @ T[:, 2]
        main[(main == last) & (along > hand.lengths[digit, 2] - TIP_PATCH_M)] = FIRST_TIP + digit
    return main


@cache
def _kernels() -> Any:
    """Import the kernels, and numba, on first use."""
    from mocapella.sources.simulate import arm_mesh_kernels

    return arm_mesh_kernels
