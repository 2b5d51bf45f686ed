"""Initialise a tracked body: model, size and pose from 3D joints at one time.

The joints come from a file, or are triangulated from 2D keypoints. Segment lengths give the model's proportions; the
pose is fitted to the joints (`mocapella.kinematics.landmark_pose`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mocapella.errors import CalibrationError, InputError, SettingsError, one_of
from mocapella.fusion.point_tracks import TracksSettings, triangulate_tracks
from mocapella.geometry import lens as lenses
from mocapella.geometry.rigid import apply
from mocapella.kinematics.landmark_pose import pose_of
from mocapella.model.body_builds import built_mesh
from mocapella.model.body_proportions import AVERAGE, BodyProportions, proportions_of
from mocapella.model.camera import CameraRig
from mocapella.model.observations import JointState
from mocapella.model.openpose_names import LANDMARKS, NO_LANDMARKS
from mocapella.model.point_tracks import ImageTracks, SpaceTracks
from mocapella.model.rigged_mesh import RiggedMesh, landmarks_at
from mocapella.model.trajectories import Trajectories
from mocapella.model.twist_tree import TreePose
from mocapella.settings import parse
from mocapella.tracker.initial_body import InitialBody, LaterJoints, build_of

Float64 = NDArray[np.float64]

MODELS: Final = ("male", "female", "legs")
_SIDES: Final = ("left", "right")
NEEDED: Final = {
    "legs": tuple(f"{side} {joint}" for joint in ("hip", "knee", "ankle") for side in _SIDES),
    **dict.fromkeys(("male", "female"), tuple(f"{side} {joint}" for joint in ("hip", "shoulder") for side in _SIDES)),
}
"""Joints required to place a body, by model."""
ENOUGH: Final = {"legs": ("shank", "thigh"), **dict.fromkeys(("male", "female"), ("shank", "thigh", "trunk"))}
"""Segments that must be known to determine a person's size without a height, by model."""
FAR_M: Final = 0.15
"""Largest median distance of the joints from the model; joints farther off do not fit a body of its size [m]."""
APART_M: Final = 0.15
"""Least distance between the roots of two bodies at the start [m]."""
SOON_S: Final = 0.5
"""Time after the first frame; people who appear within it are there from the start [s]."""
RIG_FROM_Y_UP: Final = {
    "y": np.eye(3),
    "z": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "-y": np.diag([1.0, -1.0, -1.0]),
}
"""Rotation to a rig's world from one with y up, by the upward axis of the rig's world."""
LATER_EVERY_S: Final = 0.1
"""Least time between two later frames whose joints are kept: a lost body is searched until it is found [s]."""
_ERROR, _LEAST_ERROR_PX = 0.008, 4.0
"""Largest reprojection error of points, as a fraction of the image's longer side, and its lower bound [px]."""
_REJECTED, _FEWEST_POINTS = 0.6, 6
"""A camera disagrees with the others if more than this fraction of its points, of at least so many, is rejected."""


@dataclass(frozen=True)
class Body:
    """A body to be tracked.

    Attributes:
        model: name of one of `MODELS`, or of another mesh.
        height_m: subject height; None if not given [m].
        proportions: measured segment lengths; average ones if not measured.
        mesh: the rigged mesh.
        sha256: hash of the mesh file, in hexadecimal digits; empty without one.
    """

    model: str
    height_m: float | None
    proportions: BodyProportions
    mesh: RiggedMesh
    sha256: str = ""

    def starting(self, pose: TreePose, later: Sequence[LaterJoints] = ()) -> InitialBody:
        """Return the body with an initial pose and joints at later instants, for a tracker; the mesh is shared."""
        build = build_of(self.model, self.height_m, self.proportions.known, sha256=self.sha256)
        return InitialBody(self.mesh, pose, build, later)


@dataclass(frozen=True, eq=False)
class PersonJoints:
    """A person's joints, by the names of a body's landmarks, in the rig's world [m].

    Attributes:
        start: joints (3,) at the first frame; empty if the person comes later.
        later: joints at later instants, one each `LATER_EVERY_S`.
    """

    start: dict[str, Float64]
    later: list[LaterJoints]


def people_joints(people: Trajectories, first_s: float, up: str = "y") -> dict[str, PersonJoints]:
    """Return the joints of tracked people, to start their bodies, by name.

    At the start, also joints that are only inferred count; later, measured ones alone.

    Args:
        people: people with the keypoints of `halpe_26`, in a world with y up.
        first_s: time of the first frame that is tracked, on the keypoints' clock [s].
        up: upward axis of the rig's world, the frame of the joints: y, z or -y.
    """
    names = [_landmark(name) for name in people.keypoints]
    turn = RIG_FROM_Y_UP[up]
    found = {}
    times = people.times_s - people.times_s[0]
    for index, person in enumerate(people.individuals):
        start: dict[str, Float64] = {}
        later: list[LaterJoints] = []
        for k in np.flatnonzero(people.present[:, index] & (times >= first_s - SOON_S)):
            at_s = float(times[k]) - first_s
            measured = people.states[k, index] == JointState.TRACKED
            places = people.positions[k, index].astype(np.float64) @ turn.T
            known = {n: places[j] for j, n in enumerate(names) if n and np.isfinite(places[j]).all()}
            if at_s <= SOON_S and (not start or at_s <= 0):
                start = known
            if at_s > 0 and at_s >= (later[-1].at_s if later else 0.0) + LATER_EVERY_S - 1e-9:
                sure = {n: known[n] for j, n in enumerate(names) if n in known and measured[j]}
                later += [LaterJoints(at_s, sure)] if sure else []
        found[person] = PersonJoints(start, later)
    return found


def joints_of_points(tracks: ImageTracks, rig: CameraRig, frame: int = 0) -> dict[str, Float64]:
    """Triangulate joints (3,) [m] from 2D points, by the names of a body's landmarks; without those not found.

    Args:
        tracks: 2D points x, y [px] in two cameras or more, named as in OpenPose, or as a body's landmarks; other
            names are ignored.
        rig: the cameras' intrinsics and poses.
        frame: index of the frame to use, from 0.

    Raises:
        InputError: a camera that the rig does not have, no such frame, or no point named like a joint.
        CalibrationError: the cameras' points do not meet in space.
    """
    if not 0 <= frame < len(tracks.frames):
        raise InputError(
            "the points have no such frame", field="frame", value=frame, fix=f"there are {len(tracks.frames)}"
        )
    columns = {name: _landmark(name) for name in tracks.points if _landmark(name)}
    if not columns:
        raise InputError(
            "no point is called like a joint", field="point", value=", ".join(tracks.points[:5]),
            fix="name points as OpenPose does (LHip …), or left hip, left knee …",
        )  # fmt: skip
    first, largest = _of_frames(tracks, np.array([frame])), _largest_error_px(rig)
    space, report = triangulate_tracks(first, rig, TracksSettings("weighted-linear", largest_error_px=largest))
    found = _joints(space, 0)
    confident = (first.confidences[0] > TracksSettings().least_confidence).sum(axis=0) >= 2
    seen = sum(bool(confident[k]) for k, name in enumerate(tracks.points) if name in columns)
    if seen >= 4 and 2 * len(found) < seen:
        raise CalibrationError(
            f"the points of frame {frame} do not meet in space: of {seen} that two cameras or more see, {len(found)} "
            f"do within {largest:.0f} px; are cameras and rig of one recording?"
        )
    for name, camera in report.cameras.items():
        if camera.seen >= _FEWEST_POINTS and camera.rejected_share > _REJECTED:
            share = f"{camera.rejected_share:.0%} of {camera.seen}"
            raise CalibrationError(
                f"the points of {name} do not agree with the other cameras' in frame {frame}: {share} are elsewhere; "
                "is it the rig's camera of that name, and of this instant?"
            )
    return found


def later_joints(tracks: ImageTracks, rig: CameraRig, first: int, rate_hz: float) -> list[LaterJoints]:
    """Triangulate joints from 2D points of later frames, one each `LATER_EVERY_S`; frames without any are left out.

    Args:
        tracks: 2D points, as in `joints_of_points`.
        rig: the cameras' intrinsics and poses.
        first: index of the first frame that is tracked, from 0; the later ones are used.
        rate_hz: rate of the points' numbered frames [Hz].

    Raises:
        InputError: a camera that the rig does not have.
    """
    since_s = (tracks.frames - tracks.frames[first]) / rate_hz
    these: list[int] = []
    for k in range(first + 1, len(since_s)):
        if since_s[k] >= (since_s[these[-1]] if these else 0.0) + LATER_EVERY_S - 1e-9:
            these.append(k)
    if not these:
        return []
    settings = TracksSettings("weighted-linear", largest_error_px=_largest_error_px(rig))
    space, _ = triangulate_tracks(_of_frames(tracks, np.array(these)), rig, settings)
    found = [LaterJoints(float(since_s[frame]), _joints(space, k)) for k, frame in enumerate(these)]
    return [one for one in found if one.joints]


def _of_frames(tracks: ImageTracks, these: NDArray[np.int64]) -> ImageTracks:
    return ImageTracks(
        tracks.cameras, tracks.points, tracks.frames[these], tracks.at_s[these], tracks.pixels[these],
        tracks.confidences[these],
    )  # fmt: skip


def _largest_error_px(rig: CameraRig) -> float:
    # A detector's errors grow with the image.
    return max(_LEAST_ERROR_PX, _ERROR * float(np.median([max(c.camera.size_px) for c in rig.cameras.values()])))


def _joints(space: SpaceTracks, k: int) -> dict[str, Float64]:
    """Return the joints of the frame of index k, by landmark name."""
    return {
        _landmark(name): space.positions[k, column]
        for column, name in enumerate(space.points)
        if _landmark(name) and np.isfinite(space.positions[k, column]).all()
    }


def check_joints(model: str, joints: Mapping[str, Float64], file: object = None) -> None:
    """Check that the joints suffice to initialise a body model.

    Args:
        model: name of the body model; any other than `MODELS` needs no joint.
        joints: position of each joint, by its name; only the names are checked.
        file: named in errors; None leaves it out.

    Raises:
        InputError: one is missing; lists those needed.
    """
    needed = NEEDED.get(model, ())
    missing = [name for name in needed if name not in joints]
    if missing:
        raise InputError(
            "is missing",
            file=file,
            field=missing[0],
            fix=f"a start needs {', '.join(needed)}; there are {', '.join(joints)}",
        )


def body_of(model: str, height_m: float | None, joints: Mapping[str, Float64]) -> Body:
    """Return the body model of a person of a known height, or of the size that the joints give.

    Args:
        model: one of `MODELS`.
        height_m: subject height, with average proportions; None to use the lengths between the joints [m].
        joints: positions (3,) in the world [m], by the names of a body's landmarks.

    Raises:
        SettingsError: no such model, or an implausible height.
        InputError: no height, and the joints lack the segments of `ENOUGH`.
        CalibrationError: the joints do not fit a person.
    """
    if model not in MODELS:
        raise SettingsError(f"model is {model!r}; it must be one of {one_of(model, MODELS)}, or a .glb or .gltf file")
    if height_m is not None:
        return _made(model, height_m, AVERAGE)
    try:
        measured = proportions_of(joints)
        missing = [name for name in ENOUGH[model] if name not in measured.known]
        if missing:
            raise InputError(
                f"the joints do not say how long {' and '.join(missing)} are", field="--start",
                fix="say how tall the person is with --set height=METRES, or give hips, knees, ankles and shoulders",
            )  # fmt: skip
        return _made(model, None, measured)
    except SettingsError as error:
        raise CalibrationError(
            f"the joints of the start are no person's: {error}; are they in metres, and is the rig?"
        ) from None


def body_again(model: str, height_m: float | None, proportions: Mapping[str, float]) -> Body:
    """Rebuild the body model of an earlier run.

    Args:
        model: one of `MODELS`.
        height_m: subject height; None if not given [m].
        proportions: lengths of segments [m], by name.

    Raises:
        SettingsError: no such model, or an implausible height or length.
    """
    if model not in MODELS:
        raise SettingsError(f"model is {model!r}; it must be one of {one_of(model, MODELS)}, or a mesh's file")
    return _made(model, height_m, parse(BodyProportions, dict(proportions), where="proportions"))


def _made(model: str, height_m: float | None, proportions: BodyProportions) -> Body:
    return Body(model, height_m, proportions, built_mesh(model, height_m, proportions))


def start_pose(mesh: RiggedMesh, joints: Mapping[str, Float64]) -> TreePose:
    """Fit a body's pose to joints, as the start of its tracking.

    Args:
        mesh: the body's mesh.
        joints: positions (3,) in the world [m], by landmark name; joints that the body lacks are ignored.

    Raises:
        SettingsError: fewer than three joints that the body has, or all on a line.
        CalibrationError: no pose is near the joints: their median distance is above `FAR_M`.
    """
    known = {name: at for name, at in joints.items() if name in mesh.landmarks}
    if len(known) < 3:
        raise SettingsError(
            f"--start has {len(known)} joints that {mesh.name} has; three at least, of {', '.join(mesh.landmarks)}"
        )
    pose = pose_of(mesh, known)
    at = dict(zip(mesh.landmarks, landmarks_at(mesh, pose), strict=True))
    away = {name: float(np.linalg.norm(at[name] - place)) for name, place in known.items()}
    median = float(np.median(list(away.values())))
    if median > FAR_M:
        worst = max(away, key=lambda name: away[name])
        raise CalibrationError(
            f"no pose of the model is near the start's joints: {100 * median:.0f} cm off in the median, {worst} "
            f"{100 * away[worst]:.0f} cm; are they in metres, left and right the person's own, the height right?"
        )
    return pose


def root_of(mesh: RiggedMesh, pose: TreePose) -> Float64:
    """Return the position (3,) of the body's root in the world [m], for a pose."""
    return np.asarray(pose.T_world_model[:3, :3] @ mesh.tree.root + pose.T_world_model[:3, 3])


def check_apart(poses: Mapping[str, tuple[RiggedMesh, TreePose]]) -> None:
    """Check that no two bodies start at the same position, because their outlines could not be distinguished.

    ``poses`` has the mesh and the initial pose of each body, by name.

    Raises:
        InputError: two do; names them and their distance.
    """
    roots = {name: root_of(mesh, pose) for name, (mesh, pose) in poses.items()}
    for one, other in combinations(roots, 2):
        away = float(np.linalg.norm(roots[one] - roots[other]))
        if away < APART_M:
            raise InputError(
                f"{one} and {other} start in the same place, {100 * away:.0f} cm apart", field="start",
                fix="give each the joints of another person",
            )  # fmt: skip


def cameras_that_see(mesh: RiggedMesh, pose: TreePose, rig: CameraRig) -> list[str]:
    """Return the names of the cameras whose images contain at least one of a body's landmarks, in the rig's order.

    Of a mesh without landmarks, the origin counts.
    """
    points = landmarks_at(mesh, pose) if mesh.landmarks else pose.T_world_model[None, :3, 3]
    found = []
    for name, placed in rig.cameras.items():
        at, (width, height) = (
            lenses.project(apply(placed.T_camera_world, points), placed.camera.lens),
            placed.camera.size_px,
        )
        inside = (at >= -0.5).all(axis=-1) & (at[..., 0] < width - 0.5) & (at[..., 1] < height - 0.5)
        found += [name] if inside.any() else []
    return found


def _landmark(name: str) -> str:
    """Return the landmark that a point's name denotes; empty for none."""
    if name in NO_LANDMARKS:
        return ""
    plain = name.replace("_", " ").strip().lower()
    return LANDMARKS.get(name, plain if plain in LANDMARKS.values() or plain in _OTHERS else "")


_OTHERS: Final = ("left fingertip", "right fingertip", "left hand", "right hand", "neck", "pelvis", "waist")
