"""Calibrate cameras from the people they see, without a board: poses, focal lengths and clocks.

The steps: tracks of each camera (`keypoint_tracks`), relative poses of all pairs of cameras and identities
(`keypoint_pairs`, `keypoint_people`), poses along a tree (`keypoint_start`), adjustment of everything together
(`keypoint_bundle`), floor and stature (`people_floor`), and a scale from stated lengths. docs/cameras-people.md
describes its limits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from mocapella.calibration.keypoint_bundle import (
    BEND,
    CAMERA,
    CENTRE,
    CLOCK,
    FOCAL,
    JOINTS,
    LENS,
    POSE,
    STATURES,
    AdjustedPeople,
    BundlePrior,
    KeypointViews,
    PeopleBundle,
    adjusting_people,
    stating_covariance,
)
from mocapella.calibration.keypoint_gauge import aligned_sds
from mocapella.calibration.keypoint_lenses import WrongLens, questioning_lenses
from mocapella.calibration.keypoint_pairs import CameraPair, SampledTracks, finding_pair, rescored
from mocapella.calibration.keypoint_people import PersonPassage, join_people
from mocapella.calibration.keypoint_start import LEAST_ANGLE_RAD, spanning_tree, tree_poses, triangulate_rays
from mocapella.calibration.keypoint_tracks import HALPE, CameraTracks, PersonTrack, at_instants, velocities_at
from mocapella.calibration.people_floor import find_contacts
from mocapella.calibration.stepwise import Steps, result_of
from mocapella.errors import CalibrationError
from mocapella.geometry.lens import undistort
from mocapella.geometry.plucker import camera_rays
from mocapella.geometry.rigid import inverse
from mocapella.model.camera import Camera
from mocapella.settings import check

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Progress = Callable[[str], None]

STATURE_M: Final = 1.70
"""Stature of people without a stated one: about the mean of adults worldwide [m]."""
FIELD_OF_VIEW_RAD: Final = math.radians(66.0)
"""Typical field of view of a webcam along the longer side of the image [rad]."""
FOCAL_SD: Final = 0.25
"""Standard deviation of the logarithm of an unknown focal length: fields of view of 50° to 90°."""
CENTRE_SD: Final = 0.01
"""Standard deviation of an unknown principal point from the middle of the image, along each axis, as a fraction of the
longer side: boards find about 0.5 to 1.5 % in inexpensive cameras."""
BEND_SD: Final = 0.15
"""Standard deviation of an unknown k1: lenses with a field of view of 90° or less have −0.3 to 0.1."""
_JOINT_SD: Final = {  # error of keypoints relative to a wrist's, after COCO's object keypoint similarity
    "Nose": 0.7, "LEye": 0.7, "REye": 0.7, "LEar": 0.8, "REar": 0.8, "LHip": 1.5, "RHip": 1.5, "Hip": 1.5, "Neck": 1.2,
    "Head": 1.2, "LShoulder": 1.2, "RShoulder": 1.2, "LKnee": 1.2, "RKnee": 1.2,
}  # fmt: skip
_SIZE_PX: Final = 400.0
"""Size of a person whose keypoints have the standard deviation of the adjustment [px]."""


@dataclass(frozen=True)
class RigFromPeopleSettings:
    """How cameras are calibrated from people.

    Attributes:
        instants: most instants that are used; larger: a little more accurate, and slower [instants].
        every_s: shortest interval between instants; larger: more independent errors, fewer instants [s].
        passage_instants: number of instants within which two cameras' tracks are matched; larger: fewer wrong matches,
            more harm by an exchange of people [instants].
        clock_search_s: largest difference of two cameras' clocks that is searched for; larger: takes longer [s].
        same_lenses: whether all cameras of one image size are of one model, with equal focal lengths and k1.
        least_share: least share of keypoints that must agree between two cameras; larger: fewer wrong calibrations,
            more refusals [0 to 1].
        least_score: least number of agreeing keypoints of two cameras [keypoints].
        seed: of the random samples; the same keypoints and seed give the same rig [number].

    Raises:
        SettingsError: a value is invalid; names it and the valid values.
    """

    instants: int = 600
    every_s: float = 0.1
    passage_instants: int = 10
    clock_search_s: float = 0.0
    same_lenses: bool = False
    least_share: float = 0.7
    least_score: float = 100.0
    seed: int = 0

    def __post_init__(self) -> None:
        check(10 <= self.instants <= 5000, "instants", self.instants, "from 10 to 5000")
        check(0.01 <= self.every_s <= 10, "every_s", self.every_s, "from 0.01 to 10 s")
        check(2 <= self.passage_instants <= 100, "passage_instants", self.passage_instants, "from 2 to 100")
        check(0 <= self.clock_search_s <= 10, "clock_search_s", self.clock_search_s, "from 0 to 10 s")
        check(0 < self.least_share < 1, "least_share", self.least_share, "above 0 and below 1")
        check(1 <= self.least_score <= 1e6, "least_score", self.least_score, "from 1 to 1e6")
        check(0 <= self.seed < 2**32, "seed", self.seed, "0 or more")


class PeopleSolution(msgspec.Struct, frozen=True, eq=False):
    """Cameras as far as people alone determine them: the first is the origin, and people have a stature of 1.7 m.

    Attributes:
        names: the cameras.
        sizes_px: (width, height) of each camera's images.
        adjusted: poses, lenses, joints and covariance; the clocks are relative to ``clocks_s``.
        clocks_s: (cameras,) each camera's time minus the first's [s].
        views: the keypoints that were used.
        at_s: (bodies,) time of each body, on the first camera's clock [s].
        lens_known: (cameras,) whether the focal length was given.
        people: (bodies, 26, 3) all joints in the first camera's frame [m]; NaN where fewer than two cameras agree.
        wrong_lenses: given lenses that the people contradict.
    """

    names: tuple[str, ...]
    sizes_px: tuple[tuple[int, int], ...]
    adjusted: AdjustedPeople
    clocks_s: Float64
    views: KeypointViews
    at_s: Float64
    lens_known: NDArray[np.bool_]
    people: Float64
    wrong_lenses: tuple[WrongLens, ...] = ()


class _Data(msgspec.Struct, frozen=True, eq=False):
    """The tracks of all cameras, and the instants at which they are compared."""

    names: tuple[str, ...]
    sizes_px: tuple[tuple[int, int], ...]
    tracks: list[list[PersonTrack]]
    at_s: Float64
    passages: Int64

    def sampled(self, camera: int, clock_s: float) -> SampledTracks:
        """Return a camera's tracks at the instants, by its clock [s]."""
        tracks, at_s = self.tracks[camera], self.at_s + clock_s
        pixels, sizes = (np.stack(of) for of in zip(*(at_instants(track, at_s) for track in tracks), strict=True))
        return SampledTracks(pixels, np.stack([velocities_at(track, at_s) for track in tracks]), sizes)

    def pixels(self, camera: int, clock_s: float) -> Float64:
        """Return the pixels of `sampled` alone."""
        return np.stack([at_instants(track, self.at_s + clock_s)[0] for track in self.tracks[camera]])

    def thinned(self, every: int) -> _Data:
        """Return the same tracks at every so many instants."""
        return _Data(self.names, self.sizes_px, self.tracks, self.at_s[::every], self.passages[::every])


def solve_people(
    tracks: Mapping[str, CameraTracks],
    known: Mapping[str, Camera] | None = None,
    settings: RigFromPeopleSettings | None = None,
    progress: Progress = lambda _text: None,
) -> PeopleSolution:
    """Estimate poses, unknown focal lengths and clocks of cameras.

    Args:
        tracks: the tracks of each camera, by name.
        known: cameras with a given lens, which stays fixed, by name; None for none.
        settings: how; the defaults if None.
        progress: receives the name of the next step.

    Raises:
        CalibrationError: the people do not determine the cameras; says which, why, and what to do.
    """
    return result_of(solving_people(tracks, known, settings, progress))


def solving_people(
    tracks: Mapping[str, CameraTracks],
    known: Mapping[str, Camera] | None = None,
    settings: RigFromPeopleSettings | None = None,
    progress: Progress = lambda _text: None,
) -> Steps[PeopleSolution]:
    """Return the steps of `solve_people`; it reads the tracks in the first."""
    s, known = settings or RigFromPeopleSettings(), known or {}
    data = _data(tracks, s)
    _check_sizes(data, known)
    lenses = np.array([_lens(name, size, known) for name, size in zip(data.names, data.sizes_px, strict=True)])
    lens_known = np.array([name in known for name in data.names])
    clocks = np.zeros(len(data.names))
    if s.clock_search_s > 0:
        progress("searching the clocks …")
        clocks = yield from _searched_clocks(data, lenses, s)
    progress("comparing pairs of cameras …")
    directions = _directions(data, lenses, clocks)
    pairs = yield from _pairs(data, directions, s)
    tree = spanning_tree(pairs, len(data.names))
    _check_pairs(data, pairs, tree)
    progress("adjusting the cameras …")
    placed = tree_poses(pairs, directions, data.passages, tree, STATURE_M)
    poses = np.stack([placed[k] for k in range(len(data.names))])
    rough = data.thinned(max(1, len(data.at_s) // _ROUGH_INSTANTS))
    solution = yield from _solution(rough, _Start(poses, lenses, clocks, lens_known, s.same_lenses), pairs)
    solution = yield from _again(data, solution, same_lenses=s.same_lenses)
    _check_solution(solution)
    return solution


LARGEST_SIGMA_PX: Final = 12.0
"""Error of keypoints of a person of `_SIZE_PX` above which cameras contradict each other [px]."""
LARGEST_SD_M: Final = 1.0
"""Standard deviation of a position, of people of typical stature, above which nothing is known of it [m]."""


def _check_solution(found: PeopleSolution) -> None:
    """Raise a `CalibrationError` if the cameras contradict each other, or one is not determined at all."""
    sigma = found.adjusted.sigma
    sds = aligned_sds(found.adjusted.bundle.T_camera_world, found.adjusted.covariance[:, :6, :, :6])[0]
    worst = int(np.argmax(sds))
    if sigma > LARGEST_SIGMA_PX:
        raise CalibrationError(
            f"the cameras contradict each other by {sigma:.0f} px: they may see different rooms or people, or their "
            "clocks may differ by more than was searched; film one room with all, and walk about"
        )
    if not sds[worst] <= LARGEST_SD_M:
        raise CalibrationError(
            f"camera {found.names[worst]} is not determined (± {sds[worst]:.1f} m): it may see another room; otherwise "
            "walk about where it and others see you"
        )


def _data(tracks: Mapping[str, CameraTracks], s: RigFromPeopleSettings) -> _Data:
    if len(tracks) < 2:
        there = f"only {next(iter(tracks))} is" if tracks else "none is"
        raise CalibrationError(f"two cameras or more are needed, and {there} there: start another camera")
    lists = {name: camera.tracks() for name, camera in tracks.items()}
    for name, of in lists.items():
        if not of:
            raise CalibrationError(
                f"camera {name} sees nobody for half a second or longer: walk about where it sees your whole body"
            )
    first = max(camera.first_s for camera in tracks.values())
    last = min(camera.last_s for camera in tracks.values())
    count = min(s.instants, int((last - first) / s.every_s))
    if count < s.passage_instants:
        raise CalibrationError(
            f"the cameras have {max(0.0, last - first):.1f} s in common: film all at the same time, for half a minute"
        )
    at_s = np.linspace(first, last, count + 2)[1:-1]
    sizes = tuple(camera.size_px for camera in tracks.values())
    return _Data(tuple(tracks), sizes, list(lists.values()), at_s, np.arange(count) // s.passage_instants)


def _check_sizes(data: _Data, known: Mapping[str, Camera]) -> None:
    for name, size in zip(data.names, data.sizes_px, strict=True):
        if name in known and known[name].size_px != size:
            given = known[name].size_px
            raise CalibrationError(
                f"camera {name} has pictures of {size[0]}×{size[1]} px, and its lens is for {given[0]}×{given[1]}: "
                "film with that size, or leave the lens out"
            )


def _lens(name: str, size_px: tuple[int, int], known: Mapping[str, Camera]) -> Float64:
    if name in known:
        return known[name].lens.astype(np.float64)
    focal = max(size_px) / 2 / math.tan(FIELD_OF_VIEW_RAD / 2)
    return np.array([focal, focal, (size_px[0] - 1) / 2, (size_px[1] - 1) / 2, 0.0, 0.0, 0.0, 0.0, 0.0])


def _pairs(
    data: _Data, directions: Sequence[Float64], s: RigFromPeopleSettings
) -> Steps[dict[tuple[int, int], CameraPair]]:
    found = {}
    for a, b in combinations(range(len(data.names)), 2):
        rng = np.random.default_rng([s.seed, a, b])
        pair = yield from finding_pair(directions[a], directions[b], data.passages, rng)
        if pair is not None and pair.score >= s.least_score and pair.share >= s.least_share:
            found[a, b] = pair
    return found


def _directions(data: _Data, lenses: Float64, clocks: Float64) -> list[Float64]:
    return [undistort(data.pixels(c, clocks[c]), lenses[c]) for c in range(len(data.names))]


def _searched_clocks(data: _Data, lenses: Float64, s: RigFromPeopleSettings) -> Steps[Float64]:
    """Return the clocks at which pairs of cameras agree best, from a coarse grid, along a tree from the first."""
    steps = max(1, round(s.clock_search_s / _CLOCK_STEP_S))
    offsets = np.arange(-steps, steps + 1) * _CLOCK_STEP_S
    cameras = len(data.names)
    found: dict[tuple[int, int], tuple[CameraPair, float]] = {}
    directions = _directions(data, lenses, np.zeros(cameras))
    for a, b in combinations(range(cameras), 2):
        best: tuple[CameraPair, float] | None = None
        for offset in offsets:
            second = undistort(data.pixels(b, float(offset)), lenses[b])
            pair = yield from finding_pair(directions[a], second, data.passages, np.random.default_rng([s.seed, a, b]))
            if pair is not None and (best is None or pair.score > best[0].score):
                best = pair, float(offset)
        if best is not None:
            found[a, b] = best
    clocks = np.zeros(cameras)
    for one, new in spanning_tree({key: pair for key, (pair, _) in found.items()}, cameras):
        offset = found[min(one, new), max(one, new)][1]
        clocks[new] = clocks[one] + (offset if one < new else -offset)
    return clocks


_CLOCK_STEP_S: Final = 0.1
"""Step of the search for the offset of two cameras' clocks [s]."""


def _check_pairs(data: _Data, pairs: Mapping[tuple[int, int], CameraPair], tree: Sequence[tuple[int, int]]) -> None:
    cameras = len(data.names)
    reached = {0} | {new for _, new in tree}
    if len(reached) < cameras:
        others = ", ".join(data.names[k] for k in range(cameras) if k not in reached)
        own = ", ".join(data.names[k] for k in sorted(reached))
        raise CalibrationError(
            f"{others} and {own} see nobody in common: walk about where cameras of both see you at the same time; "
            "or they see different rooms, or their clocks differ by more than was searched"
        )
    for one, new in tree:
        pair = pairs[min(one, new), max(one, new)]
        if pair.angle_rad < LEAST_ANGLE_RAD:
            raise CalibrationError(
                f"{data.names[one]} and {data.names[new]} see people from the same side, {_degrees(pair.angle_rad)} "
                "apart, so distances are not determined: move one of them, so that they look from different sides"
            )


def _degrees(angle_rad: float) -> str:
    return f"{math.degrees(angle_rad):.1f}°"


class _Start(msgspec.Struct, frozen=True, eq=False):
    """Values to begin an adjustment with."""

    T_camera_world: Float64
    lenses: Float64
    clocks_s: Float64
    lens_known: NDArray[np.bool_]
    same_lenses: bool


def _solution(
    data: _Data, start: _Start, pairs: Mapping[tuple[int, int], CameraPair], *, complete: bool = False
) -> Steps[PeopleSolution]:
    """Adjust everything; the tracks are interpolated again by the clocks until these settle.

    Args:
        data: the tracks.
        start: values to begin with.
        pairs: matches of the tracks of pairs of cameras.
        complete: whether the covariance and all joints are wanted.
    """
    sightings = join_people(pairs)
    clocks, T, lenses = start.clocks_s.copy(), start.T_camera_world, start.lenses
    before: PeopleBundle | None = None
    for turn in range(_TURNS):
        yield
        views, at_s = _views(data, sightings, clocks)
        yield
        views, bundle = _bundle(views, at_s, (T, lenses), before)
        settling, prior = turn + 1 < _TURNS, _prior(data, start, clocks, lenses)
        adjusted = yield from adjusting_people(views, bundle, prior, rounds=1 if settling else 2)
        before = adjusted.bundle
        T, lenses, moved = before.T_camera_world, before.lenses, before.clocks_s
        if np.abs(moved).max() < _SETTLED_S and turn:
            break
        clocks = clocks + moved
    people, wrong = np.zeros((0, len(HALPE), 3)), tuple[WrongLens, ...]()
    if complete:
        adjusted = yield from stating_covariance(views, adjusted, prior)
        adjusted, wrong = yield from questioning_lenses(views, adjusted, prior)
        yield
        people = _all_joints(data, sightings, clocks, adjusted.bundle)
    return PeopleSolution(data.names, data.sizes_px, adjusted, clocks, views, at_s, start.lens_known, people, wrong)


def _all_joints(data: _Data, sightings: Sequence[PersonPassage], clocks: Float64, bundle: PeopleBundle) -> Float64:
    """Triangulate all joints (bodies, 26, 3) of all people; NaN where no two cameras agree."""
    T = bundle.T_camera_world
    rays = [
        camera_rays(data.pixels(c, float(clocks[c])), bundle.lenses[c], T[c])[..., :3] for c in range(len(data.names))
    ]
    origins = np.stack([inverse(one)[:3, 3] for one in T])
    bodies = []
    for sighting in sightings:
        here = np.flatnonzero(data.passages == sighting.passage)
        of = np.full((len(here), len(HALPE), len(T), 3), np.nan)
        for c, t in sighting.tracks.items():
            of[:, :, c] = rays[c][t, here]
        flat = of.reshape(-1, len(T), 3)
        bodies.append(triangulate_rays(origins, flat, np.ones(flat.shape[:2])).reshape(len(here), -1, 3))
    return np.concatenate(bodies)


_ROUGH_INSTANTS: Final = 40
"""Number of instants of the first adjustment."""
_TURNS: Final = 4
_SETTLED_S: Final = 0.001
"""Change of the clocks below which the tracks are not interpolated again [s]."""


def _again(data: _Data, found: PeopleSolution, *, same_lenses: bool) -> Steps[PeopleSolution]:
    """Match the people of all pairs of cameras by the adjusted cameras, and adjust again."""
    bundle, clocks = found.adjusted.bundle, found.clocks_s
    directions = _directions(data, bundle.lenses, clocks)
    pairs = {}
    for a, b in combinations(range(len(data.names)), 2):
        yield
        T_b_a = bundle.T_camera_world[b] @ inverse(bundle.T_camera_world[a])
        pair = rescored(T_b_a, directions[a], directions[b], data.passages)
        if pair is not None and pair.score > 0:
            pairs[a, b] = pair
    start = _Start(bundle.T_camera_world, bundle.lenses, clocks, found.lens_known, same_lenses)
    return (yield from _solution(data, start, pairs, complete=True))


def _views(data: _Data, sightings: Sequence[PersonPassage], clocks: Float64) -> tuple[KeypointViews, Float64]:
    """Return the keypoints of all people at all instants, each joint seen by two cameras or more; and bodies' times."""
    sampled = [data.sampled(c, float(clocks[c])) for c in range(len(data.names))]
    relative = np.array([_JOINT_SD.get(name, 1.0) for name in HALPE.joints])
    rows: list[tuple[Int64, Int64, Int64, Float64, Float64, Float64]] = []
    persons, clusters, times = list[int](), list[int](), list[float]()
    for number, sighting in enumerate(sightings):
        for k in np.flatnonzero(data.passages == sighting.passage):
            body = len(persons)
            pixels = np.stack([sampled[c].pixels[t, k] for c, t in sighting.tracks.items()])
            seen = np.isfinite(pixels).all(axis=-1)
            seen &= seen.sum(axis=0) >= 2
            for n, (c, t) in enumerate(sighting.tracks.items()):
                joints = np.flatnonzero(seen[n])
                if not len(joints):
                    continue
                count = len(joints)
                sd = relative[joints] * sampled[c].sizes_px[t, k] / _SIZE_PX
                velocities = sampled[c].velocities[t, k, joints]
                rows.append((np.full(count, c), np.full(count, body), joints, pixels[n, joints], velocities, sd))
            persons.append(sighting.person)
            clusters.append(number)
            times.append(float(data.at_s[k]))
    if not rows:
        raise CalibrationError("no person is seen by two cameras at once: walk about where several cameras see you")
    people = {person: k for k, person in enumerate(sorted(set(persons)))}
    camera, of_body, joint, pixel, velocity, sd = (np.concatenate([row[k] for row in rows]) for k in range(6))
    person = np.array([people[p] for p in persons])
    return KeypointViews(
        camera.astype(np.int64), of_body.astype(np.int64), joint.astype(np.int64), pixel, velocity, sd, person,
        np.array(clusters),
    ), np.array(times)  # fmt: skip


def _bundle(
    views: KeypointViews, at_s: Float64, placed: tuple[Float64, Float64], before: PeopleBundle | None
) -> tuple[KeypointViews, PeopleBundle]:
    """Triangulate all joints, leave out keypoints that lie behind a camera or far off, and find feet that rest."""
    T, lenses = placed
    cameras, bodies = len(lenses), len(views.person)
    rays = np.full((bodies, JOINTS, cameras, 3), np.nan)
    for c in range(cameras):
        mine = views.camera == c
        rays[views.body[mine], views.joint[mine], c] = camera_rays(views.pixel[mine], lenses[c], T[c])[:, :3]
    origins = np.stack([inverse(one)[:3, 3] for one in T])
    flat = rays.reshape(-1, cameras, 3)
    joints = triangulate_rays(origins, flat, np.ones(flat.shape[:2])).reshape(bodies, JOINTS, 3)
    if before is not None and before.joints.shape == joints.shape:
        joints = np.where(before.joints.any(axis=-1, keepdims=True), before.joints, joints)
    depth = np.einsum("nj,nj->n", T[views.camera][:, 2, :3], joints[views.body, views.joint]) + T[views.camera][:, 2, 3]
    kept = depth > 0.1
    count = np.zeros((bodies, JOINTS), dtype=int)
    np.add.at(count, (views.body[kept], views.joint[kept]), 1)
    kept &= count[views.body, views.joint] >= 2
    views = replace(
        views, **{name: getattr(views, name)[kept] for name in ("camera", "body", "joint", "pixel", "velocity", "sd")}
    )
    people = int(views.person.max()) + 1
    typical = np.log(STATURES * STATURE_M)
    lengths = np.tile(typical, (people, 1))
    if before is not None and before.log_lengths.shape == lengths.shape:
        lengths = before.log_lengths
    joints = np.where((count >= 2)[..., None], joints, np.nan)
    resting, floor = find_contacts(joints, views.person, at_s, STATURE_M)
    views = replace(views, resting=resting)
    return views, PeopleBundle(T, lenses, np.zeros(cameras), np.nan_to_num(joints), lengths, floor)


def _prior(data: _Data, start: _Start, clocks: Float64, lenses: Float64) -> BundlePrior:
    cameras = len(data.names)
    free = np.ones((cameras, CAMERA), dtype=bool)
    free[0, POSE] = free[0, CLOCK] = False
    free[:, list(LENS)] &= ~start.lens_known[:, None]
    typical = np.array([_lens(name, size, {}) for name, size in zip(data.names, data.sizes_px, strict=True)])
    sd = np.full((cameras, CAMERA), np.inf)
    sd[:, FOCAL], sd[:, CLOCK], sd[:, BEND] = FOCAL_SD, _CLOCK_SD_S, BEND_SD
    sd[:, CENTRE] = (CENTRE_SD * np.max(data.sizes_px, axis=1) / typical[:, 0])[:, None]
    mean = np.where(start.lens_known[:, None], lenses, typical)
    return BundlePrior(free, mean, -(clocks - clocks[0]), sd, STATURE_M, _alike(data) if start.same_lenses else None)


def _alike(data: _Data) -> Float64:
    """Return the matrix (cameras, cameras) that takes from each value the mean of the cameras of its image size."""
    same = np.array([[one == other for other in data.sizes_px] for one in data.sizes_px], dtype=np.float64)
    return np.asarray(np.eye(len(same)) - same / same.sum(axis=1, keepdims=True))


_CLOCK_SD_S: Final = 1.0
