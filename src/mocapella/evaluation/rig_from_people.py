"""Score cameras that people calibrated against the true ones, in simulated scenes and in recordings with a calibration.

The rigs are compared after the rigid motion that aligns them best. Their scale is that of the true distance of two
cameras, as if it had been measured with a tape.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.keypoint_bundle import JOINTS
from mocapella.calibration.keypoint_gauge import aligned_sds
from mocapella.calibration.keypoint_start import triangulate_rays
from mocapella.calibration.keypoint_tracks import collect_tracks
from mocapella.calibration.people_rig import RigFromPeople, RigScale, place_rig
from mocapella.calibration.rig_from_people import CENTRE_SD, PeopleSolution, RigFromPeopleSettings, solve_people
from mocapella.geometry.lens import project
from mocapella.geometry.plucker import camera_rays
from mocapella.geometry.rigid import apply, inverse
from mocapella.geometry.twists import log_motion
from mocapella.model.camera import CameraRig
from mocapella.model.keypoints import KeypointFrame
from mocapella.sources.simulate.crowd import build_crowd, crowd_settings

Float64 = NDArray[np.float64]


class RigErrorRow(msgspec.Struct, frozen=True):
    """Errors of one rig.

    Attributes:
        name: the scene, or the recording.
        seed: of the scene and of the samples.
        lenses: whether the lenses were given.
        same_lenses: whether it was stated that the cameras are of one model.
        position_mm, direction_deg: worst errors of a camera after the best rigid motion, scale by a camera distance.
        focal_percent: worst error of a focal length; 0 if the lenses were given.
        clock_ms: worst error of a clock relative to the first camera's.
        stature_scale: true scale by the scale of the true mean stature, if people are simulated; NaN otherwise.
        nees: mean normalised squared error of the poses relative to the first camera's; 1 if the stated covariance is
            right.
        stated_mm: worst stated standard deviation of a position.
        bound_mm: worst standard deviation of a position that independent errors of the keypoints would leave, see
            `AdjustedPeople.bound`.
        shift_px: largest shift of a person as a whole against the true rig, see `shift_of_people`.
        good: whether the calibration says that it is good.
    """

    name: str
    seed: int
    lenses: bool
    same_lenses: bool
    position_mm: float
    direction_deg: float
    focal_percent: float
    clock_ms: float
    stature_scale: float
    nees: float
    stated_mm: float
    bound_mm: float
    shift_px: float
    good: bool


def run_scene(scene: str, seed: int, *, lenses: bool, same_lenses: bool = False, seconds: float = 30.0) -> RigErrorRow:
    """Calibrate the cameras of a simulated crowd, whose principal points are not in the middle.

    Args:
        scene: a name of `crowd_names`.
        seed: of the simulation.
        lenses: whether the lenses are given.
        same_lenses: whether the calibration is told that the cameras are of one model, which is true.
        seconds: duration of the scene; people of scenarios other than ``wander`` stand when theirs has ended [s].

    Raises:
        SettingsError: unknown scene.
        CalibrationError: the people do not determine the cameras.
    """
    own = crowd_settings(scene)
    ring = replace(own.ring, centre_sd=CENTRE_SD)
    made = build_crowd(replace(own, seed=seed, seconds=seconds, ring=ring))
    frames = [item.frame for item in made.frames()]
    stature = float(np.mean([person.stature for person in made.settings.people]))
    return run_frames(frames, made.rig, scene, seed=seed, lenses=lenses, same_lenses=same_lenses, stature_m=stature)


def run_frames(
    frames: Sequence[KeypointFrame], true: CameraRig, name: str, *, seed: int = 0, lenses: bool = True,
    same_lenses: bool = False, stature_m: float = float("nan"), every_s: float = 0.1,
) -> RigErrorRow:  # fmt: skip
    """Calibrate the cameras of keypoint frames, and compare with the true rig.

    Args:
        frames: the frames of all cameras of the rig.
        true: the true cameras.
        name: of the row.
        seed: of the random samples.
        lenses: whether the lenses are given.
        same_lenses: whether it is stated that the cameras are of one model.
        stature_m: true mean stature of the people [m]; NaN if unknown.
        every_s: shortest interval between instants [s].

    Raises:
        CalibrationError: the people do not determine the cameras.
    """
    known = {key: placed.camera for key, placed in true.cameras.items()} if lenses else {}
    settings = RigFromPeopleSettings(seed=seed, every_s=every_s, same_lenses=same_lenses)
    solved = solve_people(collect_tracks(frames), known, settings)
    far = _farthest(true)
    apart = float(np.linalg.norm(_centre(true, far[0]) - _centre(true, far[1])))
    found = place_rig(solved, RigScale(distance_m=apart, between=far))
    scale = float("nan")
    if np.isfinite(stature_m):
        own = place_rig(solved, RigScale(stature_m=stature_m)).rig
        scale = apart / float(np.linalg.norm(_centre(own, far[0]) - _centre(own, far[1])))
    position, direction = pose_errors(found.rig, true)
    names = list(found.rig.cameras)
    focal = [found.rig.cameras[n].camera.lens[0] / true.cameras[n].camera.lens[0] - 1 for n in names]
    clocks = np.array([found.rig.cameras[n].clock_s - true.cameras[n].clock_s for n in names])
    return RigErrorRow(
        name, seed, lenses, same_lenses, 1e3 * float(position.max()), math.degrees(float(direction.max())),
        100 * float(np.abs(focal).max()), 1e3 * float(np.abs(clocks - clocks[0]).max()), scale,
        float(np.mean(normalised_squares(found, true))),
        max(c.position_sd_mm for c in found.cameras.values()), 1e3 * _bound_m(solved, found),
        shift_of_people(solved, true), found.good,
    )  # fmt: skip


def _bound_m(solved: PeopleSolution, found: RigFromPeople) -> float:
    """Return the worst standard deviation of a position if the keypoints' errors were independent [m]."""
    own, adjusted = solved.adjusted.bundle.T_camera_world, solved.adjusted
    first, *_, last = (_centre(found.rig, name) for name in solved.names)
    apart = np.linalg.norm(inverse(own[0])[:3, 3] - inverse(own[-1])[:3, 3])
    sds = aligned_sds(own, adjusted.bound[:, :6, :, :6])[0]
    return float(np.linalg.norm(first - last) / apart * sds.max())


def shift_of_people(solved: PeopleSolution, true: CameraRig) -> float:
    """Return how far the keypoints of a person are from the joints that all cameras of a rig triangulate, in common.

    A detector's errors differ between joints, so a shift of several pixels that all joints of a person have in one
    camera is an error of the rig, such as of a principal point.

    Args:
        solved: the people, with their keypoints in all cameras.
        true: the rig to be tested; it has the cameras of ``solved``.

    Returns:
        The largest length of the median shift of a person in a camera [px].
    """
    views, placed = solved.views, [true.cameras[name] for name in solved.names]
    bodies = len(views.person)
    rays = np.full((bodies, JOINTS, len(placed), 3), np.nan)
    for c, one in enumerate(placed):
        mine = views.camera == c
        directions = camera_rays(views.pixel[mine], one.camera.lens, one.T_camera_world)[:, :3]
        rays[views.body[mine], views.joint[mine], c] = directions
    origins = np.stack([_centre(true, name) for name in solved.names])
    flat = rays.reshape(-1, len(placed), 3)
    joints = triangulate_rays(origins, flat, np.ones(flat.shape[:2])).reshape(bodies, JOINTS, 3)
    shifts = [0.0]
    for c, one in enumerate(placed):
        mine = views.camera == c
        seen = project(apply(one.T_camera_world, joints[views.body[mine], views.joint[mine]]), one.camera.lens)
        off, person = views.pixel[mine] - seen, views.person[views.body[mine]]
        usable = np.isfinite(off).all(axis=1)
        for number in np.unique(person[usable]):
            shifts.append(float(np.linalg.norm(np.median(off[usable & (person == number)], axis=0))))
    return max(shifts)


def _centre(rig: CameraRig, name: str) -> Float64:
    return inverse(rig.cameras[name].T_camera_world)[:3, 3]


def _farthest(rig: CameraRig) -> tuple[str, str]:
    names = list(rig.cameras)
    pairs = [(a, b) for k, a in enumerate(names) for b in names[k + 1 :]]
    return max(pairs, key=lambda pair: float(np.linalg.norm(_centre(rig, pair[0]) - _centre(rig, pair[1]))))


def pose_errors(found: CameraRig, true: CameraRig) -> tuple[Float64, Float64]:
    """Return the errors of positions (cameras,) [m] and orientations (cameras,) [rad] after the best rigid motion.

    The rotation is the mean of the cameras' own; the translation aligns the means of the positions.
    """
    names = list(found.cameras)
    R = [true.cameras[n].T_camera_world[:3, :3].T @ found.cameras[n].T_camera_world[:3, :3] for n in names]
    U, _, Vt = np.linalg.svd(np.sum(R, axis=0))
    mean = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    p, q = (np.stack([_centre(rig, n) for n in names]) for rig in (true, found))
    off = (q - q.mean(axis=0)) @ mean.T - (p - p.mean(axis=0))
    turns = [math.acos(float(np.clip((np.trace(mean.T @ one) - 1) / 2, -1.0, 1.0))) for one in R]
    return np.linalg.norm(off, axis=1), np.array(turns)


def normalised_squares(found: RigFromPeople, true: CameraRig) -> Float64:
    """Return eᵀ C⁻¹ e / 6 of the pose of each camera but the first, relative to the first."""
    first, *others = found.rig.cameras
    out = []
    for name in others:
        here, there = (
            rig.cameras[name].T_camera_world @ inverse(rig.cameras[first].T_camera_world) for rig in (found.rig, true)
        )
        error, covariance = log_motion(there @ inverse(here)), found.rig.cameras[name].covariance
        out.append(float(error @ np.linalg.pinv(covariance, rcond=1e-9, hermitian=True) @ error) / 6)
    return np.array(out)
